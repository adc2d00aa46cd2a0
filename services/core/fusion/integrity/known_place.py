"""The place where the vehicle was parked before this drive, and whether it has come back to it.

A position that is off by an offset shows the vehicle beside the place where it has stood before. One that shows it
there again, standing, after it had driven away, is off by no more than both know.
"""

from dataclasses import dataclass
from math import hypot

from shared.maths.earth import Geodetic, ned_from_geodetic_difference

from .disagreement import CLOSURE_SDS, Pair

AWAY_M = 200.0  # from the place, after which the vehicle has left it
MIN_STANDSTILL_S = 10.0
MAX_LEVEL_M = 10.0  # of the saved position; what is held of an offset is part of it
MAX_DISTANCE_M: Pair = (6.0, 12.0)  # from it, as it is shown: less than half of an offset that matters


def known_well(level_m: float | None) -> bool:
    """Whether a place with a protection level [m] is one: that of a position in doubt may be where a spoofer put it."""
    return level_m is not None and level_m <= MAX_LEVEL_M


@dataclass
class KnownPlace:
    """A parking place of an earlier life of the unit."""

    position: Geodetic
    spread: Pair  # [m] standard deviation, horizontal and vertical
    is_left: bool = False
    _standing_ns: int | None = None

    def distance_m(self, position: Geodetic) -> float:
        """Horizontal distance of a position."""
        north, east, _ = ned_from_geodetic_difference(position, self.position)
        return hypot(north, east)

    def recognised(self, time_ns: int, position: Geodetic, spread: Pair, *, stationary: bool) -> bool:
        """Whether a vehicle that had left stands there again.

        Parameters
        ----------
        time_ns : int
            Stamp.
        position : Geodetic
            Of the solution in use.
        spread : tuple of float
            [m] Standard deviation of it, horizontal and vertical.
        stationary : bool
            Whether the vehicle stands.
        """
        north, east, down = ned_from_geodetic_difference(position, self.position)
        distance_m = hypot(north, east)
        self.is_left |= distance_m > AWAY_M
        self._standing_ns = (self._standing_ns or time_ns) if stationary else None
        if not self.is_left or self._standing_ns is None or (time_ns - self._standing_ns) * 1e-9 < MIN_STANDSTILL_S:
            return False
        limits = [
            min(CLOSURE_SDS * hypot(mine, its), most)
            for mine, its, most in zip(spread, self.spread, MAX_DISTANCE_M, strict=True)
        ]
        return distance_m <= limits[0] and abs(down) <= limits[1]
