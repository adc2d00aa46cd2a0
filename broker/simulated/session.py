"""What the broker keeps for one client: subscriptions, messages in flight, and a bounded queue."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from shared.bus.mqtt.packets import Publish, Subscription, encode_publish
from shared.bus.mqtt.wire import Reason

from .tally import Tally


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on what a client can make the broker hold."""

    packet_bytes: int = 1_114_112  # 1 MiB of payload, 64 KiB of the rest
    queue_messages: int = 1_000
    queue_bytes: int = 16_777_216  # of payload
    in_flight: int = 100
    session_expiry_s: int = 3_600
    sessions: int = 500
    subscriptions: int = 500  # a session
    retained: int = 1_000
    unread_bytes: int = 1_048_576  # of answers to a client that asks and does not read
    connect_within_s: float = 5.0


class Writer(Protocol):
    """The connection of a session."""

    writable: bool

    def write(self, frame: bytes) -> None:
        """Send the bytes of one packet."""

    def end(self, reason: Reason, *, will: bool = True) -> None:
        """Close the connection, with a farewell that says why."""


class Delivery(NamedTuple):
    """A message on its way to a client; `frame` are its bytes where they are the same for every client."""

    message: Publish
    deadline_s: float | None = None
    frame: bytes = b""


class Session:
    """One client, connected or awaited."""

    def __init__(self, client_id: str, limits: Limits, tally: Tally) -> None:
        self.client_id = client_id
        self.user: str | None = None
        self.will: Publish | None = None
        self.subscriptions: dict[str, Subscription] = {}
        self.writer: Writer | None = None
        self.expiry_s = 0
        self.ends_s: float | None = None  # when a session without a connection is forgotten
        self.window = 0  # messages of QoS 1 that the client takes at once
        self.packet_bytes = 0  # largest packet that the client takes
        self.queue: deque[Delivery] = deque()
        self.queue_bytes = 0
        self.in_flight: dict[int, Delivery] = {}
        self._limits = limits
        self._tally = tally
        self._packet_id = 0

    def send(self, delivery: Delivery, now_s: float) -> None:
        """Write a message now, or queue it behind those that wait: the order is never changed."""
        if self.writer is not None and not self.queue and self._ready(delivery):
            self._write(delivery, now_s)
        elif self.writer is not None or delivery.message.qos:
            self._enqueue(delivery)

    def acknowledge(self, packet_id: int, now_s: float) -> None:
        """Forget a message that the client has, and send what waited for its place."""
        if self.in_flight.pop(packet_id, None) is not None:
            self.pump(now_s)

    def pump(self, now_s: float) -> None:
        """Write what waits, as far as the client takes it."""
        while self.queue and self._ready(self.queue[0]):
            delivery = self.queue.popleft()
            self.queue_bytes -= len(delivery.message.payload)
            if delivery.deadline_s is None or delivery.deadline_s > now_s:
                self._write(delivery, now_s)

    def resume(self, now_s: float) -> None:
        """Send again what the client never acknowledged, marked as duplicate, then what waited."""
        unacknowledged, self.in_flight = self.in_flight, {}
        for packet_id, delivery in unacknowledged.items():
            self._write_as(packet_id, delivery._replace(message=delivery.message._replace(duplicate=True)), now_s)
        self.pump(now_s)

    def _ready(self, delivery: Delivery) -> bool:
        if self.writer is None or not self.writer.writable:
            return False
        return delivery.message.qos == 0 or len(self.in_flight) < self.window

    def _enqueue(self, delivery: Delivery) -> None:
        self.queue.append(delivery)
        self.queue_bytes += len(delivery.message.payload)
        while len(self.queue) > self._limits.queue_messages or self.queue_bytes > self._limits.queue_bytes:
            self._forget_oldest()

    def _forget_oldest(self) -> None:
        """Forget the oldest message of QoS 0, or the oldest of all where every message is of QoS 1."""
        index = next((i for i, waiting in enumerate(self.queue) if waiting.message.qos == 0), 0)
        self.queue_bytes -= len(self.queue[index].message.payload)
        del self.queue[index]
        self._tally.note("forgotten", f"the queue of {self.client_id} is full")

    def _write(self, delivery: Delivery, now_s: float) -> None:
        if delivery.message.qos:
            self._write_as(self._next_packet_id(), delivery, now_s)
        else:
            self._transmit(delivery.frame or _encode(delivery, 0, now_s))

    def _write_as(self, packet_id: int, delivery: Delivery, now_s: float) -> None:
        if self._transmit(_encode(delivery, packet_id, now_s)):
            self.in_flight[packet_id] = delivery

    def _transmit(self, frame: bytes) -> bool:
        if len(frame) > self.packet_bytes:
            self._tally.note("too large", f"a packet of {len(frame)} bytes for {self.client_id}")
            return False
        if self.writer is not None:
            self.writer.write(frame)
        return True

    def _next_packet_id(self) -> int:
        while True:
            self._packet_id = self._packet_id % 65_535 + 1
            if self._packet_id not in self.in_flight:
                return self._packet_id


def _encode(delivery: Delivery, packet_id: int, now_s: float) -> bytes:
    message = delivery.message
    expiry_s = message.expiry_s
    if expiry_s is not None and delivery.deadline_s is not None:
        expiry_s = min(expiry_s, max(1, round(delivery.deadline_s - now_s)))
    return encode_publish(message._replace(packet_id=packet_id, expiry_s=expiry_s))
