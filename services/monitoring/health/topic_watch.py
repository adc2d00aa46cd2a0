"""One topic as it looks from outside: how often, how old, how late."""

from collections import deque

from shared.bus import codec
from shared.messages.operation import Freshness, ProcessHealth, TopicTraffic
from shared.runtime.freshness import freshness_of, limits_of, percentile
from shared.runtime.tally import TopicCounters
from shared.topics import Topic

RATE_WINDOW_NS = 10_000_000_000
LATENCIES = 256
RECENT, RECENT_TOLD = 32, 4  # messages, and heartbeats that tell of them: a second or two


class TopicWatch:
    """Counts, rates and ages of one row of the contract: by its messages, or by heartbeats that tell of them."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.tally = TopicCounters(topic)
        self.newest_ns: int | None = None
        self.producer: str | None = None
        self.kept = False  # only retained messages were received, which may be from before the start of the unit
        self._limits = limits_of(topic)
        self._count = 0  # of messages that came here
        self._latencies_s: deque[float] = deque(maxlen=LATENCIES)
        self._marks: deque[tuple[int, int]] = deque()
        self._rate_hz = 0.0

    def take(self, producer: str, payload: bytes, received_ns: int, *, retained: bool) -> None:
        """Note an arrival. A message that the broker had kept is as old as its own stamp says."""
        stamp_ns = codec.stamp_ns(self.topic, payload)
        if retained:
            received_ns = min(received_ns, stamp_ns or received_ns)
        elif stamp_ns is not None:
            self._latencies_s.append((received_ns - stamp_ns) * 1e-9)
        self.kept = retained and (self.kept or not self.count)
        self._count += 1
        self.producer = producer
        self.newest_ns = max(self.newest_ns or 0, received_ns)

    def take_told(self, health: ProcessHealth, carried: TopicTraffic, *, published: bool, now_ns: int) -> None:
        """Note what a heartbeat tells."""
        self.tally.take(health, carried, published=published, now_ns=now_ns)
        if self.tally.latency_s is not None:
            self._latencies_s.append(self.tally.latency_s)
        if self.tally.newest_ns is not None:
            self.newest_ns = max(self.newest_ns or 0, self.tally.newest_ns)
            self.producer, self.kept = self.tally.producer, False

    @property
    def count(self) -> int:
        """Messages since this process started."""
        return self.tally.count or self._count

    def rate_hz(self, now_ns: int) -> float:
        """Give the rate over the last ten seconds; to be called a few times a second."""
        if self.tally.count:
            return self.tally.rate_hz(now_ns)
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
        return tuple(self._latencies_s)[-(RECENT_TOLD if self.tally.count else RECENT) :]

    def latencies_s(self) -> tuple[float | None, float | None]:
        """Give median and 99th percentile of the last messages' latency; None if they bear no stamp."""
        ordered = sorted(self._latencies_s)
        return percentile(ordered, 0.5), percentile(ordered, 0.99)

    def age_s(self, now_ns: int) -> float | None:
        """Give the age of the newest message."""
        if self.newest_ns is None:
            return None
        return max(now_ns - max(self.newest_ns, self.tally.updated_ns(now_ns) or 0), 0) * 1e-9

    def freshness(self, now_ns: int) -> Freshness:
        """Judge the age."""
        return freshness_of(self.age_s(now_ns), self._limits)
