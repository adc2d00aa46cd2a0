"""Tells from inertial samples whether the vehicle stands still."""

from math import sqrt
from typing import NamedTuple

from shared.maths.rotation import Vector

QUIET_S = 0.5  # how long all conditions must hold
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
DRIVING_M_S = 1.0  # beyond it nothing needs smoothing
SMOOTHING_S = 0.25  # time constant of the low-pass; an idling engine shakes single samples beyond both limits


class Rest(NamedTuple):
    """What the detector knows: smoothed rate [rad/s, body] and acceleration [m/s², NED], time of quiet [s]."""

    rate: Vector = (0.0, 0.0, 0.0)
    acceleration: Vector = (0.0, 0.0, 0.0)
    quiet_s: float = -SMOOTHING_S  # negative: it has yet to settle

    @property
    def stationary(self) -> bool:
        """Whether the vehicle stands still."""
        return self.quiet_s >= QUIET_S

    def after(
        self, rate: Vector, acceleration: Vector, velocity: Vector, step_s: float, speed_limit: float = SPEED_LIMIT
    ) -> "Rest":
        """Take one sample in: true from `QUIET_S` after the vehicle came to rest, and false at once when it moves.

        Parameters
        ----------
        rate : tuple of float
            [rad/s, body] Angular rate, bias removed.
        acceleration : tuple of float
            [m/s², NED] C f + g.
        velocity : tuple of float
            [m/s, NED]
        step_s : float
            [s] Time since the sample before.
        speed_limit : float
            [m/s] Larger than usual where wheels that stand still vouch for it, and the filter is uncertain.

        Returns
        -------
        Rest
            |w| < 0.012 rad/s, |C f + g| < 0.06 m/s² (both smoothed), |v| < `speed_limit` must hold for half a second.
            A test of |f| against g alone would also pass while rolling evenly.
        """
        speed = _length(velocity)
        if speed > max(DRIVING_M_S, speed_limit):
            return Rest()
        share = min(1.0, step_s / SMOOTHING_S)
        rate, acceleration = _blend(self.rate, rate, share), _blend(self.acceleration, acceleration, share)
        quiet = _length(rate) < RATE_LIMIT and _length(acceleration) < ACCELERATION_LIMIT and speed < speed_limit
        if self.quiet_s < 0.0:
            return Rest(rate, acceleration, min(0.0, self.quiet_s + step_s))
        return Rest(rate, acceleration, self.quiet_s + step_s if quiet else 0.0)


def _blend(old: Vector, new: Vector, share: float) -> Vector:
    x, y, z = old
    return x + share * (new[0] - x), y + share * (new[1] - y), z + share * (new[2] - z)


def _length(vector: Vector) -> float:
    x, y, z = vector
    return sqrt(x * x + y * y + z * z)
