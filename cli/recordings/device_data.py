"""Selects the messages of a recording that replace its devices, and shifts their stamps."""

import re
from collections.abc import Collection
from typing import Any

from shared.bus.bus import Envelope
from shared.messages.base import Message
from shared.messages.vehicle import CanRaw
from shared.processes import BY_NAME as PROCESS_ROWS
from shared.topics import Topic, measurements, publications, topic_of

CANDUMP_TIME = re.compile(rb"\((\d{1,10})\.(\d{1,9})\)")
STAMPS = ("received_ns", "sampled_ns")


def inputs_among(recorded: Collection[str]) -> frozenset[str]:
    """Topics to publish: bytes of the devices, and measurements only where their bytes are missing."""
    present = [topic for topic in measurements() if topic.name in recorded]
    raw = {topic.name for topic in present if topic.is_raw}
    derived = {
        made.name
        for name in raw
        for consumer in _row(name).consumers
        for made in publications(consumer)
        if made.name not in PROCESS_ROWS[consumer].passes_on
    }
    return frozenset(topic.name for topic in present if topic.name not in derived)


def shifted(envelope: Envelope, shift_ns: int) -> Message:
    """Copy a message with its stamps shifted."""
    message = envelope.decode()
    values: dict[str, Any] = {name: getattr(message, name) for name in STAMPS if hasattr(message, name)}
    moved = {
        name: tuple(stamp + shift_ns for stamp in value) if isinstance(value, tuple) else value + shift_ns
        for name, value in values.items()
    }
    if isinstance(message, CanRaw):
        moved["data"] = _shifted_candump(message.data, shift_ns)
    return message.model_copy(update=moved)


def _shifted_candump(lines: bytes, shift_ns: int) -> bytes:
    """Shift the times of the lines of a candump log, with their number of digits."""

    def move(match: re.Match[bytes]) -> bytes:
        digits = len(match[2])
        time_ns = int(match[1]) * 1_000_000_000 + int(match[2].ljust(9, b"0")) + shift_ns
        seconds, fraction_ns = divmod(time_ns, 1_000_000_000)
        return b"(%d.%s)" % (seconds, b"%09d" % fraction_ns if digits > 6 else b"%06d" % (fraction_ns // 1000))

    return CANDUMP_TIME.sub(move, lines)


def _row(name: str) -> Topic:
    row = topic_of(name)
    assert row is not None, "it comes from the contract"
    return row
