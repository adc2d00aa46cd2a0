"""Barometer, dual antenna and magnetometer: effect on the solution, and rejected measurements."""

from functools import cache
from math import cos, degrees, radians, sin

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cli.papers.navigation import give_fix
from services.core.fusion.aids.barometer.aid import BarometricHeight
from services.core.fusion.aids.barometer.atmosphere import pressure_height
from services.core.fusion.aids.barometer.settings import BarometerSettings
from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.dual_antenna.aid import BaselineHeading
from services.core.fusion.aids.magnetometer.aid import MAX_SECTOR_ERROR, SECTORS, CompassCheck, MagneticHeading
from services.core.fusion.aids.magnetometer.settings import MagnetometerSettings
from services.core.fusion.aids.non_holonomic.settings import NonHolonomicSettings
from services.core.fusion.aids.odometer.settings import OdometerSettings
from services.core.fusion.aids.standstill.settings import StandstillSettings
from services.core.fusion.codes import Code, HeadingMethod
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import AlignmentSettings, Settings
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import Drive, simulate
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.maths.geoid.geoid import separation_m
from shared.maths.rotation import Vector, ned_from_body, quaternion_from_matrix
from shared.messages.explanation import explain
from shared.messages.navigation import AidingKind, NavigationPhase
from shared.runtime.config import GnssAntenna, Vehicle

FloatArray = npt.NDArray[np.float64]

STATE = InertialState(
    0, quaternion_from_matrix(ned_from_body(0.1, -0.2, 0.7)), (12.0, -9.0, 0.5), Geodetic(0.7, 0.2, 300.0)
)
DECLINATION = radians(4.0)
OFFSET_M = 61.0  # of barometric height above the ellipsoid: weather and geoid
OUTAGE_S = (60.0, 110.0)


def wrong_by(error: FloatArray) -> ErrorStateFilter:
    """Filter with a given error, estimated minus true."""
    C = Rotation.from_rotvec(error[em.ATTITUDE]).as_matrix() @ ned_from_body(0.1, -0.2, 0.7)
    north, east, down = error[em.POSITION].tolist()
    state = STATE._replace(
        quaternion=quaternion_from_matrix(C), position=geodetic_from_ned_difference((north, east, down), STATE.position)
    )
    return ErrorStateFilter(Settings(), state, np.eye(em.SIZE), parameters=tuple(error[em.PARAMETERS].tolist()))


@pytest.mark.parametrize(
    "measurement",
    [
        BarometricHeight(0, 0, "", 310.0, Settings()),
        BaselineHeading(0, 0, "", 0.4, 0.01, 0.3),
        MagneticHeading(0, 0, "", (0.5, -0.1, 0.8), DECLINATION),
    ],
    ids=["barometer", "baseline", "compass"],
)
def test_the_measurement_matrices_agree_with_finite_differences(
    measurement: BarometricHeight | BaselineHeading | MagneticHeading,
) -> None:
    H = measurement.observe(wrong_by(np.zeros(em.SIZE))).H
    for j in range(em.SIZE):
        step = np.zeros(em.SIZE)
        step[j] = 1e-5
        ahead, behind = measurement.observe(wrong_by(step)).z, measurement.observe(wrong_by(-step)).z
        tilt_left_out = isinstance(measurement, MagneticHeading) and j < 2
        if not tilt_left_out:
            assert (ahead - behind) / 2e-5 == pytest.approx(H[:, j], abs=1e-6)


@given(st.floats(-300.0, 4000.0))
def test_the_height_of_a_pressure_is_that_of_the_standard_atmosphere(height: float) -> None:
    pressure = 101_325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588  # ICAO Doc 7488
    assert pressure_height(pressure) == pytest.approx(height, abs=0.02)


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=5, duration_s=OUTAGE_S[1])


def pressure_at(i: int, shift_m: float = 0.0) -> float:
    """Pressure at a sample, with a noise of 2 Pa."""
    height = float(drive().position[i, 2]) + OFFSET_M + shift_m
    noise = 2.0 * float(np.random.default_rng((7, i)).standard_normal())
    return float(101_325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588 + noise)


def field_at(i: int, iron: Vector = (0.0, 0.0, 0.0)) -> Vector:
    """Magnetic field in body axes, with the field of iron in the vehicle."""
    north, east, down = cos(1.0) * cos(DECLINATION), cos(1.0) * sin(DECLINATION), sin(1.0)
    x, y, z = (ned_from_body(*drive().attitude[i].tolist()).T @ (north, east, down) + iron).tolist()
    return x, y, z


def processed(
    *,
    pressure: bool = False,
    shifted: tuple[float, float] = (1e9, 0.0),
    iron: Vector | None = None,
    outage: bool = True,
    seconds: float = OUTAGE_S[1],
    qnh_hpa: float | None = None,
) -> tuple[Navigator, list[Outcome]]:
    """Process the drive; the pressure height has a step at a time."""
    d = drive()
    made = Navigator(
        Settings(
            vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=d.lever_arm_b)),
            magnetometer=MagnetometerSettings(enabled=iron is not None, declination_rad=DECLINATION),
            odometer=OdometerSettings(enabled=False),
            non_holonomic=NonHolonomicSettings(enabled=False),
            standstill=StandstillSettings(enabled=False),
            barometer=BarometerSettings(qnh_hpa=qnh_hpa),
        )
    )
    outcomes: list[Outcome] = []
    for i, time_ns in enumerate(d.t_ns.tolist()):
        if time_ns > seconds * 1e9:
            break
        if pressure and i % 10 == 9:
            pressure_pa = pressure_at(i, shifted[1] if time_ns >= shifted[0] * 1e9 else 0.0)
            made.measure(BarometricHeight(time_ns, time_ns, "imu", pressure_pa, made.settings))
        if iron is not None and i % 10 == 9:
            made.measure(MagneticHeading(time_ns, time_ns, "imu", field_at(i, iron), DECLINATION))
        if i % 100 == 99 and not (outage and time_ns >= OUTAGE_S[0] * 1e9):
            give_fix(d, i // 100, made)
        outcomes += made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
    return made, outcomes


def height_error(made: Navigator) -> tuple[float, float]:
    """Error of the height, and its standard deviation."""
    solution = made.solution()
    assert solution is not None
    i = int(np.searchsorted(drive().t_ns, solution.time_ns))
    return solution.position.height - float(drive().position[i, 2]), float(solution.position_cov[2, 2]) ** 0.5


def of_kind(outcomes: list[Outcome], kind: AidingKind) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.kind is kind]


def test_a_barometer_halves_the_height_deviation_in_an_outage() -> None:
    """Fifty seconds without GNSS, odometer or standstill."""
    made, outcomes = processed(pressure=True)
    error, sd = height_error(made)
    without, without_sd = height_error(processed()[0])
    assert abs(error) < 3.0 * sd and abs(without) < 3.0 * without_sd
    assert sd < 1.0 < 0.5 * without_sd
    heights = of_kind(outcomes, AidingKind.BAROMETRIC_HEIGHT)
    assert len(heights) > 80 and np.mean([o.used for o in heights]) > 0.97
    filtered = made.engine.filter
    assert filtered is not None
    offset_sd = float(filtered.P[LAYOUT.index("barometer_offset"), LAYOUT.index("barometer_offset")]) ** 0.5
    assert abs(filtered.parameter(LAYOUT.index("barometer_offset")) - OFFSET_M) < 3.0 * offset_sd < 5.0


def test_a_stated_qnh_gives_the_offset_at_the_start() -> None:
    place = Geodetic(*drive().position[0].tolist())
    separation = separation_m(degrees(place.latitude), degrees(place.longitude))
    qnh_hpa = 1013.25 * (1.0 - 2.25577e-5 * (OFFSET_M + separation)) ** 5.25588  # of air whose offset is OFFSET_M
    sd, offset = {}, LAYOUT.index("barometer_offset")
    for stated in (None, qnh_hpa):
        made, _ = processed(seconds=OUTAGE_S[0] / 2.0, qnh_hpa=stated)
        filtered = made.engine.filter
        assert filtered is not None
        sd[stated] = float(filtered.P[offset, offset]) ** 0.5
    assert filtered is not None and filtered.parameter(offset) == pytest.approx(OFFSET_M, abs=0.5)
    assert 5.0 < sd[qnh_hpa] < 0.1 * sd[None]  # the temperature is not known
    off = Settings(barometer=BarometerSettings(enabled=False, qnh_hpa=qnh_hpa))
    assert LAYOUT.block("barometer_offset").known(off, place) is None


def test_a_pressure_step_is_rejected_and_the_height_stays_within_three_sigma() -> None:
    made, outcomes = processed(pressure=True, shifted=(OUTAGE_S[0] - 20.0, 12.0), outage=False)
    rejected = [o for o in of_kind(outcomes, AidingKind.BAROMETRIC_HEIGHT) if o.time_ns > (OUTAGE_S[0] - 19.0) * 1e9]
    assert rejected and not rejected[0].used and rejected[0].reason == "beyond the gate"
    error, sd = height_error(made)
    assert abs(error) < 3.0 * sd < 1.5


@pytest.mark.parametrize("pressure_pa", [0.0, -5.0, 1e9])
def test_a_pressure_of_no_road_is_counted(pressure_pa: float) -> None:
    made = Navigator()
    made.measure(BarometricHeight(1, 1, "imu", pressure_pa, made.settings))
    assert made.rejects == {"implausible pressure": 1}


def test_two_antennas_give_the_heading_at_standstill() -> None:
    d, yaw_body, sd = drive(), radians(90.0), radians(0.3)
    made = Navigator(
        Settings(
            vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=d.lever_arm_b)),
            alignment=AlignmentSettings(levelling_s=5.0),
        )
    )
    started_ns = None
    for i, time_ns in enumerate(d.t_ns[:1600].tolist()):
        if i % 100 == 99:
            position = Geodetic(*d.fix_position[i // 100].tolist())
            made.measure(BaselineHeading(time_ns, time_ns, "gnss", float(d.attitude[i, 2]) + yaw_body, sd, yaw_body))
            made.fix(time_ns, position=position, velocity=(0.0, 0.0, 0.0), position_sd=(1.0, 1.0, 2.0))
        made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        if started_ns is None and made.phase is NavigationPhase.NAVIGATING:
            started_ns = time_ns
            assert made.why == (explain(Code.STARTED, method=HeadingMethod.TWO_ANTENNAS),)
    solution = made.solution()
    assert solution is not None and np.hypot(*d.velocity_n[1599, :2]) == 0.0, "at standstill"
    assert solution.yaw == pytest.approx(float(d.attitude[1599, 2]), abs=3.0 * sd)
    assert solution.attitude_cov[2, 2] ** 0.5 < sd, "smaller than that of one heading"


def test_a_dual_antenna_heading_that_contradicts_the_filter_is_rejected() -> None:
    made, _ = processed(outage=False, seconds=60.0)
    d, at = drive(), int(drive().t_ns[5999])
    made.measure(BaselineHeading(at + 1, at + 1, "gnss", float(d.attitude[5999, 2]) + 0.5, 0.005, 0.0))
    outcomes: list[Outcome] = []
    for i in range(6000, 6050):
        outcomes += made.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
    (heading,) = of_kind(outcomes, AidingKind.BASELINE_HEADING)
    assert not heading.used and heading.reason == "beyond the gate"


def test_a_magnetometer_is_used_once_four_known_headings_have_confirmed_it() -> None:
    outcomes = of_kind(processed(iron=(0.01, -0.01, 0.02), outage=False)[1], AidingKind.MAGNETIC_HEADING)
    first = next(i for i, o in enumerate(outcomes) if o.used)
    assert outcomes[first - 1].reason == "not yet judged by 4 known headings"
    assert np.mean([o.used for o in outcomes[first:]]) > 0.95
    assert max(abs(o.innovation[0]) for o in outcomes[first:]) < radians(10.0)


def test_a_magnetometer_disturbed_by_iron_is_rejected_with_a_reason() -> None:
    outcomes = of_kind(processed(iron=(0.2, 0.1, 0.0), outage=False)[1], AidingKind.MAGNETIC_HEADING)
    assert not any(o.used for o in outcomes)
    reasons = {o.reason for o in outcomes}
    assert "field of another strength than the Earth's" in reasons or any("errs by up to" in str(r) for r in reasons)


def test_magnetometer_errors_are_averaged_by_sectors_of_heading() -> None:
    check = CompassCheck()
    for k in range(4):
        assert check.spread is None
        check = check.after(2.0 * np.pi * (k + 0.5) / SECTORS, 0.01 * (k + 1))
    assert check.spread == pytest.approx(0.04)
    assert MAX_SECTOR_ERROR > 0.04
    shaken = check.after(0.1, 1.0)
    assert shaken.errors[0] == pytest.approx(0.01 + 0.1 * 0.99), "one reading has a weight of a tenth"
    seen = MagneticHeading(0, 0, "", (0.5, 0.1, 0.8), 0.0, CompassCheck((0.3, 0.3, 0.3, 0.3) + (None,) * 4))
    assert seen.unfit == f"errs by up to {degrees(0.3):.0f} degrees"
