"""Whether this computer keeps up: how late heartbeats arrive, and how far the filter is behind its samples."""

import os
from collections.abc import Sequence

from shared.messages.operation import Problem
from shared.runtime.freshness import percentile

COMPUTER = "computer"
LATE_S = 0.5  # delay of messages, from which a unit of milliseconds does not keep up
BEHIND_S = 1.0  # of the solution, beyond the delay of the samples it is made of
LASTS_NS = 5_000_000_000  # after which a delay is no moment's
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
        share = max(late_s / LATE_S, (behind_s or 0.0) / BEHIND_S)
        if share >= 1.0:
            self._since_ns, self._over_since_ns = self._since_ns or now_ns, None
        elif share < SHARE_OF_LIMIT or self.problem is None:
            self._over_since_ns = self._over_since_ns or now_ns
            if self.problem is None or now_ns - self._over_since_ns >= LASTS_NS:
                self._since_ns = self.problem = None
        if self._since_ns is not None and now_ns - self._since_ns >= LASTS_NS:
            text = self._text(load, late_s, behind_s or 0.0)
            self.problem = Problem(what=COMPUTER, text=text, since_ns=self._since_ns)

    def _text(self, load: float, late_s: float, behind_s: float) -> str:
        delays = [f"messages arrive {late_s:.1f} s late"] if late_s >= SHARE_OF_LIMIT * LATE_S else []
        delays += (
            [f"core.fusion is {behind_s:.1f} s behind its samples"] if behind_s >= SHARE_OF_LIMIT * BEHIND_S else []
        )
        processors = f"{self._processors} processor{'s' if self._processors > 1 else ''}"
        if load >= self._processors:
            what, remedy = "this computer is overloaded", "end other programs, lower the rates of the sensors"
        else:
            what, remedy = "this computer does not keep up", "check its disk, its temperature and its power supply"
        figures = ", ".join([f"load {load:.1f} on {processors}", *([" and ".join(delays)] if delays else [])])
        return f"{what}: {figures}; {remedy}, or use a faster one"
