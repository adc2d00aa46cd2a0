"""Whether this computer keeps up: how late heartbeats arrive, and how far the filter is behind its samples."""

import os
from collections.abc import Sequence

from shared.messages.explanation import Explanation, explain
from shared.messages.operation import Problem
from shared.runtime.freshness import percentile
from shared.words.words import reason

from .codes import Code

COMPUTER = "computer"
MAX_DELAY_S = 0.5  # delay of messages, from which a unit of milliseconds does not keep up
BEHIND_S = 1.0  # of the solution, beyond the delay of the samples it is made of
DURATION_NS = 5_000_000_000  # after which a delay is no moment's
SHARE_OF_LIMIT = 0.5  # of both limits, below which it is over


class Overload:
    """Judges delays against their limits, with a hysteresis in size and time."""

    def __init__(self, processors: int | None = None) -> None:
        self._processors = processors or len(os.sched_getaffinity(0))
        self._since_ns: int | None = None  # when the delays were first above, or as long as it lasts
        self._over_since_ns: int | None = None
        self.problem: Problem | None = None

    def judge(self, now_ns: int, load: float, heartbeats_s: Sequence[float], behind_s: float | None) -> None:
        """Renew the finding.

        Parameters
        ----------
        now_ns : int
            [ns] Of the OBU time line.
        load : float
            Mean number of programs that wanted a processor over the last minute.
        heartbeats_s : sequence of float
            [s] Delays of the newest heartbeats.
        behind_s : float, optional
            [s] By how much the newest solutions are later than their samples; None while it is not known.
        """
        late_s = percentile(heartbeats_s, 0.5) or 0.0
        share = max(late_s / MAX_DELAY_S, (behind_s or 0.0) / BEHIND_S)
        if share >= 1.0:
            self._since_ns, self._over_since_ns = self._since_ns or now_ns, None
        elif share < SHARE_OF_LIMIT or self.problem is None:
            self._over_since_ns = self._over_since_ns or now_ns
            if self.problem is None or now_ns - self._over_since_ns >= DURATION_NS:
                self._since_ns = self.problem = None
        if self._since_ns is not None and now_ns - self._since_ns >= DURATION_NS:
            why = self._why(load, late_s, behind_s)
            self.problem = Problem(what=COMPUTER, text=reason(why), text_code=why, since_ns=self._since_ns)

    def _why(self, load: float, late_s: float, behind_s: float | None) -> Explanation:
        """The later of the two is stated: messages of the bus, or core.fusion behind its samples."""
        is_busy = load >= self._processors
        alone, fusion = (Code.OVERLOADED, Code.OVERLOADED_FUSION) if is_busy else (Code.SLOW, Code.SLOW_FUSION)
        given = {"load_count": load, "processor_count": self._processors}
        if behind_s is None or behind_s <= late_s:
            return explain(alone, **given, late_s=late_s)
        return explain(fusion, **given, behind_s=behind_s)
