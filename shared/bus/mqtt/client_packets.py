"""MQTT 5 control packets as a client writes and reads them (OASIS MQTT 5.0, chapter 3)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from . import packets
from . import properties as p
from .packets import Acknowledge, Connect, Disconnect, Kind, Ping, Subscription, decode_by, frame
from .properties import Properties, Property
from .wire import ProtocolError, Reader, Reason, binary, text

MESSAGE_EXPIRY, USER_PROPERTY = int(Property.MESSAGE_EXPIRY_S), int(Property.USER_PROPERTY)
PINGREQ = frame(Kind.PINGREQ, b"")


class Delivery(NamedTuple):
    """A message from the broker, with its user properties; of a name that comes twice, the last."""

    topic: str
    payload: bytes
    user: dict[str, str]
    qos: int
    retained: bool
    packet_id: int


@dataclass(frozen=True, slots=True)
class Welcome:
    """CONNACK: whether we may stay, and what the broker can do."""

    reason: int
    session_present: bool
    properties: Properties


@dataclass(frozen=True, slots=True)
class Granted:
    """SUBACK: a reason code for each filter, in the order asked for."""

    packet_id: int
    reasons: tuple[int, ...]


Answer = Welcome | Acknowledge | Granted | Ping | Disconnect


def decode_answer(first: int, body: bytes) -> Answer:
    """Read a packet that a broker sends, other than PUBLISH; raises ProtocolError, nothing else."""
    return decode_by(ANSWERS, first, body)


def decode_delivery(first: int, body: bytes) -> Delivery:
    """Read a PUBLISH; raises ProtocolError, nothing else.

    One pass over the bytes, for this is what a client does most. Properties that the unit does not use are left to
    `packets.decode_publish`, and what it does not like is malformed there as well.
    """
    flags = first & 0x0F
    if flags > 3 or len(body) < 3:  # a duplicate, QoS 2, or too short
        return _decode_thoroughly(flags, body)
    user: dict[str, str] = {}
    try:
        position = 2 + (body[0] << 8 | body[1])
        topic = str(body[2:position], "utf-8")
        packet_id = 0
        if flags & 2:
            packet_id = body[position] << 8 | body[position + 1]
            position += 2
        length = body[position]
        position += 1
        if length > 127:
            length += (body[position] << 7) - 128
            position += 1
            if not 128 <= length < 16_384:
                return _decode_thoroughly(flags, body)
        stop = position + length
        expires = False
        while position < stop:
            if body[position] != USER_PROPERTY:
                if body[position] != MESSAGE_EXPIRY or expires:
                    return _decode_thoroughly(flags, body)
                expires = True
                position += 5
                continue
            start = position + 3
            position = start + (body[position + 1] << 8 | body[position + 2])
            key = str(body[start:position], "utf-8")
            start = position + 2
            position = start + (body[position] << 8 | body[position + 1])
            user[key] = str(body[start:position], "utf-8")
    except (IndexError, UnicodeDecodeError):
        return _decode_thoroughly(flags, body)
    strange = position != stop or stop > len(body) or (flags & 2 and not packet_id)
    if strange or "\0" in topic or any("\0" in key or "\0" in value for key, value in user.items()):
        return _decode_thoroughly(flags, body)
    return Delivery(topic, body[stop:], user, flags >> 1, bool(flags & 1), packet_id)


def _decode_thoroughly(flags: int, body: bytes) -> Delivery:
    message = packets.decode_publish(flags, Reader(body))
    user = dict(user_properties(message.properties))
    return Delivery(message.topic, message.payload, user, message.qos, message.retain, message.packet_id)


def user_properties(passed_on: bytes) -> list[tuple[str, str]]:
    """Find the user properties among properties that were read before."""
    reader, found = Reader(passed_on), []
    while reader.position < reader.end:
        kind = Property(reader.integer(1))
        if kind is Property.USER_PROPERTY:
            found.append((reader.text(), reader.text()))
        else:
            p.read_value(reader, kind, {}, {})
    return found


def user_property(key: str, value: str) -> bytes:
    """Write one user property."""
    return b"\x26" + text(key) + text(value)


def encode_connect(request: Connect, password: str | None) -> bytes:
    """Write a CONNECT; the password is not kept in the request."""
    will, body = request.will, b""
    flags = request.clean_start << 1
    if will is not None:
        flags |= 4 | will.qos << 3 | will.retain << 5
        body = packets.publish_properties(will) + text(will.topic) + binary(will.payload)
    if request.user is not None:
        flags |= 0x80
        body += text(request.user)
    if password is not None:
        flags |= 0x40
        body += text(password)
    head = text("MQTT") + bytes((5, flags)) + request.keep_alive_s.to_bytes(2) + p.encode(request.properties)
    return frame(Kind.CONNECT, head + text(request.client_id) + body)


def encode_subscribe(packet_id: int, subscriptions: Iterable[Subscription]) -> bytes:
    """Write a SUBSCRIBE."""
    filters = b"".join(
        text(s.pattern) + bytes((s.qos | s.no_local << 2 | s.retain_as_published << 3 | s.retain_handling << 4,))
        for s in subscriptions
    )
    return frame(Kind.SUBSCRIBE, packet_id.to_bytes(2) + b"\0" + filters, packets.FLAGS[Kind.SUBSCRIBE])


def _decode_welcome(reader: Reader) -> Welcome:
    flags, reason = reader.integer(1), reader.integer(1)
    if flags > 1:
        raise ProtocolError(Reason.MALFORMED_PACKET, f"flags {flags:#x} of CONNACK")
    return Welcome(reason, bool(flags), p.decode(reader, p.ON_CONNACK))


def _decode_granted(reader: Reader) -> Granted:
    packet_id = packets.packet_id_of(reader)
    p.decode(reader, p.ON_ACKNOWLEDGE)
    return Granted(packet_id, tuple(reader.rest()))


ANSWERS: dict[int, Callable[[Reader], Answer]] = {
    Kind.CONNACK: _decode_welcome,
    Kind.PUBACK: packets.decode_acknowledge,
    Kind.SUBACK: _decode_granted,
    Kind.PINGRESP: lambda _: Ping(),
    Kind.DISCONNECT: packets.decode_disconnect,
}
