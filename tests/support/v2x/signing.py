"""Signed packets: of a ticket that no authority has issued, in every form, and of a PKI whose chain is whole."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import Prehashed, decode_dss_signature, encode_dss_signature

from shared.v2x.geonetworking import BASIC, BASIC_NEXT_SECURED, VERSION
from shared.v2x.security import certificates
from shared.v2x.security.issuing import signing
from shared.v2x.security.reader import encoded

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
    psid: int = certificates.CAM_PSID
    uncompressed: bool = False  # a certificate whose points are not those of the canonical form
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def certificate(self) -> bytes:
        """The certificate in OER; what its issuer signs is not true."""
        return self._encoded(uncompressed=self.uncompressed)

    @property
    def digest(self) -> bytes:
        """HashedId8 of the canonical certificate."""
        canonical = self._encoded(uncompressed=False)
        return hashlib.new(CURVES[self.key.curve.name][3].name, canonical).digest()[-8:]

    def _encoded(self, *, uncompressed: bool) -> bytes:
        head = {"version": 3, "type": "explicit", "issuer": ("sha256AndDigest", bytes(range(8)))}
        record = self._record(uncompressed=uncompressed)
        body = encoded("ToBeSignedCertificate", record["toBeSigned"])
        return b"\x80" + encoded("CertificateHead", head) + body + encoded("Signature", record["signature"])

    def _record(self, *, uncompressed: bool) -> dict[str, Any]:
        size, key, signature, _ = CURVES[self.key.curve.name]
        numbers = self.key.public_key().public_numbers()
        x, y = numbers.x.to_bytes(size, "big"), numbers.y.to_bytes(size, "big")
        whole = (f"uncompressedP{8 * size}", {"x": x, "y": y})
        permissions = [{"psid": 37}, {"psid": self.psid, "ssp": ("bitmapSsp", SSP)}]
        return {
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
    information = {"psid": 36, "generationTime": its_time_ms * 1000 + 7} | (header or {})
    tbs = {
        "payload": {"data": {"protocolVersion": 3, "content": ("unsecuredData", packet[BASIC.size :])}},
        "headerInfo": {name: value for name, value in information.items() if value is not None},
    }
    tbs_data = encoded("ToBeSignedData", tbs)
    signer = b"\x81\x01\x01" + ticket.certificate if with_certificate else b"\x80" + ticket.digest
    size, _, name, algorithm = CURVES[ticket.key.curve.name]
    r, s = decode_dss_signature(
        ticket.key.sign(message_hash(tbs_data, ticket.certificate, algorithm), ec.ECDSA(Prehashed(algorithm)))
    )
    signature = (name, {"rSig": ("x-only", r.to_bytes(size, "big")), "sSig": s.to_bytes(size, "big")})
    hash_id = encoded("HashAlgorithm", algorithm.name)
    content = b"\x03\x81" + hash_id + tbs_data + signer + encoded("Signature", signature)
    return bytes([VERSION << 4 | BASIC_NEXT_SECURED]) + packet[1 : BASIC.size] + bytes(content)


def message_hash(tbs_data: bytes, certificate: bytes, algorithm: hashes.HashAlgorithm) -> bytes:
    """Hash that is signed: of the hashes of the data and of the signer's certificate (IEEE 1609.2, 5.3.1)."""
    parts = [hashlib.new(algorithm.name, part).digest() for part in (tbs_data, certificate)]
    return hashlib.new(algorithm.name, b"".join(parts)).digest()


def dss_signature(r: bytes, s: bytes) -> bytes:
    """DER of a signature, as `cryptography` verifies it."""
    return encode_dss_signature(int.from_bytes(r, "big"), int.from_bytes(s, "big"))


@dataclass(frozen=True)
class Pki:
    """A root, an authority and what they issue; the members of a certificate can be replaced."""

    root: signing.Holder
    authority: signing.Holder
    start_s: int

    @classmethod
    def make(
        cls, now_s: int, curve: str = "ecdsaNistP256", *, name: str = "test",
        root: dict[str, Any] | None = None, authority: dict[str, Any] | None = None,
    ) -> "Pki":  # fmt: skip
        """Make a PKI whose certificates are valid from a day before an ITS time [s] on, for years."""
        start_s = now_s - 86_400
        top = signing.issue(
            signing.key_of(f"{name} root {curve}".encode(), curve), signing.root_tbs(name, start_s, 4) | (root or {})
        )
        middle = signing.issue(
            signing.key_of(f"{name} AA {curve}".encode(), curve),
            signing.authority_tbs(name, start_s, 3) | (authority or {}),
            top,
        )
        return cls(top, middle, start_s)

    def ticket(self, name: str = "car", curve: str = "ecdsaNistP256", **members: Any) -> signing.Holder:
        """Issue a ticket; members replace those of ToBeSignedCertificate."""
        body = signing.ticket_tbs(self.start_s, 168) | members
        return signing.issue(signing.key_of(name.encode(), curve), body, self.authority)

    def files(self, *, revoked: tuple[bytes, ...] = (), until_s: int | None = None) -> dict[str, bytes]:
        """Files of a folder that trusts it: root, authority, and the list of what is revoked."""
        crl = signing.revocation_list(self.root, self.start_s, until_s or self.start_s + 100 * 86_400, revoked)
        return {"root": self.root.certificate.encoded, "aa": self.authority.certificate.encoded, "crl": crl}

    def write(self, folder: Path, **lists: Any) -> Path:
        """Write the files into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files(**lists).items():
            (folder / name).write_bytes(content)
        return folder
