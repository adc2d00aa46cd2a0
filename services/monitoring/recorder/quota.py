"""How much one topic, and one source, may add to the recordings: a flood of one does not push out the others.

Each has a budget of bytes, which fills at a steady rate up to its size; a message that the budget does not hold is left
out. Sizes are those of the payloads, before compression.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from shared.bus.bus import Envelope
from shared.messages.explanation import Explanation, explain, process, topic

from .codes import Code

TOPIC_SHARE = 8  # of the room for all recordings, one part of which a topic may fill at once
SOURCES_TOPICS = 2  # a source may fill as much as so many topics
SENDERS_MAXIMUM = 3  # named by the code of a flood
MAX_BUDGETS = 512  # of names that come from the bus; further ones share one budget
OTHERS = "others"
TOPIC, SOURCE = "topic", "source"  # kinds of budgets
REPORT_PERIOD_NS = 10_000_000_000  # for which a flood is said after its last message


@dataclass
class _Budget:
    size: float
    rate_per_s: float
    level: float
    filled_ns: int
    left_out: int = 0
    last_ns: int = 0  # when a message was last left out

    def holds(self, count: int, now_ns: int) -> bool:
        """Whether so many bytes are there, at a time."""
        passed_s = max(now_ns - self.filled_ns, 0) * 1e-9
        self.level, self.filled_ns = min(self.level + passed_s * self.rate_per_s, self.size), now_ns
        return count <= self.level


class Quota:
    """Budgets by topic and by source; `left_out` counts the messages that none of them held."""

    def __init__(self, bytes_per_s: float, total_bytes: int) -> None:
        self._rate_per_s, self._size = bytes_per_s, max(total_bytes / TOPIC_SHARE, bytes_per_s)
        self._budgets: dict[tuple[str, str], _Budget] = {}
        self.left_out = 0

    def admitted(self, envelopes: Iterable[Envelope], now_ns: int) -> list[Envelope]:
        """Select the messages that both budgets hold."""
        return [envelope for envelope in envelopes if self._admits(envelope, now_ns)]

    def complaint(self, now_ns: int) -> Explanation | None:
        """Say which topics and sources are flooded at present, and how many of their messages were left out."""
        flooded = [
            ((topic if kind == TOPIC else process)(name), budget.left_out)
            for (kind, name), budget in self._budgets.items()
            if budget.left_out and now_ns - budget.last_ns < REPORT_PERIOD_NS
        ]
        if not flooded:
            return None
        return explain(
            Code.FLOOD,
            senders=tuple(sender for sender, _ in flooded[:SENDERS_MAXIMUM]),
            left_out_count=max(left_out for _, left_out in flooded),  # a message counts in its topic and its source
            per_second_bytes=round(self._rate_per_s),
        )

    def _admits(self, envelope: Envelope, now_ns: int) -> bool:
        size = len(envelope.payload)
        budgets = (
            self._budget(TOPIC, envelope.topic, 1, now_ns),
            self._budget(SOURCE, envelope.producer, SOURCES_TOPICS, now_ns),
        )
        short = [budget for budget in budgets if not budget.holds(size, now_ns)]
        for budget in short:
            budget.left_out, budget.last_ns = budget.left_out + 1, now_ns
        if short:
            self.left_out += 1
            return False
        for budget in budgets:
            budget.level -= size
        return True

    def _budget(self, kind: str, name: str, times: int, now_ns: int) -> _Budget:
        key = (kind, name)
        if key not in self._budgets and len(self._budgets) >= MAX_BUDGETS:
            key = (kind, OTHERS)
        if key not in self._budgets:
            size = self._size * times
            self._budgets[key] = _Budget(size, self._rate_per_s * times, size, now_ns)
        return self._budgets[key]
