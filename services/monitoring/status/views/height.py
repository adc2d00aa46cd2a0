"""Height above mean sea level: by the receiver's own geoid where it has stated one, else by a grid."""

from typing import Literal, NamedTuple

from shared.maths.geoid.geoid import SD_M, separation_m
from shared.messages.navigation import NavigationSolution

from ..state import State

Geoid = Literal["receiver", "grid"]


class SeaLevel(NamedTuple):
    """Height above mean sea level [m], whose geoid it is by, and the standard deviation of that [m]."""

    height_m: float
    geoid: Geoid
    geoid_sd_m: float | None  # no receiver states it


def above_sea(state: State, solution: NavigationSolution) -> SeaLevel:
    """Height of a solution above mean sea level; it does not step where one fix states no heights."""
    correction_m = state.geoid_correction_m
    separation = separation_m(solution.latitude_deg, solution.longitude_deg) + (correction_m or 0.0)
    height_m = round(solution.height_ellipsoid_m - separation, 3)
    return SeaLevel(height_m, "grid", SD_M) if correction_m is None else SeaLevel(height_m, "receiver", None)
