"""ECDSA signatures of IEEE 1609.2 on P-256, P-384, brainpoolP256r1 and brainpoolP384r1.

What is signed is a hash of two hashes (5.3.1), of the data and of the signer's certificate in its canonical form::

    e = H( H(data) || H(certificate) )

A certificate that signs itself has no signer: H of no bytes stands for it. H is SHA-256, or SHA-384 for keys of 384
bits.
"""

import hashlib
from functools import lru_cache

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import Prehashed, encode_dss_signature

from ...errors import RejectedFrame
from .certificates import Certificate, Signature, hash_of

CURVES: dict[str, ec.EllipticCurve] = {
    "ecdsaNistP256": ec.SECP256R1(),
    "ecdsaNistP384": ec.SECP384R1(),
    "ecdsaBrainpoolP256r1": ec.BrainpoolP256R1(),
    "ecdsaBrainpoolP384r1": ec.BrainpoolP384R1(),
}
ALGORITHMS: dict[str, ec.ECDSA] = {
    "sha256": ec.ECDSA(Prehashed(hashes.SHA256())),
    "sha384": ec.ECDSA(Prehashed(hashes.SHA384())),
}
NO_SIGNER = b""
MOST_KEYS = 4096


@lru_cache(maxsize=MOST_KEYS)
def public_key(curve: str, point: bytes) -> ec.EllipticCurvePublicKey:
    """Public key of a compressed point; raises `RejectedFrame` for a point that is not on the curve."""
    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(CURVES[curve], point)
    except ValueError as error:
        raise RejectedFrame("security_algorithm", "a key that is no point of its curve") from error


def signed_hash(data: bytes, signer: bytes, name: str) -> bytes:
    """Hash that a signature is of; `signer` is the canonical certificate, or `NO_SIGNER`."""
    parts = hashlib.new(name, data).digest() + hashlib.new(name, signer).digest()
    return hashlib.new(name, parts).digest()


def is_signed_by(certificate: Certificate, data: bytes, signature: Signature) -> bool:
    """Whether the key of a certificate has signed data."""
    return _verifies(certificate, data, certificate.canonical, signature)


def signs_itself(certificate: Certificate) -> bool:
    """Whether a certificate is signed by its own key, and says so."""
    return certificate.issuer is None and _verifies(certificate, certificate.tbs, NO_SIGNER, certificate.signature)


def is_issued_by(certificate: Certificate, issuer: Certificate) -> bool:
    """Whether the issuer's key has signed a certificate."""
    return certificate.issuer == issuer.digest and is_signed_by(issuer, certificate.tbs, certificate.signature)


def _verifies(key_of: Certificate, data: bytes, signer: bytes, signature: Signature) -> bool:
    if signature.curve != key_of.curve:
        return False
    name = hash_of(key_of.curve)
    encoded = encode_dss_signature(int.from_bytes(signature.r), int.from_bytes(signature.s))
    try:
        public_key(key_of.curve, key_of.point).verify(encoded, signed_hash(data, signer, name), ALGORITHMS[name])
    except (InvalidSignature, RejectedFrame):
        return False
    return True
