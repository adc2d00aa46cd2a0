"""The primitive fields of MQTT 5: integers, strings, binary data (OASIS MQTT 5.0, section 1.5)."""

from enum import IntEnum

LONGEST_VARINT = 268_435_455  # four groups of seven bits


class Reason(IntEnum):
    """Reason codes (section 2.4); from 0x80 on they are failures."""

    SUCCESS = 0x00
    DISCONNECT_WITH_WILL = 0x04
    NO_MATCHING_SUBSCRIBERS = 0x10
    NO_SUBSCRIPTION_EXISTED = 0x11
    UNSPECIFIED_ERROR = 0x80
    MALFORMED_PACKET = 0x81
    PROTOCOL_ERROR = 0x82
    IMPLEMENTATION_SPECIFIC_ERROR = 0x83
    UNSUPPORTED_PROTOCOL_VERSION = 0x84
    CLIENT_IDENTIFIER_NOT_VALID = 0x85
    BAD_USER_NAME_OR_PASSWORD = 0x86
    NOT_AUTHORIZED = 0x87
    SERVER_UNAVAILABLE = 0x88
    SERVER_BUSY = 0x89
    BANNED = 0x8A
    SERVER_SHUTTING_DOWN = 0x8B
    BAD_AUTHENTICATION_METHOD = 0x8C
    KEEP_ALIVE_TIMEOUT = 0x8D
    SESSION_TAKEN_OVER = 0x8E
    TOPIC_FILTER_INVALID = 0x8F
    TOPIC_NAME_INVALID = 0x90
    PACKET_IDENTIFIER_IN_USE = 0x91
    PACKET_IDENTIFIER_NOT_FOUND = 0x92
    RECEIVE_MAXIMUM_EXCEEDED = 0x93
    TOPIC_ALIAS_INVALID = 0x94
    PACKET_TOO_LARGE = 0x95
    MESSAGE_RATE_TOO_HIGH = 0x96
    QUOTA_EXCEEDED = 0x97
    ADMINISTRATIVE_ACTION = 0x98
    PAYLOAD_FORMAT_INVALID = 0x99
    RETAIN_NOT_SUPPORTED = 0x9A
    QOS_NOT_SUPPORTED = 0x9B
    USE_ANOTHER_SERVER = 0x9C
    SERVER_MOVED = 0x9D
    SHARED_SUBSCRIPTIONS_NOT_SUPPORTED = 0x9E
    CONNECTION_RATE_EXCEEDED = 0x9F
    MAXIMUM_CONNECT_TIME = 0xA0
    SUBSCRIPTION_IDENTIFIERS_NOT_SUPPORTED = 0xA1
    WILDCARD_SUBSCRIPTIONS_NOT_SUPPORTED = 0xA2


FAILURE = 0x80  # the first reason code that is one


def in_words(code: int) -> str:
    """Say a reason code as a person would."""
    try:
        return Reason(code).name.lower().replace("_", " ")
    except ValueError:
        return f"reason code {code:#x}"


class ProtocolError(Exception):
    """A packet that is refused, with the reason code that its sender is told."""

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


class Reader:
    """Reads fields from the body of one packet and never beyond its end."""

    __slots__ = ("data", "end", "position")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.position = 0
        self.end = len(data)

    def take(self, size: int) -> bytes:
        """Read `size` bytes."""
        start = self.position
        stop = start + size
        if stop > self.end:
            raise ProtocolError(Reason.MALFORMED_PACKET, "the packet ends inside a field")
        self.position = stop
        return self.data[start:stop]

    def integer(self, size: int) -> int:
        """Read a big-endian integer of one, two or four bytes."""
        return int.from_bytes(self.take(size))

    def varint(self) -> int:
        """Read a variable byte integer in its shortest form."""
        value = 0
        for group in range(4):
            byte = self.integer(1)
            value |= (byte & 0x7F) << 7 * group
            if byte < 0x80:
                if group and byte == 0:
                    break
                return value
        raise ProtocolError(Reason.MALFORMED_PACKET, "a variable byte integer is too long")

    def binary(self) -> bytes:
        """Read binary data with its length of two bytes."""
        return self.take(int.from_bytes(self.take(2)))

    def text(self) -> str:
        """Read a UTF-8 string; U+0000 and surrogates are malformed."""
        raw = self.binary()
        try:
            text = raw.decode()
        except UnicodeDecodeError:
            raise ProtocolError(Reason.MALFORMED_PACKET, "a string is not UTF-8") from None
        if "\0" in text:
            raise ProtocolError(Reason.MALFORMED_PACKET, "a string holds U+0000")
        return text

    def rest(self) -> bytes:
        """Read what is left."""
        return self.take(self.end - self.position)


def varint(value: int) -> bytes:
    """Encode a variable byte integer."""
    if value < 0x80:
        return bytes((value,))
    if value < 0x4000:
        return bytes((value & 0x7F | 0x80, value >> 7))
    if value > LONGEST_VARINT:
        raise ValueError(f"{value} does not fit a variable byte integer")
    groups = bytearray()
    while value >= 0x80:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    groups.append(value)
    return bytes(groups)


def binary(value: bytes) -> bytes:
    """Encode binary data with its length; raises OverflowError above 65,535 bytes."""
    return len(value).to_bytes(2) + value


def text(value: str) -> bytes:
    """Encode a UTF-8 string with its length."""
    return binary(value.encode())
