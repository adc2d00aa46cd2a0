"""What the vertical level holds while nobody knows which way the heights of GNSS count."""

from shared.messages.gnss import GnssFix

from ..solution import Solution


class HeightSign:
    """Widens the vertical level until a check has seen the sign of the heights.

    Receivers' protocols define it. Columns of a file do not: there, up to twice the change of height since the start
    may be wrong.
    """

    def __init__(self) -> None:
        self._assumed = False
        self._first_m: float | None = None  # height of the first solution

    def see(self, fix: GnssFix) -> None:
        """Take from a fix whether its sign is assumed."""
        if fix.height_ellipsoid_m is not None or fix.height_msl_m is not None:
            self._assumed = fix.height_sign_assumed

    def widened(self, solution: Solution, *, known: bool) -> Solution:
        """Solution whose vertical level reaches to the one with the other sign; the same if the sign is `known`."""
        if known or not self._assumed:
            return solution
        height_m = solution.position.height
        self._first_m = height_m if self._first_m is None else self._first_m
        apart_m = 2.0 * (height_m - self._first_m)
        return solution.reaching((0.0, 0.0, apart_m), (0.0, solution.protection_level_vertical))
