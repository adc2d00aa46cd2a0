"""Receipts: which batches a centre has committed, and which it refuses and why."""

from dataclasses import dataclass
from typing import NamedTuple

from .batch import MAX_SEQUENCE
from .cbor import BadCbor, decoded, encoded
from .sealed import RECEIPT_DIGEST_BYTES

MAX_BATCHES = 256  # named in one receipt
REASONS = ("signature", "key", "vehicle", "format", "conflict", "epochs")


class StoredBatch(NamedTuple):
    """A batch that is committed, now or before."""

    epoch_ms: int
    first: int
    digest: bytes


class RejectedBatch(NamedTuple):
    """A batch that is not stored, and why: one of `REASONS`."""

    epoch_ms: int
    first: int
    digest: bytes
    reason: str


@dataclass(frozen=True)
class Receipt:
    """Names exactly the batches that it answers."""

    stored: tuple[StoredBatch, ...] = ()
    refused: tuple[RejectedBatch, ...] = ()

    def encode(self) -> bytes:
        """Encode it as CBOR."""
        return encoded(
            {"stored": [list(stored) for stored in self.stored], "refused": [list(refused) for refused in self.refused]}
        )

    @classmethod
    def decode(cls, data: bytes) -> "Receipt":
        """Read a receipt; raises `BadCbor`."""
        match decoded(data):
            case {"stored": list() as stored, "refused": list() as refused, **rest} if (
                not rest and len(stored) + len(refused) <= MAX_BATCHES
            ):
                return cls(tuple(StoredBatch(*_named(row)) for row in stored), tuple(_refused(row) for row in refused))
        raise BadCbor("no receipt")


def _named(row: object) -> tuple[int, int, bytes]:
    match row:
        case [int() as epoch, int() as first, bytes() as digest] if (
            0 <= epoch <= MAX_SEQUENCE
            and 0 <= first <= MAX_SEQUENCE
            and len(digest) == RECEIPT_DIGEST_BYTES
            and bool not in (type(epoch), type(first))
        ):
            return epoch, first, digest
    raise BadCbor("a receipt that names no batch")


def _refused(row: object) -> RejectedBatch:
    match row:
        case [epoch, first, digest, str() as reason] if reason in REASONS:
            return RejectedBatch(*_named([epoch, first, digest]), reason)
    raise BadCbor("a receipt that refuses for no known reason")
