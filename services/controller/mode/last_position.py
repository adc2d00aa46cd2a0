"""Decides when the vehicle's position is stored for the next start, and computes its message."""

import math
from collections.abc import Iterator

from shared.maths.dates import is_plausible
from shared.messages.navigation import LastPosition, NavigationPhase, NavigationSolution

NS = 1_000_000_000
MEASURED = (NavigationPhase.NAVIGATING, NavigationPhase.GNSS_ONLY)  # phases in which positions are measured


class LastPositionWriter:
    """Yields the position every `period_s` while navigating, when the vehicle stops, and at shutdown."""

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * NS)
        self._newest: NavigationSolution | None = None
        self._kept_ns: int | None = None
        self._was_stationary = False

    def take(self, solution: NavigationSolution, utc_offset_ns: int | None) -> Iterator[LastPosition]:
        """Process a solution; yield its position if it is due to be stored."""
        if solution.phase not in MEASURED and solution.phase is not NavigationPhase.COASTING:
            return
        self._newest = solution
        stopped = solution.stationary and not self._was_stationary
        self._was_stationary = solution.stationary
        due = self._kept_ns is None or not 0 <= solution.sampled_ns - self._kept_ns < self._period_ns
        if solution.phase in MEASURED and (stopped or due):
            yield from self.last(utc_offset_ns)

    def last(self, utc_offset_ns: int | None) -> Iterator[LastPosition]:
        """Yield the newest position unless it is already stored."""
        solution = self._newest
        if solution is None or solution.sampled_ns == self._kept_ns:
            return
        self._kept_ns = solution.sampled_ns
        nn, _, _, ee, _, dd = solution.position_cov_ned_m2
        utc_ns = None if utc_offset_ns is None else solution.sampled_ns + utc_offset_ns
        yield LastPosition(
            sampled_ns=solution.sampled_ns,
            utc_ns=utc_ns if utc_ns is not None and is_plausible(utc_ns) else None,
            latitude_deg=solution.latitude_deg,
            longitude_deg=solution.longitude_deg,
            height_ellipsoid_m=solution.height_ellipsoid_m,
            yaw_rad=solution.yaw_rad - (solution.heading_turn_rad or 0.0),  # of the inertial sensors: for the filter
            position_sd_ned_m=(_sd(nn), _sd(ee), _sd(dd)),
            yaw_sd_rad=_sd(solution.attitude_cov_ned_rad2[5]),
            stationary=solution.stationary,
            protection_level_horizontal_m=solution.protection_level_horizontal_m,
        )


def _sd(variance: float) -> float:
    return math.sqrt(max(variance, 0.0))  # guards against an invalid message
