"""An encoded message: topic, payload and sender."""

from typing import NamedTuple

from ..errors import BadPayload
from ..messages.base import Message
from ..topics import topic_of
from . import codec


class Envelope(NamedTuple):
    """An encoded message: short topic name, payload, arrival time, sender and sequence number."""

    topic: str
    payload: bytes
    received_ns: int
    producer: str = ""
    incarnation: int = 0
    sequence: int = 0
    retained: bool = False
    recorded_ns: int | None = None  # arrival at the recorder, of a message that is replayed

    @classmethod
    def of(cls, topic: str, payload: bytes, received_ns: int, *, retained: bool = False) -> "Envelope":
        """Decode the sender of a payload; raises `BadPayload`. `decode` reads the other fields."""
        if topic_of(topic) is None:
            raise BadPayload(f"{topic} is no topic of the contract")
        sender = codec.sender_of(payload)
        return cls(
            topic, payload, received_ns, sender.process, sender.incarnation, sender.sequence, retained,
            sender.recorded_ns,
        )  # fmt: skip

    def decode(self) -> Message:
        """Decode the payload; raises `BadPayload`."""
        return codec.decode(self.topic, self.payload)
