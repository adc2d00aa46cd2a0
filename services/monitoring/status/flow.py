"""What flows on one topic, and how one process is doing: counts, rates, latencies, ages."""

from collections import deque
from itertools import pairwise

from shared.bus.bus import Envelope
from shared.errors import BadPayload
from shared.messages.base import Message
from shared.messages.operation import ConsumptionOrder, Freshness, MessageKind, ProcessHealth, TopicTraffic
from shared.runtime.freshness import freshness_of, limits_of, percentile
from shared.runtime.tally import TopicCounters
from shared.topics import Topic

RATE_WINDOW_S = 10
SAMPLES = 256
HEARTBEATS = 11  # five seconds: the host counts CPU time in steps of 10 ms
EAGER_UP_TO_HZ = 20.0
DECIMATION = 16  # of a faster topic one message in so many is decoded, unless somebody looks
# Of these the track, the histories and the counters take every message; other fast topics only for those who look.
DRAWN = ("navigation/solution", "navigation/aiding", "vehicle/wheel_speed", "truth/state")
LATENCY_MAXIMUM_S = 60.0  # beyond, the stamp is of another time line


def stamp_ns(message: Message) -> int | None:
    """Find when a message was true, or else when it was sent, on the OBU time line."""
    for name in ("sampled_ns", "sent_ns", "now_ns", "received_ns"):
        value = getattr(message, name, None)
        if value is not None:
            return int(value[-1] if isinstance(value, tuple) else value)
    return None


def on_demand(topic: Topic) -> bool:
    """Whether the messages of a topic come here only while somebody looks at them."""
    return topic.fast and topic.name not in DRAWN


class TopicFlow:
    """The traffic of one topic: as seen here, or by the heartbeats that tell of it while nobody follows it."""

    def __init__(self, name: str, topic: Topic) -> None:
        self.name, self.topic = name, topic
        self.limits = limits_of(topic)
        self.tally = TopicCounters(topic)
        self.followed = True
        self.producer, self.incarnation = "", 0  # of the newest; not before `incarnation`
        self.newest: Envelope | None = None
        self.message: Message | None = None  # the newest that was decoded
        self.heard_ns: int | None = None  # when the newest one came, or was said if the broker had kept it
        self.updated_ns: int | None = None  # when what the newest one says was true: this is its age
        self.rate_hz = 0.0
        self.latency_p50_s: float | None = None
        self.latency_p99_s: float | None = None
        self.latencies_s: deque[float] = deque(maxlen=SAMPLES)
        self._arrivals_ns: deque[int] = deque(maxlen=64)
        self._seconds: deque[int] = deque(maxlen=RATE_WINDOW_S)
        self._taken = self._counted = 0  # messages, now and at the end of the last second
        self._lag_ns = 0  # from the stamp of the newest message that was decoded to its arrival
        fast = (topic.rate_hz or 0.0) > EAGER_UP_TO_HZ and not topic.is_raw
        self._decode_every = 0 if topic.message is ConsumptionOrder else DECIMATION if fast else 1

    def note(self, envelope: Envelope) -> Message | None:
        """Take one message; returns it if it was decoded, None if it can wait, or raises `BadPayload`."""
        due = envelope.retained or (self._decode_every and self._taken % self._decode_every == 0)
        message = envelope.decode() if due else None
        self._taken += 1
        said_ns = stamp_ns(message) if message else None
        known_ns = self.heard_ns if envelope.retained and not self.topic.per_process else None
        if said_ns is not None and known_ns is not None and said_ns <= known_ns:
            return None  # the broker was away, and has kept less than is known here
        self.newest, self.message, self.heard_ns = envelope, message, envelope.received_ns
        self.producer, self.incarnation = envelope.producer, envelope.incarnation
        if said_ns is not None:
            self._lag_ns = max(envelope.received_ns - said_ns, 0)
        elif message is not None:
            self._lag_ns = 0  # it bears no stamp
        self.updated_ns = envelope.received_ns - self._lag_ns
        if envelope.retained:
            self.heard_ns = self.updated_ns
        else:
            self._arrivals_ns.append(envelope.received_ns)
            self._note_latency(said_ns, envelope.received_ns)
        return message

    def note_told(self, health: ProcessHealth, carried: TopicTraffic, *, published: bool, now_ns: int) -> float | None:
        """Note what a heartbeat tells; gives the latency that it tells of, None while the topic is followed."""
        self.tally.take(health, carried, published=published, now_ns=now_ns)
        if self.followed or self.tally.newest_ns is None:
            return None
        self.producer, self.heard_ns = self.tally.producer or "", self.tally.newest_ns
        self.incarnation = self.tally.newest_ns
        latency_s = self.tally.latency_s
        if latency_s is None or not 0 <= latency_s < LATENCY_MAXIMUM_S:
            return None
        self.latencies_s.append(latency_s)
        return latency_s

    def pass_to(self, now_ns: int) -> None:
        """Let time pass: what heartbeats tell of flows on until the next one is due."""
        if not self.followed and (newest_ns := self.tally.updated_ns(now_ns)) is not None:
            self.updated_ns = newest_ns - self.tally.lag_ns

    def follow(self, *, followed: bool) -> None:
        """Note whether its messages come here; without them, the newest one that came is none."""
        if self.followed and not followed:
            self.newest = self.message = None
            self._arrivals_ns.clear()
        self.followed = followed

    def is_coming(self, now_ns: int) -> bool:
        """Whether its first message since somebody looks is still to come."""
        return self.newest is None and self.tally.rate_hz(now_ns) >= 1.0

    @property
    def count(self) -> int:
        """Messages since this process started."""
        return self.tally.count or self._taken

    def _note_latency(self, said_ns: int | None, received_ns: int) -> None:
        latency_s = -1.0 if said_ns is None else (received_ns - said_ns) * 1e-9
        if 0 <= latency_s < LATENCY_MAXIMUM_S:
            self.latencies_s.append(latency_s)

    def decoded(self) -> Message:
        """Decode the newest message, once."""
        if self.newest is None:
            raise BadPayload(f"nothing has come on {self.name}")
        if self.message is None:
            self.message = self.newest.decode()
        return self.message

    def roll(self, now_ns: int) -> None:
        """Close a second: renew the rate and the latencies."""
        self._seconds.append(self._taken - self._counted)
        self._counted = self._taken
        told = self.tally.count > 0
        self.rate_hz = self.tally.rate_hz(now_ns) if told else sum(self._seconds) / len(self._seconds)
        ordered = sorted(self.latencies_s)
        self.latency_p50_s, self.latency_p99_s = percentile(ordered, 0.5), percentile(ordered, 0.99)

    def age_s(self, now_ns: int) -> float | None:
        """Age of what the newest message says, by its stamp; None if there is none."""
        return None if self.updated_ns is None else max((now_ns - self.updated_ns) * 1e-9, 0.0)

    def freshness(self, now_ns: int) -> Freshness:
        """Judge the age of the newest message."""
        return freshness_of(self.age_s(now_ns), self.limits)

    @property
    def jitter_s(self) -> float | None:
        """Standard deviation of the time between arrivals; None of fewer than three."""
        stamps = list(self._arrivals_ns)
        gaps = [(b - a) * 1e-9 for a, b in pairwise(stamps)]
        if len(gaps) < 2:
            return None
        mean = sum(gaps) / len(gaps)
        return float((sum((gap - mean) ** 2 for gap in gaps) / (len(gaps) - 1)) ** 0.5)


class ProcessFlow:
    """Load and counters of one process, from its health messages."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.health: ProcessHealth | None = None
        self.heartbeat_ns: int | None = None
        self.cpu_share: float | None = None  # of one core
        self.in_hz: float | None = None
        self.out_hz: float | None = None
        self.last_error: str | None = None
        self.kinds: tuple[MessageKind, ...] = ()  # messages of its devices
        self._past: deque[ProcessHealth] = deque(maxlen=HEARTBEATS)

    @property
    def memory_bytes(self) -> int | None:
        """Proportional set size; of a recording that has none, the resident set size. None if nothing is known."""
        return (self.health.pss_bytes or self.health.rss_bytes) if self.health else None

    def note(self, health: ProcessHealth, heartbeat_ns: int) -> None:
        """Take one health message."""
        before = self.health
        same_life = before is not None and before.incarnation == health.incarnation
        self.last_error = health.last_error or (self.last_error if same_life else None)
        self.heartbeat_ns = heartbeat_ns
        if health.state.is_over and before is not None:
            # A last will was written at the start: the newest values of the incarnation are kept, except its state.
            self.health = before.model_copy(update={"state": health.state, "incarnation": health.incarnation})
            return
        if not same_life:
            self._past.clear()
            self.kinds = ()
        self.kinds = health.kinds or self.kinds  # not every heartbeat holds the table
        self.health = health
        self._past.append(health)
        first = self._past[0]
        if (elapsed_s := (health.sent_ns - first.sent_ns) * 1e-9) > 0.1:
            self.cpu_share = (health.cpu_s - first.cpu_s) / elapsed_s
            self.in_hz = (health.messages_in - first.messages_in) / elapsed_s
            self.out_hz = (health.messages_out - first.messages_out) / elapsed_s
