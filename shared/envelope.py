"""A message as it travels: what stands on the outside, and the way to its content."""

import struct
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

from . import codec
from .messages import Message
from .mqtt.client_packets import Delivery, decode_delivery, user_property
from .mqtt.wire import text, varint
from .topics import topic_of

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

    layout: struct.Struct
    constants: tuple[bytes, ...]
    sample: Envelope
    numbers: tuple[str, ...]  # names of the numbers after the first, which is the running number


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
        if form is not None and len(body) >= form.layout.size:
            fields = form.layout.unpack_from(body)
            numbers = fields[1::2]
            if fields[::2] == form.constants and b"".join(numbers).isdigit():
                last, properties = form.sample, {}
                if form.numbers:
                    values = (number.decode() for number in numbers[1:])
                    properties = {**last.properties, **dict(zip(form.numbers, values, strict=True))}
                return Envelope(
                    last.topic, body[form.layout.size :], properties, self._now_ns(),
                    last.producer, last.incarnation, int(numbers[0]), first == 0x31,
                )  # fmt: skip
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
        cuts, names, position = [0], [], len(head) - len(properties)
        for (key, value), pair in zip(delivery.user.items(), pairs, strict=True):
            position += len(pair)
            if key in NUMBERS and value.isascii() and value.isdigit():
                cuts += position - len(value), position
                names.append(key)
        unlike = not body.startswith(head) or len(head) + len(envelope.payload) != len(body)
        if unlike or names[:1] != ["seq"] or envelope.properties.keys() - names - {"source"} or topic[0]:
            return
        if len(self._forms) >= FORMS:
            self._forms.clear()
        layout = struct.Struct("".join(f"{stop - start}s" for start, stop in pairwise([*cuts, len(head)])))
        constants = layout.unpack_from(body)[::2]
        self._forms[topic] = Form(layout, constants, envelope._replace(payload=b""), tuple(names[1:]))
