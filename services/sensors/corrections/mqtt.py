"""A subscriber of MQTT 3.1.1 that does no input and output itself: enough for topics of corrections at QoS 0.

The bus's own client blocks while it connects, and takes messages of up to 256 MB from its broker. A broker of
corrections is a stranger in the internet: here nothing waits, and a message has a largest size.

References
----------
OASIS, MQTT version 3.1.1: sections 2.2 (fixed header), 3.1 (CONNECT), 3.2 (CONNACK), 3.3 (PUBLISH), 3.8 and 3.9.
"""

import secrets
from collections.abc import Iterator

from .address import Address
from .fault import SourceFault, refused

KEEP_ALIVE_S = 60
PING_S = 30.0
MAX_MESSAGE = 65_536  # [bytes]; SPARTN of a continent is at most a few kilobytes at once
CONNACK, PUBLISH, SUBACK, PINGRESP = 2, 3, 9, 13
_REFUSALS = {
    1: "it does not know MQTT 3.1.1", 2: "it refuses the client identifier", 3: "it is not available",
    4: "it refuses user or password; check user and password_file", 5: "it does not allow this client to connect; "
    "check user, password_file and certificate_file",
}  # fmt: skip
_REJECTED = 0x80  # of a subscription


class MqttDialogue:
    """Connects, subscribes to the topics of an address, and gives the content of what is published there."""

    def __init__(self, address: Address, password: str) -> None:
        self.streaming = False
        self._address, self._password = address, password
        self._buffer = b""
        self._answer = b""
        self._ping_due_s: float | None = None

    def request(self, gga: str | None = None) -> bytes:
        """The packet CONNECT, with a clean session."""
        user, password = self._address.user, self._password
        flags = 0x02 | (0x80 if user is not None else 0) | (0x40 if user is not None and password else 0)
        body = (
            _text("MQTT") + bytes((4, flags)) + KEEP_ALIVE_S.to_bytes(2, "big") + _text(f"obu-{secrets.token_hex(8)}")
        )
        if user is not None:
            body += _text(user) + (_text(password) if password else b"")
        return _packet(0x10, body)

    def feed(self, data: bytes) -> bytes:
        """Process received bytes; return the content of messages.

        Raises
        ------
        SourceFault
            The broker refuses, or does not speak MQTT.
        """
        self._buffer += data
        if not self.streaming and self._buffer and self._buffer[0] >> 4 != CONNACK:
            raise self._no_broker()
        return b"".join(self._content(kind, flags, body) for kind, flags, body in self._packets())

    def answer(self, now_s: float) -> bytes:
        """What is to be sent: the subscription after the broker's greeting, and a ping now and then."""
        data, self._answer = self._answer, b""
        if self.streaming and (self._ping_due_s is None or now_s >= self._ping_due_s):
            data += b"" if self._ping_due_s is None else _packet(0xC0, b"")
            self._ping_due_s = now_s + PING_S
        return data

    def ended(self, fault: SourceFault) -> SourceFault:
        """Explain the end of the connection."""
        return fault if self.streaming else SourceFault(f"{fault} without an answer: is it an MQTT broker?")

    def _packets(self) -> Iterator[tuple[int, int, bytes]]:
        """Cut complete packets from the buffer: kind, flags and body."""
        while len(self._buffer) >= 2:
            size, at, shift = 0, 1, 0
            while True:
                if at >= len(self._buffer):
                    return
                byte = self._buffer[at]
                size, at, shift = size | (byte & 0x7F) << shift, at + 1, shift + 7
                if not byte & 0x80:
                    break
                if shift > 21:
                    raise self._no_broker()
            if size > MAX_MESSAGE:
                raise (
                    self._no_broker() if not self.streaming else SourceFault("the broker sends a message of over 64 kB")
                )
            if len(self._buffer) < at + size:
                return
            first, body = self._buffer[0], self._buffer[at : at + size]
            self._buffer = self._buffer[at + size :]
            yield first >> 4, first & 0xF, body

    def _content(self, kind: int, flags: int, body: bytes) -> bytes:
        if not self.streaming and kind != CONNACK:
            raise self._no_broker()
        if kind == PUBLISH:
            skipped = 2 + int.from_bytes(body[:2], "big") + (2 if flags & 0x06 else 0)
            return body[skipped:]
        if kind == CONNACK:
            self._greeted(body)
        elif kind == SUBACK and _REJECTED in body[2:]:
            raise refused("the broker does not allow this client its topics; check them in sources")
        return b""

    def _greeted(self, body: bytes) -> None:
        if len(body) != 2:
            raise self._no_broker()
        if code := body[1]:
            reason = f"the broker does not accept the connection: {_REFUSALS.get(code, f'code {code}')}"
            raise SourceFault(reason) if code == 3 else refused(reason)
        topics = b"".join(_text(topic) + b"\0" for topic in self._address.topics)
        self._answer += _packet(0x82, b"\0\1" + topics)
        self.streaming = True

    def _no_broker(self) -> SourceFault:
        return SourceFault(f"{self._address.host}:{self._address.port} is no MQTT broker")


def _text(text: str) -> bytes:
    data = text.encode()
    return len(data).to_bytes(2, "big") + data


def _packet(first: int, body: bytes) -> bytes:
    size, length = len(body), b""
    while True:
        size, byte = size >> 7, size & 0x7F
        length += bytes((byte | (0x80 if size else 0),))
        if not size:
            return bytes((first,)) + length + body
