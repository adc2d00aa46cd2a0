"""Standstill detector: rate, acceleration and speed that stay small for half a second.

A filter whose tilt is wrong sees an acceleration where there is none, but a constant one: up to 0.2 m/s² it is enough
that the acceleration stays within 0.06 m/s² of its value when the quiet began, for 2 s. A filter whose speed is
uncertain cannot go by it: seen slow, the vehicle may roll evenly; seen to move, it may stand. Its limit of the speed is
three standard deviations, and the more they are, the longer the quiet has to last, up to 2 s. In 70 minutes of
driving with five cars the smoothed rate and acceleration never stayed within the limits for 1.5 s.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable
from shared.maths.rotation import Vector

FloatArray = npt.NDArray[np.float64]

QUIET_S = 0.5  # how long all conditions must hold
UNCERTAIN_QUIET_S = 2.0  # the same for a filter that does not know its speed or its tilt
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
DRIVING_M_S = 1.0  # beyond it the detector starts anew
SPEED_SDS = 3.0  # of the velocity, within which it may be zero
TILT_ACCELERATION_LIMIT = 0.2  # [m/s²] what a tilt that is wrong by 1.2 degrees makes of gravity
SMOOTHING_S = (
    0.25  # time constant of the low-pass; the vibration of an idling engine exceeds both limits in single samples
)
SLOWEST_PACE = QUIET_S / UNCERTAIN_QUIET_S


class Quiet(NamedTuple):
    """State of the detector."""

    rate: Vector  # [rad/s, body] smoothed
    acceleration: Vector  # [m/s², NED] smoothed
    quiet_s: float  # how long all conditions have held; negative while the low-pass settles
    reference: Vector  # [m/s², NED] acceleration when the quiet began


class Limits(NamedTuple):
    """Speed [m/s] below which the vehicle may stand, and pace [-] at which the time of quiet counts.

    `tilted_pace` holds while a constant acceleration may be a tilt.
    """

    speed: float
    pace: float
    tilted_pace: float = QUIET_S / UNCERTAIN_QUIET_S


UNSETTLED = Quiet((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), -SMOOTHING_S, (0.0, 0.0, 0.0))
CERTAIN = Limits(SPEED_LIMIT, 1.0)


@compilable
def detect(quiet: Quiet, rate: Vector, acceleration: Vector, speed: float, step: float, limits: Limits) -> Quiet:
    """Update the detector by one sample.

    Parameters
    ----------
    quiet : Quiet
        Of the samples before.
    rate : tuple of float
        [rad/s, body] Angular rate, bias removed.
    acceleration : tuple of float
        [m/s², NED] C f + g; a test of |f| against g alone would also pass while rolling evenly.
    speed : float
        [m/s] Length of the velocity.
    step : float
        [s] Time since the sample before.
    limits : Limits
        Of this filter.

    Returns
    -------
    Quiet
        |w| < 0.012 rad/s, |C f + g| < 0.06 m/s² (both smoothed) and |v| < 0.3 m/s let its time grow; the first
        motion sets it to zero.
    """
    if speed > DRIVING_M_S and speed > limits.speed:
        return UNSETTLED
    share, pace = min(1.0, step / SMOOTHING_S), limits.pace
    rate, acceleration = low_pass(quiet.rate, rate, share), low_pass(quiet.acceleration, acceleration, share)
    if quiet.quiet_s < 0.0:
        return Quiet(rate, acceleration, min(0.0, quiet.quiet_s + step), quiet.reference)
    if norm(acceleration) >= ACCELERATION_LIMIT:
        (x, y, z), (a, b, c) = acceleration, quiet.reference
        if norm((x - a, y - b, z - c)) >= ACCELERATION_LIMIT or norm(acceleration) >= TILT_ACCELERATION_LIMIT:
            return Quiet(rate, acceleration, 0.0, acceleration)
        pace = min(pace, limits.tilted_pace)
    holds = norm(rate) < RATE_LIMIT and speed < limits.speed
    return Quiet(rate, acceleration, quiet.quiet_s + pace * step if holds else 0.0, quiet.reference)


@compilable
def stands(quiet: Quiet) -> bool:
    """Whether the vehicle stands still."""
    return quiet.quiet_s >= QUIET_S


def limits_of(P: FloatArray) -> Limits:
    """Limits for a filter of this covariance."""
    speed = SPEED_SDS * sqrt(P.item(3, 3) + P.item(4, 4) + P.item(5, 5))
    return CERTAIN if speed <= SPEED_LIMIT else Limits(speed, max(SLOWEST_PACE, SPEED_LIMIT / speed))


@compilable
def norm(vector: Vector) -> float:
    """Length of a vector."""
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


@compilable
def low_pass(old: Vector, new: Vector, share: float) -> Vector:
    """Move a vector towards another by a share of their difference."""
    x, y, z = old
    return x + share * (new[0] - x), y + share * (new[1] - y), z + share * (new[2] - z)
