"""The session of a client: subscriptions, messages in flight, and a bounded queue."""

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from .counters import Counters
from .packets import Publish, encode_publish


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits on the memory that a client can occupy."""

    packet_bytes: int = 262_144  # 240 KiB of payload, 16 KiB of the rest
    queue_messages: int = 1_000
    queue_bytes: int = 4_194_304  # of payload
    in_flight: int = 100
    sessions: int = 500
    sessions_of_user: int = 100
    subscriptions: int = 500  # a session
    retained: int = 1_000
    retained_bytes: int = 33_554_432
    packets_in_turn: int = 64  # of a client, before the others are served
    bytes_in_turn: int = 65_536
    unread_bytes: int = 1_048_576  # of replies to a client that does not read
    connect_within_s: float = 5.0
    connections: int = 64  # to a listener, also of those that have not said who they are
    connect_bytes: int = 16_384  # of the packet that says it


class Writer(Protocol):
    """The connection of a session."""

    writable: bool

    def write(self, frame: bytes) -> None:
        """Send the bytes of one packet."""

    def end(self, *, will: bool = True) -> None:
        """Close the connection."""


class Session:
    """One connected client; it ends with its connection."""

    def __init__(
        self, client_id: str, user: str | None, will: Publish | None, writer: Writer, limits: Limits, counters: Counters
    ) -> None:
        self.client_id, self.user, self.will, self.writer = client_id, user, will, writer
        self.subscriptions: dict[str, int] = {}  # QoS by filter
        self.queue: deque[Publish] = deque()
        self.queue_bytes = 0
        self.in_flight: set[int] = set()
        self._limits, self._counters = limits, counters
        self.packet_id = 0

    def send(self, message: Publish, frame: bytes = b"") -> None:
        """Send a message, or queue it behind the waiting ones; `frame` is its encoding, if known."""
        if not self.queue and self._ready(message):
            self._write(message, frame)
        else:
            self._enqueue(message)

    def acknowledge(self, packet_id: int) -> None:
        """Remove an acknowledged message from those in flight, and send the next."""
        self.in_flight.discard(packet_id)
        self.pump()

    def pump(self) -> None:
        """Send the queued messages, as far as the client reads."""
        while self.queue and self._ready(self.queue[0]):
            message = self.queue.popleft()
            self.queue_bytes -= len(message.payload)
            self._write(message)

    def _ready(self, message: Publish) -> bool:
        return self.writer.writable and (message.qos == 0 or len(self.in_flight) < self._limits.in_flight)

    def _enqueue(self, message: Publish) -> None:
        self.queue.append(message)
        self.queue_bytes += len(message.payload)
        while len(self.queue) > self._limits.queue_messages or self.queue_bytes > self._limits.queue_bytes:
            self._forget_oldest()

    def _forget_oldest(self) -> None:
        """Drop the oldest message of QoS 0, or the oldest of all if every message is of QoS 1."""
        index = next((i for i, waiting in enumerate(self.queue) if waiting.qos == 0), 0)
        self.queue_bytes -= len(self.queue[index].payload)
        del self.queue[index]
        self._counters.note("dropped", f"the queue of {self.client_id} is full")

    def _write(self, message: Publish, frame: bytes = b"") -> None:
        if message.qos:
            packet_id = self._next_packet_id()
            self.in_flight.add(packet_id)
            message = message._replace(packet_id=packet_id)
        self.writer.write(frame or encode_publish(message))

    def _next_packet_id(self) -> int:
        while True:
            self.packet_id = self.packet_id % 65_535 + 1
            if self.packet_id not in self.in_flight:
                return self.packet_id
