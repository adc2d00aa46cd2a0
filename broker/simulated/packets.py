"""MQTT 3.1.1 control packets as the broker reads and writes them (OASIS MQTT 3.1.1, chapters 2 and 3)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple


class Kind(IntEnum):
    """Types of control packet: the upper four bits of the first byte."""

    CONNECT = 1
    CONNACK = 2
    PUBLISH = 3
    PUBACK = 4
    SUBSCRIBE = 8
    SUBACK = 9
    UNSUBSCRIBE = 10
    UNSUBACK = 11
    PINGREQ = 12
    PINGRESP = 13
    DISCONNECT = 14


class Answer(IntEnum):
    """Return codes of CONNACK (section 3.2.2.3)."""

    ACCEPTED = 0
    UNACCEPTABLE_PROTOCOL_VERSION = 1
    IDENTIFIER_REJECTED = 2
    SERVER_UNAVAILABLE = 3
    NOT_AUTHORIZED = 5


REFUSED = 0x80  # in a SUBACK: the filter is not subscribed to


class ProtocolError(Exception):
    """An invalid packet, which ends its connection; `answer` is sent first if given."""

    def __init__(self, detail: str, answer: Answer | None = None) -> None:
        super().__init__(detail)
        self.answer = answer


class Publish(NamedTuple):
    """An application message, to or from the broker."""

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    packet_id: int = 0


@dataclass(frozen=True, slots=True)
class Connect:
    """CONNECT."""

    client_id: str
    clean_session: bool
    keep_alive_s: int
    user: str | None
    will: Publish | None
    password: str | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """PUBACK of a message of QoS 1."""

    packet_id: int


@dataclass(frozen=True, slots=True)
class Subscribe:
    """SUBSCRIBE: filters with the maximum QoS of each."""

    packet_id: int
    filters: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """UNSUBSCRIBE: filters."""

    packet_id: int
    filters: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Ping:
    """PINGREQ."""


@dataclass(frozen=True, slots=True)
class Disconnect:
    """DISCONNECT: the will is not published."""


Packet = Connect | Publish | Acknowledge | Subscribe | Unsubscribe | Ping | Disconnect


class Framer:
    """Splits a byte stream into packets; buffers at most `limit` bytes plus one read, of the first packet `first`."""

    def __init__(self, limit: int, first: int | None = None) -> None:
        self._limit, self._later = limit if first is None else first, limit
        self._left = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Give the first byte and the body of each packet that is complete; raises ProtocolError."""
        self._left += data
        position = 0
        while (span := self._span(position)) is not None:
            start, stop = span
            yield self._left[position], bytes(self._left[start:stop])
            position, self._limit = stop, self._later
        del self._left[:position]

    def _span(self, position: int) -> tuple[int, int] | None:
        """Find where the body of the packet at `position` starts and stops; None while bytes are missing."""
        size = 0
        for group, byte in enumerate(self._left[position + 1 : position + 5]):
            size |= (byte & 0x7F) << 7 * group
            if byte < 0x80:
                start = position + 2 + group
                if start - position + size > self._limit:
                    raise ProtocolError(f"a packet of {size} bytes")
                return (start, start + size) if start + size <= len(self._left) else None
        if len(self._left) - position >= 5:
            raise ProtocolError("a remaining length of more than four bytes")
        return None


class Reader:
    """Reads fields from the body of one packet and never beyond its end."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    @property
    def left(self) -> int:
        """Number of unread bytes."""
        return len(self._data) - self._position

    def take(self, size: int) -> bytes:
        """Read `size` bytes."""
        if size > self.left:
            raise ProtocolError("the packet ends inside a field")
        self._position += size
        return self._data[self._position - size : self._position]

    def integer(self, size: int) -> int:
        """Read a big-endian integer."""
        return int.from_bytes(self.take(size))

    def binary(self) -> bytes:
        """Read binary data with its length of two bytes."""
        return self.take(self.integer(2))

    def text(self) -> str:
        """Read a UTF-8 string without U+0000."""
        try:
            text = self.binary().decode()
        except UnicodeDecodeError:
            raise ProtocolError("a string is not UTF-8") from None
        if "\0" in text:
            raise ProtocolError("a string holds U+0000")
        return text

    def packet_id(self) -> int:
        """Read a packet identifier, which is never 0."""
        packet_id = self.integer(2)
        if packet_id == 0:
            raise ProtocolError("packet identifier 0")
        return packet_id


def decode(first: int, body: bytes) -> Packet:
    """Read a packet that a client sends; raises ProtocolError, nothing else."""
    kind, flags, reader = first >> 4, first & 0x0F, Reader(body)
    if kind == Kind.PUBLISH:
        return _publish(flags, reader)
    if kind not in READERS:
        raise ProtocolError(f"a client does not send packets of type {kind}")
    if flags != (2 if kind in (Kind.SUBSCRIBE, Kind.UNSUBSCRIBE) else 0):
        raise ProtocolError(f"flags {flags:#x} on a packet of type {kind}")
    packet = READERS[kind](reader)
    if reader.left:
        raise ProtocolError("bytes after the end of the packet")
    return packet


def _publish(flags: int, reader: Reader) -> Publish:
    qos = _at_most_one(flags >> 1 & 3)
    topic = reader.text()
    packet_id = reader.packet_id() if qos else 0
    return Publish(topic, reader.take(reader.left), qos, bool(flags & 1), packet_id)


def _at_most_one(qos: int) -> int:
    if qos > 1:
        raise ProtocolError(f"QoS {qos}; this broker has 0 and 1")
    return qos


def _connect(reader: Reader) -> Connect:
    if reader.binary() not in (b"MQTT", b"MQIsdp"):
        raise ProtocolError("not MQTT")
    if (level := reader.integer(1)) != 4:
        raise ProtocolError(f"MQTT protocol level {level}, wants 4", Answer.UNACCEPTABLE_PROTOCOL_VERSION)
    flags, keep_alive_s = reader.integer(1), reader.integer(2)
    client_id, clean_session = reader.text(), bool(flags & 2)
    if not client_id and not clean_session:
        raise ProtocolError("a session without a name", Answer.IDENTIFIER_REJECTED)
    will = None
    if flags & 4:
        will = Publish(reader.text(), reader.binary(), _at_most_one(flags >> 3 & 3), bool(flags & 0x20))
    user = reader.text() if flags & 0x80 else None
    password = reader.binary().decode("utf-8", "replace") if flags & 0x40 else None
    return Connect(client_id, clean_session, keep_alive_s, user, will, password)


def _subscribe(reader: Reader) -> Subscribe:
    packet_id, filters = reader.packet_id(), [_filter(reader)]
    while reader.left:
        filters.append(_filter(reader))
    return Subscribe(packet_id, tuple(filters))


def _filter(reader: Reader) -> tuple[str, int]:
    pattern, qos = reader.text(), reader.integer(1)
    if qos > 2:
        raise ProtocolError(f"a subscription with QoS {qos}")
    return pattern, min(qos, 1)


def _unsubscribe(reader: Reader) -> Unsubscribe:
    packet_id, filters = reader.packet_id(), [reader.text()]
    while reader.left:
        filters.append(reader.text())
    return Unsubscribe(packet_id, tuple(filters))


READERS: dict[int, Callable[[Reader], Packet]] = {
    Kind.CONNECT: _connect,
    Kind.PUBACK: lambda reader: Acknowledge(reader.packet_id()),
    Kind.SUBSCRIBE: _subscribe,
    Kind.UNSUBSCRIBE: _unsubscribe,
    Kind.PINGREQ: lambda _: Ping(),
    Kind.DISCONNECT: lambda _: Disconnect(),
}


def frame(kind: Kind, body: bytes, flags: int = 0) -> bytes:
    """Put the fixed header before the body of a packet."""
    size, length = len(body), bytearray()
    while size >= 0x80:
        length.append(size & 0x7F | 0x80)
        size >>= 7
    return bytes((kind << 4 | flags, *length, size)) + body


def encode_publish(message: Publish) -> bytes:
    """Write a PUBLISH."""
    topic, packet_id = message.topic.encode(), message.packet_id.to_bytes(2) if message.qos else b""
    body = len(topic).to_bytes(2) + topic + packet_id + message.payload
    return frame(Kind.PUBLISH, body, message.qos << 1 | message.retain)


def encode_connack(answer: Answer) -> bytes:
    """Encode a CONNACK; no session is present."""
    return frame(Kind.CONNACK, bytes((0, answer)))


def encode_acknowledgement(kind: Kind, packet_id: int, granted: bytes = b"") -> bytes:
    """Write a PUBACK, a SUBACK with the QoS granted to each filter, or an UNSUBACK."""
    return frame(kind, packet_id.to_bytes(2) + granted)


PINGRESP = frame(Kind.PINGRESP, b"")
