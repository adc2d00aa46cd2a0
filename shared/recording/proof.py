"""Checks the seals of a recording: that nothing was changed, removed or added since the unit wrote it.

Two ways lead to an answer. The bytes of the file are compared with the chain of digests in the seals; where they
differ in a file of another tool, the messages are compared with the second digest of each seal, so that a recording
that was only packed anew is told from one whose content is another.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import BytesIO
from typing import cast

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from ..evidence import KeyRing, Outcome
from ..evidence.statement import printable
from .descriptions import Descriptions
from .proof_index import Index, topics_of_index
from .reader import MAGIC, MALFORMED, MESSAGE_FIELDS, Record, Recording, channel_of, records
from .seals import COPY, SEAL, Seal, context_of, message_of, record_of

LIBRARY = "obu"
STEP_BYTES = 1 << 20
FAULTS = 8  # named one by one


@dataclass(frozen=True)
class Proof:
    """What the seals of a recording prove; times are arrivals at the recorder [ns]."""

    outcome: Outcome
    sentences: tuple[str, ...]
    first: Seal | None = None
    proven: Seal | None = None  # the newest seal before the first fault
    digest: str = ""  # of the last seal, which the next file of the recorder names

    @property
    def text(self) -> str:
        """All sentences in one line."""
        return "; ".join(self.sentences)


@dataclass
class _LocatedSeal:
    """A seal, where it is, its digest and the pieces before it."""

    seal: Seal
    record: Record
    digest: str
    pieces: list[tuple[int, int]]


@dataclass
class _Walk:
    """What was found on the way through a file."""

    seals: list[_LocatedSeal] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    proven: _LocatedSeal | None = None
    index: Index = field(default_factory=Index)
    pieces: list[tuple[int, int]] = field(default_factory=list)  # since the last seal
    data_end: Record | None = None
    end: int = 0  # of what could be read as records
    copy: str = ""
    intact: int = 0  # seals that follow on chunks as this unit has written them
    others: list[tuple[dict[str, str], Record]] = field(default_factory=list)  # seals that are not genuine

    def fault(self, text: str) -> None:
        """Note a fault."""
        self.faults.append(text)


def prove(recording: Recording, ring: KeyRing) -> Proof:
    """Check the seals of a recording against accepted keys."""
    walk = _walk(recording)
    if not walk.seals and not walk.others and not _later_seal(recording, 0):
        return _without_seals(walk)
    _check_end(recording, walk)
    first = walk.seals[0].seal if walk.seals else None
    if walk.faults:
        return _faulty(recording, walk, first, ring)
    assert first is not None and walk.proven is not None
    last = walk.proven.seal
    if (foreign := _foreign(first, ring)) is not None:
        return Proof(Outcome.FOREIGN, (foreign,), first, last, walk.proven.digest)
    if walk.data_end is None:
        text = f"proven until {clock(last.until_ns)}, then cut: the file was not finished"
        if not last.messages:
            text = "cut before its first messages were signed: nothing of the drive is proven"
        elif last.last:
            text = f"all messages are proven until {clock(last.until_ns)}; the index behind them was cut"
        elif (more := recording.size - walk.proven.record.end) > 0:
            text += f"; {more} bytes behind its last seal are not proven"
        return Proof(Outcome.CUT, (text,), first, last, walk.proven.digest)
    text = f"verified: {last.messages} messages until {clock(last.until_ns)}"
    return Proof(Outcome.VERIFIED, (text,), first, last, walk.proven.digest)


def clock(stamp_ns: int) -> str:
    """Give a time for a person: UTC with seconds."""
    try:
        return f"{datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return "a time out of range"


def _without_seals(walk: _Walk) -> Proof:
    if walk.copy:
        text = (
            f"a copy made by {printable(walk.copy)} of a signed recording, without its signatures; verify the original"
        )
        return Proof(Outcome.REWRITTEN, (text,))
    return Proof(Outcome.UNSIGNED, ("unsigned: nothing proves who recorded it, or that it is unchanged",))


def _foreign(first: Seal, ring: KeyRing) -> str | None:
    if ring.accepts(first.key, first.public_key, first.started_ns):
        return None
    known = ring.find(first.key)
    if known is not None and known.public_key.hex() == first.public_key:
        return f"signed by key {first.key[:16]} more than a day after that key was replaced"
    return (
        f"signed by key {first.key[:16]}, which is not among the accepted ones; if it is that of a vehicle that you "
        "trust, give its public key with --key"
    )


# Bytes


def _walk(recording: Recording) -> _Walk:
    """Go through the records of the data section, and check each seal where it stands."""
    walk, position, begin = _Walk(), 0, 0
    if recording.raw(0, len(MAGIC)) != MAGIC:
        walk.fault("it does not begin like an MCAP file")
    position = len(MAGIC)
    while (record := recording.record_at(position)) is not None:
        if record.opcode == Opcode.DATA_END:
            walk.data_end = record
            break
        if record.opcode == Opcode.FOOTER:
            walk.fault("the end of its data is not marked")
            break
        fields = _seal_fields(record, recording, walk)
        if fields is not None or record.opcode == Opcode.CHUNK:
            if begin < position:
                walk.pieces.append((begin, position))
            begin = position
        if fields is not None:
            _check_seal(recording, walk, record, fields)
            begin = record.end
        _index(walk, record, recording)
        position = record.end
    walk.end = position
    if begin < position:
        walk.pieces.append((begin, position))
    return walk


def _index(walk: _Walk, record: Record, recording: Recording) -> None:
    try:
        walk.index.add(record, recording)
    except (*MALFORMED, IndexError):
        walk.fault(f"the record at byte {record.begin} is damaged")


def _seal_fields(record: Record, recording: Recording, walk: _Walk) -> dict[str, str] | None:
    """Read the fields of a seal; None for every other record."""
    if record.opcode != Opcode.METADATA:
        return None
    try:
        read = cast(Metadata, Metadata.read(ReadDataStream(BytesIO(recording.raw(record.start, record.end)))))
    except MALFORMED:
        return None
    if read.name == COPY:
        walk.copy = read.metadata.get("by", "another program")
    return read.metadata if read.name == SEAL else None


def _check_seal(recording: Recording, walk: _Walk, record: Record, fields: dict[str, str]) -> None:
    """Check a seal and the pieces before it."""
    pieces, walk.pieces = walk.pieces, []
    seal, raw = Seal.of(fields), recording.raw(record.begin, record.end)
    if seal is None or record_of(SEAL, fields) != raw:
        walk.others.append((fields, record))
        walk.fault(f"the seal at byte {record.begin} is changed: its signature does not fit it")
        return
    found = _LocatedSeal(seal, record, hashlib.sha256(raw).hexdigest(), pieces)
    faults = len(walk.faults)
    before = walk.seals[-1] if walk.seals else None
    _check_order(walk, seal, before)
    _check_pieces(recording, walk, found, before)
    walk.seals.append(found)
    if not walk.faults:
        walk.proven = found
    elif len(walk.faults) == faults and before is None:
        walk.fault("its first seal is missing")


def _check_order(walk: _Walk, seal: Seal, before: _LocatedSeal | None) -> None:
    if before is None:
        if seal.number != 0:
            walk.fault(f"its begin is missing: the first seal is number {seal.number}")
        return
    old = before.seal
    if (seal.recording, seal.key, seal.public_key) != (old.recording, old.key, old.public_key):
        walk.fault(f"from {clock(old.until_ns)} on it holds a part of another recording")
    elif old.last:
        walk.fault("something was added behind its end")
    elif seal.number != old.number + 1:
        walk.fault(f"removed: what was recorded from {clock(old.until_ns)} to {clock(seal.until_ns)}")
    elif seal.previous != before.digest:
        walk.fault(f"the seal of {clock(old.until_ns)} was replaced")


def _check_pieces(recording: Recording, walk: _Walk, found: _LocatedSeal, before: _LocatedSeal | None) -> None:
    """Compare the pieces before a seal with its digests, each by the digest that is stated of the one before."""
    stated, pieces = found.seal.chain, found.pieces
    since = clock(before.seal.until_ns) if before else "its begin"
    span = f"between {since} and {clock(found.seal.until_ns)}"
    previous = before.digest if before is not None else ""
    digests: list[str] = []
    for number, piece in enumerate(pieces):
        last = previous if number == 0 else stated[number - 1] if number - 1 < len(stated) else digests[-1]
        digests.append(_digest(recording, piece, bytes.fromhex(last)))
    changed = [piece for piece, now, then in zip(pieces, digests, stated, strict=False) if now != then]
    if len(pieces) != len(stated):
        walk.fault(f"{len(pieces)} chunks instead of {len(stated)} {span}: some were removed or added")
    elif changed:
        begin, end = changed[0]
        walk.fault(f"edited {span}: the bytes {begin} to {end} are not those that were signed")
    elif stated and before is not None:
        walk.intact += 1


def _digest(recording: Recording, piece: tuple[int, int], previous: bytes) -> str:
    digest = hashlib.sha256(previous)
    for begin in range(piece[0], piece[1], STEP_BYTES):
        digest.update(recording.raw(begin, min(begin + STEP_BYTES, piece[1])))
    return digest.hexdigest()


def _later_seal(recording: Recording, position: int) -> bool:
    """Whether a genuine seal stands somewhere behind a place, where records cannot be followed."""
    name = len(SEAL).to_bytes(4, "little") + SEAL.encode()
    place = recording.find(name, position)
    while place >= 0:
        record = recording.record_at(place - 9)
        if record is not None and record.opcode == Opcode.METADATA:
            fields = _seal_fields(record, recording, _Walk())
            if fields is not None and Seal.of(fields) is not None:
                return True
        place = recording.find(name, place + 1)
    return False


def _check_end(recording: Recording, walk: _Walk) -> None:
    """Check what stands behind the last seal: an index in a closed file, or the cut end."""
    last = walk.seals[-1] if walk.seals else None
    if last is None:
        walk.fault("no seal of it is whole")
    elif walk.data_end is not None:
        if not last.seal.last:
            walk.fault(f"the end from {clock(last.seal.until_ns)} on is missing: it was closed without its last seal")
        elif walk.pieces:
            walk.fault("something was added behind its last seal")
        elif recording.raw(recording.size - len(MAGIC), recording.size) != MAGIC:
            walk.data_end = None  # readers ignore an index that was cut
        elif (text := _index_fault(recording, walk, walk.data_end, last.seal)) is not None:
            walk.fault(text)
    elif last.seal.last and walk.pieces:
        walk.fault("something was added behind its last seal")
    elif _later_seal(recording, walk.end) or (
        walk.end + len(MAGIC) <= recording.size and recording.raw(recording.size - len(MAGIC), recording.size) == MAGIC
    ):
        walk.fault(f"the bytes from {walk.end} on cannot be read, though the recording goes on behind them")


def _index_fault(recording: Recording, walk: _Walk, data_end: Record, last: Seal) -> str | None:
    try:
        return walk.index.fault(recording, data_end, last.described)
    except MALFORMED:
        return "its index is damaged"


# Content


def _faulty(recording: Recording, walk: _Walk, first: Seal | None, ring: KeyRing) -> Proof:
    """Tell a recording that another tool packed anew from one that was edited."""
    proven = walk.proven.seal if walk.proven else None
    library = _library(recording)
    if first is not None and not library.startswith(LIBRARY) and not walk.others and not walk.intact:
        content = _Content(recording, [seal.seal for seal in walk.seals])
        try:
            fault = content.fault(walk)
        except MALFORMED:
            fault = "its records are damaged"
        if fault is None:
            if (foreign := _foreign(first, ring)) is not None:
                return Proof(Outcome.FOREIGN, (foreign,), first)
            text = f"rewritten by {printable(library) or 'another program'}: {content.text}; verify the original"
            return Proof(Outcome.REWRITTEN, (text,), first, content.last)
        walk.faults[:] = [fault]
    sentences = [f"edited: {walk.faults[0]}", *walk.faults[1:FAULTS]]
    if len(walk.faults) > FAULTS:
        sentences.append(f"and {len(walk.faults) - FAULTS} more")
    if proven is not None:
        sentences.append(f"proven until {clock(proven.until_ns)} only")
    return Proof(Outcome.EDITED, tuple(sentences), first, proven)


def _library(recording: Recording) -> str:
    record = recording.record_at(len(MAGIC))
    if record is None or record.opcode != Opcode.HEADER:
        return LIBRARY
    try:
        header = cast(Header, Header.read(ReadDataStream(BytesIO(recording.raw(record.start, record.end)))))
    except MALFORMED:
        return LIBRARY
    return str(header.library)


class _Content:
    """Compares the messages of a file with the digests of its seals, wherever these stand."""

    def __init__(self, recording: Recording, seals: list[Seal]) -> None:
        self._recording = recording
        self._seals = sorted(seals, key=lambda seal: seal.number)
        self.last = self._seals[-1]
        self.text = ""
        self._descriptions = Descriptions()

    def fault(self, walk: _Walk) -> str | None:
        """Name what differs; None if every message up to the last seal is the one that was signed."""
        if [seal.number for seal in self._seals] != list(range(len(self._seals))):
            return "seals are missing, and with them a part of the recording"
        names = {(seal.recording, seal.key) for seal in self._seals}
        if len(names) > 1:
            return "it holds parts of several recordings"
        digests = {seal.seal.number: seal.digest for seal in walk.seals}
        if any(seal.previous != digests[seal.number - 1] for seal in self._seals[1:]):
            return "a seal was replaced"
        context = context_of(self._recording.metadata, self._recording.attachments)
        if hashlib.sha256(context).hexdigest() != self._seals[0].contents:
            return "the vehicle's file or the metadata are not those that were signed"
        return self._messages_fault() or self._descriptions_fault() or self._index_fault(walk)

    def _descriptions_fault(self) -> str | None:
        """Compare schemas and channels, of which a reader takes the meaning of the messages."""
        try:
            text = self._descriptions.checked(records(self._recording.summary()), self.last.described)
        except ValueError as error:
            return str(error)
        self.text += text
        return None

    def _index_fault(self, walk: _Walk) -> str | None:
        return None if walk.index.leads_to(self._recording) else "its index does not describe its content"

    def _messages_fault(self) -> str | None:
        """Compare the messages of each seal, by their number in the file."""
        messages = self._messages()
        before = self._seals[0]
        for seal in self._seals[1:]:
            digest = hashlib.sha256()
            for _ in range(seal.messages - before.messages):
                if (message := next(messages, None)) is None:
                    return f"messages before {clock(seal.until_ns)} are missing"
                digest.update(message)
            if digest.hexdigest() != seal.contents:
                return (
                    f"messages between {clock(before.until_ns)} and {clock(seal.until_ns)} are not those that were "
                    "signed"
                )
            before = seal
        more = sum(1 for _ in messages)
        if more and before.last:
            return f"{more} messages were added behind its end"
        self.text = f"the {before.messages} messages until {clock(before.until_ns)} are those that were signed"
        if not before.last:
            self.text += f", {more} behind them are not proven, and the end is missing"
        return None

    def _messages(self) -> Iterator[bytes]:
        """Yield every message in the order of the file; one that cannot be read ends it."""
        position, topics, indexed = len(MAGIC), {}, topics_of_index(self._recording)
        while (record := self._recording.record_at(position)) is not None and record.opcode != Opcode.DATA_END:
            data = self._recording.content_of(record)
            if data is None:
                return
            for opcode, content in records(data):
                self._descriptions.add(opcode, content)
                if opcode == Opcode.CHANNEL:
                    channel = channel_of(content)
                    if indexed.get(channel.id, channel.topic) != channel.topic:
                        return
                    topics[channel.id] = channel.topic
                elif opcode == Opcode.MESSAGE:
                    number, sequence, log_ns, publish_ns = MESSAGE_FIELDS.unpack_from(content)
                    payload = content[MESSAGE_FIELDS.size :]
                    self._descriptions.use(number)
                    yield message_of(topics.get(number, ""), payload, log_ns, publish_ns, sequence)
            position = record.end
