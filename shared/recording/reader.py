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

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from .. import VERSION, is_newer
from ..bus.envelope import Envelope
from ..errors import BadPayload, BadRecording
from ..unpacked import BadPack, Form, check_size, unpacked
from .channels import envelope_of
from .foxglove import PREFIX

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, raw size, checksum, length of the next word
FOOTER = struct.Struct("<BQQQI")  # opcode, length, begin of the summary and of its offsets, checksum of all that
MESSAGE = int(Opcode.MESSAGE)  # with which every record is compared
MESSAGE_FIELDS = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
OPCODES = frozenset(int(opcode) for opcode in Opcode)
CHUNK_START = re.compile(rb"\x06(?=[\s\S]{4}\0{4})")  # opcode, and a length below 4 GiB
MAX_NAME = 16  # of a compression
MAXIMUM_RECORD = 1 << 24  # of metadata or an attachment
MAXIMUM_SUMMARY = 1 << 26
MAX_DESCRIBED = 1000  # records of metadata and attachments
MAXIMUM_CHUNK = 1 << 24  # this unit writes 1 MB, other tools 4 MB
COMPRESSIONS: dict[bytes, Form | None] = {b"": None, b"zstd": "zstd", b"lz4": "lz4"}
PLACE = struct.Struct("<QQ")  # the first fields of an index record: begin and length of what it names
SEAL_NAME = b"evidence/seal"  # metadata that `proof` reads, one each ten seconds of the drive

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

    compression: Form | None
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
        self._unpacked: set[int] = set()  # begins of the chunks that were unpacked
        self._packed_bytes = self._unpacked_bytes = 0  # of these chunks
        self._described = 0  # records of metadata and attachments
        self._refused: set[str] = set()  # why chunks are not read
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
        """Yield the messages; raises `BadRecording` for a file that unpacks to far more than data can be."""
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
            self.problems.append(f"{lost} messages could not be decoded{self.newer}")
        self.problems += sorted(self._refused)

    @property
    def newer(self) -> str:
        """What to add to an error if a newer version has written the recording; empty otherwise."""
        written = self.metadata.get("obu", {}).get("version", "")
        return (
            f"; version {written} recorded it, and this is {VERSION}: update this program" if is_newer(written) else ""
        )

    def _read_front(self) -> None:
        """Read metadata and attachments: before the first chunk, or where the summary says, as other tools write."""
        position = len(MAGIC)
        while (record := self._record(position)) is not None and record.opcode != Opcode.CHUNK:
            position = record.end
            if not self._describe(record):
                break
        for opcode, content in records(self.summary()):
            if opcode in (Opcode.METADATA_INDEX, Opcode.ATTACHMENT_INDEX) and len(content) >= PLACE.size:
                if content.endswith(SEAL_NAME):
                    continue
                named = self._record(PLACE.unpack_from(content)[0])
                if named is not None:
                    self._describe(named)

    def _describe(self, record: Record) -> bool:
        """Store metadata or an attachment; False for a record that is malformed, or has more than they may have."""
        self._described += 1
        if record.end - record.start > MAXIMUM_RECORD or self._described > MAX_DESCRIBED:
            self._refused.add(
                f"metadata and attachments beyond {MAXIMUM_RECORD >> 20} MB each, or {MAX_DESCRIBED}, are not read"
            )
            return self._described <= MAX_DESCRIBED
        try:
            if record.opcode == Opcode.METADATA:
                described = cast(Metadata, Metadata.read(self._stream(record)))
                self.metadata[described.name] = described.metadata
            elif record.opcode == Opcode.ATTACHMENT:
                attached = cast(Attachment, Attachment.read(self._stream(record)))
                self.attachments[attached.name] = attached.data
        except MALFORMED:
            return False
        return True

    def _stream(self, record: Record) -> ReadDataStream:
        return ReadDataStream(BytesIO(self._buffer[record.start : record.end]))

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

    def schemas(self) -> dict[str, bytes]:
        """JSON schemas by topic, as the summary has them; none of a recording that was not closed."""
        summary = self.summary()
        channels: dict[int, Channel] = {}
        list(_messages(summary, channels))
        known: dict[int, bytes] = {}
        for opcode, content in records(summary):
            if opcode == Opcode.SCHEMA:
                try:
                    schema = cast(Schema, Schema.read(ReadDataStream(BytesIO(content))))
                except MALFORMED:
                    continue
                known[schema.id] = schema.data
        return {channel.topic: known[channel.schema_id] for channel in channels.values() if channel.schema_id in known}

    def summary(self) -> bytes:
        """Give the summary section; empty for a recording that was not closed, or whose summary is damaged."""
        end = self.size - len(MAGIC) - FOOTER.size
        if end >= 0 and self._buffer[-len(MAGIC) :] == MAGIC:
            _, _, start, _, checksum = FOOTER.unpack(self._buffer[end : end + FOOTER.size])
            bounded = start and end - start <= MAXIMUM_SUMMARY
            if bounded and checksum in (0, zlib.crc32(self._buffer[start : end + FOOTER.size - 4])):
                return self._buffer[start:end]
        return b""

    def record_at(self, position: int) -> Record | None:
        """Give the record that begins at a byte; None if it is invalid, or ends beyond the file."""
        return self._record(position)

    def raw(self, begin: int, end: int) -> bytes:
        """Give bytes of the file as they are."""
        return self._buffer[begin:end]

    def find(self, data: bytes, begin: int) -> int:
        """Give the place of the next occurrence of some bytes; -1 if there is none."""
        return self._buffer.find(data, begin)

    def content_of(self, record: Record) -> bytes | None:
        """Give the records in a record: itself, or the data of a chunk; None if it is damaged."""
        return self._content(record)

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
        if last is not None and head is not None:
            data = self._buffer[head.start : self.size]
            self._count(last, len(data), head.raw_size)
            yield data if head.compression is None else unpacked(data, head.compression, head.raw_size, whole=False)

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
        name = self._buffer[position : position + min(word, MAX_NAME)]
        start = position + word + 8
        if start > self.size or start + int.from_bytes(self._buffer[start - 8 : start], "little") != record.end:
            return None
        if name not in COMPRESSIONS or raw_size > MAXIMUM_CHUNK:
            self._refused.add(
                f"a chunk that unpacks to {raw_size / 1e6:.0f} MB is not read: {MAXIMUM_CHUNK >> 20} MB at most"
                if name in COMPRESSIONS
                else f"chunks packed with {name.decode(errors='replace')!r} are not read: zstd, lz4 and none are"
            )
            return None
        return ChunkHead(COMPRESSIONS[name], raw_size, checksum, start, record.end)

    def _count(self, record: Record, packed_bytes: int, unpacked_bytes: int) -> None:
        """Raise `BadRecording` if the chunks so far unpack to far more than data can be."""
        if record.begin in self._unpacked:
            return
        self._unpacked.add(record.begin)
        self._packed_bytes += packed_bytes
        self._unpacked_bytes += unpacked_bytes
        try:
            check_size(self._packed_bytes, self._unpacked_bytes)
        except BadPack as error:
            raise BadRecording(f"{self.path}: {error}") from error

    def _content(self, record: Record) -> bytes | None:
        """The records in a record (itself, or the data of a chunk); None if it is damaged."""
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            if record.end - record.start > MAXIMUM_CHUNK:
                return b""
            return self._buffer[record.begin : record.end]
        if record.opcode != Opcode.CHUNK:
            return b""
        head = self._chunk_head(record)
        if head is not None:
            self._count(record, head.end - head.start, head.raw_size)
        data = None if head is None else _content_of(self._buffer[head.start : head.end], head)
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
        if position > len(data) or opcode not in OPCODES:
            break
        yield opcode, data[start:position]


def channel_of(content: bytes) -> Channel:
    """Decode the content of a channel record."""
    return cast(Channel, Channel.read(ReadDataStream(BytesIO(content))))


def _messages(data: bytes, channels: dict[int, Channel]) -> Iterator[Envelope | None]:
    """Yield the messages of a chunk; None for one that cannot be decoded."""
    for opcode, content in records(data):
        try:
            if opcode == MESSAGE:
                id_, sequence, log_time, publish_time = MESSAGE_FIELDS.unpack_from(content)
                channel = channels[id_]
                if channel.topic.startswith(PREFIX):
                    continue  # derived from another message, for other tools
                yield envelope_of(channel, content[MESSAGE_FIELDS.size :], log_time, sequence, publish_time)
            elif opcode == Opcode.CHANNEL:
                channel = channel_of(content)
                channels[channel.id] = channel
        except (*MALFORMED, BadPayload, KeyError):
            yield None


def _content_of(data: bytes, head: ChunkHead) -> bytes | None:
    """The data of a chunk; None if they are damaged."""
    if head.compression is None:
        return data
    try:
        content = unpacked(data, head.compression, head.raw_size)
    except BadPack:
        return None
    return content if len(content) == head.raw_size else None
