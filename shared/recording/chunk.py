"""A chunk of an MCAP file in the making."""

import struct

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord

MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
MESSAGE_OVERHEAD = MESSAGE_HEAD.size - 9


def packed(record: McapRecord) -> bytes:
    """Pack a record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]  # mcap annotates it by half


class ChunkInProgress:
    """Messages that are not in the file yet, and where in the chunk each of them starts."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.stamps: dict[int, list[int]] = {}  # channel -> log time, offset, log time, offset, ...

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(map(len, self.stamps.values())) // 2

    @property
    def span(self) -> tuple[int, int]:
        """First and last log time."""
        times = [time for entries in self.stamps.values() for time in entries[::2]]
        return min(times), max(times)

    def add(self, channel: Channel, head: tuple[int, int, int], data: bytes) -> None:
        """Add a message with its sequence number, log time and publish time."""
        if channel.id not in self.stamps:
            self.stamps[channel.id] = []
            self.data += packed(channel)
        self.stamps[channel.id] += head[1], len(self.data)
        self.data += MESSAGE_HEAD.pack(Opcode.MESSAGE, MESSAGE_OVERHEAD + len(data), channel.id, *head)
        self.data += data

    def indexes(self) -> dict[int, bytes]:
        """Pack the message index of each channel."""
        return {
            id_: struct.pack(
                f"<BQHI{len(entries)}Q", Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), id_, 8 * len(entries), *entries
            )
            for id_, entries in self.stamps.items()
        }
