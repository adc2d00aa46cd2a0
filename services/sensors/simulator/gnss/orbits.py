"""Circular orbits as the satellites broadcast them: every parameter is a multiple of its unit in the message."""

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
import numpy.typing as npt

from shared.maths.gnss_signals import EARTH_RATE
from shared.maths.navigation_words import GPS_PI

from .navigation_words import NS, WEEK_S, Elements

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

ANGLE_UNIT = GPS_PI * 2.0**-31  # [rad]
ROOT_UNIT = 2.0**-19  # [sqrt m]
CLOCK_UNIT = 2.0**-31  # [s]
UPLOAD_S = 7200  # [s] between two ephemerides; the reference time is the nearest multiple
CLOCK_UNITS = 200_000  # satellite clocks are within ±93 us
GROUP_DELAY_UNITS = -18  # -8.4 ns


@dataclass(frozen=True)
class Broadcast:
    """Elements of n satellites at a reference time."""

    toe_s: int  # [s, GPS time]
    root: FloatArray  # shape (n,) [sqrt m] square root of the radius
    anomaly: FloatArray  # shape (n,) [rad] from the ascending node, at the reference time
    node: FloatArray  # shape (n,) [rad] longitude of the ascending node at the start of the week
    inclination: FloatArray  # shape (n,) [rad]


class Orbits:
    """n satellites in circular orbits, with clocks that are off by a constant.

    Parameters
    ----------
    number : ndarray, shape (n,)
        Within each system.
    mu : ndarray, shape (n,)
        [m³/s²] Gravitational constant of each system.
    radius, inclination : ndarray, shape (n,)
        [m], [rad].
    node, phase : ndarray, shape (n,)
        [rad] Right ascension of the node, and angle from it, at GPS time 0.
    """

    def __init__(
        self, number: IntArray, mu: FloatArray, radius: FloatArray, inclination: FloatArray, node: FloatArray,
        phase: FloatArray,
    ) -> None:  # fmt: skip
        self._number, self._node, self._phase = number, node, phase
        self._root = np.rint(np.sqrt(radius) / ROOT_UNIT) * ROOT_UNIT
        self._motion = np.sqrt(mu / self._root**6)
        self._inclination = np.rint(inclination / ANGLE_UNIT) * ANGLE_UNIT
        # Any spread of clocks does; this one needs no random numbers.
        self.clock_s = (np.arange(len(number)) * 7919 * 97 % (2 * CLOCK_UNITS) - CLOCK_UNITS) * CLOCK_UNIT
        self.group_delay_s = GROUP_DELAY_UNITS * CLOCK_UNIT
        self._broadcast = lru_cache(maxsize=2)(self._broadcast_at)

    def broadcast(self, gps_s: float) -> Broadcast:
        """Give the elements that are in force at a GPS time [s]."""
        return self._broadcast(round(gps_s / UPLOAD_S) * UPLOAD_S)

    def _broadcast_at(self, toe_s: int) -> Broadcast:
        week_s = toe_s // WEEK_S * WEEK_S
        anomaly = self._phase + self._motion * toe_s
        node = self._node - EARTH_RATE * week_s
        return Broadcast(toe_s, self._root, _in_units(anomaly), _in_units(node), self._inclination)

    def position_e(self, of: Broadcast, after_s: FloatArray, index: IntArray) -> FloatArray:
        """Compute positions.

        Parameters
        ----------
        of : Broadcast
            Elements.
        after_s : ndarray, shape () or (m,)
            [s] Since the reference time.
        index : ndarray, shape (m,)
            Which satellites.

        Returns
        -------
        ndarray, shape (m, 3)
            [m, ECEF] In the axes of that time.

        Notes
        -----
        The user algorithm of IS-GPS-200N, table 20-IV, with e = 0 and no corrections::

            u = M0 + n t,  Omega = Omega0 - w_e (t + toe),  r = a [cos u cos Omega - sin u cos i sin Omega, ...]
        """
        radius = of.root[index] ** 2
        u = of.anomaly[index] + self._motion[index] * after_s
        node = of.node[index] - EARTH_RATE * (after_s + of.toe_s % WEEK_S)
        along, across = radius * np.cos(u), radius * np.sin(u)
        level = across * np.cos(of.inclination[index])
        return np.stack([
            along * np.cos(node) - level * np.sin(node),
            along * np.sin(node) + level * np.cos(node),
            across * np.sin(of.inclination[index]),
        ], axis=1)  # fmt: skip

    def elements(self, gps_s: float, satellite: int) -> Elements:
        """Give what a satellite broadcasts at a GPS time [s]."""
        of = self.broadcast(gps_s)
        return Elements(
            number=int(self._number[satellite]),
            issue=of.toe_s // UPLOAD_S % 256,
            toe_ns=of.toe_s * NS,
            toc_ns=of.toe_s * NS,
            sqrt_a=float(of.root[satellite]),
            mean_anomaly=float(of.anomaly[satellite]),
            node=float(of.node[satellite]),
            inclination=float(of.inclination[satellite]),
            clock=(float(self.clock_s[satellite]), 0.0, 0.0),
            group_delay_s=self.group_delay_s,
        )


def _in_units(angle: FloatArray) -> FloatArray:
    """Bring angles [rad] into ±pi and to multiples of their unit."""
    wrapped: FloatArray = np.rint(((angle + pi) % (2.0 * pi) - pi) / ANGLE_UNIT)
    return np.clip(wrapped, -(2.0**31), 2.0**31 - 1) * ANGLE_UNIT
