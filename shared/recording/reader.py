"""Reads recordings, also truncated at any byte or damaged in the middle."""

import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import cast

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata

from ..bus.envelope import Envelope
from ..errors import BadPayload, BadRecording
from .channels import envelope_of
from .foxglove import PREFIX

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, raw size, checksum, length of the next word
FOOTER = struct.Struct("<BQQQI")  # opcode, length, begin of the summary and of its offsets, checksum of all that
MESSAGE_FIELDS = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
OPCODES = frozenset(int(opcode) for opcode in Opcode)
CHUNK_START = re.compile(rb"\x06(?=[\s\S]{4}\0{4})")  # opcode, and a length below 4 GiB
MAXIMUM_CHUNK = 1 << 28
BLOCK = 1 << 14
COMPRESSIONS = (b"", b"zstd")

Buffer = mmap.mmap | bytes
MALFORMED = (struct.error, EndOfFile, UnicodeDecodeError, ValueError, OverflowError)


@dataclass(frozen=True)
class Record:
    """Where a record lies in the file."""

    opcode: int
    begin: int  # of its opcode
    start: int  # of its content
    end: int


@dataclass(frozen=True)
class ChunkHead:
    """The fields before the data of a chunk."""

    compression: bytes
    raw_size: int
    checksum: int
    start: int  # of the data
    end: int  # may lie beyond the end of a file that was cut


class Recording:
    """The messages of a recording, in the order in which they were recorded.

    Iterate over it as often as you like; `problems` then says what could not be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.position = 0  # of the iteration [bytes]
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        try:
            with path.open("rb") as file:
                self.size = file.seek(0, 2)
                self._buffer: Buffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if self.size else b""
        except OSError as error:
            raise BadRecording(f"cannot read {path}: {error.strerror}") from error
        self._read_front()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def recognised(self) -> bool:
        """Whether it begins like a recording, or at least holds a part of one."""
        begins = self._buffer[: len(MAGIC)] == MAGIC
        return begins or any(self._find_chunk(0, cut=cut) is not None for cut in (False, True))

    def close(self) -> None:
        """Close the file."""
        if isinstance(self._buffer, mmap.mmap):
            self._buffer.close()

    def __iter__(self) -> Iterator[Envelope]:
        self.problems.clear()
        channels = self._summary_channels()
        lost = 0
        for data in self._chunks():
            for envelope in _messages(data, channels):
                if envelope is None:
                    lost += 1
                else:
                    yield envelope
        if lost:
            self.problems.append(f"{lost} messages could not be decoded")

    def _read_front(self) -> None:
        """Read the records before the first chunk: metadata and attachments."""
        position = len(MAGIC)
        while (record := self._record(position)) is not None and record.opcode != Opcode.CHUNK:
            stream, position = ReadDataStream(BytesIO(self._buffer[record.start : record.end])), record.end
            try:
                if record.opcode == Opcode.METADATA:
                    described = cast(Metadata, Metadata.read(stream))
                    self.metadata[described.name] = described.metadata
                elif record.opcode == Opcode.ATTACHMENT:
                    attached = cast(Attachment, Attachment.read(stream))
                    self.attachments[attached.name] = attached.data
            except MALFORMED:
                break

    def _summary_channels(self) -> dict[int, Channel]:
        """Read the channels of the summary, so that none is lost with the chunk in which it first occurs."""
        channels: dict[int, Channel] = {}
        list(_messages(self.summary(), channels))  # it holds no messages
        return channels

    @property
    def topics(self) -> frozenset[str]:
        """Topics that the summary names; none of a recording that was not closed."""
        names = (channel.topic for channel in self._summary_channels().values())
        return frozenset(name for name in names if not name.startswith(PREFIX))

    def summary(self) -> bytes:
        """Give the summary section; empty for a recording that was not closed, or whose summary is damaged."""
        end = self.size - len(MAGIC) - FOOTER.size
        if end >= 0 and self._buffer[-len(MAGIC) :] == MAGIC:
            _, _, start, _, checksum = FOOTER.unpack(self._buffer[end : end + FOOTER.size])
            if start and zlib.crc32(self._buffer[start : end + FOOTER.size - 4]) == checksum:
                return self._buffer[start:end]
        return b""

    def chunk_at(self, begin: int) -> bytes | None:
        """Give the raw data of the chunk that begins at a byte; None if it is damaged."""
        record = self._record(begin)
        return None if record is None or record.opcode != Opcode.CHUNK else self._content(record)

    def _chunks(self) -> Iterator[bytes]:
        """Yield the raw data of each chunk; a record outside chunks comes as a chunk of its own.

        After anything that cannot be right the search goes on right behind the last chunk whose
        checksum held, because a damaged length may have led far beyond.
        """
        trusted = position = len(MAGIC) if self._buffer[: len(MAGIC)] == MAGIC else 0
        if not position:
            self.problems.append("the file does not begin like an MCAP recording")
        while position < self.size:
            self.position = position
            record = self._record(position)
            data = None if record is None else self._content(record)
            if record is not None and data is not None:
                yield data
                position = record.end
                if record.opcode == Opcode.FOOTER:
                    break
                trusted = position if record.opcode == Opcode.CHUNK else trusted
                continue
            if record is not None and record.opcode == Opcode.CHUNK:
                trusted = position + 1
            following = self._find_chunk(trusted, cut=False)
            if following is None:
                break
            self.problems.append(f"damage: skipped the bytes {trusted} to {following.begin}")
            trusted = position = following.begin
        if self._buffer[position : position + len(MAGIC) + 1] != MAGIC:
            yield from self._cut_end(trusted)
        self.position = self.size

    def _cut_end(self, trusted: int) -> Iterator[bytes]:
        """Yield the readable part of a chunk that is truncated by the end of the file."""
        self.problems.append(f"the recording was not closed: it ends at byte {self.size}")
        last = self._find_chunk(trusted, cut=True)
        head = None if last is None else self._chunk_head(last)
        if head is not None:
            yield _decompress_some(self._buffer[head.start : self.size], head.compression)

    def _record(self, position: int, *, cut: bool = False) -> Record | None:
        """Read the head of a record; None if it is invalid, or ends beyond the file."""
        head = self._buffer[position : position + RECORD_HEAD.size]
        if len(head) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(head)
        start = position + RECORD_HEAD.size
        if opcode not in OPCODES or (start + length > self.size) is not cut:
            return None
        return Record(opcode, position, start, start + length)

    def _chunk_head(self, record: Record) -> ChunkHead | None:
        """Read the head of a chunk; None if its lengths contradict each other."""
        position = record.start + CHUNK_HEAD.size
        if position > self.size:
            return None
        _, _, raw_size, checksum, word = CHUNK_HEAD.unpack(self._buffer[record.start : position])
        compression = self._buffer[position : position + min(word, 4)]
        start = position + word + 8
        if compression not in COMPRESSIONS or raw_size > MAXIMUM_CHUNK or start > self.size:
            return None
        length = int.from_bytes(self._buffer[start - 8 : start], "little")
        return ChunkHead(compression, raw_size, checksum, start, record.end) if start + length == record.end else None

    def _content(self, record: Record) -> bytes | None:
        """The records in a record (itself, or the data of a chunk); None if it is damaged."""
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            return self._buffer[record.begin : record.end]
        if record.opcode != Opcode.CHUNK:
            return b""
        head = self._chunk_head(record)
        data = None if head is None else _decompress(self._buffer[head.start : head.end], head)
        sound = data is not None and head is not None and head.checksum in (0, zlib.crc32(data))
        return data if sound else None

    def _find_chunk(self, position: int, *, cut: bool) -> Record | None:
        """Find the next chunk that is whole, or the one that the end of the file cuts."""
        for match in CHUNK_START.finditer(self._buffer, position):
            record = self._record(match.start(), cut=cut)
            if record is not None and self._chunk_head(record) is not None:
                return record
        return None


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record of a section; an incomplete record at the end is left out."""
    position = 0
    while position + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > len(data):
            break
        yield opcode, data[start:position]


def channel_of(content: bytes) -> Channel:
    """Decode the content of a channel record."""
    return cast(Channel, Channel.read(ReadDataStream(BytesIO(content))))


def _messages(data: bytes, channels: dict[int, Channel]) -> Iterator[Envelope | None]:
    """Yield the messages of a chunk; None for one that cannot be decoded."""
    for opcode, content in records(data):
        try:
            if opcode == Opcode.CHANNEL:
                channel = channel_of(content)
                channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                id_, sequence, log_time, publish_time = MESSAGE_FIELDS.unpack_from(content)
                if channels[id_].topic.startswith(PREFIX):
                    continue  # derived from another message, for other tools
                yield envelope_of(channels[id_], content[MESSAGE_FIELDS.size :], log_time, sequence, publish_time)
        except (*MALFORMED, BadPayload, KeyError):
            yield None


def _decompress(data: bytes, head: ChunkHead) -> bytes | None:
    if not head.compression:
        return data
    try:
        if zstandard.frame_content_size(data) not in (-1, head.raw_size):
            return None
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=head.raw_size)
    except zstandard.ZstdError:
        return None


def _decompress_some(data: bytes, compression: bytes) -> bytes:
    """Decompress as many whole blocks as there are."""
    if not compression:
        return data
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    raw = bytearray()
    try:
        for start in range(0, len(data), BLOCK):
            raw += decompressor.decompress(data[start : start + BLOCK])
            if len(raw) > MAXIMUM_CHUNK:
                break
    except zstandard.ZstdError:
        pass  # the blocks before the damage are valid
    return bytes(raw)
