"""Whether the index at the end of a recording describes what stands before it.

Readers that jump to a time follow the index: one that leads elsewhere would show them another drive than a reader that
goes through the file. Schemas and channels of the index are compared with the digest in the last seal; everything else
of it is derived again from the records before it.
"""

import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO
from typing import cast

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, ChunkIndex, MetadataIndex, Statistics, SummaryOffset

from .reader import CHUNK_HEAD, FOOTER, MAGIC, RECORD_HEAD, Record, Recording, channel_of, records
from .seals import described_by, encoded

MESSAGE_INDEX = struct.Struct("<HI")  # channel, bytes of the entries
ENTRY_BYTES = 16
DATA_END = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
DESCRIPTIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
Indexed = ChunkIndex | AttachmentIndex | MetadataIndex


@dataclass
class Index:
    """The index records that follow from the records before the index, collected one by one."""

    chunks: list[ChunkIndex] = field(default_factory=list)
    others: list[Indexed] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)  # of messages by channel

    def add(self, record: Record, recording: Recording) -> None:
        """Take a record of the data section; raises one of `MALFORMED`."""
        size = record.end - record.begin
        match record.opcode:
            case Opcode.CHUNK:
                self.chunks.append(_chunk_index(record, recording))
            case Opcode.MESSAGE_INDEX:
                number, length = MESSAGE_INDEX.unpack(recording.raw(record.start, record.start + MESSAGE_INDEX.size))
                self.counts[number] += length // ENTRY_BYTES
                chunk = self.chunks[-1]
                chunk.message_index_offsets[number] = record.begin
                chunk.message_index_length += size
            case Opcode.METADATA:
                name = ReadDataStream(BytesIO(recording.raw(record.start, record.end))).read_prefixed_string()
                self.others.append(MetadataIndex(offset=record.begin, length=size, name=name))
            case Opcode.ATTACHMENT:
                found = cast(
                    Attachment, Attachment.read(ReadDataStream(BytesIO(recording.raw(record.start, record.end))))
                )
                self.others.append(
                    AttachmentIndex(
                        offset=record.begin, length=size, log_time=found.log_time, create_time=found.create_time,
                        data_size=len(found.data), name=found.name, media_type=found.media_type,
                    )
                )  # fmt: skip
            case _:
                pass

    def fault(self, recording: Recording, data_end: Record, described: str) -> str | None:
        """Compare the end of a closed file with what follows from its data; None if all of it agrees."""
        begin, summary = data_end.end, recording.summary()
        footer = recording.size - len(MAGIC) - FOOTER.size
        found = list(records(summary))
        size = sum(RECORD_HEAD.size + len(content) for _, content in found)
        if recording.raw(data_end.begin, data_end.end) != DATA_END:
            return "the record at the end of its data is changed"
        if not size or size != len(summary) or footer - size != begin or not _is_whole(recording, footer):
            return "its index is damaged, or does not follow its data"
        return self._difference(found, begin, described)

    def _difference(self, found: list[tuple[int, bytes]], begin: int, described: str) -> str | None:
        raw = [_framed(opcode, content) for opcode, content in found if opcode in DESCRIPTIONS]
        if described_by(raw) != described:
            return "the channels of its index are changed"
        listed = Counter(
            _framed(opcode, content)
            for opcode, content in found
            if opcode not in (*DESCRIPTIONS, Opcode.STATISTICS, Opcode.SUMMARY_OFFSET)
        )
        if listed != Counter(map(encoded, (*self.chunks, *self.others))):
            return "its index does not describe its content"
        if not self._has_statistics(found) or not _has_offsets(found, begin):
            return "the statistics or the offsets of its index are changed"
        return None

    def _has_statistics(self, found: list[tuple[int, bytes]]) -> bool:
        read = [
            cast(Statistics, Statistics.read(ReadDataStream(BytesIO(content))))
            for opcode, content in found
            if opcode == Opcode.STATISTICS
        ]
        expected = Statistics(
            attachment_count=sum(isinstance(item, AttachmentIndex) for item in self.others),
            channel_count=sum(opcode == Opcode.CHANNEL for opcode, _ in found),
            channel_message_counts=dict(+self.counts),
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            metadata_count=sum(isinstance(item, MetadataIndex) for item in self.others),
            schema_count=sum(opcode == Opcode.SCHEMA for opcode, _ in found),
        )
        return read == [expected]

    def leads_to(self, recording: Recording) -> bool:
        """Whether the chunks and channels of the index of any tool are those of the data."""
        found = {(c.chunk_start_offset, c.chunk_length, c.message_start_time, c.message_end_time) for c in self.chunks}
        listed = [
            ChunkIndex.read(ReadDataStream(BytesIO(content)))
            for opcode, content in records(recording.summary())
            if opcode == Opcode.CHUNK_INDEX
        ]
        return not listed or found == {
            (c.chunk_start_offset, c.chunk_length, c.message_start_time, c.message_end_time) for c in listed
        }


def topics_of_index(recording: Recording) -> dict[int, str]:
    """Give the topic of each channel of the index."""
    return {
        channel.id: channel.topic
        for opcode, content in records(recording.summary())
        if opcode == Opcode.CHANNEL
        for channel in (channel_of(content),)
    }


def _chunk_index(record: Record, recording: Recording) -> ChunkIndex:
    head = recording.raw(record.start, record.start + CHUNK_HEAD.size)
    first_ns, last_ns, raw_size, _, word = CHUNK_HEAD.unpack(head)
    name = record.start + CHUNK_HEAD.size
    return ChunkIndex(
        chunk_length=record.end - record.begin,
        chunk_start_offset=record.begin,
        compression=recording.raw(name, name + word).decode(),
        compressed_size=record.end - name - word - 8,
        message_end_time=last_ns,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=first_ns,
        uncompressed_size=raw_size,
    )


def _is_whole(recording: Recording, footer: int) -> bool:
    """Whether the footer has a checksum, and its place of the offsets is inside the index."""
    opcode, length, start, offsets, checksum = FOOTER.unpack(recording.raw(footer, footer + FOOTER.size))
    head = (opcode, length) == (Opcode.FOOTER, FOOTER.size - RECORD_HEAD.size)
    return bool(head and start < offsets < footer and checksum)


def _has_offsets(found: list[tuple[int, bytes]], begin: int) -> bool:
    """Whether the offsets name each group of records where it is."""
    groups: dict[int, list[int]] = {}
    place, listed = begin, []
    for opcode, content in found:
        end = place + RECORD_HEAD.size + len(content)
        if opcode == Opcode.SUMMARY_OFFSET:
            listed.append(cast(SummaryOffset, SummaryOffset.read(ReadDataStream(BytesIO(content)))))
        else:
            groups.setdefault(opcode, [place, end])[1] = end
        place = end
    expected = {(opcode, start, end - start) for opcode, (start, end) in groups.items()}
    named = {
        (summary_offset.group_opcode, summary_offset.group_start, summary_offset.group_length)
        for summary_offset in listed
        if summary_offset.group_length
    }
    return named == expected


def _framed(opcode: int, content: bytes) -> bytes:
    return RECORD_HEAD.pack(opcode, len(content)) + content
