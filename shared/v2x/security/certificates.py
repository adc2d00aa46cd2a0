"""Certificates of IEEE 1609.2 in the profile of TS 103 097: what one states, and the bytes that are hashed of it.

Layout in OER: preamble 1 byte, version 1, type 1, issuer, ToBeSignedCertificate, signature.
"""

import hashlib
from dataclasses import dataclass
from typing import Any

from ...errors import RejectedFrame
from .reader import Reader, Record, encoded

VERSION = 3  # of certificates, and of Ieee1609Dot2Data
SIGNED = b"\x80"  # preamble: the signature is there
DIGEST_BYTES = 8  # of a HashedId8: the last bytes of the hash
KEYS_384 = frozenset({"ecdsaBrainpoolP384r1", "ecdsaNistP384"})  # certificates of these keys are hashed by SHA-384
CAM_PSID, CRL_PSID, CTL_PSID = 36, 622, 624  # TS 102 965
ANY_LENGTH = -1  # chainLengthRange without a limit
UNIT_S = {
    "microseconds": 1e-6, "milliseconds": 1e-3, "seconds": 1.0, "minutes": 60.0, "hours": 3600.0,
    "sixtyHours": 216_000.0, "years": 31_556_952.0,
}  # fmt: skip

Permissions = tuple[tuple[int, bytes | None], ...]  # PSID and its bitmap of service-specific permissions (SSP)


@dataclass(frozen=True)
class SspRange:
    """SSP that an issuer may grant for a service: those with the bits of `value` where `mask` has a one."""

    psid: int
    value: bytes | None = None  # None: any SSP
    mask: bytes = b""

    def holds(self, ssp: bytes | None) -> bool:
        """Whether an SSP is in the range (IEEE 1609.2, 6.4.30)."""
        if self.value is None:
            return True
        if ssp is None or not len(ssp) == len(self.value) == len(self.mask):
            return False
        return all((a ^ b) & mask == 0 for a, b, mask in zip(ssp, self.value, self.mask, strict=True))


@dataclass(frozen=True)
class Grant:
    """Permissions to issue certificates, and how many certificates may be below this one."""

    ranges: tuple[SspRange, ...] | None  # None: every service
    least: int  # chain length
    more: int  # that it may be longer; ANY_LENGTH

    def holds(self, psid: int, ssp: bytes | None, length: int) -> bool:
        """Whether a certificate that is so many below this one may have a permission."""
        if length < self.least or (self.more != ANY_LENGTH and length > self.least + self.more):
            return False
        return self.ranges is None or any(part.psid == psid and part.holds(ssp) for part in self.ranges)


@dataclass(frozen=True)
class Signature:
    """ECDSA signature: x coordinate of the ephemeral point, and s, big-endian."""

    curve: str  # name of the key that makes it
    r: bytes
    s: bytes


@dataclass(frozen=True)
class Certificate:
    """An explicit certificate with a verification key."""

    encoded: bytes  # as received
    canonical: bytes  # compressed keys, x-only r: the form that is hashed (IEEE 1609.2, 6.4.3)
    tbs: bytes  # ToBeSignedCertificate in that form
    digest: bytes  # HashedId8
    issuer: bytes | None  # HashedId8; None: it signs itself
    name: str  # that it states; empty in an authorization ticket
    start_s: int  # [s] ITS time
    end_s: float
    region: Any  # GeographicRegion as asn1tools represents it; None: everywhere
    permissions: Permissions
    grants: tuple[Grant, ...]  # none in an authorization ticket
    curve: str
    point: bytes  # public key, compressed: 02 or 03, and x
    signature: Signature

    @property
    def hash_name(self) -> str:
        """Hash that its key signs with, and that its own digest is of."""
        return hash_of(self.curve)

    @property
    def ssp(self) -> bytes | None:
        """Service-specific permissions for CAM; None: it has no permission for CAM, or no SSP with it."""
        return self.permission(CAM_PSID)

    def permission(self, psid: int) -> bytes | None:
        """SSP of a service; None: it may not use the service, or has no SSP for it."""
        return next((ssp for number, ssp in self.permissions if number == psid), None)

    def grants_all(self, permissions: Permissions, length: int) -> bool:
        """Whether it may issue a certificate, so many below it, with these permissions."""
        return all(any(grant.holds(psid, ssp, length) for grant in self.grants) for psid, ssp in permissions)


def hash_of(curve: str) -> str:
    """Name of the hash that goes with the keys of a curve."""
    return "sha384" if curve in KEYS_384 else "sha256"


def take_certificate(reader: Reader) -> Certificate:
    """Read the next certificate.

    Raises
    ------
    RejectedFrame
        With the reason `security_encoding`, `security_version`, `security_algorithm` or `security_signer` (no
        explicit certificate with a key and a signature).
    """
    begin = reader.position
    is_signed = reader.accept(SIGNED)
    if not is_signed:
        reader.expect(b"\x00")
    head, _ = reader.take("CertificateHead")
    if head["version"] != VERSION:
        raise RejectedFrame("security_version", head["version"])
    head_bytes = reader.data[begin : reader.position]
    tbs, tbs_bytes = reader.take("ToBeSignedCertificate")
    indicator, key = tbs["verifyKeyIndicator"]
    if head["type"] != "explicit" or indicator != "verificationKey" or not is_signed:
        raise RejectedFrame("security_signer", head["type"])
    signature, signature_bytes = reader.take("Signature")
    if key[0] is None or signature[0] is None or head["issuer"][0] is None:  # behind an extension mark
        raise RejectedFrame("security_algorithm")
    canonical_tbs = _canonical_part("ToBeSignedCertificate", tbs, tbs_bytes, _canonical(tbs))
    x_only = (signature[0], {**signature[1], "rSig": _x_only(signature[1]["rSig"])})
    canonical = head_bytes + canonical_tbs + _canonical_part("Signature", signature, signature_bytes, x_only)
    curve, point = key
    start_s = tbs["validityPeriod"]["start"]
    unit, count = tbs["validityPeriod"]["duration"]
    kind, issuer = head["issuer"]
    return Certificate(
        encoded=reader.data[begin : reader.position],
        canonical=canonical,
        tbs=canonical_tbs,
        digest=hashlib.new(hash_of(curve), canonical).digest()[-DIGEST_BYTES:],
        issuer=None if kind == "self" else issuer,
        name=str(tbs["id"][1]) if tbs["id"][0] == "name" else "",
        start_s=start_s,
        end_s=start_s + count * UNIT_S[unit],
        region=tbs.get("region"),
        permissions=tuple((part["psid"], _ssp(part)) for part in tbs.get("appPermissions", ())),
        grants=tuple(_grant(part) for part in tbs.get("certIssuePermissions", ())),
        curve=curve,
        point=_encoded_point(point),
        signature=signature_of(signature),
    )


def signature_of(value: tuple[str, Record]) -> Signature:
    """Signature that the module has decoded; raises `RejectedFrame` without r."""
    kind, parts = value
    return Signature(kind.removesuffix("Signature"), _x_only(parts["rSig"])[1], parts["sSig"])


def _canonical_part(name: str, record: Any, received: bytes, canonical: Any) -> bytes:
    """Bytes of a canonical form; one in another form and with unknown extensions, which encoding drops, has none."""
    if canonical == record:
        return received
    if encoded(name, record) != received:
        raise RejectedFrame("security_encoding", "no canonical form")
    return encoded(name, canonical)


def _canonical(tbs: Record) -> Record:
    tbs = dict(tbs)
    indicator, (curve, point) = tbs["verifyKeyIndicator"]
    tbs["verifyKeyIndicator"] = indicator, (curve, _compressed(point))
    if encryption := tbs.get("encryptionKey"):
        scheme, point = encryption["publicKey"]
        if scheme is not None:
            tbs["encryptionKey"] = {**encryption, "publicKey": (scheme, _compressed(point))}
    return tbs


def _compressed(point: tuple[str, Any]) -> tuple[str, Any]:
    form, value = point
    if not form.startswith("uncompressed"):
        return point
    return f"compressed-y-{value['y'][-1] & 1}", value["x"]


def _x_only(point: tuple[str, Any]) -> tuple[str, Any]:
    form, value = point
    if form == "fill":
        raise RejectedFrame("security_encoding", "signature without r")
    return "x-only", value["x"] if form.startswith("uncompressed") else value


def _encoded_point(point: tuple[str, Any]) -> bytes:
    form, value = _compressed(point)
    if not form.startswith("compressed-y-"):
        raise RejectedFrame("security_algorithm", f"a key as {form}")
    return bytes([2 + int(form[-1])]) + bytes(value)


def _ssp(permission: Record) -> bytes | None:
    kind, value = permission.get("ssp", (None, None))
    return bytes(value) if kind == "bitmapSsp" else None


def _grant(group: Record) -> Grant:
    kind, parts = group["subjectPermissions"]
    ranges = None if kind == "all" else tuple(_range(part) for part in (parts if kind == "explicit" else ()))
    return Grant(ranges, group["minChainLength"], group["chainLengthRange"])


def _range(part: Record) -> SspRange:
    """Range of SSP; lists of opaque ones, which no service of TS 103 097 has, hold none."""
    kind, value = part.get("sspRange", ("all", None))
    if kind == "all":
        return SspRange(part["psid"])
    if kind == "bitmapSspRange":
        return SspRange(part["psid"], bytes(value["sspValue"]), bytes(value["sspBitmask"]))
    return SspRange(part["psid"], b"", b"no SSP")
