"""Displacements by carrier phases as an aid: consistent over an outage, and nothing where it is not switched on."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.aiding import CARRIED
from services.core.fusion.aids.base import Measurement, Outcome, Sensor
from services.core.fusion.aids.carrier.aid import CarrierPath, of_displacement
from services.core.fusion.aids.carrier.settings import CarrierSettings
from services.core.fusion.aids.gnss.fix import GnssVelocity, Reading, Stamp, gnss_measurements
from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.aids.odometer.settings import OdometerSettings
from services.core.fusion.batch import solve
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.integrity.innovation_statistics import Axis
from services.core.fusion.messages import aiding_message
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.core.spoofing.drift.monitor import DriftMonitor
from services.core.spoofing.grade import Grade
from services.core.spoofing.process import Config
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.world import messages
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body, quaternion_from_matrix
from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierDisplacement
from shared.messages.navigation import AidingKind, AidingUpdate
from shared.messages.trust import Outcome as Verdict
from shared.runtime.config import GnssAntenna, Vehicle, parse_vehicle
from shared.runtime.offline import OfflineUnit
from shared.trust.result import Test
from tests.support.drives.golden import VEHICLE
from tests.support.drives.yaw_rates import solution_of

FloatArray = npt.NDArray[np.float64]

DURATION_S, OUTAGE_S = 140.0, 75.0
NOISE_M, DRIFT_M_S, CORRELATION_S = 0.003, 0.003, 300.0  # of one epoch, and of the integrated path, each axis
FIX_SD_M, VELOCITY_SD_M_S = 0.02, 0.05
SEEDS = range(1, 13)
S = 1_000_000_000


@cache
def drive() -> Drive:
    return simulate("urban", 1, DURATION_S)


def settings(*, carrier: bool) -> Settings:
    return Settings(
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive().lever_arm_b)),
        odometer=OdometerSettings(enabled=False), carrier=CarrierSettings(enabled=carrier),
    )  # fmt: skip


def antennas() -> list[Geodetic]:
    """Places of the antenna at whole seconds."""
    found = []
    for k in range(99, len(drive().t_ns), 100):
        north, east, down = (ned_from_body(*drive().attitude[k]) @ drive().lever_arm_b).tolist()
        found.append(geodetic_from_ned_difference((north, east, down), Geodetic(*drive().position[k].tolist())))
    return found


def isotropic(variance: float) -> Symmetric3:
    return variance, 0.0, 0.0, variance, 0.0, variance


def displacements(seed: int) -> list[CarrierDisplacement]:
    """True displacements, the noise of two epochs, and a drift of minutes: no part of the code that is tested."""
    rng = np.random.default_rng(seed)
    noise, drift = NOISE_M * rng.standard_normal((200, 3)), DRIFT_M_S * rng.standard_normal(3)
    left = np.exp(-1.0 / CORRELATION_S)
    places, found = antennas(), []
    for k in range(1, len(places)):
        moved = np.array(ned_from_geodetic_difference(places[k], places[k - 1]))
        drift = left * drift + DRIFT_M_S * np.sqrt(1.0 - left**2) * rng.standard_normal(3)
        north, east, down = (moved + noise[k] - noise[k - 1] + drift).tolist()
        found.append(
            CarrierDisplacement(
                sampled_ns=(k + 1) * S, received_ns=(k + 1) * S, source="gnss", since_ns=k * S,
                displacement_ned_m=(north, east, down), slow_cov_ned_m2=isotropic(DRIFT_M_S**2),
                displacement_cov_ned_m2=isotropic(2.0 * NOISE_M**2 + DRIFT_M_S**2),
                satellites_used=9, redundancy=5, checked=True,
            )
        )  # fmt: skip
    return found


def fixes(seed: int, made: Settings) -> list[Measurement]:
    """Precise positions until the outage, and velocities throughout."""
    rng, found = np.random.default_rng((seed, 1)), []
    for k, place in enumerate(antennas()):
        time_ns = (k + 1) * S
        north, east, down = (FIX_SD_M * rng.standard_normal(3)).tolist()
        index = 100 * k + 99
        swing = ned_from_body(*drive().attitude[index]) @ np.cross(drive().ideal_rate_b[index], drive().lever_arm_b)
        vn, ve, vd = (drive().velocity_n[index] + swing + VELOCITY_SD_M_S * rng.standard_normal(3)).tolist()
        both = gnss_measurements(
            made, Stamp(time_ns, time_ns, "gnss"), geodetic_from_ned_difference((north, east, down), place),
            Reading((0.0, 0.0, 0.0), FIX_SD_M**2 * np.eye(3)), Reading((vn, ve, vd), VELOCITY_SD_M_S**2 * np.eye(3)),
            fixed=True,
        )  # fmt: skip
        found += [m for m in both if isinstance(m, GnssVelocity) or time_ns <= OUTAGE_S * S]
    return found


@cache
def solved(seed: int, *, carrier: bool = True) -> dict[int, Solution]:
    """Solutions by whole seconds since the beginning of the outage."""
    made = settings(carrier=carrier)
    navigator = Navigator(made)
    navigator.use_prior(saved_heading(drive(), YAW_SD))
    measured = fixes(seed, made)
    for message in displacements(seed):
        measured += measurements_of(message, made)
    samples = np.hstack([drive().force_b, drive().rate_b])
    found = solve(navigator, drive().t_ns, samples, measured, every_ns=S)
    return {round(one.time_ns / 1e9 - OUTAGE_S): one for one in found}


def error_of(solution: Solution) -> FloatArray:
    k = int(np.searchsorted(drive().t_ns, solution.time_ns))
    return np.array(ned_from_geodetic_difference(solution.position, Geodetic(*drive().position[k].tolist())))


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [1, 10, 60])
def test_the_integrated_path_is_consistent(after_s: int) -> None:
    """36 normalised squares have a mean of 1 +- 0.24: 0.91, 0.65 and 0.45 after 1, 10 and 60 s."""
    squares = []
    for seed in SEEDS:
        solution = solved(seed)[after_s]
        error = error_of(solution)
        squares.append(error @ np.linalg.solve(solution.position_cov, error) / 3.0)
    assert 0.3 < np.mean(squares) < 1.7


@pytest.mark.slow
def test_a_minute_without_positions_is_better_by_carrier_than_by_velocity() -> None:
    by_carrier, by_velocity = (
        np.mean([np.sum(error_of(solved(seed, carrier=carrier)[60]) ** 2) for seed in (1, 2, 3)]) ** 0.5
        for carrier in (True, False)
    )
    assert by_carrier < 0.2 * by_velocity  # 5 and 41 cm


def test_nothing_is_measured_where_it_is_not_switched_on() -> None:
    message = displacements(1)[0]
    assert measurements_of(message, Settings()) == []
    assert len(measurements_of(message, settings(carrier=True))) == 1


def navigated(
    given: list[CarrierDisplacement], velocities: list[Measurement] | None = None, wrong_ns: int | None = None,
) -> tuple[Navigator, list[Outcome]]:  # fmt: skip
    """Navigator after 45 s, and outcomes of velocities and displacements from 30 s on.

    At `wrong_ns` the velocity of the filter becomes wrong by 2 m/s, which its covariance does not know.
    """
    made = settings(carrier=True)
    navigator = Navigator(made)
    navigator.use_prior(saved_heading(drive(), YAW_SD))
    measured = [*fixes(1, made), *(velocities or []), *(m for message in given for m in measurements_of(message, made))]
    found: list[Outcome] = []
    measured.sort(key=lambda m: m.time_ns)
    rows = zip(drive().t_ns[:4500].tolist(), drive().force_b.tolist(), drive().rate_b.tolist(), strict=False)
    for time_ns, force, rate in rows:
        while measured and measured[0].time_ns <= time_ns:
            navigator.measure(measured.pop(0))
        found += navigator.imu(time_ns, force, rate)
        if time_ns == wrong_ns:
            running = navigator.engine.filter
            assert isinstance(running, ErrorStateFilter)
            north, east, down = running.velocity
            running.inertial = running.inertial._replace(velocity=(north + 2.0, east, down))
    wanted = AidingKind.CARRIER_DISPLACEMENT, AidingKind.GNSS_VELOCITY
    return navigator, [o for o in found if o.kind in wanted and o.time_ns > 30 * S]


@cache
def undisturbed() -> tuple[Navigator, list[Outcome]]:
    return navigated(displacements(1))


def outcomes_of(given: list[CarrierDisplacement]) -> list[tuple[AidingKind, int]]:
    """Kinds and seconds of what was used of velocities and displacements, from 30 s to 45 s."""
    return [(o.kind, round(o.time_ns / 1e9)) for o in navigated(given)[1] if o.used]


def moved(one: CarrierDisplacement, north_m: float) -> CarrierDisplacement:
    north, east, down = one.displacement_ned_m
    return one.model_copy(update={"displacement_ned_m": (north + north_m, east, down)})


def of_kind(outcomes: list[Outcome], kind: AidingKind, *, used: bool) -> list[int]:
    return [round(o.time_ns / 1e9) for o in outcomes if o.kind is kind and o.used is used]


def test_wrong_displacements_are_left_out_and_velocities_are_used() -> None:
    wrong = [moved(one, 1.0) if one.sampled_ns >= 34 * S else one for one in displacements(1)]
    _, outcomes = navigated(wrong)
    assert of_kind(outcomes, AidingKind.CARRIER_DISPLACEMENT, used=False) == [34, 35, 36]
    velocities = of_kind(outcomes, AidingKind.GNSS_VELOCITY, used=True)
    assert velocities == list(range(35, velocities[-1] + 1)) and velocities[-1] >= 43


def test_one_wrong_displacement_ends_the_path_for_one_epoch() -> None:
    wrong = [moved(one, 1.0) if one.sampled_ns == 34 * S else one for one in displacements(1)]
    _, outcomes = navigated(wrong)
    assert of_kind(outcomes, AidingKind.CARRIER_DISPLACEMENT, used=False) == [34]
    assert of_kind(outcomes, AidingKind.GNSS_VELOCITY, used=True) == [35], "until a displacement is used again"
    assert set(range(35, 43)) <= set(of_kind(outcomes, AidingKind.CARRIER_DISPLACEMENT, used=True))


def test_velocities_put_a_filter_right_whose_velocity_is_wrong() -> None:
    """By its own path the filter would reject displacements that are right."""
    navigator, outcomes = navigated(displacements(1), wrong_ns=36 * S)
    assert of_kind(outcomes, AidingKind.CARRIER_DISPLACEMENT, used=False)
    assert of_kind(outcomes, AidingKind.GNSS_VELOCITY, used=True)
    running = navigator.engine.filter
    assert isinstance(running, ErrorStateFilter)
    k = int(np.searchsorted(drive().t_ns, running.time_ns))
    assert np.abs(np.array(running.velocity) - drive().velocity_n[k]).max() < 0.3


def test_velocities_that_are_left_out_are_tested_and_velocities_between_are_used() -> None:
    """At ten velocities a second; those of another receiver are used in every epoch."""
    made = settings(carrier=True)
    template = next(m for m in fixes(1, made) if isinstance(m, GnssVelocity))
    between = []
    for k in range(99, len(drive().t_ns), 10):
        time_ns = int(drive().t_ns[k])
        swing = ned_from_body(*drive().attitude[k]) @ np.cross(drive().ideal_rate_b[k], drive().lever_arm_b)
        north, east, down = (drive().velocity_n[k] + swing).tolist()
        if time_ns % S:
            between.append(replace(template, time_ns=time_ns, received_ns=time_ns, velocity=(north, east, down)))
    _, outcomes = navigated(displacements(1), list(between))
    velocities = [o for o in outcomes if o.kind is AidingKind.GNSS_VELOCITY]
    whole = [o for o in velocities if o.time_ns % S == 0]
    assert whole and all(not o.used and o.reason == CARRIED for o in whole)
    assert len(velocities) - len(whole) >= 9 * (len(whole) - 1)
    assert all(o.used for o in velocities if o.time_ns % S)


@pytest.mark.parametrize(
    ("past_s", "source", "rejections", "carried"),
    [
        (0.0, "gnss", 0, True), (0.0, "gnss/nmea", 0, True), (1.0, "gnss", 0, True), (0.1, "gnss", 0, False),
        (0.9, "gnss", 0, False), (2.0, "gnss", 0, False), (0.0, "gnss2", 0, False), (0.0, "gnss", 1, False),
    ],
)  # fmt: skip
def test_a_path_carries_velocities_of_its_epochs(past_s: float, source: str, rejections: int, *, carried: bool) -> None:
    velocity = next(m for m in fixes(1, settings(carrier=True)) if isinstance(m, GnssVelocity))
    path = CarrierPath("gnss", 10 * S, S, 5 * S, Geodetic(0.7, 0.2, 300.0), rejections=rejections)
    late = replace(velocity, time_ns=10 * S + round(past_s * S), source=source).corrected(0.0, 0.2)
    assert path.carries(late) is carried


def test_a_displacement_over_a_long_interval_is_not_used() -> None:
    made = settings(carrier=True)
    one = displacements(1)[1]
    for since_s, checked in ((1.0, True), (2.0, True), (2.1, False)):
        (made_of,) = of_displacement(one.model_copy(update={"since_ns": one.sampled_ns - round(since_s * S)}), made)
        assert made_of.checked is checked


def test_levels_know_of_displacements() -> None:
    """Steps that pass the gate show in the statistics, and the largest undetected shift is that of displacements."""
    navigator, _ = undisturbed()
    aids = navigator.engine.aids
    assert aids.error_monitor.displacement.time_ns > 40 * S and aids.error_monitor.velocity.time_ns > 40 * S
    assert aids.undetected_shift.kinds[AidingKind.CARRIER_DISPLACEMENT].change[em.VELOCITY].max() > 0.0
    assert AidingKind.GNSS_VELOCITY not in aids.undetected_shift.kinds, "its last one was used long ago"
    wrong = replace(aids.error_monitor.displacement, axes=(Axis(mean_square=9.0, mean_ratio=9.0),) * 3)
    monitor = replace(aids.error_monitor, displacement=wrong)
    assert monitor.scale_horizontal > 8.0 and monitor.scale_vertical > 7.0 and monitor.overstatement == 8.5


def test_the_drift_monitor_sees_a_drift_of_velocities_that_are_left_out() -> None:
    """It takes messages of innovations, used or not: white ones are evaluated, a drag of the velocity accuses."""
    found = {}
    for drag in (0.0, 0.15):
        monitor, rng = DriftMonitor(Config(grade=Grade.INDUSTRIAL), Counter()), np.random.default_rng(3)
        _, outcomes = undisturbed()
        sd = next(o.innovation_sd for o in outcomes if o.reason == CARRIED)
        one = next(aiding_message(o) for o in outcomes if o.reason == CARRIED)
        tests: Mapping[str, Test] = {}
        for second in range(1, 90):
            monitor.solution(solution_of(second * S, 0.0, stationary=False))
            z = np.array(sd) * rng.standard_normal(3) + drag
            innovation = one.model_copy(update={"sampled_ns": second * S, "innovation": tuple(z.tolist())})
            monitor.innovation(innovation)
            tests = monitor.verdicts(second * S + S // 2)
        found[drag] = tests["velocity_30"].outcome
    assert found == {0.0: Verdict.PASS, 0.15: Verdict.ACCUSES}


def test_an_epoch_has_a_displacement_or_a_velocity_and_an_unchecked_one_neither() -> None:
    unchecked = [
        one.model_copy(update={"checked": one.sampled_ns not in (36 * S, 37 * S, 38 * S)}) for one in displacements(1)
    ]
    used = outcomes_of(unchecked)
    seconds = [second for _, second in used]
    assert len(seconds) == len(set(seconds)), "never both in one epoch"
    kinds = {second: kind for kind, second in used}
    assert all(kinds[second] is AidingKind.CARRIER_DISPLACEMENT for second in (32, 33, 34, 35, 42, 43))
    assert 36 not in kinds, "carried up to here, and nothing found of a slip"
    assert kinds[38] is kinds[37] is AidingKind.GNSS_VELOCITY


@pytest.mark.slow
def test_the_unit_uses_the_displacements_of_its_own_receiver() -> None:
    """Bytes of the simulated receiver through all processes: displacements once ephemerides are there, after 30 s."""
    text = VEHICLE.read_text(encoding="utf-8") + "\n[core.fusion.carrier]\nenabled = true\n"
    unit, used, seconds = OfflineUnit(parse_vehicle(text)), Counter[AidingKind](), Counter[int]()
    for message in unit.run(messages("parking_lot", 2, 70.0)):
        if isinstance(message, AidingUpdate) and message.used:
            used[message.kind] += 1
            if message.kind in (AidingKind.CARRIER_DISPLACEMENT, AidingKind.GNSS_VELOCITY):
                seconds[message.sampled_ns // S] += 1
    assert used[AidingKind.CARRIER_DISPLACEMENT] > 30 > used[AidingKind.GNSS_VELOCITY] > 0
    assert set(seconds.values()) == {1}


def test_the_measurement_matrix_agrees_with_finite_differences() -> None:
    made = settings(carrier=True)
    place = Geodetic(0.7, 0.2, 300.0)
    path = CarrierPath("gnss", 1 * S, S, 1 * S, place)
    (measurement,) = of_displacement(
        displacements(1)[1].model_copy(update={"since_ns": 1 * S, "sampled_ns": 2 * S}), made
    )
    along = measurement.after(path)
    assert along.sensor is Sensor.GNSS and along.path.anchor_ns == S

    def wrong_by(error: FloatArray) -> ErrorStateFilter:
        C = Rotation.from_rotvec(error[em.ATTITUDE]).as_matrix() @ ned_from_body(0.1, -0.2, 0.7)
        north, east, down = error[em.POSITION].tolist()
        state = InertialState(
            0, quaternion_from_matrix(C), (12.0, -9.0, 0.5), geodetic_from_ned_difference((north, east, down), place)
        )
        return ErrorStateFilter(made, state, np.eye(em.SIZE), parameters=tuple(error[em.PARAMETERS].tolist()))

    H = along.observe(wrong_by(np.zeros(em.SIZE))).H
    for j in range(em.SIZE):
        step = np.zeros(em.SIZE)
        step[j] = 1e-4
        ahead, behind = along.observe(wrong_by(step)).z, along.observe(wrong_by(-step)).z
        assert (ahead - behind) / 2e-4 == pytest.approx(H[:, j], abs=3e-5)
