"""Messages to and from what travels on the bus: short topic name, and JSON that begins with who sent it."""

from pydantic import ValidationError

from ..errors import BadPayload
from ..messages.base import Message, Sender
from ..topics import BY_MESSAGE, Topic, topic_of

MAXIMUM_PAYLOAD = 1 << 20  # a hostile sender shall not fill the memory
SENDER = b'{"sender":'


def topic_name(message: Message, topic: Topic | None = None) -> str:
    """Give the short topic name that a message travels on; `topic` is its row, if one knows it."""
    topic = topic or BY_MESSAGE[type(message)]
    if not topic.per_process:
        return topic.name
    return topic.name[:-1] + str(message.process)  # type: ignore[attr-defined]  # the contract test holds it


def encode(message: Message) -> bytes:
    """Encode a message as JSON; what is missing is left out."""
    # What `model_dump_json` does behind its long signature, and the bytes themselves.
    return message.__pydantic_serializer__.to_json(message, exclude_none=True)


def signed(body: bytes, sender: Sender) -> bytes:
    """Put the sender in front of the fields of an encoded message, of which there is at least one."""
    return SENDER + encode(sender) + b"," + body[1:]


def replayed(payload: bytes, recorded_ns: int) -> bytes:
    """Add to the sender of a recorded payload when it arrived at the recorder."""
    end = payload.find(b"}")
    return payload[:end] + b',"recorded_ns":%d' % recorded_ns + payload[end:]


def sender_of(payload: bytes) -> Sender:
    """Read who sent a payload, which is its first field, or raise `BadPayload`."""
    if len(payload) > MAXIMUM_PAYLOAD or not payload.startswith(SENDER):
        raise BadPayload(f"{len(payload)} bytes that do not begin with their sender")
    try:
        sender: Sender = Sender.__pydantic_validator__.validate_json(payload[len(SENDER) : payload.find(b"}") + 1])
    except ValidationError as error:
        raise BadPayload(f"sender: {error.errors()[0]['msg']}") from error
    return sender


def decode(name: str, payload: bytes) -> Message:
    """Decode what came on a topic, or raise `BadPayload` with the reason."""
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
        raise BadPayload(f"{name} speaks for {topic_name(message)}")
    return message
