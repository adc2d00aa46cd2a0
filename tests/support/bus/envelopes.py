"""Messages as they are delivered, with a sender that the test chooses."""

from shared.bus import codec
from shared.bus.envelope import Envelope
from shared.messages.base import Message, Sender


def sent(
    message: Message, received_ns: int, producer: str = "x", incarnation: int = 1, sequence: int = 1,
    *, retained: bool = False,
) -> Envelope:  # fmt: skip
    """Make what the bus delivers when a process has published a message."""
    name, body = codec.topic_name(message), codec.encode(message)
    return sent_bytes(name, body, received_ns, producer, incarnation, sequence, retained=retained)


def sent_bytes(
    topic: str, body: bytes, received_ns: int, producer: str = "x", incarnation: int = 1, sequence: int = 1,
    *, retained: bool = False,
) -> Envelope:  # fmt: skip
    """Make what the bus delivers for a body that may violate the contract, from a valid sender."""
    payload = codec.signed(body, Sender(process=producer, incarnation=incarnation, sequence=sequence))
    return Envelope(topic, payload, received_ns, producer, incarnation, sequence, retained)
