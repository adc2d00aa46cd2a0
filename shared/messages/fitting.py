"""How much of a list one message can hold: the broker passes on no larger packet (`Topic.most_bytes`)."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

from .base import Message

M = TypeVar("M", bound=Message)


def size(message: Message) -> int:
    """Length of a message as it is on the bus, without its sender [bytes]."""
    return len(message.__pydantic_serializer__.to_json(message, exclude_none=True))


def fitting(items: Sequence[M], most_bytes: int) -> Sequence[M]:
    """Take the first of a list whose encodings together have at most so many bytes."""
    left = most_bytes
    for count, item in enumerate(items):
        left -= size(item) + 1
        if left < 0:
            return items[:count]
    return items


def parts(items: Sequence[M], most_bytes: int) -> Iterator[Sequence[M]]:
    """Split a list into parts of at most so many encoded bytes, or of one item."""
    while items:
        part = fitting(items, most_bytes) or items[:1]
        yield part
        items = items[len(part) :]
