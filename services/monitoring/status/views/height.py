"""Height above mean sea level: by the receiver's own geoid where it states one, else by a coarse grid."""

from typing import Literal, NamedTuple

from shared.maths.geoid.geoid import SD_M, separation_m
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution

from ..state import State

Geoid = Literal["receiver", "grid"]


class SeaLevel(NamedTuple):
    """Height above mean sea level [m], whose geoid it is by, and the standard deviation of that [m]."""

    height_m: float
    geoid: Geoid
    geoid_sd_m: float | None  # no receiver states it


def above_sea(state: State, solution: NavigationSolution, now_ns: int) -> SeaLevel:
    """Height of a solution above mean sea level."""
    fix = state.newest(GnssFix, "gnss/fix", now_ns)
    if fix is not None and fix.height_ellipsoid_m is not None and fix.height_msl_m is not None:
        separation = fix.height_ellipsoid_m - fix.height_msl_m
        return SeaLevel(round(solution.height_ellipsoid_m - separation, 3), "receiver", None)
    separation = separation_m(solution.latitude_deg, solution.longitude_deg)
    return SeaLevel(round(solution.height_ellipsoid_m - separation, 3), "grid", SD_M)
