"""The traffic of a fast topic as the heartbeats of its producers and consumers tell of it, for those who observe it.

The producer's word counts: it is the first to know. That of a consumer counts where the producer is a program that does
not count, and tells how late messages arrive. A consumer that receives nothing of what is sent is deaf.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from ..messages.operation import ProcessHealth, TopicTraffic
from ..processes import BY_NAME as PROCESS_ROWS
from ..topics import BY_NAME, Topic

HEARTBEAT_NS = round(1e9 / (BY_NAME["health/+"].rate_hz or 2.0))
SILENCE_TIMEOUT_NS = 4 * HEARTBEAT_NS  # by which another's newest message is newer, after which that one's word counts
RATE_WINDOW_NS = 10_000_000_000
DEAF_HEARTBEATS = 10  # without a message of this topic, while
DEAF_MESSAGES = 10  # so many were sent
Teller = tuple[str, bool]  # process, and whether it is about what it published


def told(health: ProcessHealth) -> Iterator[tuple[TopicTraffic, bool]]:
    """Yield what a heartbeat tells of fast topics, and whether the process has published them."""
    for published, carried in ((True, health.published), (False, health.received)):
        yield from ((item, published) for item in carried if item.topic in BY_NAME and BY_NAME[item.topic].fast)


@dataclass
class _Word:
    """What one process said last, and since when it has had nothing new to say."""

    incarnation: int
    count: int
    since_ns: int
    sent_before: int  # messages of the topic by then
    heartbeats: int = 0  # since then, between which messages of the topic were sent
    total: int = 0  # of these messages at the last heartbeat


class TopicCounters:
    """Count, rate, age and latency of one topic; empty while no heartbeat tells of it."""

    def __init__(self, topic: Topic) -> None:
        self.count = 0
        self.newest_ns: int | None = None  # when the newest message was sent, or arrived
        self.lag_ns = 0  # from the stamp of that one
        self.producer: str | None = None
        self.latency_s: float | None = None  # that the last heartbeat told of
        self._by_producer = not any(_is_prompt(name) for name in topic.consumers)
        self._words: dict[Teller, _Word] = {}
        self._leader: Teller | None = None
        self._said_ns = 0  # when the leader spoke last
        self._marks: deque[tuple[int, int]] = deque()

    def take(self, health: ProcessHealth, carried: TopicTraffic, *, published: bool, now_ns: int) -> None:
        """Note what a heartbeat tells of the topic; nothing is newer than its arrival here."""
        said_ns = min(health.sent_ns, now_ns)
        teller = health.process, published
        before = self._words.get(teller)
        if before is not None and health.incarnation < before.incarnation:
            return
        same_life = before is not None and health.incarnation == before.incarnation
        new = max(carried.count - before.count, 0) if before and same_life else carried.count
        if before and same_life and not new:
            before.heartbeats += self.count > before.total  # who hears nothing of a silent topic is not deaf
            before.total = self.count
        else:
            self._words[teller] = _Word(health.incarnation, carried.count, said_ns, self.count, total=self.count)
        self.latency_s = self._latency_s(teller, carried) if new else None
        if carried.newest_ns is None or not self._leads(teller, carried.newest_ns):
            return
        self.count += new if before else min(new, 1)  # what was sent before anybody listened is not counted
        self.newest_ns = max(self.newest_ns or 0, min(carried.newest_ns, said_ns))
        self.lag_ns = max(self.newest_ns - carried.stamp_ns, 0) if carried.stamp_ns is not None else 0
        self.producer, self._said_ns = carried.producer or health.process, said_ns
        self._marks.append((said_ns, self.count))
        while len(self._marks) > 2 and self._marks[1][0] <= said_ns - RATE_WINDOW_NS:
            self._marks.popleft()

    def updated_ns(self, now_ns: int) -> int | None:
        """When the newest message came: until the next heartbeat is due, what was flowing is taken to flow on."""
        if self.newest_ns is None:
            return None
        return min(self.newest_ns + min(max(now_ns - self._said_ns, 0), HEARTBEAT_NS), now_ns)

    def rate_hz(self, now_ns: int) -> float:
        """Rate over the last ten seconds."""
        if len(self._marks) < 2:
            return 0.0
        (start_ns, start_count), (end_ns, _) = self._marks[0], self._marks[-1]
        elapsed_ns = max(end_ns, now_ns - 2 * HEARTBEAT_NS) - start_ns
        return (self.count - start_count) / (elapsed_ns * 1e-9) if elapsed_ns > 0 else 0.0

    def deaf(self) -> Iterator[tuple[str, int]]:
        """Yield the consumers that receive nothing of what is sent, each with the time since when."""
        for (process, published), word in self._words.items():
            missed = self.count - word.sent_before
            if not published and word.heartbeats >= DEAF_HEARTBEATS and missed >= DEAF_MESSAGES:
                yield process, word.since_ns

    def _leads(self, teller: Teller, newest_ns: int) -> bool:
        """Whether this one's word counts: a producer's before a consumer's, and nobody's who has fallen silent."""
        overrules = self._leader is None or teller[1] > self._leader[1]
        if overrules or newest_ns > (self.newest_ns or 0) + SILENCE_TIMEOUT_NS:
            self._leader = teller
        return self._leader == teller

    def _latency_s(self, teller: Teller, carried: TopicTraffic) -> float | None:
        """Time from the stamp of the newest message to its arrival, or its sending where nobody receives it at once."""
        process, published = teller
        if published is not self._by_producer or carried.newest_ns is None or carried.stamp_ns is None:
            return None
        return (carried.newest_ns - carried.stamp_ns) * 1e-9 if published or _is_prompt(process) else None


def _is_prompt(process: str) -> bool:
    """Whether a process reads its messages as they come."""
    return process not in PROCESS_ROWS or not PROCESS_ROWS[process].pause_s
