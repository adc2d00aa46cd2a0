"""Standstill detector: angular rate, acceleration and speed below their limits for half a second.

A tilt error adds a constant acceleration: up to 0.2 m/s² it is enough that the acceleration stays within 0.06 m/s² of
its value at the beginning, for 2 s. With an uncertain velocity the speed limit is three standard deviations; the larger
it is, the longer the conditions must hold, up to 2 s, because the vehicle may roll at constant speed. In 70 minutes of
driving with five cars the smoothed rate and acceleration never stayed within the limits for 1.5 s.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compilable
from shared.maths.rotation import Vector

from . import error_model as em

FloatArray = npt.NDArray[np.float64]

QUIET_S = 0.5  # time for which all conditions must hold
UNCERTAIN_QUIET_S = 2.0  # the same for a filter with uncertain velocity or tilt
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
DRIVING_M_S = 1.0  # speed above which the detector is reset
SPEED_SDS = 3.0  # standard deviations of the velocity within which it may be zero
TILT_ACCELERATION_LIMIT = 0.2  # [m/s²] gravity times a tilt error of 1.2 degrees
SMOOTHING_S = 0.25  # time constant of the low-pass: single samples of an idling engine exceed both limits
STANDSTILL_RATE_SD = 2e-4  # [rad/s] of the mean rate over a standstill of a few seconds
SLOWEST_PACE = QUIET_S / UNCERTAIN_QUIET_S


class StandstillState(NamedTuple):
    """State of the detector."""

    rate: Vector  # [rad/s, body] smoothed
    acceleration: Vector  # [m/s², NED] smoothed
    quiet_s: float  # time for which all conditions have held; negative while the low-pass settles
    reference: Vector  # [m/s², NED] acceleration at the beginning of that time


class Limits(NamedTuple):
    """Speed [m/s] below which the vehicle may be at standstill, and factor [-] on the time that is counted.

    `tilted_pace` is the factor while there is a constant acceleration, which may be a tilt error.
    """

    speed: float
    pace: float
    tilted_pace: float = QUIET_S / UNCERTAIN_QUIET_S


UNSETTLED = StandstillState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), -SMOOTHING_S, (0.0, 0.0, 0.0))
CERTAIN_LIMITS = Limits(SPEED_LIMIT, 1.0)


@compilable
def detect(
    quiet: StandstillState, rate: Vector, acceleration: Vector, speed: float, step: float, limits: Limits
) -> StandstillState:
    """Update the detector by one sample.

    Parameters
    ----------
    quiet : Quiet
        State after the samples before.
    rate : tuple of float
        [rad/s, body] Angular rate, bias removed.
    acceleration : tuple of float
        [m/s², NED] C f + g; a test of |f| against g alone would also pass while rolling evenly.
    speed : float
        [m/s] Length of the velocity.
    step : float
        [s] Time since the sample before.
    limits : Limits
        Limits of this filter.

    Returns
    -------
    Quiet
        Its time grows while |w| < 0.012 rad/s, |C f + g| < 0.06 m/s² (both smoothed) and |v| < 0.3 m/s; otherwise
        it is zero.
    """
    if speed > DRIVING_M_S and speed > limits.speed:
        return UNSETTLED
    share, pace = min(1.0, step / SMOOTHING_S), limits.pace
    rate, acceleration = low_pass(quiet.rate, rate, share), low_pass(quiet.acceleration, acceleration, share)
    if quiet.quiet_s < 0.0:
        return StandstillState(rate, acceleration, min(0.0, quiet.quiet_s + step), quiet.reference)
    if norm(acceleration) >= ACCELERATION_LIMIT:
        (x, y, z), (a, b, c) = acceleration, quiet.reference
        if norm((x - a, y - b, z - c)) >= ACCELERATION_LIMIT or norm(acceleration) >= TILT_ACCELERATION_LIMIT:
            return StandstillState(rate, acceleration, 0.0, acceleration)
        pace = min(pace, limits.tilted_pace)
    holds = norm(rate) < RATE_LIMIT and speed < limits.speed
    return StandstillState(rate, acceleration, quiet.quiet_s + pace * step if holds else 0.0, quiet.reference)


@compilable
def is_standstill(quiet: StandstillState) -> bool:
    """Whether the vehicle is at standstill."""
    return quiet.quiet_s >= QUIET_S


@compilable
def limits_of(P: FloatArray, wheels_stand: bool = False) -> Limits:
    """Limits for a filter with covariance P; with wheels at zero speed, an uncertain filter needs no longer time."""
    k = em.VELOCITY.start
    speed = SPEED_SDS * sqrt(float(P[k, k]) + float(P[k + 1, k + 1]) + float(P[k + 2, k + 2]))
    if speed <= SPEED_LIMIT:
        speed, pace = SPEED_LIMIT, 1.0
    else:
        pace = max(SLOWEST_PACE, SPEED_LIMIT / speed)
    return Limits(speed, 1.0, 1.0) if wheels_stand else Limits(speed, pace, SLOWEST_PACE)


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
