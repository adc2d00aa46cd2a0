"""Messages to and from what travels on the bus: short topic name, payload, user properties."""

from collections.abc import Mapping

from pydantic import ValidationError

from ..errors import BadPayload
from ..messages.base import DEVICE_NAME_LENGTH, LARGEST_NS, Message, RawBytes
from ..topics import BY_MESSAGE, Topic, topic_of

MAXIMUM_PAYLOAD = 1 << 20  # a hostile sender shall not fill the memory


def topic_name(message: Message, topic: Topic | None = None) -> str:
    """Give the short topic name that a message travels on; `topic` is its row, if one knows it."""
    topic = topic or BY_MESSAGE[type(message)]
    if not topic.per_process:
        return topic.name
    return topic.name[:-1] + str(message.process)  # type: ignore[attr-defined]  # the contract test holds it


def encode(message: Message) -> tuple[bytes, dict[str, str]]:
    """Encode a message as payload and user properties."""
    if BY_MESSAGE[type(message)].is_raw:  # asking pydantic whose child it is takes far longer
        raw: RawBytes = message  # type: ignore[assignment]
        return raw.data, {"received_ns": str(raw.received_ns), "source": raw.source}
    # What `model_dump_json` does behind its long signature, and the bytes themselves.
    return message.__pydantic_serializer__.to_json(message, exclude_none=True), {}


def decode(name: str, payload: bytes, properties: Mapping[str, str]) -> Message:
    """Decode what came on a topic, or raise `BadPayload` with the reason."""
    topic = topic_of(name)
    if topic is None:
        raise BadPayload(f"{name} is no topic of the contract")
    if len(payload) > MAXIMUM_PAYLOAD:
        raise BadPayload(f"{len(payload)} bytes on {name}")
    try:
        if topic.is_raw:
            stamp, source = int(properties["received_ns"]), properties["source"]
            if not -LARGEST_NS <= stamp < LARGEST_NS or len(source) > DEVICE_NAME_LENGTH:
                raise ValueError("a stamp beyond 64 bits, or a device with a name of more letters than any has")
            return topic.message.unchecked(received_ns=stamp, source=source, data=payload)
        message: Message = topic.message.__pydantic_validator__.validate_json(payload)
    except KeyError as error:
        raise BadPayload(f"{name} without the user property {error}") from error
    except ValidationError as error:
        raise BadPayload(f"{name}: {error.errors()[0]['msg']}") from error
    except ValueError as error:
        raise BadPayload(f"{name}: {error}") from error
    if topic.per_process and name != topic_name(message):
        raise BadPayload(f"{name} speaks for {topic_name(message)}")
    return message
