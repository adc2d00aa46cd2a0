"""Odometer and non-holonomic constraint: drift in outages, estimated parameters, and rejected speeds."""

from copy import copy, deepcopy
from dataclasses import replace
from functools import cache
from math import hypot, radians

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.starts.start import Receiver, Start
from cli.papers.navigation import give_fix
from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.gate import Gate
from services.core.fusion.aids.non_holonomic.aid import NonHolonomic
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.aids.odometer.zero_speeds import ZeroSpeeds
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.inertial.standstill import QUIET_S, SMOOTHING_S, UNSETTLED, Limits, detect, is_standstill
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Prior
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body
from shared.messages.navigation import AidingKind
from tests.support.drives.starts import manoeuvre

FloatArray = npt.NDArray[np.float64]

MOUNTING = (0.0, radians(2.0), radians(-1.5))  # roll, pitch, yaw of the IMU against the vehicle
OUTAGE_S = (80.0, 110.0)
ARM_B = (0.0, 0.0, 0.0)  # the simulated vehicle turns about the IMU


@cache
def drive() -> Drive:
    """110 s of the car park with a rotated IMU."""
    straight = simulate("parking_lot", seed=3, duration_s=OUTAGE_S[1])
    body_from_vehicle = ned_from_body(*MOUNTING).T
    force, rate = straight.force_b @ body_from_vehicle.T, straight.rate_b @ body_from_vehicle.T
    forward, right, down = (body_from_vehicle @ straight.lever_arm_b).tolist()
    return replace(straight, force_b=force, rate_b=rate, lever_arm_b=(forward, right, down))


def navigator(**changes: object) -> Navigator:
    d = drive()
    made = Navigator(
        Settings().with_values(
            {"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "vehicle.rear_axle_body_m": ARM_B, **changes}
        )
    )
    yaw = float(d.attitude[0, 2]) + MOUNTING[2]
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), yaw, radians(1.0)))
    return made


def feed(
    made: Navigator, speeds: FloatArray | None, begin: int = 0, end: int | None = None, *, outage: bool = True
) -> list[Outcome]:
    """Process the drive, or the samples from `begin` to `end` of it."""
    d = drive()
    outcomes: list[Outcome] = []
    for i, time_ns in list(enumerate(d.t_ns.tolist()))[begin:end]:
        if speeds is not None and i % 10 == 9:
            made.speed(time_ns, float(speeds[(i + 1) // 10]))
        if i % 100 == 99 and not (outage and time_ns * 1e-9 >= OUTAGE_S[0]):
            give_fix(d, i // 100, made)
        outcomes += made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
    return outcomes


def error_m(made: Navigator) -> float:
    """Horizontal error at the end."""
    solution = made.solution()
    assert solution is not None
    return hypot(*ned_from_geodetic_difference(solution.position, Geodetic(*drive().position[-1].tolist()))[:2])


def filter_of(made: Navigator) -> ErrorStateFilter:
    inside = made.engine.filter  # the vehicle parameters are not published
    assert inside is not None
    return inside


@cache
def unaided() -> tuple[Navigator, list[Outcome]]:
    """Drive with odometer and NHC disabled."""
    made = navigator(**{"odometer.enabled": False, "non_holonomic.enabled": False})
    return made, feed(made, drive().odometer)


@cache
def aided_until(end: int) -> Navigator:
    """Navigator after some samples with true wheel speeds."""
    made = navigator()
    feed(made, drive().odometer, end=end)
    return made


@cache
def aided() -> tuple[Navigator, list[Outcome]]:
    made = navigator()
    return made, feed(made, drive().odometer * 1.03)


def mounting(navigation: ErrorStateFilter) -> FloatArray:
    """Vehicle from body, by the mounting angles of a filter."""
    pitch, yaw = (navigation.parameter(place) for place in range(em.SIZE)[LAYOUT.place("mounting")])
    return ned_from_body(0.0, pitch, yaw)


def test_odometer_and_nhc_halve_the_drift_in_an_outage_and_keep_it_below_0_3_m() -> None:
    assert error_m(aided()[0]) < min(0.3, 0.5 * error_m(unaided()[0]))


def test_scale_and_mounting_are_estimated_within_four_sigma() -> None:
    inside = filter_of(aided()[0])
    d = drive()
    moving = d.odometer > 1.0
    truth = np.hypot(d.velocity_n[:, 0], d.velocity_n[:, 1])
    scale = 1.03 * float(np.median(d.odometer[1:][moving[1:]] / truth[9::10][moving[1:]])) - 1.0
    sd = np.sqrt(inside.P.diagonal()[LAYOUT.index("odometer_scale") : LAYOUT.place("mounting").stop])
    errors = np.array(inside.parameters[:3]) - (scale, MOUNTING[1], MOUNTING[2])
    assert (np.abs(errors) < 4.0 * sd).all()
    assert sd[0] < 0.005 and (sd[1:] < radians(0.7)).all(), "much smaller than the initial ones"


def test_odometer_and_nhc_have_outcomes_and_98_percent_are_used() -> None:
    outcomes = aided()[1]
    assert {o.kind for o in outcomes} >= {AidingKind.ODOMETER, AidingKind.NON_HOLONOMIC}
    wheels = [o for o in outcomes if o.kind in (AidingKind.ODOMETER, AidingKind.NON_HOLONOMIC)]
    assert np.mean([o.used for o in wheels]) > 0.98
    assert all(o.reason == "beyond the gate" for o in wheels if not o.used)


def test_disabled_odometer_and_nhc_are_not_used_and_estimate_nothing() -> None:
    made, outcomes = unaided()
    kinds = {o.kind for o in outcomes}
    assert not kinds & {AidingKind.ODOMETER, AidingKind.NON_HOLONOMIC}
    assert filter_of(made).parameters[:3] == (0.0, 0.0, 0.0)
    cross = filter_of(made).P[LAYOUT.index("odometer_scale") : LAYOUT.place("mounting").stop, :15]
    assert not cross.any(), "no correlation with the other fifteen states"


def test_the_lateral_nhc_variance_grows_in_bends_and_the_vertical_one_does_not() -> None:
    """On a straight the two configured deviations; in a bend at 10 m/s lateral slip is added."""
    settings = Settings().with_values({"vehicle.rear_axle_body_m": ARM_B})
    twin = reversing(-10.0, 0.1)
    twin.state = twin.state._replace(rate_b=(0.0, 0.0, 0.0))
    straight = NonHolonomic(0, settings).observe(twin).R
    assert np.diagonal(straight).tolist() == pytest.approx([10.0 * 0.05**2, 10.0 * 0.1**2])
    twin.state = twin.state._replace(rate_b=(0.0, 0.0, 0.2))
    bend = NonHolonomic(0, settings).observe(twin).R
    assert bend[0, 0] == pytest.approx(10.0 * (0.05**2 + (0.006 * 10.0**2 * 0.2) ** 2), rel=0.01)
    assert bend[1, 1] == straight[1, 1]


def test_speeds_of_spinning_wheels_are_rejected() -> None:
    """Wheel speeds of three times the true speed, as on ice."""
    speeds = drive().odometer.copy()
    speeds[900:] *= 3.0
    made = deepcopy(aided_until(8900))
    outcomes = [o for o in feed(made, speeds, 8900) if o.kind is AidingKind.ODOMETER and o.time_ns > 91e9]
    fast = [o for o in outcomes if abs(o.innovation[0]) > 2.0]
    assert len(fast) > 20 and not any(o.used for o in fast)


def test_a_second_odometer_is_used_once_the_first_one_is_silent() -> None:
    made = navigator()
    d = drive()
    for k, time_ns in enumerate(d.odometer_ns.tolist()):
        made.speed(time_ns, float(d.odometer[k]), source="can" if time_ns < 70e9 else "spare")
    outcomes = feed(made, None, outage=False)
    used = {name: [o.time_ns for o in outcomes if o.source == name] for name in ("can", "spare")}
    assert max(used["can"]) < 70e9 and min(used["spare"]) > 71.9e9, "two seconds after the last speed of the first"


def reversing(speed_m_s: float, velocity_sd: float) -> ErrorStateFilter:
    """A filter at a speed backwards, with a standard deviation of its velocity."""
    twin = copy(filter_of(aided()[0]))
    twin.propagate_covariance()
    north, east, _ = (twin.ned_from_body @ mounting(twin).T @ np.array([-speed_m_s, 0.0, 0.0])).tolist()
    twin.state = twin.state._replace(velocity=(north, east, 0.0))
    P = twin.P.copy()
    P[em.VELOCITY] = P[:, em.VELOCITY] = 0.0
    P[em.VELOCITY, em.VELOCITY] = velocity_sd**2 * np.eye(3)
    twin.P = P
    return twin


@pytest.mark.parametrize("speed_m_s", [0.2, 3.0])
def test_an_unsigned_speed_agrees_with_driving_backwards(speed_m_s: float) -> None:
    twin = reversing(speed_m_s, 0.05)
    seen = WheelSpeed(0, 0, "", speed_m_s, 0.0, True, True, navigator().settings).observe(twin)
    assert abs(float(seen.z[0])) < 0.02 + 0.06 * speed_m_s  # the scale of the odometer is not one


def test_an_unsigned_speed_at_unknown_sign_has_mean_zero_and_variance_of_its_square() -> None:
    """The mean of +1 and -1 m/s is zero and the variance one."""
    twin = reversing(0.0, 0.5)
    seen = WheelSpeed(0, 0, "", 1.0, 0.0, True, True, navigator().settings).observe(twin)
    assert abs(float(seen.z[0])) < 0.05
    assert 1.0 < float(seen.R[0, 0]) < 1.01


def test_a_negative_speed_is_measured_with_its_sign() -> None:
    twin = reversing(1.0, 0.05)
    seen = WheelSpeed(0, 0, "", -1.0, 0.0, True, True, navigator().settings).observe(twin)
    assert abs(float(seen.z[0])) < 0.05
    assert float(seen.R[0, 0]) < 0.01


def test_speeds_rejected_for_two_seconds_are_used_in_the_end() -> None:
    """A velocity error of 1 m/s with a small covariance, which grows after two seconds of rejections."""
    settings = navigator().settings
    twin, gate = reversing(-5.0, 0.02), Gate(settings)
    before = twin.P[em.VELOCITY, em.VELOCITY].copy()
    used = []
    for k in range(600):
        seen = WheelSpeed(k * 100_000_000, 0, "", 6.2, 0.0, True, True, settings)
        used.append(gate.use(twin, seen, seen.observe(twin)).used)
        if k == 15:
            assert (twin.P[em.VELOCITY, em.VELOCITY] == before).all()
    assert not any(used[:20]) and all(used[-50:])
    ahead = twin.ned_from_body.T @ np.array(twin.velocity)
    assert abs(hypot(ahead[0], ahead[1]) - 6.0) < 0.4


def stationary_after(speed: float, limit: float, force: float = 0.0) -> bool:
    rest = UNSETTLED
    for _ in range(round((SMOOTHING_S + QUIET_S) * 100) + 2):
        rest = detect(rest, (0.0, 0.0, 0.0), (force, 0.0, 0.0), speed, 0.01, Limits(limit, 1.0))
    return is_standstill(rest)


def test_zero_wheel_speeds_widen_the_speed_limit_of_the_standstill_detector_only() -> None:
    """After a minute without GNSS the estimated speed at standstill may be 1.5 m/s."""
    assert not stationary_after(1.5, limit=0.3)
    assert stationary_after(1.5, limit=2.0)
    assert not stationary_after(2.5, limit=2.0), "above the limit"
    assert not stationary_after(1.5, limit=2.0, force=0.5), "locked wheels on ice"


@pytest.mark.parametrize(("speed", "supports"), [(0.0, True), (0.4, False)])
def test_only_current_zero_wheel_speeds_widen_the_limit_of_the_standstill_detector(
    speed: float, supports: bool
) -> None:
    made, share = deepcopy(aided_until(8900)), np.interp(np.arange(1101), [1000, 1050], [0.0, 1.0])
    feed(made, share * (speed - drive().odometer) + drive().odometer, 8900)
    aids = made.engine.aids
    inside = filter_of(made)
    inside.inflate(velocity_sd=1.0)
    limit, pace, _ = aids.standstill_limits(inside.time_ns, inside)
    assert limit > 3.0
    assert (pace == 1.0) is supports, "otherwise a longer time below the limits is needed"
    if supports:
        assert aids.standstill_limits(inside.time_ns + 3 * 10**9, inside).pace < 1.0, (
            "three seconds after the last zero speed"
        )


def test_the_first_zero_wheel_speed_reduces_a_velocity_error_of_0_3_m_s_below_0_04_m_s() -> None:
    """Velocity errors of 0.2 m/s to the side and downwards after an outage."""
    twin = reversing(0.0, 0.3)
    slide = twin.ned_from_body @ mounting(twin).T @ np.array([0.0, 0.2, 0.2])
    twin.state = twin.state._replace(velocity=(float(slide[0]), float(slide[1]), float(slide[2])))
    twin.state = twin.state._replace(rate_b=(0.0, 0.0, 0.0))
    settings = navigator().settings
    outcome = Gate(settings).use(twin, zero := wheels(0.0, settings), zero.observe(twin))
    assert outcome.used and len(outcome.innovation) == 3
    assert hypot(*twin.velocity) < 0.04
    assert np.sqrt(twin.P[em.VELOCITY, em.VELOCITY].trace()) < 0.3


@pytest.mark.parametrize("before", [None, 12.0])
def test_zero_speeds_of_a_failed_odometer_are_rejected(before: float | None) -> None:
    """It never indicated motion, or fell from 12 m/s to zero within 0.1 s; the velocity deviation is 2 m/s."""
    settings = navigator().settings
    zeros = ZeroSpeeds()
    if before is not None:
        zeros = zeros.after(0, before)
        assert zeros.doubt is None
    zeros = zeros.after(100_000_000, 0.0)
    twin = reversing(-5.0, 2.0)
    zero = wheels(0.0, settings, zeros.doubt)
    outcome = Gate(settings).use(twin, zero, zero.observe(twin))
    assert not outcome.used and outcome.reason == zeros.doubt
    assert hypot(*twin.velocity) > 4.5
    assert zeros.after(200_000_000, 5.0).after(700_000_000, 0.0).doubt is None, "a plausible deceleration"


def wheels(speed: float, settings: Settings, doubt: str | None = None) -> WheelSpeed:
    return WheelSpeed(0, 0, "", speed, 0.0, True, True, settings, doubt=doubt)


@pytest.mark.parametrize(("period_s", "step_m_s"), [(0.1, 0.0), (1.0, 1.0 / 3.6)])
def test_a_stop_in_an_outage_is_a_standstill_within_two_seconds(period_s: float, step_m_s: float) -> None:
    """After 20 s without GNSS the car stops; wheel speeds, or OBD in steps of 1 km/h, are zero."""
    legs = (
        (12.0, 0.0, 0.0),
        (5.0, 1.6, 0.0),
        (8.0, 0.0, 0.08),
        (12.0, 0.0, -0.08),
        (8.0, -1.0, 0.05),
        (10.0, 0.0, 0.0),
    )
    car = Start(manoeuvre(legs, seed=4, yaw=1.0), Receiver(rate_hz=4), 0.0, 0.0, 5)
    made = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": car.drive.lever_arm_b}))
    truth = np.hypot(car.drive.velocity_n[:, 0], car.drive.velocity_n[:, 1])
    every, stops = round(period_s * 100), 45.0
    speeds_at_stop = []
    for i, _ in car.lead(made, 55.0, until_s=25.0):
        if i % every == 0:
            speed = truth[i] if step_m_s == 0.0 else np.floor(truth[i] / step_m_s) * step_m_s
            made.speed(
                int(car.drive.t_ns[i]), float(speed), resolution=step_m_s, of_wheels=step_m_s == 0.0, exact=False
            )
        solution = made.solution()
        if solution and car.drive.t_ns[i] * 1e-9 > stops + 1.7 + period_s:
            speeds_at_stop.append(hypot(*solution.velocity))
    assert len(speeds_at_stop) > 500
    assert max(speeds_at_stop) < 0.03
