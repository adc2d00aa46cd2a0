"""The survey: sensitivities by finite differences, the simulator as an oracle, and wrong installations found again."""

from dataclasses import replace
from functools import cache
from math import radians

import numpy as np
import pytest

from benchmarks.set_up.installation import Installation
from benchmarks.set_up.trial import GOALS, angle_of, errors, trial
from cli.set_up.drive import motion_of
from services.core.fusion.set_up.findings import Verdict
from services.core.fusion.set_up.motion import Motion, MotionLog
from services.core.fusion.set_up.survey import rows as kinds
from services.core.fusion.set_up.survey.arcs import (
    START,
    STEP_S,
    Increments,
    Path,
    Starts,
    arcs_of,
    increments_of,
    path_of,
    rotations,
    starts_of,
)
from services.core.fusion.set_up.survey.findings import LIMITS, Quantity, changes_of, findings_of
from services.core.fusion.set_up.survey.rows import ARM, AXLE, DELAY, RATIO, SLIP, TURN, WHEEL_LAG, Rows, Unknowns
from services.core.fusion.set_up.survey.survey import survey
from services.core.fusion.settings import Settings
from services.sensors.simulator.drive import simulate
from services.sensors.simulator.imu.ideal_imu import attitude_matrices
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.runtime.config import ImuMounting
from tests.support.cases import each

PLACE = Geodetic(radians(48.0), radians(11.0), 500.0)


def steered(count: int = 3, steps: int = 200) -> tuple[Increments, Starts]:
    """Arcs of a car that brakes and turns on hills."""
    rng = np.random.default_rng(1)
    time = STEP_S * np.arange(steps)
    shake = rng.uniform(0.5, 1.5, (count, 6))[:, np.newaxis] * np.sin(
        np.array([0.5, 0.8, 1.1, 0.3, 0.4, 0.6]) * time[:, np.newaxis]
    )
    force = shake[..., :3] * np.array([1.5, 1.0, 0.3]) + np.array([0.0, 0.0, -9.81])
    rate = shake[..., 3:] * np.array([0.03, 0.03, 0.3])
    attitude = rotations(rng.standard_normal((count, 3)) * np.array([0.05, 0.05, 2.0]))
    small = 0.001 * rng.standard_normal((2, count, 3))
    velocity = attitude @ np.array([9.0, 0.2, 0.1])
    begins = np.arange(0.0, 100.0 * count, 100.0)
    return Increments(begins, force, rate), Starts(attitude, velocity, rng.standard_normal((count, 3)), *small)


def moved(starts: Starts, step: FloatArray) -> Starts:
    return Starts(
        rotations(step[:3]) @ starts.attitude, starts.velocity + step[3:6], starts.position + step[6:9],
        starts.force_bias + step[9:12], starts.rate_bias + step[12:15],
    )  # fmt: skip


def path(arcs: Increments, starts: Starts) -> Path:
    return path_of(arcs, starts, np.zeros(3), np.zeros(3), PLACE)


@pytest.mark.parametrize("column", range(START))
def test_sensitivities_of_an_arc_are_its_finite_differences(column: int) -> None:
    arcs, starts = steered()
    size = 1e-5
    step = np.zeros(START)
    step[column] = size
    here, there, back = path(arcs, starts), path(arcs, moved(starts, step)), path(arcs, moved(starts, -step))
    turn = there.attitude @ back.attitude.transpose(0, 1, 3, 2)
    vector = 0.5 * np.stack([
        turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1],
    ], axis=-1)  # fmt: skip
    # Over ten seconds the steps of 50 ms and the rotation of the Earth make a part in a thousand of it.
    for found, by in (
        (vector, here.attitude_by), (there.velocity - back.velocity, here.velocity_by),
        (there.position - back.position, here.position_by),
    ):  # fmt: skip
        expected = by[..., column]
        assert found / (2.0 * size) == pytest.approx(expected, rel=5e-3, abs=5e-3 * max(1.0, np.abs(expected).max()))


@cache
def town() -> tuple[Installation, Motion, Increments, Starts]:
    """A drive of a correct installation whose measurements are disturbed by nothing but their noise."""
    installation = replace(
        Installation.random(0), mounting=np.eye(3), delay_s=0.0, scale=1.0, flex=0.0, vibration=(0.0, 0.0),
        bank_rad=0.0, wind_up=0.0, slip=0.0, imu=np.zeros(3),
    )  # fmt: skip
    motion = motion_of(installation.messages(installation.settings, 1), installation.settings)
    assert motion is not None
    arcs = arcs_of(motion, motion.of_receiver())
    assert arcs is not None
    return installation, motion, arcs, starts_of(arcs, motion, motion.of_receiver(), np.zeros(3))


def all_rows(of: Unknowns, arcs: Increments, starts: Starts, motion: Motion) -> list[Rows]:
    assert motion.place is not None
    found = path_of(arcs, starts, of.force_bias, of.rate_bias, motion.place)
    of_gnss = [*kinds.positions(motion, arcs.begin, found, of), *kinds.velocities(motion, arcs.begin, found, of)]
    return [*of_gnss, *kinds.constraints(arcs.begin, found, of), *kinds.speeds(motion, arcs.begin, found, of)]


@each(
    ("column", "size"),
    [
        *((ARM.start + axis, 1e-3) for axis in range(3)), (DELAY, 1e-4),
        *((TURN.start + axis, 1e-4) for axis in range(3)),
        (AXLE.start, 1e-3), (AXLE.start + 1, 1e-3), (RATIO, 1e-4), (WHEEL_LAG, 1e-4), (SLIP, 1e-4),
    ],
)  # fmt: skip
def test_derivatives_of_innovations_are_their_finite_differences(column: int, size: float) -> None:
    """What a step of the search changes an innovation by is what the derivative says."""
    _, motion, arcs, starts = town()
    arcs = Increments(arcs.begin[:4], arcs.force[:4], arcs.rate[:4])
    starts = Starts(*(values[:4] for values in vars(starts).values()))
    of = Unknowns(arm=np.array([0.3, 0.1, -1.0]), axle=np.array([-0.5, 0.1]), wheel_lag_s=0.05, slip=0.002)
    before = all_rows(of, arcs, starts, motion)
    step = np.zeros(kinds.SHARED)
    step[column] = size
    turn = rotations(step[TURN])
    turned = replace(starts, attitude=starts.attitude @ turn)
    after = all_rows(of.changed(step, turn), arcs.turned(turn), turned, motion)
    for kind, (first, second) in enumerate(zip(before, after, strict=True)):
        if len(first.z) != len(second.z):  # a row has passed a threshold
            continue
        change = (first.z - second.z) / size
        # Between nodes accelerations change; turns change the rates of axle and level as well, which is small
        # beside the speed. The next step starts from there.
        of_velocity = column == DELAY and kind >= 2
        loose, small = 0.6 if of_velocity else 0.03, 0.03 if TURN.start <= column < TURN.stop else 1e-3
        assert np.abs(change - first.shared[:, column]).mean() <= loose * np.abs(first.shared[:, column]).mean() + small


def test_an_arc_of_ideal_measurements_is_the_path_that_the_simulator_drove() -> None:
    """Begun with the truth, ten seconds end within 5 cm of it: the simulator integrates exactly, in steps of 10 ms."""
    drive = simulate("urban", 3, 90.0)
    log = MotionLog()
    forces, rates = map(tuple, drive.ideal_force_b.tolist()), map(tuple, drive.ideal_rate_b.tolist())
    log.samples(tuple(drive.t_ns.tolist()), tuple(forces), tuple(rates))
    motion = log.motion()
    assert motion is not None
    begin_s, span_s = 50.0, 10.0
    arcs = increments_of(motion, np.array([begin_s]), span_s)
    first, last = (
        int(np.searchsorted(drive.t_ns, round((begin_s + more) * 1e9) + drive.t_ns[0])) for more in (0.0, span_s)
    )
    track = ned_track(drive.position, Geodetic(*drive.position[first].tolist()))
    attitude = attitude_matrices(drive.attitude[[first]])
    starts = Starts(attitude, drive.velocity_n[[first]], np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))
    found = path_of(arcs, starts, np.zeros(3), np.zeros(3), Geodetic(*drive.position[first].tolist()))
    assert found.velocity[0, -1] == pytest.approx(drive.velocity_n[last], abs=0.01)
    assert found.position[0, -1] == pytest.approx(track[last], abs=0.05)


def test_a_correct_installation_changes_nothing() -> None:
    installation, motion, _, _ = town()
    settings = installation.settings.with_values({"vehicle.gnss.lever_arm_body_m": installation.arm.tolist()})
    findings = findings_of(survey(motion, settings), settings)
    assert changes_of(findings) == {}
    assert {one.quantity for one in findings if one.verdict is Verdict.AGREES} >= {
        Quantity.MOUNTING, Quantity.LEVER_ARM, Quantity.DELAY, Quantity.ODOMETER_SCALE
    }  # fmt: skip


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_survey_of_turned_axes_is_the_turned_survey(mirrored: bool) -> None:
    """All but the mounting stays, and the mounting is turned: nothing prefers an axis of the sensor."""
    installation, motion, _, _ = town()
    settings = installation.settings
    turn = rotations(np.array([1.0, -0.7, 2.0])) @ np.diag([1.0, -1.0 if mirrored else 1.0, 1.0])
    integrals = np.concatenate([turn @ motion.integrals[:3], turn @ motion.integrals[3:]])
    plain, other = survey(motion, settings), survey(replace(motion, integrals=integrals), settings)
    assert plain.matrix is not None and other.matrix is not None and plain.adjusted and other.adjusted
    assert angle_of((turn @ plain.matrix).T @ other.matrix) < radians(0.01)
    assert other.adjusted.of.arm == pytest.approx(plain.adjusted.of.arm, abs=1e-3)
    assert other.adjusted.of.delay_s == pytest.approx(plain.adjusted.of.delay_s, abs=1e-4)
    proposed = findings_of(other, settings)[0]
    rows = proposed.changes["vehicle.imu.body_from_sensor"]
    assert isinstance(rows, list)
    ImuMounting(body_from_sensor=tuple(tuple(row) for row in rows))  # type: ignore[arg-type]


@each("seed", [1, 4])
def test_a_wrong_installation_is_within_the_goals_after_two_drives(seed: int) -> None:
    """The small form of benchmarks/set_up: a car park, and a receiver with errors of metres."""
    found = trial(seed)
    for quantity, (goal, _) in GOALS.items():
        left = found.left[quantity.value]
        assert left.known and left.after < goal, quantity


def test_a_motorway_shows_no_lever_arm_and_writes_none() -> None:
    installation = Installation.random(7)
    assert installation.scenario == "highway"
    settings = installation.settings
    motion = motion_of(installation.messages(settings, 1), settings)
    assert motion is not None
    findings = {one.quantity: one for one in findings_of(survey(motion, settings), settings)}
    arm = findings[Quantity.LEVER_ARM]
    assert arm.verdict is Verdict.UNKNOWN and not arm.changes and arm.sd is not None
    assert arm.known == pytest.approx(LIMITS[Quantity.LEVER_ARM].sd / arm.sd) and arm.known < 1.0
    assert findings[Quantity.MOUNTING].verdict is Verdict.CONTRADICTS
    before, settings = (
        errors(installation, settings),
        settings.with_values(
            {name.removeprefix("core.fusion."): value for name, value in changes_of(list(findings.values())).items()}
        ),
    )
    assert errors(installation, settings)[Quantity.LEVER_ARM] == before[Quantity.LEVER_ARM]


def test_a_parked_vehicle_shows_nothing() -> None:
    _, motion, _, _ = town()
    still = replace(
        motion, velocities=np.zeros((0, 4)), speeds=np.zeros((0, 2)),
        positions=np.column_stack([motion.positions[:, 0], np.zeros((len(motion.positions), 3))]),
    )  # fmt: skip
    findings = findings_of(survey(still, Settings()), Settings())
    assert {one.verdict for one in findings} == {Verdict.UNKNOWN} and changes_of(findings) == {}
    assert [one.known for one in findings] == [0.0] * len(Quantity)


def test_measurements_that_no_car_makes_change_nothing() -> None:
    """Velocities of another vehicle: the model does not describe them, and that is said."""
    _, motion, _, _ = town()
    rng = np.random.default_rng(3)
    wild = motion.velocities.copy()
    wild[:, 1:] += 8.0 * rng.standard_normal(wild[:, 1:].shape)
    findings = findings_of(survey(replace(motion, velocities=wild), Settings()), Settings())
    assert changes_of(findings) == {}
