"""Receipts: which batches a centre has committed, and which it refuses and why."""

from dataclasses import dataclass
from typing import NamedTuple

from .batch import MOST_SEQUENCE
from .cbor import BadCbor, decoded, encoded
from .sealed import RECEIPT_DIGEST_BYTES

MOST_BATCHES = 256  # named in one receipt
REASONS = ("signature", "key", "vehicle", "format", "conflict", "epochs")


class Stored(NamedTuple):
    """A batch that is committed, now or before."""

    epoch_ms: int
    first: int
    digest: bytes


class Refused(NamedTuple):
    """A batch that is not stored, and why: one of `REASONS`."""

    epoch_ms: int
    first: int
    digest: bytes
    reason: str


@dataclass(frozen=True)
class Receipt:
    """Names exactly the batches that it answers."""

    stored: tuple[Stored, ...] = ()
    refused: tuple[Refused, ...] = ()

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
                not rest and len(stored) + len(refused) <= MOST_BATCHES
            ):
                return cls(tuple(Stored(*_named(row)) for row in stored), tuple(_refused(row) for row in refused))
        raise BadCbor("no receipt")


def _named(row: object) -> tuple[int, int, bytes]:
    match row:
        case [int() as epoch, int() as first, bytes() as digest] if (
            0 <= epoch <= MOST_SEQUENCE
            and 0 <= first <= MOST_SEQUENCE
            and len(digest) == RECEIPT_DIGEST_BYTES
            and bool not in (type(epoch), type(first))
        ):
            return epoch, first, digest
    raise BadCbor("a receipt that names no batch")


def _refused(row: object) -> Refused:
    match row:
        case [epoch, first, digest, str() as reason] if reason in REASONS:
            return Refused(*_named([epoch, first, digest]), reason)
    raise BadCbor("a receipt that refuses for no known reason")
