"""Whether the verdict was right: the error against the truth of a simulation, and the alert limits."""

from collections import defaultdict
from dataclasses import dataclass
from math import hypot

from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.trust import TrustLevel, TrustState

from .views.geometry import offset_m

NS = 1_000_000_000
MAX_STEP_NS = NS  # between two comparisons; a longer pause is not counted


@dataclass(frozen=True)
class Comparison:
    """One comparison of the position with the truth."""

    horizontal_m: float
    vertical_m: float
    above: bool  # an error is above its alert limit


class TruthCheck:
    """Adds up, for each state of the verdict, how long the error was within and above the alert limits."""

    def __init__(self) -> None:
        self.newest: Comparison | None = None
        self.seconds: defaultdict[TrustLevel, list[float]] = defaultdict(lambda: [0.0, 0.0])  # within, above
        self._compared_ns: int | None = None

    def update(
        self, now_ns: int, solution: NavigationSolution | None, truth: TruthState | None, trust: TrustState | None
    ) -> None:
        """Compare what is live; nothing is counted where one of the three is missing."""
        self.newest = None
        before_ns, self._compared_ns = self._compared_ns, None
        if solution is None or truth is None or trust is None or (offset := offset_m(solution, truth)) is None:
            return
        fall = (truth.velocity_ned_m_s or (0.0, 0.0, 0.0))[2] * (solution.sampled_ns - truth.sampled_ns) / NS
        horizontal, vertical = hypot(*offset), abs(solution.height_ellipsoid_m - truth.height_ellipsoid_m + fall)
        above = horizontal > trust.alert_limit_horizontal_m or vertical > trust.alert_limit_vertical_m
        self.newest, self._compared_ns = Comparison(horizontal, vertical, above), now_ns
        if before_ns is not None and now_ns - before_ns <= MAX_STEP_NS:
            self.seconds[trust.state][above] += (now_ns - before_ns) / NS
