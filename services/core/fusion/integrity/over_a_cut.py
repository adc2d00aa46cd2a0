"""A contradiction over a power cut: how fast it grew, and what it may have become."""

from collections import deque
from dataclasses import dataclass, replace
from math import hypot
from statistics import median
from typing import NamedTuple

from .disagreement import NONE, Disagreement, Pair, Vector

WINDOW = 5  # [-] successive seconds over which a growth lasts; a step is none
MIN_CONFLICT_S = 3  # [-] seconds of a new conflict from which a rate is known
MAX_DURATION_S = 3600.0  # [s] over which growth is extrapolated, and of a cut whose length the clock does not tell
MAX_DISTANCE_M = 1e5  # [m] beyond which a bound is of no use, horizontal and vertical


class Distances(NamedTuple):
    """Distance of two solutions at a time [m, horizontal and vertical]."""

    time_ns: int
    apart: Pair


class GrowthRate:
    """Largest rate [m/s, horizontal and vertical] at which the two solutions of a conflict have moved apart.

    Notes
    -----
    The median over 5 s of the rates of single seconds, so that a step is no growth; the largest of these medians.
    """

    def __init__(self) -> None:
        self.largest: Pair = NONE
        self._last: Distances | None = None
        self._rates: deque[Pair] = deque(maxlen=WINDOW)

    def update(self, time_ns: int, apart_n: Vector | None) -> None:
        """Use the difference of the two [m, NED], once a second; None while there is no conflict."""
        if apart_n is None:
            self._last = None
            self._rates.clear()
            return
        new, last = Distances(time_ns, (hypot(*apart_n[:2]), abs(apart_n[2]))), self._last
        self._last = new
        if last is None or time_ns <= last.time_ns:
            return
        span_s = (time_ns - last.time_ns) * 1e-9
        self._rates.append(((new.apart[0] - last.apart[0]) / span_s, (new.apart[1] - last.apart[1]) / span_s))
        if len(self._rates) >= MIN_CONFLICT_S:
            horizontal, vertical = (median(rates) for rates in zip(*self._rates, strict=True))
            self.largest = max(self.largest[0], horizontal), max(self.largest[1], vertical)

    def forget(self) -> None:
        """Begin again, when nothing is held any more."""
        self.largest = NONE


@dataclass(frozen=True)
class RememberedConflict:
    """What an earlier process held, how fast it grew [m/s], and when that was."""

    time_ns: int
    held: Disagreement
    growth: Pair = NONE

    def at(self, time_ns: int) -> Disagreement:
        """What is held at a start: as it was, with the growth since then.

        A cut of unknown length, after which the clock shows an earlier time, counts as one of `MAX_DURATION_S`. What
        has contradicted nothing does not grow.
        """
        if not self.held.is_open:
            return self.held
        gap_s = (time_ns - self.time_ns) * 1e-9
        span_s = min(gap_s, MAX_DURATION_S) if gap_s >= 0.0 else MAX_DURATION_S
        grown_h, grown_v = (
            min(slack + rate * span_s, MAX_DISTANCE_M) for slack, rate in zip(self.held.slack, self.growth, strict=True)
        )
        return replace(self.held, slack=(grown_h, grown_v), agreeing_ns=None)
