"""A message as it travels: what stands on the outside, and the way to its content."""

import re
from collections.abc import Callable
from typing import NamedTuple

from ..messages.base import Message
from ..topics import topic_of
from . import codec
from .mqtt.client_packets import Delivery, decode_delivery, user_property
from .mqtt.wire import text, varint

FORMS = 256  # remembered
NUMBERS = ("seq", "received_ns")  # what changes from one message to the next
QOS_1 = 0x32  # from this first byte on a PUBLISH has a packet identifier


class Envelope(NamedTuple):
    """A message as it travelled: short topic name, payload, and who sent it as which of theirs."""

    topic: str
    payload: bytes
    properties: dict[str, str]
    received_ns: int
    producer: str = ""
    incarnation: int = 0
    sequence: int = 0
    retained: bool = False

    def decode(self) -> Message:
        """Decode the payload, or raise `BadPayload`."""
        return codec.decode(self.topic, self.payload, self.properties)


def make_envelope(
    name: str, payload: bytes, properties: dict[str, str], *, received_ns: int, retained: bool = False
) -> Envelope | None:
    """Open the user properties of a message; None if they are not ours or the topic is unknown."""
    if topic_of(name) is None or len(payload) > codec.MAXIMUM_PAYLOAD:
        return None
    rest = dict(properties)
    try:
        producer, life, sequence = rest.pop("from"), int(rest.pop("life")), int(rest.pop("seq"))
    except (KeyError, ValueError):
        return None
    return Envelope(name, payload, rest, received_ns, producer, life, sequence, retained)


class Form(NamedTuple):
    """What the last message of a topic looked like: bytes that stay, and numbers between them."""

    match: Callable[[bytes], re.Match[bytes] | None]
    sample: Envelope  # its properties are those that stay
    number: str | None  # the property that is a number, beside the running number


class Opener:
    """Opens packets PUBLISH; fast where one differs from the last of its topic in its numbers only.

    That is the rule for what one process sends many times a second. All else is read in full, with the same result.
    """

    def __init__(self, prefix: str, now_ns: Callable[[], int]) -> None:
        self._prefix, self._now_ns = prefix, now_ns
        self._forms: dict[bytes, Form] = {}

    def __call__(self, first: int, body: bytes) -> Envelope | None:
        """Open a packet; None if it is not ours. Raises ProtocolError."""
        form = self._forms.get(body[: body[1] + 2]) if first < QOS_1 and len(body) > 1 and not body[0] else None
        if form is not None and (found := form.match(body)) is not None:
            _, last, number = form
            properties = {**last.properties, number: found[2].decode()} if number else {}
            # Not by the type's own name, which a named tuple makes a call more.
            return tuple.__new__(Envelope, (
                last.topic, body[found.end() :], properties, self._now_ns(),
                last.producer, last.incarnation, int(found[1]), first == 0x31,
            ))  # fmt: skip
        delivery = decode_delivery(first, body)
        envelope = make_envelope(
            delivery.topic.removeprefix(self._prefix), delivery.payload, delivery.user,
            received_ns=self._now_ns(), retained=delivery.retained,
        )  # fmt: skip
        if envelope is not None and first < QOS_1:
            self._learn(body, delivery, envelope)
        return envelope

    def _learn(self, body: bytes, delivery: Delivery, envelope: Envelope) -> None:
        """Remember the form of a message that is nothing but topic, user properties once each, and payload."""
        pairs = [user_property(key, value) for key, value in delivery.user.items()]
        topic, properties = text(delivery.topic), b"".join(pairs)
        head = topic + varint(len(properties)) + properties
        numbers = [
            key for key, value in delivery.user.items() if key in NUMBERS and value.isascii() and value.isdigit()
        ]
        unlike = not body.startswith(head) or len(head) + len(envelope.payload) != len(body)
        if unlike or numbers[:1] != ["seq"] or envelope.properties.keys() - numbers - {"source"} or topic[0]:
            return
        if len(self._forms) >= FORMS:
            self._forms.clear()
        pattern = re.escape(head[: len(head) - len(properties)])
        for (key, value), pair in zip(delivery.user.items(), pairs, strict=True):
            constant, size = (pair[: -len(value)], len(value)) if key in numbers else (pair, 0)
            pattern += re.escape(constant) + (b"([0-9]{%d})" % size if size else b"")
        kept = {key: value for key, value in envelope.properties.items() if key not in numbers}
        sample = envelope._replace(payload=b"", properties=kept)
        self._forms[topic] = Form(re.compile(pattern).match, sample, numbers[1] if len(numbers) > 1 else None)
