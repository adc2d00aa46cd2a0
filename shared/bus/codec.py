"""Encodes and decodes messages: short topic name, and JSON that begins with the sender."""

import re
from functools import cache

from pydantic import ValidationError

from ..errors import BadPayload
from ..maths.dates import END_DATE_NS
from ..messages.base import Message, Sender
from ..topics import BY_MESSAGE, Topic, topic_of

MAXIMUM_PAYLOAD = 1 << 20  # bytes that are read: recordings of 0.1 hold such; `Topic.most_bytes` may be sent
SENDER = b'{"sender":'
HEAD_BYTES = 300  # the stamps stand at the front of a payload
STAMPS = ("received_ns", "sampled_ns", "now_ns", "sent_ns")


def topic_name(message: Message, topic: Topic | None = None) -> str:
    """Short topic name of a message; `topic` is its row, if known."""
    topic = topic or BY_MESSAGE[type(message)]
    if not topic.per_process:
        return topic.name
    return topic.name[:-1] + str(message.process)  # type: ignore[attr-defined]  # asserted by the contract test


def encode(message: Message) -> bytes:
    """Encode a message as JSON without its missing fields."""
    # As `model_dump_json`, but bytes, and without its overhead.
    return message.__pydantic_serializer__.to_json(message, exclude_none=True)


def signed(body: bytes, sender: Sender) -> bytes:
    """Insert the sender as first field of an encoded message, which has at least one field."""
    return SENDER + encode(sender) + b"," + body[1:]


def replayed(payload: bytes, recorded_ns: int) -> bytes:
    """Add the arrival time at the recorder to the sender of a recorded payload."""
    end = payload.find(b"}")
    return payload[:end] + b',"recorded_ns":%d' % recorded_ns + payload[end:]


def sender_of(payload: bytes) -> Sender:
    """Decode the sender, the first field of a payload; raises `BadPayload`."""
    if len(payload) > MAXIMUM_PAYLOAD or not payload.startswith(SENDER):
        raise BadPayload(f"{len(payload)} bytes that do not begin with their sender")
    try:
        sender: Sender = Sender.__pydantic_validator__.validate_json(payload[len(SENDER) : payload.find(b"}") + 1])
    except ValidationError as error:
        raise BadPayload(f"sender: {error.errors()[0]['msg']}") from error
    return sender


def decode(name: str, payload: bytes) -> Message:
    """Decode a payload; raises `BadPayload` with the reason."""
    topic = topic_of(name)
    if topic is None:
        raise BadPayload(f"{name} is no topic of the contract")
    if len(payload) > MAXIMUM_PAYLOAD:
        raise BadPayload(f"{len(payload)} bytes on {name}")
    try:
        message: Message = topic.message.__pydantic_validator__.validate_json(payload)
    except ValidationError as error:
        raise BadPayload(f"{name}: {error.errors()[0]['msg']}") from error
    if topic.per_process and name != topic_name(message):
        raise BadPayload(f"{name} carries a message of {topic_name(message)}")
    return message


def stamp_ns(topic: Topic, payload: bytes) -> int | None:
    """Find the stamp of a message without decoding it: arrival at the driver, else when it was true; None without."""
    pattern = _stamp_pattern(topic.message)
    match = pattern.search(payload, 0, HEAD_BYTES) if pattern else None
    stamp = int(match[1]) if match else END_DATE_NS
    return stamp if stamp < END_DATE_NS else None


@cache
def _stamp_pattern(message: type[Message]) -> re.Pattern[bytes] | None:
    for name in STAMPS:
        field = message.model_fields.get(name)
        if field is not None and field.annotation is int:
            return re.compile(rb'"%s":(\d{1,19})\b' % name.encode())
    return None
