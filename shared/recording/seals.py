"""Chains the bytes of a recording by their hashes, and signs the chain every ten seconds.

A recording is divided into pieces: the front (header, metadata, attachments), then each chunk with its message
indexes. The digest of a piece is

    d = SHA-256(digest of the piece before, bytes of the piece)

so that each piece holds the one before. A seal is an MCAP metadata record of the name `evidence/seal` with the digests
of the pieces since the last seal, the digest of that seal, and a signature over all of it. The digest of a seal's
record starts the next piece. `contents` is a second digest, over the messages instead of the bytes: it survives a
tool that packs the same messages anew.
"""

import hashlib
import re
import secrets
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import cast

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Metadata, Schema

from ..bus.envelope import Envelope
from ..errors import BadPayload
from ..evidence.signer import Signer
from ..evidence.statement import is_genuine, signed
from ..messages.operation import Origin

SEAL = "evidence/seal"
COPY = "evidence/copy"  # metadata of a copy that our own tools made of a sealed recording
PREFIX = "evidence/"
KIND = "recording seal"
FORMAT = "1"
PERIOD_NS = 10_000_000_000
UNKNOWN = "unknown"
DIGEST = re.compile(r"[0-9a-f]{64}")
STAMPS = struct.Struct("<QQII")  # log time, publish time, sequence, bytes of the topic


@dataclass(frozen=True)
class Seal:
    """The content of a seal."""

    recording: str  # random name of the recording
    number: int
    last: bool
    previous: str  # digest of the seal before; of number 0 that of the last seal of the file before, or empty
    chain: tuple[str, ...]  # digests of the pieces since the seal before
    contents: str
    described: str  # digest of the schemas and channels; empty before the last seal
    messages: int  # in the file so far
    vehicle: str
    origin: str  # simulated, live or replay, joined by + where it changed; unknown before the first statement
    started_ns: int
    until_ns: int  # arrival of the newest message so far
    key: str
    public_key: str

    @classmethod
    def of(cls, fields: Mapping[str, str]) -> "Seal | None":
        """Read a seal; None for a record that is none, or whose signature does not fit it."""
        try:
            found = cls(
                recording=fields["recording"], number=int(fields["number"]), last=fields["last"] == "yes",
                previous=fields["previous"], chain=tuple(fields["chain"].split()), contents=fields["contents"],
                described=fields["described"], messages=int(fields["messages"]), vehicle=fields["vehicle"],
                origin=fields["origin"], started_ns=int(fields["started_ns"]), until_ns=int(fields["until_ns"]),
                key=fields["key"], public_key=fields["public_key"],
            )  # fmt: skip
        except (KeyError, ValueError):
            return None
        if not all(DIGEST.fullmatch(name) for name in (*found.chain, found.previous or "0" * 64)):
            return None  # anybody can sign anything with a key of their own
        return found if fields.get("format") == FORMAT and is_genuine(KIND, fields) else None


class Sealer:
    """What is hashed and not yet signed of one recording."""

    def __init__(self, signer: Signer, *, vehicle: str, started_ns: int = 0, follows: str = "") -> None:
        self._signer = signer
        self._vehicle, self._started_ns, self._until_ns = vehicle, started_ns, started_ns
        self._recording = secrets.token_hex(16)
        self._previous, self._digest = follows, b""
        self._piece = hashlib.sha256()
        self._has_piece = self._is_seal = False
        self._chain: list[str] = []
        self._contents = hashlib.sha256()
        self._number = self._messages = 0
        self._origins: list[str] = []
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._sealed_ns: int | None = None

    @property
    def digest(self) -> str:
        """Digest of the newest seal, which the next file names."""
        return self._previous

    def context(self, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> None:
        """Take what the front of the file says: it is the content of the first seal."""
        self._contents.update(context_of(metadata, attachments))

    def written(self, data: bytes) -> None:
        """Take bytes of the file, in their order; those of a chunk must begin a call."""
        if not data:
            return
        if self._is_seal:
            self._previous, self._is_seal = hashlib.sha256(data).hexdigest(), False
            self._digest = bytes.fromhex(self._previous)
            return
        if data[0] == Opcode.CHUNK and self._has_piece:
            self._end_piece()
        if not self._has_piece:
            self._piece, self._has_piece = hashlib.sha256(self._digest), True
        self._piece.update(data)

    def message(self, topic: str, payload: bytes, arrival_ns: int) -> None:
        """Take a message that was added to the file."""
        self._contents.update(message_of(topic, payload, arrival_ns, arrival_ns, 0))
        self._messages += 1
        self._until_ns = arrival_ns

    def describe(self, record: Schema | Channel) -> None:
        """Take a schema or a channel, which the summary repeats at the end of the file."""
        (self._schemas if isinstance(record, Schema) else self._channels).append(encoded(record))

    def notice(self, envelope: Envelope) -> None:
        """Note whether the data are simulated, live or replayed."""
        if envelope.topic != "origin/state":
            return
        try:
            message = envelope.decode()
        except BadPayload:
            return
        if isinstance(message, Origin) and (not self._origins or self._origins[-1] != message.kind.value):
            self._origins = [*self._origins[-7:], message.kind.value]

    def is_due(self, arrival_ns: int) -> bool:
        """Whether ten seconds have passed since the last seal."""
        if self._sealed_ns is None:
            self._sealed_ns = arrival_ns
            self._started_ns = self._started_ns or arrival_ns
        return abs(arrival_ns - self._sealed_ns) >= PERIOD_NS

    def seal(self, *, last: bool = False) -> dict[str, str]:
        """Make the next seal, whose record must be written at once."""
        if self._has_piece:
            self._end_piece()
        fields = {
            "format": FORMAT, "recording": self._recording, "number": str(self._number),
            "last": "yes" if last else "no", "previous": self._previous, "chain": " ".join(self._chain),
            "contents": self._contents.hexdigest(),
            "described": described_by([*self._schemas, *self._channels]) if last else "",
            "messages": str(self._messages), "vehicle": self._vehicle, "origin": "+".join(self._origins) or UNKNOWN,
            "started_ns": str(self._started_ns), "until_ns": str(self._until_ns),
        }  # fmt: skip
        self._chain, self._contents, self._is_seal = [], hashlib.sha256(), True
        self._number += 1
        if self._sealed_ns is not None:
            self._sealed_ns = self._until_ns
        return signed(KIND, fields, self._signer)

    def _end_piece(self) -> None:
        self._chain.append(self._piece.hexdigest())
        self._digest, self._has_piece = self._piece.digest(), False


def message_of(topic: str, payload: bytes, log_ns: int, publish_ns: int, sequence: int) -> bytes:
    """Encode a message for the digest of the contents: no channel number, which another tool may change."""
    name = topic.encode()
    return STAMPS.pack(log_ns, publish_ns, sequence, len(name)) + name + len(payload).to_bytes(8, "little") + payload


def context_of(metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]) -> bytes:
    """Encode metadata and attachments for the digest of the contents, sorted: another tool may move them."""
    parts: list[bytes] = []
    for name, fields in sorted(metadata.items()):
        if not name.startswith(PREFIX):
            parts += [b"metadata", name.encode(), *_flat(sorted(fields.items()))]
    for name, data in sorted(attachments.items()):
        parts += [b"attachment", name.encode(), data]
    return b"".join(len(part).to_bytes(8, "little") + part for part in parts)


def described_by(records: Iterable[bytes]) -> str:
    """Give the digest of schemas and channels: whole records, as the summary holds them."""
    return hashlib.sha256(b"".join(records)).hexdigest()


def _flat(items: Iterable[tuple[str, str]]) -> list[bytes]:
    return [text.encode() for item in items for text in item]


def record_of(name: str, fields: Mapping[str, str]) -> bytes:
    """Encode a metadata record, as it stands in a file."""
    return encoded(Metadata(name=name, metadata=dict(fields)))


def encoded(record: McapRecord) -> bytes:
    """Encode a record, with its head."""
    builder = RecordBuilder()
    record.write(builder)
    return cast(bytes, builder.end())  # type: ignore[no-untyped-call]
