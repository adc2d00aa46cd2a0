"""Tells from inertial samples whether the vehicle stands still."""

from math import hypot, sqrt

from shared.maths.rotation import Vector

QUIET_S = 0.5  # how long all conditions must hold
RATE_LIMIT = 0.012  # [rad/s]
ACCELERATION_LIMIT = 0.06  # [m/s²]
SPEED_LIMIT = 0.3  # [m/s]
SMOOTHING_S = 0.25  # time constant of the low-pass on acceleration


class StationaryDetector:
    """Says that the vehicle stands still after half a second of quiet, and takes it back at once.

    All of |w| < 0.012 rad/s, |low-passed (C f + g)| < 0.06 m/s² and |v| < 0.3 m/s must hold. A test of |f| against g
    alone would also pass while rolling evenly.
    """

    def __init__(self) -> None:
        self._acceleration: Vector = (0.0, 0.0, 0.0)
        self._quiet_s = 0.0
        self._started = False

    def fork(self) -> "StationaryDetector":
        """Copy that goes its own way."""
        twin = StationaryDetector.__new__(StationaryDetector)
        twin.__dict__.update(self.__dict__)
        return twin

    def update(self, rate: Vector, acceleration: Vector, velocity: Vector, step_s: float) -> bool:
        """Take one sample in and say whether the vehicle stands still.

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

        Returns
        -------
        bool
            True from `QUIET_S` after the vehicle came to rest until the first sample of motion.
        """
        share = min(1.0, step_s / SMOOTHING_S) if self._started else 1.0
        self._started = True
        x, y, z = self._acceleration
        x, y, z = (
            x + share * (acceleration[0] - x),
            y + share * (acceleration[1] - y),
            z + share * (acceleration[2] - z),
        )
        self._acceleration = (x, y, z)
        quiet = (
            sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2) < RATE_LIMIT
            and sqrt(x * x + y * y + z * z) < ACCELERATION_LIMIT
            and hypot(*velocity) < SPEED_LIMIT
        )
        self._quiet_s = self._quiet_s + step_s if quiet else 0.0
        return self._quiet_s >= QUIET_S
