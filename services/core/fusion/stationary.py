"""Tells from inertial samples whether the vehicle stands still."""

from math import sqrt

from shared.maths.rotation import Vector

QUIET_S = 0.5  # how long all conditions must hold
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
DRIVING_M_S = 1.0  # beyond it nothing needs smoothing
SMOOTHING_S = 0.25  # time constant of the low-pass; an idling engine shakes single samples beyond both limits

# What the detector knows: smoothed rate [rad/s, body] and acceleration [m/s², NED], time of quiet [s].
Rest = tuple[Vector, Vector, float]
UNSETTLED: Rest = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), -SMOOTHING_S)  # negative: it has yet to settle


def at_rest(
    rest: Rest, rate: Vector, acceleration: Vector, speed: float, step: float, speed_limit: float = SPEED_LIMIT
) -> Rest:
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
    speed_limit : float
        [m/s] Larger than usual where wheels that stand still vouch for it, and the filter is uncertain.

    Returns
    -------
    tuple
        |w| < 0.012 rad/s, |C f + g| < 0.06 m/s² (both smoothed), |v| < `speed_limit` must hold for half a second.
        A test of |f| against g alone would also pass while rolling evenly.
    """
    if speed > DRIVING_M_S and speed > speed_limit:
        return UNSETTLED
    quiet_s, share = rest[2], min(1.0, step / SMOOTHING_S)
    rate, acceleration = _blend(rest[0], rate, share), _blend(rest[1], acceleration, share)
    if quiet_s < 0.0:
        return rate, acceleration, min(0.0, quiet_s + step)
    quiet = length(rate) < RATE_LIMIT and length(acceleration) < ACCELERATION_LIMIT and speed < speed_limit
    return rate, acceleration, quiet_s + step if quiet else 0.0


def length(vector: Vector) -> float:
    """Length of a vector."""
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)


def _blend(old: Vector, new: Vector, share: float) -> Vector:
    x, y, z = old
    return x + share * (new[0] - x), y + share * (new[1] - y), z + share * (new[2] - z)
