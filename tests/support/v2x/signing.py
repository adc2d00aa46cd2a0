"""Signed packets of a test PKI: a ticket whose key signs, and a certificate that its own random issuer names."""

import hashlib
from dataclasses import dataclass, field
from typing import Any

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import Prehashed, decode_dss_signature, encode_dss_signature

from shared.v2x import security
from shared.v2x.geonetworking import BASIC, BASIC_NEXT_SECURED, VERSION

SSP = bytes.fromhex("010000")
P256, P384 = ec.SECP256R1(), ec.SECP384R1()
# Curve: bytes of a number, name of its key and of its signature, hash.
CURVES: dict[str, tuple[int, str, str, hashes.HashAlgorithm]] = {
    "secp256r1": (32, "ecdsaNistP256", "ecdsaNistP256Signature", hashes.SHA256()),
    "brainpoolP256r1": (32, "ecdsaBrainpoolP256r1", "ecdsaBrainpoolP256r1Signature", hashes.SHA256()),
    "secp384r1": (48, "ecdsaNistP384", "ecdsaNistP384Signature", hashes.SHA384()),
    "brainpoolP384r1": (48, "ecdsaBrainpoolP384r1", "ecdsaBrainpoolP384r1Signature", hashes.SHA384()),
}


@dataclass(frozen=True)
class Ticket:
    """An authorization ticket with its key; `record` replaces members of what is signed by its issuer."""

    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: ec.generate_private_key(P256))
    psid: int = security.CAM_PSID
    uncompressed: bool = False  # a certificate whose points are not those of the canonical form
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def certificate(self) -> bytes:
        """The certificate in OER; what its issuer signs is not true, as no test here checks it."""
        return bytes(security.specification().encode("Certificate", self._record(uncompressed=self.uncompressed)))

    @property
    def digest(self) -> bytes:
        """HashedId8 of the canonical certificate."""
        canonical = security.specification().encode("Certificate", self._record(uncompressed=False))
        return hashlib.new(CURVES[self.key.curve.name][3].name, canonical).digest()[-8:]

    def _record(self, *, uncompressed: bool) -> dict[str, Any]:
        size, key, signature, _ = CURVES[self.key.curve.name]
        numbers = self.key.public_key().public_numbers()
        x, y = numbers.x.to_bytes(size, "big"), numbers.y.to_bytes(size, "big")
        whole = (f"uncompressedP{8 * size}", {"x": x, "y": y})
        permissions = [{"psid": 37}, {"psid": self.psid, "ssp": ("bitmapSsp", SSP)}]
        return {
            "version": 3,
            "type": "explicit",
            "issuer": ("sha256AndDigest", bytes(range(8))),
            "toBeSigned": {
                "id": ("none", None),
                "cracaId": bytes(3),
                "crlSeries": 0,
                "validityPeriod": {"start": 0, "duration": ("hours", 168)},
                "appPermissions": permissions,
                "verifyKeyIndicator": (
                    "verificationKey",
                    (key, whole if uncompressed else (f"compressed-y-{y[-1] & 1}", x)),
                ),
                **self.extra,
            },
            "signature": (signature, {"rSig": ("compressed-y-0" if uncompressed else "x-only", x), "sSig": y}),
        }


def signed(
    packet: bytes,
    ticket: Ticket,
    its_time_ms: int,
    *,
    with_certificate: bool = True,
    header: dict[str, Any] | None = None,
) -> bytes:
    """Sign an unsecured packet as a station does; `header` replaces members of HeaderInfo, None leaves one out."""
    compile_, information = security.specification(), {"psid": 36, "generationTime": its_time_ms * 1000 + 7}
    information |= header or {}
    tbs = {
        "payload": {"data": {"protocolVersion": 3, "content": ("unsecuredData", packet[BASIC.size :])}},
        "headerInfo": {name: value for name, value in information.items() if value is not None},
    }
    tbs_data = bytes(compile_.encode("ToBeSignedData", tbs))
    signer = b"\x81\x01\x01" + ticket.certificate if with_certificate else b"\x80" + ticket.digest
    size, _, name, algorithm = CURVES[ticket.key.curve.name]
    r, s = decode_dss_signature(
        ticket.key.sign(message_hash(tbs_data, ticket.certificate, algorithm), ec.ECDSA(Prehashed(algorithm)))
    )
    signature = (name, {"rSig": ("x-only", r.to_bytes(size, "big")), "sSig": s.to_bytes(size, "big")})
    hash_id = compile_.encode("HashAlgorithm", algorithm.name)
    content = b"\x03\x81" + hash_id + tbs_data + signer + compile_.encode("Signature", signature)
    return bytes([VERSION << 4 | BASIC_NEXT_SECURED]) + packet[1 : BASIC.size] + bytes(content)


def message_hash(tbs_data: bytes, certificate: bytes, algorithm: hashes.HashAlgorithm) -> bytes:
    """Hash that is signed: of the hashes of the data and of the signer's certificate (IEEE 1609.2, 5.3.1)."""
    parts = [hashlib.new(algorithm.name, part).digest() for part in (tbs_data, certificate)]
    return hashlib.new(algorithm.name, b"".join(parts)).digest()


def dss_signature(r: bytes, s: bytes) -> bytes:
    """DER of a signature, as `cryptography` verifies it."""
    return encode_dss_signature(int.from_bytes(r, "big"), int.from_bytes(s, "big"))
