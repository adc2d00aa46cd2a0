"""Writes a recording: MCAP in compressed chunks, each written in one go."""

import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ..bus.envelope import Envelope
from .channels import schema_of
from .chunk import ChunkInProgress, packed

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 256 * 1024
VEHICLE_FILE = "vehicle.toml"
SUMMARY_ORDER = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


class Output(Protocol):
    """The part of an unbuffered file that the writer needs."""

    def write(self, data: memoryview, /) -> int | None:
        """Write what fits, and say how much that was."""
        ...

    def truncate(self, size: int, /) -> int:
        """Cut the file."""
        ...

    def seek(self, offset: int, /) -> int:
        """Go there."""
        ...

    def fileno(self) -> int:
        """Give the number of the open file."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


Opener = Callable[[Path], Output]


def open_new(path: Path) -> Output:
    """Create a file that must not exist yet, without a buffer of its own."""
    return path.open("xb", buffering=0)


class RecordingWriter:
    """One recording in the making.

    Each chunk repeats the channels that it uses, so that `Recording` needs none of the chunks before
    it. A schema, which only describes payloads to other tools, stands in the first chunk that needs
    it and in the summary: all of them in each chunk would be 4.7 kB, compressed, every half second.
    A write that fails (a full disk) raises `OSError`, loses that chunk, and leaves the file as it
    was after the chunk before.
    """

    def __init__(
        self,
        path: Path,
        *,
        vehicle: str = "",
        vehicle_toml: str = "",
        provenance: Mapping[str, str] | None = None,
        chunk_bytes: int = CHUNK_BYTES,
        opener: Opener = open_new,
    ) -> None:
        self.path = path
        self.messages = 0  # that are in the file
        self.bytes_written = 0
        self._chunk_bytes = chunk_bytes
        self._file = opener(path)
        self._compressor = zstandard.ZstdCompressor()
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Schema] = {}
        self._summary = {opcode: bytearray() for opcode in SUMMARY_ORDER}
        self._counts: dict[int, int] = {}
        self._span = (1 << 64) - 1, 0
        self._chunks = 0
        self._chunk = ChunkInProgress()
        self._metadata = {"obu": {"vehicle": vehicle}}
        if provenance is not None:
            self._metadata["provenance"] = dict(provenance)
        try:
            self._start(vehicle_toml)
        except OSError:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @property
    def pending(self) -> int:
        """Messages that are not in the file yet."""
        return self._chunk.messages

    def write(self, envelope: Envelope) -> None:
        """Add a message; once the chunk is full it goes to the file."""
        channel = self._channels.get(envelope.topic) or self._new_channel(envelope.topic)
        arrival_ns = max(envelope.received_ns, 0)
        self._chunk.add(channel, (0, arrival_ns, arrival_ns), envelope.payload)
        if len(self._chunk.data) >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Write the chunk in progress to the file; what was flushed outlives this process."""
        if not self._chunk.stamps:
            return
        chunk, self._chunk = self._chunk, ChunkInProgress()
        data, (first, last) = bytes(chunk.data), chunk.span
        record = Chunk(
            compression="zstd",
            data=self._compressor.compress(data),
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        start, head, indexes = self.bytes_written, packed(record), chunk.indexes()
        self._append(head, *indexes.values())
        self._summary[Opcode.CHUNK_INDEX] += _chunk_index(record, start, len(head), indexes)
        self._span = min(self._span[0], first), max(self._span[1], last)
        self._chunks += 1
        self.messages += chunk.messages
        for id_, entries in chunk.stamps.items():
            self._counts[id_] = self._counts.get(id_, 0) + len(entries) // 2

    def fileno(self) -> int:
        """Give the number of the open file, for `os.fdatasync`."""
        return self._file.fileno()

    def abandon(self) -> None:
        """Close the file as it is, as a crash would leave it."""
        self._file.close()

    def close(self) -> None:
        """Finish the file with its summary, so that every MCAP tool opens it."""
        try:
            self.flush()
            self._append(self._ending())
        finally:
            self._file.close()

    def _start(self, vehicle_toml: str) -> None:
        self._append(MAGIC, packed(Header("", "obu")))
        for name, described in self._metadata.items():
            position = self.bytes_written
            self._append(packed(Metadata(name, described)))
            self._summary[Opcode.METADATA_INDEX] += packed(MetadataIndex(position, self.bytes_written - position, name))
        text = vehicle_toml.encode()
        position = self.bytes_written
        self._append(packed(Attachment(0, 0, VEHICLE_FILE, "application/toml", text)))
        self._summary[Opcode.ATTACHMENT_INDEX] += packed(
            AttachmentIndex(position, self.bytes_written - position, 0, 0, len(text), VEHICLE_FILE, "application/toml")
        )

    def _new_channel(self, topic: str) -> Channel:
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="json",
            metadata={},
            schema_id=self._schema_id(topic),
        )
        self._channels[topic] = channel
        self._summary[Opcode.CHANNEL] += packed(channel)
        return channel

    def _schema_id(self, topic: str) -> int:
        described = schema_of(topic)
        if described is None:
            return 0
        name, text = described
        if name not in self._schemas:
            schema = Schema(id=len(self._schemas) + 1, name=name, encoding="jsonschema", data=text)
            self._schemas[name] = schema
            self._chunk.data += packed(schema)
            self._summary[Opcode.SCHEMA] += packed(schema)
        return self._schemas[name].id

    def _append(self, *parts: bytes) -> None:
        data = memoryview(b"".join(parts))
        rest = data
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            self._file.truncate(self.bytes_written)
            self._file.seek(self.bytes_written)
            raise
        self.bytes_written += len(data)

    def _ending(self) -> bytes:
        """Pack the end of the data, the summary, its offsets, the footer and the closing magic."""
        self._summary[Opcode.STATISTICS] += packed(self._statistics())
        data_end = packed(DataEnd(0))
        start = position = self.bytes_written + len(data_end)
        body, offsets = b"", b""
        for opcode, group in self._summary.items():
            if group:
                offsets += packed(SummaryOffset(opcode, position, len(group)))
            body += group
            position += len(group)
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, position)
        crc = zlib.crc32(body + offsets + head)
        return data_end + body + offsets + packed(Footer(start, position, crc)) + MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=1,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=self.messages,
            message_end_time=self._span[1],
            message_start_time=self._span[0] if self.messages else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _chunk_index(record: Chunk, start: int, length: int, indexes: dict[int, bytes]) -> bytes:
    offsets, position = {}, start + length
    for id_, index in indexes.items():
        offsets[id_] = position
        position += len(index)
    return packed(
        ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=record.compression,
            compressed_size=len(record.data),
            message_end_time=record.message_end_time,
            message_index_length=position - start - length,
            message_index_offsets=offsets,
            message_start_time=record.message_start_time,
            uncompressed_size=record.uncompressed_size,
        )
    )
