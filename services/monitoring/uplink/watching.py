"""Watch sessions: a person at the centre looks at this vehicle, and messages of the bus are passed on meanwhile."""

import json

from shared.fleet.topics import MAX_WATCH_S, WATCHABLE
from shared.topics import BY_NAME

NS = 1_000_000_000
PERIOD_NS = NS // 5  # of one topic
MAX_BURST = (
    10  # messages of a topic that is not fast, at once: each monitor publishes on trust/monitor in the same second
)
PERIOD_TOLERANCE_NS = NS // 50  # a message this much before its time is passed on: topics of 10 Hz give 5, and not 3.3
MAX_BYTES = 4096  # of a request
MAX_LIVE_BYTES = 120_000  # of a message; the centre takes 131,072
MAX_WATCHERS = 1000
LIVE_WORDS = frozenset(WATCHABLE)


class BadWatch(ValueError):
    """A request that is none; the text ends a sentence."""


class Watch:
    """The present session; times in ns on the OBU time line."""

    def __init__(self) -> None:
        self.topics: frozenset[str] = frozenset()
        self.watchers = 0
        self.until_ns = 0
        self._due_ns: dict[str, int] = {}

    def take(self, payload: bytes, now_ns: int) -> None:
        """Begin, prolong or end the session; raises `BadWatch`."""
        topics, for_s, watchers = _read(payload)
        if watchers == 0 or for_s == 0 or not topics:
            self.end()
            return
        self.topics, self.watchers = topics, watchers
        self.until_ns = now_ns + round(for_s * NS)

    def end(self) -> None:
        """Pass nothing on any more."""
        self.topics, self.watchers, self.until_ns = frozenset(), 0, 0
        self._due_ns.clear()

    def is_on(self, now_ns: int) -> bool:
        """Whether somebody watches; ends the session when its time is over."""
        if self.watchers and now_ns >= self.until_ns:
            self.end()
        return bool(self.watchers)

    def wants(self, topic: str, payload: bytes, now_ns: int) -> bool:
        """Whether a message is to be passed on now."""
        if topic not in self.topics or len(payload) > MAX_LIVE_BYTES:
            return False
        due_ns = self._due_ns.get(topic, 0)
        if now_ns < due_ns - PERIOD_TOLERANCE_NS:
            return False
        saved_ns = 0 if BY_NAME[topic].fast else MAX_BURST * PERIOD_NS
        self._due_ns[topic] = max(due_ns + PERIOD_NS, now_ns - saved_ns)
        return True


def _read(payload: bytes) -> tuple[frozenset[str], float, int]:
    if len(payload) > MAX_BYTES:
        raise BadWatch(f"it has more than {MAX_BYTES} bytes")
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise BadWatch("it is no JSON") from error
    match content:
        case {"topics": list() as topics, "for_s": int() | float() as for_s, "watchers": int() as watchers} if (
            0 <= for_s <= MAX_WATCH_S and 0 <= watchers <= MAX_WATCHERS
        ):
            return frozenset(topic for topic in topics if isinstance(topic, str)) & LIVE_WORDS, for_s, watchers
    raise BadWatch("it has not topics, a time of at most 60 s and a number of watchers")
