"""Which recorded messages a replay publishes: all at ordinary speed, fewer where nobody could follow them."""

from collections.abc import Iterable

from shared.topics import BY_NAME, topic_of

FULL_SPEED = 2.0  # up to here every message is published
MAX_RATE_HZ = 20.0  # of a topic with a rate, beyond that speed
PLOTTED = {  # what the last minute of the dashboard is drawn of, and its least spacing [s]
    "navigation/solution": 0.2, "gnss/fix": 0.9, "vehicle/speed": 0.9, "vehicle/wheel_speed": 0.9,
    "trust/state": 0.9, "truth/state": 0.2, "trust/event": 0.0, "outage/event": 0.0,
}  # fmt: skip
EXCLUDED_TOPICS = ("origin/state", "replay/state", "replay/control", "replay/events")  # the replay publishes its own


def playable(topics: Iterable[str]) -> frozenset[str]:
    """Choose the topics that are published at ordinary speed."""
    return frozenset(name for name in topics if name not in EXCLUDED_TOPICS and topic_of(name) is not None)


def shown(topics: Iterable[str]) -> frozenset[str]:
    """Choose the topics that a dashboard shows: not the bytes of devices and not the order of consumption."""
    return frozenset(name for name in playable(topics) if not (name.startswith("consumed/") or _raw(name)))


def _raw(name: str) -> bool:
    return name in BY_NAME and BY_NAME[name].is_raw


class Thinning:
    """Leaves out messages of a topic that follow each other too closely at the speed of the replay."""

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}

    def keeps(self, topic: str, arrival_ns: int, speed: float) -> bool:
        """Whether to publish a message; states and events are always published."""
        row = topic_of(topic)
        if speed <= FULL_SPEED or row is None or row.qos:
            return True
        return self._spaced(topic, arrival_ns, speed / MAX_RATE_HZ)

    def keeps_plotted(self, topic: str, arrival_ns: int) -> bool:
        """Whether a message of the last minute is published after a jump."""
        return self._spaced(topic, arrival_ns, PLOTTED.get(topic, 1.0))

    def _spaced(self, topic: str, arrival_ns: int, spacing_s: float) -> bool:
        last_ns = self._last_ns.get(topic)
        if last_ns is not None and 0 <= arrival_ns - last_ns < spacing_s * 1e9:
            return False
        self._last_ns[topic] = arrival_ns
        return True
