"""Record format of a batch of frames: reception time (8 bytes, ns, signed), length (2 bytes), frame; big-endian."""

import struct
from collections.abc import Iterable, Iterator

from ..messages.v2x import MAX_FRAME_BYTES

HEADER = struct.Struct(">qH")


def pack(frames: Iterable[tuple[int, bytes]]) -> bytes:
    """Concatenate the records of frames given as (reception time in ns, bytes)."""
    return b"".join(HEADER.pack(received_ns, len(frame)) + frame for received_ns, frame in frames)


def unpack(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Split a batch into (reception time in ns, frame).

    Raises
    ------
    ValueError
        A record is truncated, or longer than a frame can be; the records before it have been yielded.
    """
    position = 0
    while position < len(data):
        if position + HEADER.size > len(data):
            raise ValueError("truncated record header")
        received_ns, length = HEADER.unpack_from(data, position)
        position += HEADER.size + length
        if length > MAX_FRAME_BYTES or position > len(data):
            raise ValueError(f"record of {length} bytes: truncated or too long")
        yield received_ns, data[position - length : position]
