"""Random access to a recording by its summary: the topics and times of each chunk."""

import struct
from bisect import bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import accumulate

from mcap.opcode import Opcode
from mcap.records import Channel

from ..bus.envelope import Envelope
from ..errors import BadPayload, BadRecording
from ..topics import topic_of
from .channels import envelope_of
from .reader import MALFORMED, MESSAGE_FIELDS, Recording, channel_of, records

CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last log time, begin and length of the chunk, bytes of the next map
CHANNEL_OFFSET = struct.Struct("<HQ")
CACHED = 64  # decoded chunks: successive positions of a scrubber are close together


@dataclass(frozen=True)
class Chunk:
    """Where a chunk lies in the file, and the arrival times that it covers."""

    first_ns: int
    last_ns: int
    begin: int


# Log time, channel, sequence, publish time and payload of a message.
Row = tuple[int, int, int, int, bytes]


class RecordingIndex:
    """The messages of a closed recording by topic and time; chunks are read on demand."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._channels: dict[int, Channel] = {}
        chunks: list[tuple[Chunk, frozenset[int]]] = []
        for opcode, data in records(recording.summary()):
            if opcode == Opcode.CHANNEL:
                channel = channel_of(data)
                if topic_of(channel.topic) is not None:
                    self._channels[channel.id] = channel
            elif opcode == Opcode.CHUNK_INDEX:
                first_ns, last_ns, begin, _, length = CHUNK_INDEX.unpack_from(data)
                table = CHANNEL_OFFSET.iter_unpack(data[CHUNK_INDEX.size : CHUNK_INDEX.size + length])
                chunks.append((Chunk(first_ns, last_ns, begin), frozenset(channel for channel, _ in table)))
        if not chunks:
            raise BadRecording(f"{recording.path} has no index: it was not closed, or holds no message")
        chunks.sort(key=lambda entry: entry[0].first_ns)
        self.chunks = [chunk for chunk, _ in chunks]
        self._channels_in = [numbers for _, numbers in chunks]
        self._firsts = [chunk.first_ns for chunk in self.chunks]
        self._lasts = list(accumulate((chunk.last_ns for chunk in self.chunks), max))  # up to and with each chunk
        self._holding: dict[int, list[int]] = {number: [] for number in self._channels}  # chunks of each channel
        for place, (_, numbers) in enumerate(chunks):
            for number in numbers:
                if number in self._holding:
                    self._holding[number].append(place)
        self.begin_ns, self.end_ns = self._firsts[0], self._lasts[-1]
        self._cache: dict[int, list[Row]] = {}

    @property
    def topics(self) -> frozenset[str]:
        """Topics of the contract that the recording holds."""
        return frozenset(channel.topic for channel in self._channels.values())

    def between(self, after_ns: int, until_ns: int, topics: Collection[str] | None = None) -> Iterator[Envelope]:
        """Yield the messages with ``after_ns < arrival <= until_ns`` in the order of the file."""
        wanted = {n for n, channel in self._channels.items() if topics is None or channel.topic in topics}
        for place in range(bisect_right(self._lasts, after_ns), bisect_right(self._firsts, until_ns)):
            if self.chunks[place].last_ns <= after_ns or wanted.isdisjoint(self._channels_in[place]):
                continue
            for row in self._messages(place):
                if after_ns < row[0] <= until_ns and row[1] in wanted and (found := self._envelope(row)) is not None:
                    yield found

    def newest(self, at_ns: int) -> list[Envelope]:
        """Give the newest message of each topic that had arrived at a time, oldest first."""
        found: list[Envelope] = []
        for number, places in self._holding.items():
            row = self._newest_of(number, places, at_ns)
            if row is not None and (envelope := self._envelope(row)) is not None:
                found.append(envelope)
        return sorted(found, key=lambda envelope: envelope.received_ns)

    def _newest_of(self, number: int, places: list[int], at_ns: int) -> Row | None:
        last = bisect_right(places, at_ns, key=lambda place: self.chunks[place].first_ns)
        for place in reversed(places[:last]):
            rows = [row for row in self._messages(place) if row[1] == number and row[0] <= at_ns]
            if rows:
                return rows[-1]
        return None

    def _messages(self, place: int) -> list[Row]:
        """The messages of a chunk, decompressed or cached."""
        found = self._cache.pop(place, None)
        if found is None:
            found = []
            for opcode, data in records(self._recording.chunk_at(self.chunks[place].begin) or b""):
                if opcode == Opcode.MESSAGE and len(data) >= MESSAGE_FIELDS.size:
                    number, sequence, log_time, publish_time = MESSAGE_FIELDS.unpack_from(data)
                    found.append((log_time, number, sequence, publish_time, data[MESSAGE_FIELDS.size :]))
        self._cache[place] = found  # as the newest
        if len(self._cache) > CACHED:
            del self._cache[next(iter(self._cache))]
        return found

    def _envelope(self, row: Row) -> Envelope | None:
        """Decode the envelope; None if it is invalid."""
        log_time, number, sequence, publish_time, data = row
        try:
            return envelope_of(self._channels[number], data, log_time, sequence, publish_time)
        except (*MALFORMED, BadPayload, KeyError):
            return None


def chosen(recording: Recording, topics: Collection[str]) -> Iterator[Envelope]:
    """Yield the messages of some topics: by the index, or of the whole file without an index."""
    try:
        index = RecordingIndex(recording)
    except BadRecording:
        yield from (envelope for envelope in recording if envelope.topic in topics)
        return
    yield from index.between(index.begin_ns - 1, index.end_ns, topics)
