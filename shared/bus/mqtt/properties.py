"""The properties of MQTT 5 packets (OASIS MQTT 5.0, section 2.2.2)."""

from collections.abc import Mapping
from enum import Enum, IntEnum, auto
from typing import NamedTuple

from .wire import ProtocolError, Reader, Reason, text, varint


class Property(IntEnum):
    """Identifiers of the properties."""

    PAYLOAD_FORMAT = 1
    MESSAGE_EXPIRY_S = 2
    CONTENT_TYPE = 3
    RESPONSE_TOPIC = 8
    CORRELATION_DATA = 9
    SUBSCRIPTION_IDENTIFIER = 11
    SESSION_EXPIRY_S = 17
    ASSIGNED_CLIENT_ID = 18
    SERVER_KEEP_ALIVE_S = 19
    AUTHENTICATION_METHOD = 21
    AUTHENTICATION_DATA = 22
    REQUEST_PROBLEM_INFORMATION = 23
    WILL_DELAY_S = 24
    REQUEST_RESPONSE_INFORMATION = 25
    RESPONSE_INFORMATION = 26
    SERVER_REFERENCE = 28
    REASON_STRING = 31
    RECEIVE_MAXIMUM = 33
    TOPIC_ALIAS_MAXIMUM = 34
    TOPIC_ALIAS = 35
    MAXIMUM_QOS = 36
    RETAIN_AVAILABLE = 37
    USER_PROPERTY = 38
    MAXIMUM_PACKET_SIZE = 39
    WILDCARD_AVAILABLE = 40
    SUBSCRIPTION_IDENTIFIER_AVAILABLE = 41
    SHARED_AVAILABLE = 42


class Form(Enum):
    """How the value of a property is written."""

    FLAG = auto()  # one byte, 0 or 1
    TWO = auto()
    FOUR = auto()
    VARINT = auto()
    TEXT = auto()
    BINARY = auto()
    PAIR = auto()


P, F = Property, Form
FORMS = {
    P.PAYLOAD_FORMAT: F.FLAG, P.REQUEST_PROBLEM_INFORMATION: F.FLAG, P.REQUEST_RESPONSE_INFORMATION: F.FLAG,
    P.MAXIMUM_QOS: F.FLAG, P.RETAIN_AVAILABLE: F.FLAG, P.WILDCARD_AVAILABLE: F.FLAG,
    P.SUBSCRIPTION_IDENTIFIER_AVAILABLE: F.FLAG, P.SHARED_AVAILABLE: F.FLAG,
    P.SERVER_KEEP_ALIVE_S: F.TWO, P.RECEIVE_MAXIMUM: F.TWO, P.TOPIC_ALIAS_MAXIMUM: F.TWO, P.TOPIC_ALIAS: F.TWO,
    P.MESSAGE_EXPIRY_S: F.FOUR, P.SESSION_EXPIRY_S: F.FOUR, P.WILL_DELAY_S: F.FOUR, P.MAXIMUM_PACKET_SIZE: F.FOUR,
    P.SUBSCRIPTION_IDENTIFIER: F.VARINT,
    P.CONTENT_TYPE: F.TEXT, P.RESPONSE_TOPIC: F.TEXT, P.ASSIGNED_CLIENT_ID: F.TEXT, P.AUTHENTICATION_METHOD: F.TEXT,
    P.RESPONSE_INFORMATION: F.TEXT, P.SERVER_REFERENCE: F.TEXT, P.REASON_STRING: F.TEXT,
    P.CORRELATION_DATA: F.BINARY, P.AUTHENTICATION_DATA: F.BINARY,
    P.USER_PROPERTY: F.PAIR,
}  # fmt: skip
NUMBER_SIZES = {Form.FLAG: 1, Form.TWO: 2, Form.FOUR: 4}
NEVER_ZERO = frozenset((P.RECEIVE_MAXIMUM, P.MAXIMUM_PACKET_SIZE, P.SUBSCRIPTION_IDENTIFIER))
# What a broker passes on as it came, in the order in which it came (section 3.3.2.3).
PASSED_ON = frozenset((P.PAYLOAD_FORMAT, P.CONTENT_TYPE, P.RESPONSE_TOPIC, P.CORRELATION_DATA, P.USER_PROPERTY))

ON_PUBLISH = PASSED_ON | {P.MESSAGE_EXPIRY_S, P.TOPIC_ALIAS}
ON_WILL = PASSED_ON | {P.MESSAGE_EXPIRY_S, P.WILL_DELAY_S}
ON_CONNECT = frozenset((
    P.SESSION_EXPIRY_S, P.RECEIVE_MAXIMUM, P.MAXIMUM_PACKET_SIZE, P.TOPIC_ALIAS_MAXIMUM,
    P.REQUEST_RESPONSE_INFORMATION, P.REQUEST_PROBLEM_INFORMATION, P.USER_PROPERTY,
    P.AUTHENTICATION_METHOD, P.AUTHENTICATION_DATA,
))  # fmt: skip
ON_CONNACK = frozenset((
    P.SESSION_EXPIRY_S, P.RECEIVE_MAXIMUM, P.MAXIMUM_QOS, P.RETAIN_AVAILABLE, P.MAXIMUM_PACKET_SIZE,
    P.ASSIGNED_CLIENT_ID, P.TOPIC_ALIAS_MAXIMUM, P.REASON_STRING, P.USER_PROPERTY, P.WILDCARD_AVAILABLE,
    P.SUBSCRIPTION_IDENTIFIER_AVAILABLE, P.SHARED_AVAILABLE, P.SERVER_KEEP_ALIVE_S, P.RESPONSE_INFORMATION,
    P.SERVER_REFERENCE, P.AUTHENTICATION_METHOD, P.AUTHENTICATION_DATA,
))  # fmt: skip
ON_ACKNOWLEDGE = frozenset((P.REASON_STRING, P.USER_PROPERTY))
ON_SUBSCRIBE = frozenset((P.SUBSCRIPTION_IDENTIFIER, P.USER_PROPERTY))
ON_UNSUBSCRIBE = frozenset((P.USER_PROPERTY,))
ON_DISCONNECT = ON_ACKNOWLEDGE | {P.SESSION_EXPIRY_S, P.SERVER_REFERENCE}


class Properties(NamedTuple):
    """The properties of one packet: values to act upon, and the bytes to pass on unchanged."""

    numbers: Mapping[Property, int] = {}
    texts: Mapping[Property, str] = {}
    passed_on: bytes = b""


NONE = Properties()


def decode(reader: Reader, allowed: frozenset[Property]) -> Properties:
    """Read the properties of a packet on which only `allowed` may stand, each once but the user's own."""
    stop = reader.varint() + reader.position
    numbers: dict[Property, int] = {}
    texts: dict[Property, str] = {}
    passed_on: list[bytes] = []
    seen: set[int] = set()
    while (start := reader.position) < stop:
        kind = reader.integer(1)
        if kind in seen or kind not in allowed:
            raise ProtocolError(Reason.PROTOCOL_ERROR, f"property {kind} is not allowed here")
        if kind == Property.USER_PROPERTY:
            reader.text()
            reader.text()
        else:
            seen.add(kind)
            read_value(reader, Property(kind), numbers, texts)
        if kind in PASSED_ON:
            passed_on.append(reader.data[start : reader.position])
    if reader.position != stop:
        raise ProtocolError(Reason.MALFORMED_PACKET, "the properties end inside a field")
    return Properties(numbers, texts, b"".join(passed_on))


def read_value(reader: Reader, kind: Property, numbers: dict[Property, int], texts: dict[Property, str]) -> None:
    """Read the value of any property but the user's own, and note it where it is one to act upon."""
    form = FORMS[kind]
    if form is Form.TEXT:
        texts[kind] = reader.text()
    elif form is Form.BINARY:
        reader.binary()
    else:
        number = reader.varint() if form is Form.VARINT else reader.integer(NUMBER_SIZES[form])
        if (form is Form.FLAG and number > 1) or (number == 0 and kind in NEVER_ZERO):
            raise ProtocolError(Reason.PROTOCOL_ERROR, f"property {kind} may not be {number}")
        numbers[kind] = number


def encode(properties: Properties) -> bytes:
    """Write properties with their length; one that is passed on is not also written as number or text."""
    parts = [properties.passed_on]
    for kind, number in properties.numbers.items():
        if kind not in PASSED_ON:
            form = FORMS[kind]
            value = varint(number) if form is Form.VARINT else number.to_bytes(NUMBER_SIZES[form])
            parts += bytes((kind,)), value
    parts += [bytes((kind,)) + text(value) for kind, value in properties.texts.items() if kind not in PASSED_ON]
    body = b"".join(parts)
    return varint(len(body)) + body
