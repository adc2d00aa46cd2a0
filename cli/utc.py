"""UTC of the unit's time line, by the fixes that state it."""

from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate, pairwise
from statistics import median

from shared.messages.base import Message
from shared.messages.gnss import GnssFix

NS = 1_000_000_000
MAX_STEP_S = 30  # by which leap seconds change; what is more is another clock
STEP_TOLERANCE_NS = NS // 5  # by which a step may differ from whole seconds


class UtcLine:
    """Converts times of the unit's time line to UTC.

    A receiver that is switched on cold states a UTC that is whole seconds off until it has the leap seconds. What it
    stated before such a step is moved by the step, so that times are as far apart as they were.
    """

    def __init__(self, messages: Iterable[Message]) -> None:
        stated = sorted(
            (fix.sampled_ns, fix.utc_ns - fix.sampled_ns)
            for fix in messages
            if isinstance(fix, GnssFix) and fix.utc_ns is not None
        )
        steps = [
            (after_ns, step_ns)
            for (_, before), (after_ns, behind) in pairwise(stated)
            if (step_ns := _whole_step(behind - before))
        ]
        self._step_ns = [time_ns for time_ns, _ in steps]
        self._sums_ns = [0, *accumulate(step_ns for _, step_ns in steps)]
        offsets = [offset_ns + self.step_ns(time_ns) for time_ns, offset_ns in stated]
        self.offset_ns = round(median(offsets)) if offsets else 0  # 0: no fix states UTC

    def step_ns(self, time_ns: int) -> int:
        """Sum of the steps behind a time, which is to be added to the UTC that was stated at it [ns]."""
        return self._sums_ns[-1] - self._sums_ns[bisect_right(self._step_ns, time_ns)]

    def utc_ns(self, time_ns: int) -> int:
        """UTC of a time by the median of what all fixes stated [ns since 1970]; the same time without any."""
        return time_ns + self.offset_ns

    def of_fix(self, fix: GnssFix) -> int:
        """UTC of a fix as it was stated, without steps behind it [ns since 1970]."""
        return self.utc_ns(fix.sampled_ns) if fix.utc_ns is None else fix.utc_ns + self.step_ns(fix.sampled_ns)


def _whole_step(change_ns: int) -> int:
    """The step of whole seconds in a change of the offset; 0 for none."""
    seconds = round(change_ns / NS)
    whole = abs(change_ns - seconds * NS) <= STEP_TOLERANCE_NS
    return seconds * NS if whole and abs(seconds) <= MAX_STEP_S else 0
