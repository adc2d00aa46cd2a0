import numpy as np
import pytest

from services.core.fusion.aids.standstill.aid import PERIOD_S, RATE_SD, SETTLING_S, Standstill
from services.core.fusion.inertial.error_model import SIZE, VELOCITY
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.inertial.standstill import (
    CERTAIN_LIMITS,
    STANDSTILL_RATE_SD,
    UNCERTAIN_QUIET_S,
    UNSETTLED,
    Limits,
    StandstillState,
    detect,
    is_standstill,
    limits_of,
)
from services.core.fusion.settings import Settings
from shared.inertial.strapdown import InertialState
from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector

STEP_S = 0.01
STILL: Vector = (0.0, 0.0, 0.0)


def after(
    rest: StandstillState,
    seconds: float,
    rate: Vector = STILL,
    acceleration: Vector = STILL,
    speed: float = 0.0,
    limits: Limits = CERTAIN_LIMITS,
) -> StandstillState:
    for _ in range(round(seconds / STEP_S)):
        rest = detect(rest, rate, acceleration, speed, STEP_S, limits)
    return rest


def uncertain(velocity_sd: float) -> Limits:
    P = np.eye(SIZE) * 1e-6
    P[VELOCITY, VELOCITY] = velocity_sd**2 * np.eye(3)
    return limits_of(P)


def test_half_a_second_below_all_limits_is_a_standstill() -> None:
    rest = after(UNSETTLED, 0.25)  # settles
    assert not is_standstill(after(rest, 0.48))
    assert is_standstill(after(rest, 0.52))


def test_each_limit_alone_prevents_a_standstill() -> None:
    assert not is_standstill(after(UNSETTLED, 5.0, rate=(0.0, 0.0, 0.013)))
    assert not is_standstill(after(UNSETTLED, 5.0, acceleration=(0.2, 0.05, 0.0)))
    assert not is_standstill(after(UNSETTLED, 5.0, speed=0.31))
    assert is_standstill(after(UNSETTLED, 5.0, rate=(0.0, 0.0, 0.011), acceleration=(0.04, 0.04, 0.0), speed=0.29))


def test_a_standstill_ends_within_50_ms_of_the_first_motion() -> None:
    """At 1 m/s² the smoothed acceleration exceeds its limit after 20 ms, when the vehicle has moved by 0.2 mm."""
    rest = after(UNSETTLED, 2.0)
    assert not is_standstill(after(rest, 0.02, acceleration=(1.0, 0.0, 0.0)))
    assert not is_standstill(after(rest, 0.05, rate=(0.0, 0.0, 0.1)))


def test_constant_speed_is_not_a_standstill() -> None:
    assert not is_standstill(after(UNSETTLED, 10.0, speed=10.0))


def test_vibration_of_an_idling_engine_does_not_end_a_standstill() -> None:
    """Vibration of 0.65 m/s² and 0.017 rad/s (1 sigma) at 27 Hz, as recorded in a car at standstill."""
    rest = after(UNSETTLED, 2.0)
    for k in range(2000):
        swing = 2.0**0.5 * np.sin(2.0 * np.pi * 27.0 * k * STEP_S)
        rest = detect(rest, (0.017 * swing, 0.0, 0.0), (0.0, 0.0, 0.65 * swing), 0.0, STEP_S, CERTAIN_LIMITS)
        assert is_standstill(rest)


def test_with_an_uncertain_velocity_a_standstill_needs_two_seconds() -> None:
    """As after a minute without GNSS: an estimated speed of 1.5 m/s at standstill, and of 0.1 m/s in motion."""
    limits, settled = uncertain(0.6), after(UNSETTLED, 0.25)
    for speed in (0.1, 1.5):
        assert not is_standstill(after(settled, UNCERTAIN_QUIET_S - 0.1, speed=speed, limits=limits))
        assert is_standstill(after(settled, UNCERTAIN_QUIET_S + 0.1, speed=speed, limits=limits))
    assert not is_standstill(after(settled, 10.0, speed=4.0, limits=limits)), "above the limit of its covariance"
    assert uncertain(0.05) == CERTAIN_LIMITS


def test_a_standstill_is_detected_with_a_tilt_error_of_half_a_degree() -> None:
    """Half a degree of tilt is 0.09 m/s² of gravity; two degrees exceed the tilt errors of a filter."""
    for limits in (CERTAIN_LIMITS, uncertain(0.6)):
        leaning = after(UNSETTLED, 0.5, acceleration=(0.5, 0.0, 0.0), limits=limits)  # braking
        leaning = after(leaning, 1.0, acceleration=(0.06, 0.06, 0.0), limits=limits)
        assert not is_standstill(leaning)
        leaning = after(leaning, UNCERTAIN_QUIET_S + 0.5, acceleration=(0.06, 0.06, 0.0), limits=limits)
        assert is_standstill(leaning)
        assert not is_standstill(after(leaning, 0.2, acceleration=(0.3, 0.06, 0.0), limits=limits)), "moving off"
        assert not is_standstill(after(UNSETTLED, 10.0, acceleration=(0.3, 0.0, 0.0), limits=limits))


def test_motion_on_a_smooth_road_is_not_a_standstill_at_an_uncertain_velocity() -> None:
    """1.5 m/s with a vertical acceleration of 0.1 m/s² and a period of 2 s, as on the smoothest recorded street."""
    rest, limits = UNSETTLED, uncertain(0.6)
    for k in range(2000):
        rest = detect(rest, STILL, (0.1 * float(np.sin(np.pi * k * STEP_S)), 0.0, 0.0), 0.1, STEP_S, limits)
        assert not is_standstill(rest)


def test_the_zaru_variance_summed_over_ten_minutes_is_that_of_the_mean_rate() -> None:
    """Variance of the mean of time-correlated and of white errors over ten minutes."""
    navigation = ErrorStateFilter(
        Settings(), InertialState(0, (1.0, 0.0, 0.0, 0.0), STILL, Geodetic(0.7, 0.2, 100.0)), np.eye(SIZE)
    )
    R = Standstill(0, STILL).observe_zero_rate(navigation).R
    count = 6000
    lags = np.arange(1, count)
    together = 1.0 + 2.0 * float(((1.0 - lags / count) * np.exp(-lags * PERIOD_S / SETTLING_S)).sum())
    mean_variance = (RATE_SD**2 + STANDSTILL_RATE_SD**2 * together) / count
    assert R[0, 0] / count == pytest.approx(mean_variance, rel=0.02)
    shaken = Standstill(0, STILL, rate_sd=0.01).observe_zero_rate(navigation).R
    assert shaken[2, 2] - R[2, 2] == pytest.approx(0.01**2 - RATE_SD**2)
