"""A message as it travels: what stands on the outside, and the way to its content."""

from dataclasses import dataclass, field

from . import codec
from .messages import Message
from .topics import topic_of


@dataclass(frozen=True)
class Envelope:
    """A message as it travelled: short topic name, payload, and who sent it as which of theirs."""

    topic: str
    payload: bytes
    properties: dict[str, str]
    received_ns: int
    producer: str = ""
    incarnation: int = 0
    sequence: int = 0
    retained: bool = field(default=False, compare=False)

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
