import numpy as np

from services.core.fusion.stationary import QUIET_S, UNSETTLED, Rest, at_rest
from shared.maths.rotation import Vector

STEP_S = 0.01
STILL: Vector = (0.0, 0.0, 0.0)


def stationary(rest: Rest) -> bool:
    return rest[2] >= QUIET_S


def after(rest: Rest, seconds: float, rate: Vector = STILL, acceleration: Vector = STILL, speed: float = 0.0) -> Rest:
    for _ in range(round(seconds / STEP_S)):
        rest = at_rest(rest, rate, acceleration, speed, STEP_S)
    return rest


def test_half_a_second_of_quiet_is_a_standstill() -> None:
    rest = after(UNSETTLED, 0.25)  # settles
    assert not stationary(after(rest, 0.48))
    assert stationary(after(rest, 0.52))


def test_each_condition_alone_prevents_it() -> None:
    assert not stationary(after(UNSETTLED, 5.0, rate=(0.0, 0.0, 0.013)))
    assert not stationary(after(UNSETTLED, 5.0, acceleration=(0.05, 0.05, 0.0)))
    assert not stationary(after(UNSETTLED, 5.0, speed=0.31))
    assert stationary(after(UNSETTLED, 5.0, rate=(0.0, 0.0, 0.011), acceleration=(0.04, 0.04, 0.0), speed=0.29))


def test_it_ends_within_a_few_samples_of_the_first_motion() -> None:
    """At 1 m/s² the smoothed acceleration passes its limit after 20 ms, and the vehicle has moved by 0.2 mm."""
    rest = after(UNSETTLED, 2.0)
    assert not stationary(after(rest, 0.02, acceleration=(1.0, 0.0, 0.0)))
    assert not stationary(after(rest, 0.05, rate=(0.0, 0.0, 0.1)))


def test_rolling_evenly_is_no_standstill() -> None:
    assert not stationary(after(UNSETTLED, 10.0, speed=10.0))


def test_an_idling_engine_does_not_end_it() -> None:
    """Single samples swing by 0.65 m/s² and 0.017 rad/s (1 sigma) at 27 Hz, as recorded in a car at rest."""
    rest = after(UNSETTLED, 2.0)
    for k in range(2000):
        swing = 2.0**0.5 * np.sin(2.0 * np.pi * 27.0 * k * STEP_S)
        rest = at_rest(rest, (0.017 * swing, 0.0, 0.0), (0.0, 0.0, 0.65 * swing), 0.0, STEP_S)
        assert stationary(rest)
