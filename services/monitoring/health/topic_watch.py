"""One topic as it looks from outside: how often, how old, how late."""

import re
from collections import deque

from shared.messages.base import Message
from shared.messages.operation import Freshness
from shared.runtime.freshness import freshness_of, limits_of, percentile
from shared.topics import Topic

RATE_WINDOW_NS = 10_000_000_000
LATENCIES = 256
RECENT = 32
HEAD_BYTES = 300  # the stamps stand at the front of a payload
STAMPS = ("received_ns", "sampled_ns", "now_ns", "sent_ns")


def stamp_pattern(message: type[Message]) -> re.Pattern[bytes] | None:
    """Build the search for the stamp in an encoded message: arrival at the driver, else when it was true."""
    for name in STAMPS:
        field = message.model_fields.get(name)
        if field is not None and field.annotation is int:
            return re.compile(rb'"%s":(\d{1,19})\b' % name.encode())
    return None


class TopicWatch:
    """Counts, rates and ages of one row of the contract."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.count = 0
        self.newest_ns: int | None = None
        self.producer: str | None = None
        self.kept = False  # only retained messages were received, which may be from before the start of the unit
        self._limits = limits_of(topic)
        self._pattern = stamp_pattern(topic.message)
        self._latencies_s: deque[float] = deque(maxlen=LATENCIES)
        self._marks: deque[tuple[int, int]] = deque()
        self._rate_hz = 0.0

    def take(self, producer: str, payload: bytes, received_ns: int, *, retained: bool) -> None:
        """Note an arrival. A message that the broker had kept is as old as its own stamp says."""
        stamp_ns = self._stamp(payload)
        if retained:
            received_ns = min(received_ns, stamp_ns or received_ns)
        elif stamp_ns is not None:
            self._latencies_s.append((received_ns - stamp_ns) * 1e-9)
        self.kept = retained and (self.kept or not self.count)
        self.count += 1
        self.producer = producer
        self.newest_ns = max(self.newest_ns or 0, received_ns)

    def rate_hz(self, now_ns: int) -> float:
        """Give the rate over the last ten seconds; to be called a few times a second."""
        if not self._marks:
            self._marks.append((now_ns, self.count))
        start_ns, start_count = self._marks[0]
        if now_ns > start_ns:
            self._rate_hz = (self.count - start_count) / ((now_ns - start_ns) * 1e-9)
        if self._marks[-1][0] < now_ns:
            self._marks.append((now_ns, self.count))
        while len(self._marks) > 2 and self._marks[1][0] <= now_ns - RATE_WINDOW_NS:
            self._marks.popleft()
        return self._rate_hz

    @property
    def recent_s(self) -> tuple[float, ...]:
        """Latencies of the newest messages, a second or two of them."""
        return tuple(self._latencies_s)[-RECENT:]

    def latencies_s(self) -> tuple[float | None, float | None]:
        """Give median and 99th percentile of the last messages' latency; None if they bear no stamp."""
        ordered = sorted(self._latencies_s)
        return percentile(ordered, 0.5), percentile(ordered, 0.99)

    def age_s(self, now_ns: int) -> float | None:
        """Give the age of the newest message."""
        return None if self.newest_ns is None else max(now_ns - self.newest_ns, 0) * 1e-9

    def freshness(self, now_ns: int) -> Freshness:
        """Judge the age."""
        return freshness_of(self.age_s(now_ns), self._limits)

    def _stamp(self, payload: bytes) -> int | None:
        """Find the stamp without decoding the message."""
        match = self._pattern.search(payload, 0, HEAD_BYTES) if self._pattern else None
        return int(match[1]) if match else None
