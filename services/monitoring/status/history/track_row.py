"""Takes the row of the track at one time from the newest messages; what is stale is missing."""

from typing import TYPE_CHECKING

from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution, TruthState

from ..views.geometry import ellipse_95
from .track import Place, TrackRow

if TYPE_CHECKING:
    from ..state import State

AIDED_S = 3.0  # age of the last fix that was used; receivers give one a second


def track_row(state: "State", now_ns: int) -> TrackRow:
    """Collect the positions of all sources, and what the solution says of itself."""
    solution = state.newest(NavigationSolution, "navigation/solution", now_ns, live=True)
    fix = state.newest(GnssFix, "gnss/fix", now_ns, live=True)
    truth = state.newest(TruthState, "truth/state", now_ns, live=True)
    return TrackRow(
        time_ns=now_ns,
        state=state.verdict.state,
        aided=solution is not None and solution.gnss_age_s is not None and solution.gnss_age_s <= AIDED_S,
        fused=Place(solution.latitude_deg, solution.longitude_deg) if solution else None,
        gnss=_place(fix) if fix else None,
        truth=Place(truth.latitude_deg, truth.longitude_deg) if truth else None,
        height_ellipsoid_m=solution.height_ellipsoid_m if solution else None,
        radius_95_m=ellipse_95(solution.position_cov_ned_m2).semi_major_m if solution else None,
        level_m=solution.protection_level_horizontal_m if solution else None,
    )


def _place(fix: GnssFix) -> Place | None:
    if fix.latitude_deg is None or fix.longitude_deg is None:
        return None
    return Place(fix.latitude_deg, fix.longitude_deg)
