"""Displacements by carrier phases as an aid: consistent over an outage, and nothing where it is not switched on."""

from collections import Counter
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.base import Measurement, Sensor
from services.core.fusion.aids.carrier.aid import CarrierPath, of_displacement
from services.core.fusion.aids.carrier.settings import CarrierSettings
from services.core.fusion.aids.gnss.fix import GnssVelocity, Reading, Stamp, gnss_measurements
from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.aids.odometer.settings import OdometerSettings
from services.core.fusion.batch import solve
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from services.sensors.simulator.drive import Drive, simulate
from services.sensors.simulator.world import messages
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body, quaternion_from_matrix
from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierDisplacement
from shared.messages.navigation import AidingKind, AidingUpdate
from shared.runtime.config import GnssAntenna, Vehicle, parse_vehicle
from shared.runtime.offline import OfflineUnit
from tests.support.drives.golden import VEHICLE

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


def outcomes_of(given: list[CarrierDisplacement]) -> list[tuple[AidingKind, int]]:
    """Kinds and seconds of what was used of velocities and displacements, from 30 s to 45 s."""
    made = settings(carrier=True)
    navigator = Navigator(made)
    navigator.use_prior(saved_heading(drive(), YAW_SD))
    measured = fixes(1, made) + [m for message in given for m in measurements_of(message, made)]
    found = []
    measured.sort(key=lambda m: m.time_ns)
    rows = zip(drive().t_ns[:4500].tolist(), drive().force_b.tolist(), drive().rate_b.tolist(), strict=False)
    for time_ns, force, rate in rows:
        while measured and measured[0].time_ns <= time_ns:
            navigator.measure(measured.pop(0))
        found += navigator.imu(time_ns, force, rate)
    wanted = AidingKind.CARRIER_DISPLACEMENT, AidingKind.GNSS_VELOCITY
    return [(o.kind, round(o.time_ns / 1e9)) for o in found if o.kind in wanted and o.used and o.time_ns > 30 * S]


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
