"""The time line of a unit as seen from the centre, from the stamps of what arrives.

Each topic arrives in the order of its stamps: one whose stamp is earlier than its last one is of a clock that was set
back, as of a unit without a clock of its own that was restarted. What is merely late is not.
"""

from collections import deque

NS = 1_000_000_000
WINDOW_NS = 30 * NS
CLOCK_TOLERANCE_NS = 2 * NS  # clocks that differ by less are taken for equal: what is left is the delay of the network


class TimeLine:
    """Estimates how far the unit's time line is from the centre's clock."""

    def __init__(self) -> None:
        self.offset_ns = 0  # of the unit's time line, to be added to the centre's clock
        self.known = False
        self._least: deque[tuple[int, int]] = deque()  # second of the centre's clock, and least lag in it
        self._stamps_ns: dict[str, int] = {}  # newest one of each topic

    def take(self, topic: str, stamp_ns: int, now_ns: int) -> bool:
        """Take the stamp of a message that arrives; whether the time line is another one than before."""
        lag_ns, second = now_ns - stamp_ns, now_ns // NS
        if stamp_ns < self._stamps_ns.get(topic, stamp_ns) - CLOCK_TOLERANCE_NS:
            self._least.clear()
            self._stamps_ns.clear()
        self._stamps_ns[topic] = max(stamp_ns, self._stamps_ns.get(topic, stamp_ns))
        if self._least and self._least[-1][0] == second:
            self._least[-1] = second, min(self._least[-1][1], lag_ns)
        else:
            self._least.append((second, lag_ns))
        while self._least[0][0] < second - WINDOW_NS // NS:
            self._least.popleft()
        least_ns = min(lag for _, lag in self._least)
        offset_ns = 0 if 0 <= least_ns <= CLOCK_TOLERANCE_NS else -least_ns
        jumped = not self.known or abs(offset_ns - self.offset_ns) > CLOCK_TOLERANCE_NS
        if jumped:
            self._least.clear()
            self._least.append((second, lag_ns))
            offset_ns = 0 if 0 <= lag_ns <= CLOCK_TOLERANCE_NS else -lag_ns
            jumped = self.known or offset_ns != 0
        self.offset_ns, self.known = offset_ns, True
        return jumped
