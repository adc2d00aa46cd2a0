"""A small MQTT 5 client that works only while it is called: no thread, no callback, nothing without a bound.

QoS 0 and 1, last will, keep-alive, user properties, expiry. It keeps no session with the broker: after each connection
it subscribes anew, and sends again, marked as duplicate, what the broker never acknowledged.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Generic, NamedTuple, TypeVar

from .client_packets import PINGREQ, Answer, Granted, Welcome, decode_answer, encode_connect, encode_subscribe
from .connection import Connection, Lost
from .packets import Acknowledge, Connect, Disconnect, Kind, Ping, Subscription, publish_frame
from .packets import encode_disconnect as farewell
from .properties import Properties, Property
from .wire import FAILURE, ProtocolError, Reason, in_words

__all__ = ["Client", "Lost", "Refused"]

log = logging.getLogger(__name__)
T = TypeVar("T")

CONNECT_S = 1.0  # a host that does not answer shall not use up the time that SIGTERM leaves
IN_FLIGHT = 100  # messages of QoS 1 that the broker has not acknowledged yet
GATHERED_BYTES = 65_536
PUBLISH, QOS_BITS = int(Kind.PUBLISH), 6
PUBACK = bytes((Kind.PUBACK << 4, 2))
LOOK_S = 0.1  # between two looks at the keep-alive
LARGEST_PACKET = 268_435_460  # of all that MQTT can express


class Refused(Lost):
    """The broker does not let us in."""


class Outgoing(NamedTuple):
    """A message whose topic and properties are encoded."""

    topic: bytes
    properties: bytes
    payload: bytes
    qos: int
    retain: bool
    duplicate: bool = False


class Client(Generic[T]):
    """One connection after another to a broker.

    `read` makes of a PUBLISH what the owner wants. What came is in `inbox`, which forgets the oldest when it is full.
    Messages of QoS 1 wait for their turn, or for the broker, in a queue of the same length; those of QoS 0 wait only
    while the broker is there and reads slowly. `dropped` counts what either forgot.
    """

    def __init__(
        self, request: Connect, password: str | None, subscriptions: Iterable[Subscription],
        read: Callable[[int, bytes], T], *, queue: int, packet_bytes: int,
    ) -> None:  # fmt: skip
        limits = {Property.RECEIVE_MAXIMUM: IN_FLIGHT, Property.MAXIMUM_PACKET_SIZE: packet_bytes}
        self._request = replace(request, properties=Properties({**request.properties.numbers, **limits}))
        self._password = password
        self._subscriptions = tuple(subscriptions)
        self._packet_bytes = packet_bytes
        self._read = read
        self.inbox: deque[T] = deque(maxlen=queue)
        self.dropped = 0
        self.up = False
        self.complaint: str | None = None  # the last refusal of a message or subscription
        self.refusals = 0
        self._waiting: deque[Outgoing] = deque()
        self._queue = queue
        self._in_flight: dict[int, Outgoing] = {}
        self._connection: Connection | None = None
        self._packet_id = 0
        self._window, self._largest = IN_FLIGHT, LARGEST_PACKET
        self._keep_alive_s = request.keep_alive_s
        self._look_s, self._pinged = 0.0, False

    @property
    def is_open(self) -> bool:
        """Whether there is a connection, be it that the broker has not greeted us yet."""
        return self._connection is not None

    @property
    def gathered_bytes(self) -> int:
        """How much waits for the next `flush`."""
        return self._connection.unsent_bytes if self._connection else 0

    @property
    def is_idle(self) -> bool:
        """Whether the broker has all that was published, as far as it tells."""
        return not (self.gathered_bytes or self._waiting or self._in_flight)

    def open(self, host: str, port: int) -> None:
        """Connect; raises OSError. The broker's answer comes with `exchange`."""
        self._connection = Connection(host, port, patience_s=CONNECT_S, packet_bytes=self._packet_bytes)
        self._connection.gather(encode_connect(self._request, self._password))
        self._keep_alive_s, self._pinged = self._request.keep_alive_s, False

    def publish(self, message: Outgoing) -> None:
        """Take a message for the next `flush` or `exchange`."""
        connection = self._connection
        if connection is None or not self.up:
            if message.qos:
                self._wait(message)
            else:
                self.dropped += 1
        elif self._waiting or not self._ready(connection, message):
            self._wait(message)
        else:
            self._transmit(connection, message)

    def flush(self) -> None:
        """Write what was gathered; raises `Lost`."""
        if self._connection is not None:
            try:
                self._connection.flush()
            except Lost:
                self._end()
                raise

    def exchange(self, timeout_s: float) -> None:
        """Write what was gathered, wait for the broker's word, and take in all of it; raises `Lost`.

        A message is acknowledged with the next `flush`, when whoever called this had it in hand.
        """
        connection = self._connection
        if connection is None:
            raise Lost("there is no connection")
        try:
            if time.monotonic() >= self._look_s:
                self._keep_alive(connection)  # before the wait: what comes shall not wait for it
            connection.flush()
            if connection.wait(timeout_s):
                self._take_in(connection)
            if self._waiting:
                self._pump(connection)
        except Lost:
            self._end()
            raise
        except ProtocolError as error:
            connection.leave(farewell(error.reason))
            self._end()
            raise Lost(f"the broker broke the protocol: {error}") from error

    def leave(self) -> None:
        """Say farewell, so that the last will is not sent."""
        if self._connection is not None:
            self._connection.leave(farewell(Reason.SUCCESS))
            self._end()

    def _take_in(self, connection: Connection) -> None:
        inbox = self.inbox
        for first, body in connection.read():
            if first >> 4 != PUBLISH:
                self._handle(connection, decode_answer(first, body))
                continue
            if not self.up:
                raise ProtocolError(Reason.PROTOCOL_ERROR, "a message before the greeting")
            self.dropped += len(inbox) == self._queue
            inbox.append(self._read(first, body))
            if first & QOS_BITS:
                topic_end = 2 + int.from_bytes(body[:2])
                connection.gather(PUBACK + body[topic_end : topic_end + 2])

    def _handle(self, connection: Connection, answer: Answer) -> None:
        match answer:
            case Welcome():
                self._begin(connection, answer)
            case Disconnect():
                raise Lost(f"the broker says {in_words(answer.reason)}")
            case _ if not self.up:
                raise ProtocolError(Reason.PROTOCOL_ERROR, "an answer before the greeting")
            case Acknowledge():
                self._in_flight.pop(answer.packet_id, None)
                if answer.reason >= FAILURE:
                    self._complain(f"the broker refuses a message: {in_words(answer.reason)}")
            case Granted():
                refused = {in_words(reason) for reason in answer.reasons if reason >= FAILURE}
                if refused:
                    self._complain(f"the broker refuses a subscription: {', '.join(sorted(refused))}")
            case Ping():
                self._pinged = False

    def _complain(self, complaint: str) -> None:
        self.refusals += 1
        if complaint != self.complaint:
            log.error("%s", complaint)
        self.complaint = complaint

    def _begin(self, connection: Connection, welcome: Welcome) -> None:
        if self.up:
            raise ProtocolError(Reason.PROTOCOL_ERROR, "a second greeting")
        if welcome.reason >= FAILURE:
            raise Refused(in_words(welcome.reason))
        numbers = welcome.properties.numbers
        if not (numbers.get(Property.MAXIMUM_QOS, 1) and numbers.get(Property.RETAIN_AVAILABLE, 1)):
            raise Refused("it takes no messages of QoS 1, or retains none")
        self.up, self.complaint = True, None
        self._window = min(numbers.get(Property.RECEIVE_MAXIMUM, IN_FLIGHT), IN_FLIGHT)
        self._largest = numbers.get(Property.MAXIMUM_PACKET_SIZE, LARGEST_PACKET)
        self._keep_alive_s = numbers.get(Property.SERVER_KEEP_ALIVE_S, self._request.keep_alive_s)
        if self._subscriptions:
            connection.gather(encode_subscribe(self._next_packet_id(), self._subscriptions))
        again = [message._replace(duplicate=True) for message in self._in_flight.values()]
        self._in_flight.clear()
        self._waiting.extendleft(reversed(again))
        self._pump(connection)
        connection.flush()

    def _ready(self, connection: Connection, message: Outgoing) -> bool:
        return not connection.blocked and (not message.qos or len(self._in_flight) < self._window)

    def _wait(self, message: Outgoing) -> None:
        self._waiting.append(message)
        if len(self._waiting) > self._queue:
            self._waiting.popleft()
            self.dropped += 1

    def _pump(self, connection: Connection) -> None:
        """Send what waited, in its order, as far as the broker takes it."""
        while self._waiting and self._ready(connection, self._waiting[0]):
            self._transmit(connection, self._waiting.popleft())
            if connection.unsent_bytes > GATHERED_BYTES:
                connection.flush()

    def _transmit(self, connection: Connection, message: Outgoing) -> None:
        packet_id = self._next_packet_id() if message.qos else 0
        flags = message.duplicate << 3 | message.qos << 1 | message.retain
        frame = publish_frame(flags, message.topic, packet_id, message.properties, message.payload)
        if len(frame) > self._largest:
            self.dropped += 1
            self._complain(f"a message of {len(frame)} bytes is more than the broker takes")
            return
        if packet_id:
            self._in_flight[packet_id] = message
        connection.gather(frame)

    def _next_packet_id(self) -> int:
        while True:
            self._packet_id = self._packet_id % 65_535 + 1
            if self._packet_id not in self._in_flight:
                return self._packet_id

    def _keep_alive(self, connection: Connection) -> None:
        """Ask for a sign of life where either side has been silent for long, and end what gives none."""
        now_s, period_s = time.monotonic(), 0.75 * self._keep_alive_s
        self._look_s = now_s + LOOK_S
        if not period_s:
            return
        if now_s - connection.heard_s >= 2 * period_s:
            raise Lost("the broker does not answer")
        if self.up and not self._pinged and now_s - min(connection.sent_s, connection.heard_s) >= period_s:
            self._pinged = True
            connection.gather(PINGREQ)

    def _end(self) -> None:
        """Close, and keep what the broker must still get."""
        if self._connection is not None:
            self._connection.close()
        self._connection, self.up = None, False
        kept = [message for message in self._waiting if message.qos]
        self.dropped += len(self._waiting) - len(kept)
        self._waiting = deque(kept)
