"""Tells from inertial samples whether the vehicle stands still."""

from math import sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import Vector

QUIET_S = 0.5  # how long all conditions must hold
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
DRIVING_M_S = 1.0  # beyond it nothing needs smoothing
DOUBT_S = 2.0  # of quiet that prove a rest to a filter that does not know its speed: no road is smooth for so long
DOUBT_SDS = 3.0  # of the velocity, within which it may be none
LEAN_LIMIT = 0.2  # [m/s²] that a tilt wrong by 1.2 degrees makes of gravity
SMOOTHING_S = 0.25  # time constant of the low-pass; an idling engine shakes single samples beyond both limits

# What the detector knows: smoothed rate [rad/s, body] and acceleration [m/s², NED], time of quiet [s], and the
# acceleration about which it is quiet.
Rest = tuple[Vector, Vector, float, Vector]
# Speed [m/s] below which a filter may be at rest, and pace [-] at which quiet counts: where the speed says little, it
# has to last.
Doubt = tuple[float, float]
FloatArray = npt.NDArray[np.float64]
STILL: Vector = (0.0, 0.0, 0.0)
UNSETTLED: Rest = (STILL, STILL, -SMOOTHING_S, STILL)  # negative: it has yet to settle
SURE: Doubt = (SPEED_LIMIT, 1.0)
PATIENCE = QUIET_S / DOUBT_S  # pace of a filter that is not sure


def at_rest(rest: Rest, rate: Vector, acceleration: Vector, speed: float, step: float, doubt: Doubt = SURE) -> Rest:
    """Take one sample in: quiet for `QUIET_S` is at rest, and the first motion ends it.

    Parameters
    ----------
    rest : tuple
        What the detector knew before.
    rate : tuple of float
        [rad/s, body] Angular rate, bias removed.
    acceleration : tuple of float
        [m/s², NED] C f + g.
    speed : float
        [m/s] Length of the velocity.
    step : float
        [s] Time since the sample before.
    doubt : tuple of float
        See `Doubt`.

    Returns
    -------
    tuple
        |w| < 0.012 rad/s, |C f + g| < 0.06 m/s² (both smoothed), |v| < 0.3 m/s must hold for half a second.
        A test of |f| against g alone would also pass while rolling evenly.

    Notes
    -----
    A filter whose tilt is wrong sees an acceleration where there is none, but an even one: up to 0.2 m/s² it is enough
    that for 2 s it stays within 0.06 m/s² of where it was when the quiet began.
    """
    speed_limit, pace = doubt
    if speed > DRIVING_M_S and speed > speed_limit:
        return UNSETTLED
    quiet_s, share = rest[2], min(1.0, step / SMOOTHING_S)
    rate, acceleration, about = blend(rest[0], rate, share), blend(rest[1], acceleration, share), rest[3]
    if quiet_s < 0.0:
        return rate, acceleration, min(0.0, quiet_s + step), STILL
    if length(acceleration) >= ACCELERATION_LIMIT:
        x, y, z = acceleration
        if (
            length((x - about[0], y - about[1], z - about[2])) >= ACCELERATION_LIMIT
            or length(acceleration) >= LEAN_LIMIT
        ):
            return rate, acceleration, 0.0, acceleration
        pace = min(pace, PATIENCE)
    quiet = length(rate) < RATE_LIMIT and speed < speed_limit
    return rate, acceleration, quiet_s + pace * step if quiet else 0.0, about


def doubt_of(P: FloatArray) -> Doubt:
    """Find how far a filter of this covariance can go by its own speed.

    Without GNSS and wheels its speed says less and less. Seen slow, the vehicle may yet roll evenly; seen to move, it
    may stand. What a road does to a vehicle tells them apart, if it is waited for: in 70 minutes of driving with five
    cars rate and acceleration, smoothed as here, never stayed within 0.012 rad/s and 0.06 m/s² of a value for 1.5 s.
    """
    speed = DOUBT_SDS * sqrt(P[3, 3] + P[4, 4] + P[5, 5])
    return SURE if speed <= SPEED_LIMIT else (speed, max(PATIENCE, SPEED_LIMIT / speed))


def length(vector: Vector) -> float:
    """Length of a vector."""
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


def blend(old: Vector, new: Vector, share: float) -> Vector:
    """Go a share of the way from one vector to another."""
    x, y, z = old
    return x + share * (new[0] - x), y + share * (new[1] - y), z + share * (new[2] - z)
