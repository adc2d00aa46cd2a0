"""A signed batch as it travels and is stored: COSE_Sign1, with the name of the vehicle as external data."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from ..evidence.signer import Signer
from .batch import MOST_BYTES, BadBatch, Batch, decode, encode
from .cbor import BadCbor
from .cose import ALGORITHM, KEY_ID, Sign1, read_sign1, sign1

if TYPE_CHECKING:
    from .cose import PublicKey

KEY_BYTES = 8  # of the key id: its 16 hexadecimal digits
RECEIPT_DIGEST_BYTES = 8


@dataclass(frozen=True)
class SealedBatch:
    """A batch of somebody, whose signature is not verified yet."""

    data: bytes
    message: Sign1

    @property
    def key(self) -> str:
        """Key id that it names, as 16 hexadecimal digits."""
        return (self.message.key_id or b"").hex()

    def is_genuine(self, public_key: "PublicKey", vehicle: str) -> bool:
        """Whether this key has signed it as this vehicle."""
        return self.message.is_genuine(public_key, vehicle.encode())

    @cached_property
    def batch(self) -> Batch:
        """Its content; raises `BadBatch`."""
        return decode(self.message.payload)


def seal(batch: Batch, signer: Signer, vehicle: str) -> bytes:
    """Encode and sign a batch; raises `BadBatch` for one that is too large or out of range."""
    data = sign1(encode(batch), signer, bytes.fromhex(signer.key_id), vehicle.encode())
    if len(data) > MOST_BYTES:
        raise BadBatch(f"it has {len(data)} bytes, and at most {MOST_BYTES} are taken")
    return data


def unsealed(data: bytes) -> SealedBatch:
    """Read the frame of a signed batch; raises `BadBatch`."""
    if len(data) > MOST_BYTES:
        raise BadBatch(f"it has {len(data)} bytes, and at most {MOST_BYTES} are taken")
    try:
        message = read_sign1(data)
    except BadCbor as error:
        raise BadBatch(str(error)) from error
    # What is not signed could be changed on the way, and the same batch would have another digest.
    if message.unprotected or set(message.header) != {ALGORITHM, KEY_ID} or len(message.key_id or b"") != KEY_BYTES:
        raise BadBatch("its header is not that of a batch")
    return SealedBatch(data, message)


def chain_digest(data: bytes) -> bytes:
    """SHA-256 of a signed batch, which the next one names."""
    return hashlib.sha256(data).digest()


def receipt_digest(data: bytes) -> bytes:
    """The first 8 bytes of its SHA-256, by which a receipt names it."""
    return chain_digest(data)[:RECEIPT_DIGEST_BYTES]
