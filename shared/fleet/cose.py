"""COSE_Sign1 (RFC 9052, section 4.2): one signature over content, its protected header and external data.

Signing is with a `Signer` (Ed25519); signatures of ES256 are verified as well, which a hardware token may make.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..evidence.signer import Signer
from .cbor import BadCbor, decoded, encoded

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    PublicKey = Ed25519PublicKey | EllipticCurvePublicKey

TAG = b"\xd2"  # 18, COSE_Sign1
ALGORITHM, KEY_ID = 1, 4  # labels of the header, RFC 9052, section 3.1
EDDSA, ES256 = -8, -7  # RFC 9053, sections 2.1 and 2.2
SIGNATURE_BYTES = 64


@dataclass(frozen=True)
class Sign1:
    """A message that was read, and not yet verified."""

    protected: bytes
    header: dict[int | str, object]  # protected
    unprotected: dict[int | str, object]
    payload: bytes
    signature: bytes

    @property
    def algorithm(self) -> object:
        """Algorithm of the signature, as the protected header states it; another place is not believed."""
        return self.header.get(ALGORITHM)

    @property
    def key_id(self) -> bytes | None:
        """Name of the key, from the protected header."""
        name = self.header.get(KEY_ID)
        return name if isinstance(name, bytes) else None

    def is_genuine(self, key: "PublicKey", external: bytes = b"") -> bool:
        """Whether the signature is that of a key for this content and the external data."""
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        signed = to_be_signed(self.protected, external, self.payload)
        try:
            if isinstance(key, Ed25519PublicKey):
                if self.algorithm != EDDSA:
                    return False
                key.verify(self.signature, signed)
                return True
            return self.algorithm == ES256 and _es256_verifies(key, self.signature, signed)
        except InvalidSignature:
            return False


def to_be_signed(protected: bytes, external: bytes, payload: bytes) -> bytes:
    """Give the Sig_structure (RFC 9052, section 4.4), which is what is signed."""
    return encoded(["Signature1", protected, external, payload])


def sign1(payload: bytes, signer: Signer, key_id: bytes, external: bytes = b"") -> bytes:
    """Sign content as this unit; algorithm and key are named in the protected header."""
    protected = encoded({ALGORITHM: EDDSA, KEY_ID: key_id})
    signature = signer.sign(to_be_signed(protected, external, payload))
    return TAG + encoded([protected, {}, payload, signature])


def read_sign1(data: bytes) -> Sign1:
    """Read a tagged message in canonical form; raises `BadCbor`."""
    if data[:1] != TAG:
        raise BadCbor("no COSE_Sign1: its tag is missing")
    match decoded(data[1:]):
        case [bytes() as protected, dict() as unprotected, bytes() as payload, bytes() as signature]:
            header = decoded(protected) if protected else {}
        case _:
            raise BadCbor("no COSE_Sign1: it is not an array of header, header, content and signature")
    if not isinstance(header, dict) or len(signature) != SIGNATURE_BYTES:
        raise BadCbor("no COSE_Sign1: its header is no map, or its signature is not of 64 bytes")
    return Sign1(protected, header, unprotected, payload, signature)


def _es256_verifies(key: "EllipticCurvePublicKey", signature: bytes, signed: bytes) -> bool:
    """Verify ECDSA with SHA-256 on P-256, whose signature is r and s of 32 bytes; raises `InvalidSignature`."""
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec, utils

    if not isinstance(key.curve, ec.SECP256R1):
        return False
    r, s = int.from_bytes(signature[:32], "big"), int.from_bytes(signature[32:], "big")
    key.verify(utils.encode_dss_signature(r, s), signed, ec.ECDSA(hashes.SHA256()))
    return True
