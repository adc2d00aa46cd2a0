"""MQTT 5 control packets as a broker reads and writes them (OASIS MQTT 5.0, chapter 3)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeVar

from . import properties as p
from .properties import Properties, Property
from .wire import ProtocolError, Reader, Reason, text, varint


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


class Publish(NamedTuple):
    """An application message, to or from the broker; `properties` are the bytes to pass on unchanged."""

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False
    duplicate: bool = False
    packet_id: int = 0
    properties: bytes = b""
    expiry_s: int | None = None


@dataclass(frozen=True, slots=True)
class Connect:
    """A client's wish to connect; its password is not kept."""

    client_id: str
    clean_start: bool
    keep_alive_s: int
    user: str | None
    will: Publish | None
    properties: Properties


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """PUBACK of a message of QoS 1."""

    packet_id: int
    reason: int


@dataclass(frozen=True, slots=True)
class Subscription:
    """One filter of a SUBSCRIBE with its options."""

    pattern: str
    qos: int = 0
    no_local: bool = False
    retain_as_published: bool = False
    retain_handling: int = 0


@dataclass(frozen=True, slots=True)
class Subscribe:
    """Filters to subscribe to."""

    packet_id: int
    subscriptions: tuple[Subscription, ...]
    properties: Properties


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """Filters to give up."""

    packet_id: int
    patterns: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Ping:
    """A sign of life."""


@dataclass(frozen=True, slots=True)
class Disconnect:
    """A farewell."""

    reason: int
    properties: Properties = p.NONE


P = TypeVar("P")
Packet = Connect | Publish | Acknowledge | Subscribe | Unsubscribe | Ping | Disconnect
FLAGS = {Kind.SUBSCRIBE: 2, Kind.UNSUBSCRIBE: 2}  # the lower four bits of the first byte; else 0


class UnsupportedVersion(Exception):
    """A client that speaks another MQTT than 5; `level` is its protocol level, 4 for 3.1.1."""

    def __init__(self, level: int) -> None:
        super().__init__(f"protocol level {level}")
        self.level = level


def decode(first: int, body: bytes) -> Packet:
    """Read a packet that a client sends; raises ProtocolError or UnsupportedVersion, nothing else."""
    if first >> 4 == Kind.PUBLISH:
        return decode_publish(first & 0x0F, Reader(body))
    return decode_by(READERS, first, body)


def decode_by(readers: Mapping[int, Callable[[Reader], P]], first: int, body: bytes) -> P:
    """Read a packet to its very end by the reader of its type."""
    kind, flags = first >> 4, first & 0x0F
    reads = readers.get(kind)
    if reads is None:
        raise ProtocolError(Reason.PROTOCOL_ERROR, f"the other side does not send packets of type {kind}")
    if flags != FLAGS.get(Kind(kind), 0):
        raise ProtocolError(Reason.MALFORMED_PACKET, f"flags {flags:#x} on a packet of type {kind}")
    reader = Reader(body)
    packet = reads(reader)
    if reader.position != reader.end:
        raise ProtocolError(Reason.MALFORMED_PACKET, "bytes after the end of the packet")
    return packet


def decode_publish(flags: int, reader: Reader) -> Publish:
    """Read a PUBLISH; neither the broker nor the client offers topic aliases or QoS 2."""
    qos = flags >> 1 & 3
    if qos > 1:
        raise ProtocolError(Reason.MALFORMED_PACKET if qos == 3 else Reason.QOS_NOT_SUPPORTED, f"QoS {qos}")
    if flags & 8 and not qos:
        raise ProtocolError(Reason.MALFORMED_PACKET, "a duplicate of QoS 0")
    topic = reader.text()
    packet_id = packet_id_of(reader) if qos else 0
    found = p.decode(reader, p.ON_PUBLISH)
    if Property.TOPIC_ALIAS in found.numbers:
        raise ProtocolError(Reason.TOPIC_ALIAS_INVALID, "a topic alias, of which there are none")
    expiry_s = found.numbers.get(Property.MESSAGE_EXPIRY_S)
    return Publish(topic, reader.rest(), qos, bool(flags & 1), bool(flags & 8), packet_id, found.passed_on, expiry_s)


def packet_id_of(reader: Reader) -> int:
    """Read a packet identifier, which is never 0."""
    packet_id = reader.integer(2)
    if packet_id == 0:
        raise ProtocolError(Reason.PROTOCOL_ERROR, "packet identifier 0")
    return packet_id


def _decode_connect(reader: Reader) -> Connect:
    name, level = reader.binary(), reader.integer(1)
    if (name, level) in ((b"MQTT", 4), (b"MQIsdp", 3)) or (name == b"MQTT" and level != 5):
        raise UnsupportedVersion(level)
    if name != b"MQTT":
        raise ProtocolError(Reason.UNSUPPORTED_PROTOCOL_VERSION, "not MQTT")
    flags, keep_alive_s = reader.integer(1), reader.integer(2)
    if flags & 1:
        raise ProtocolError(Reason.MALFORMED_PACKET, "reserved flag of CONNECT")
    found = p.decode(reader, p.ON_CONNECT)
    client_id = reader.text()
    will = _decode_will(flags, reader)
    user = reader.text() if flags & 0x80 else None
    if flags & 0x40:
        reader.binary()
    return Connect(client_id, bool(flags & 2), keep_alive_s, user, will, found)


def _decode_will(flags: int, reader: Reader) -> Publish | None:
    qos, retain = flags >> 3 & 3, bool(flags & 0x20)
    if not flags & 4:
        if qos or retain:
            raise ProtocolError(Reason.MALFORMED_PACKET, "flags of a will that is not there")
        return None
    if qos > 1:
        raise ProtocolError(Reason.MALFORMED_PACKET if qos == 3 else Reason.QOS_NOT_SUPPORTED, f"will of QoS {qos}")
    found = p.decode(reader, p.ON_WILL)
    expiry_s = found.numbers.get(Property.MESSAGE_EXPIRY_S)
    topic, payload = reader.text(), reader.binary()
    return Publish(topic, payload, qos, retain, properties=found.passed_on, expiry_s=expiry_s)


def decode_acknowledge(reader: Reader) -> Acknowledge:
    """Read a PUBACK."""
    packet_id = packet_id_of(reader)
    reason = reader.integer(1) if reader.position < reader.end else 0
    if reader.position < reader.end:
        p.decode(reader, p.ON_ACKNOWLEDGE)
    return Acknowledge(packet_id, reason)


def _decode_subscribe(reader: Reader) -> Subscribe:
    packet_id = packet_id_of(reader)
    found = p.decode(reader, p.ON_SUBSCRIBE)
    _at_least_one(reader)
    subscriptions = []
    while reader.position < reader.end:
        pattern, options = reader.text(), reader.integer(1)
        if options & 0xC0 or options & 3 == 3 or options >> 4 & 3 == 3:
            raise ProtocolError(Reason.MALFORMED_PACKET, f"subscription options {options:#x}")
        subscriptions.append(Subscription(pattern, options & 3, bool(options & 4), bool(options & 8), options >> 4 & 3))
    return Subscribe(packet_id, tuple(subscriptions), found)


def _decode_unsubscribe(reader: Reader) -> Unsubscribe:
    packet_id = packet_id_of(reader)
    p.decode(reader, p.ON_UNSUBSCRIBE)
    _at_least_one(reader)
    patterns = []
    while reader.position < reader.end:
        patterns.append(reader.text())
    return Unsubscribe(packet_id, tuple(patterns))


def _at_least_one(reader: Reader) -> None:
    if reader.position == reader.end:
        raise ProtocolError(Reason.PROTOCOL_ERROR, "no topic filter")


def decode_disconnect(reader: Reader) -> Disconnect:
    """Read a farewell."""
    reason = reader.integer(1) if reader.position < reader.end else 0
    found = p.decode(reader, p.ON_DISCONNECT) if reader.position < reader.end else p.NONE
    return Disconnect(reason, found)


READERS: dict[int, Callable[[Reader], Packet]] = {
    Kind.CONNECT: _decode_connect,
    Kind.PUBACK: decode_acknowledge,
    Kind.SUBSCRIBE: _decode_subscribe,
    Kind.UNSUBSCRIBE: _decode_unsubscribe,
    Kind.PINGREQ: lambda _: Ping(),
    Kind.DISCONNECT: decode_disconnect,
}


def frame(kind: Kind, body: bytes, flags: int = 0) -> bytes:
    """Put the fixed header before the body of a packet."""
    return bytes((kind << 4 | flags,)) + varint(len(body)) + body


def encode_publish(message: Publish) -> bytes:
    """Write a PUBLISH."""
    flags = message.duplicate << 3 | message.qos << 1 | message.retain
    return publish_frame(flags, text(message.topic), message.packet_id, publish_properties(message), message.payload)


def publish_properties(message: Publish) -> bytes:
    """Write the properties of a PUBLISH, with their length."""
    expiry = {} if message.expiry_s is None else {Property.MESSAGE_EXPIRY_S: message.expiry_s}
    return p.encode(Properties(expiry, passed_on=message.properties))


def publish_frame(flags: int, topic: bytes, packet_id: int, properties: bytes, payload: bytes) -> bytes:
    """Put a PUBLISH together from parts that are encoded already."""
    number = packet_id.to_bytes(2) if flags & 6 else b""
    size = len(topic) + len(number) + len(properties) + len(payload)
    return b"".join((FIRST_OF_PUBLISH[flags], varint(size), topic, number, properties, payload))


def encode_connack(reason: Reason, *, session_present: bool = False, properties: Properties = p.NONE) -> bytes:
    """Write the answer to a CONNECT."""
    return frame(Kind.CONNACK, bytes((session_present, reason)) + p.encode(properties))


def encode_refusal(level: int) -> bytes:
    """Write the answer to a client of another MQTT in its own tongue: up to 3.1.1 return code 1, else MQTT 5."""
    if level < 5:
        return frame(Kind.CONNACK, b"\0\1")
    return encode_connack(Reason.UNSUPPORTED_PROTOCOL_VERSION)


def encode_puback(packet_id: int, reason: Reason) -> bytes:
    """Write the acknowledgement of a message of QoS 1."""
    return frame(Kind.PUBACK, packet_id.to_bytes(2) + (bytes((reason,)) if reason else b""))


def encode_suback(kind: Kind, packet_id: int, reasons: list[int]) -> bytes:
    """Write a SUBACK or UNSUBACK: a reason code for each filter, in the order asked for."""
    return frame(kind, packet_id.to_bytes(2) + b"\0" + bytes(reasons))


def encode_disconnect(reason: Reason) -> bytes:
    """Write the broker's farewell."""
    return frame(Kind.DISCONNECT, bytes((reason,)))


FIRST_OF_PUBLISH = tuple(bytes((Kind.PUBLISH << 4 | flags,)) for flags in range(16))
PINGRESP = frame(Kind.PINGRESP, b"")
