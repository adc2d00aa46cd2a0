"""Certificates and signed packets as a PKI and its stations make them: of simulated traffic, and of tests.

Keys and signatures follow from what they are made of (RFC 6979), so that the same seed gives the same bytes.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import Prehashed, decode_dss_signature

from ...geonetworking import BASIC, BASIC_NEXT_SECURED, VERSION
from ..certificates import CAM_PSID, CRL_PSID, CTL_PSID, Certificate, hash_of, take_certificate
from ..certificates import VERSION as SECURITY_VERSION
from ..envelope import DIGEST, ONE_CERTIFICATE, SIGNED_DATA
from ..reader import Reader, Record, encoded
from ..signatures import CURVES, NO_SIGNER, signed_hash

HASHES: dict[str, hashes.HashAlgorithm] = {"sha256": hashes.SHA256(), "sha384": hashes.SHA384()}
NAMES = {curve.name: name for name, curve in CURVES.items()}
CAM_SSP = bytes.fromhex("010000")  # version 1, no special container
ANY_CAM_SSP = {"sspValue": bytes.fromhex("01ffff"), "sspBitmask": bytes.fromhex("ff0000")}


@dataclass(frozen=True)
class Holder:
    """A certificate and its key."""

    key: ec.EllipticCurvePrivateKey
    certificate: Certificate

    def signature(self, data: bytes) -> bytes:
        """Signature of data, encoded."""
        return _signature(self.key, data, self.certificate.canonical)


def key_of(seed: bytes, curve: str = "ecdsaNistP256") -> ec.EllipticCurvePrivateKey:
    """Private key that follows from a seed: whoever knows the seed has it."""
    number = int.from_bytes(hashlib.sha512(seed).digest()[: CURVES[curve].key_size // 8 - 1]) + 1
    return ec.derive_private_key(number, CURVES[curve])


def issue(key: ec.EllipticCurvePrivateKey, tbs: Mapping[str, object], issuer: Holder | None = None) -> Holder:
    """Issue a certificate for a key.

    Parameters
    ----------
    key : private key
        Of the holder.
    tbs : mapping
        Members of ToBeSignedCertificate without the key; those that every certificate of TS 103 097 has alike may be
        left out.
    issuer : Holder or None
        Who signs it; None: it signs itself.
    """
    name = NAMES[key.curve.name]
    numbers = key.public_key().public_numbers()
    point = f"compressed-y-{numbers.y & 1}", numbers.x.to_bytes(key.curve.key_size // 8)
    common = {"id": ("none", None), "cracaId": bytes(3), "crlSeries": 0}
    body = encoded("ToBeSignedCertificate", {**common, **tbs, "verifyKeyIndicator": ("verificationKey", (name, point))})
    named: tuple[str, object] = "self", hash_of(name)
    if issuer is not None:
        named = f"{issuer.certificate.hash_name}AndDigest", issuer.certificate.digest
    signature = issuer.signature(body) if issuer else _signature(key, body, NO_SIGNER)
    head = encoded("CertificateHead", {"version": SECURITY_VERSION, "type": "explicit", "issuer": named})
    return Holder(key, take_certificate(Reader(b"\x80" + head + body + signature)))


def root_tbs(name: str, start_s: int, years: int) -> Record:
    """Members of a root's certificate: it may issue authorities of tickets for CAM, and sign lists."""
    return {
        "id": ("name", name),
        "validityPeriod": validity(start_s, years=years),
        "appPermissions": permissions({CRL_PSID: b"\x01", CTL_PSID: b"\x01\x38"}),
        "certIssuePermissions": [may_issue_cam(chain_length=2)],
    }


def authority_tbs(name: str, start_s: int, years: int) -> Record:
    """Members of the certificate of an authority that issues tickets for CAM."""
    return {
        "id": ("name", name),
        "validityPeriod": validity(start_s, years=years),
        "certIssuePermissions": [may_issue_cam(chain_length=1)],
    }


def ticket_tbs(start_s: int, hours: int, ssp: bytes = CAM_SSP) -> Record:
    """Members of a ticket for CAM (TS 103 097, 7.2.1)."""
    return {"validityPeriod": validity(start_s, hours=hours), "appPermissions": permissions({CAM_PSID: ssp})}


def validity(start_s: int, **duration: int) -> Record:
    """Period from an ITS time [s] on, of a duration such as hours=168."""
    ((unit, count),) = duration.items()
    return {"start": start_s, "duration": (unit, count)}


def permissions(ssps: Mapping[int, bytes]) -> list[Record]:
    """Permissions of services, each with its bitmap."""
    return [{"psid": psid, "ssp": ("bitmapSsp", ssp)} for psid, ssp in ssps.items()]


def may_issue_cam(chain_length: int) -> Record:
    """Permission to issue certificates for CAM with every SSP."""
    return {
        "subjectPermissions": ("explicit", [{"psid": CAM_PSID, "sspRange": ("bitmapSspRange", ANY_CAM_SSP)}]),
        "minChainLength": chain_length,
    }


def sign_packet(packet: bytes, holder: Holder, time_us: int, *, with_certificate: bool) -> bytes:
    """Sign an unsecured packet with a CAM at an ITS time [us]."""
    header = {"psid": CAM_PSID, "generationTime": time_us}
    secured = sign_data(packet[BASIC.size :], holder, header, with_certificate=with_certificate)
    return bytes([VERSION << 4 | BASIC_NEXT_SECURED]) + packet[1 : BASIC.size] + secured


def sign_data(content: bytes, holder: Holder, header: Mapping[str, object], *, with_certificate: bool = False) -> bytes:
    """Make signed data of any content and HeaderInfo."""
    data = {"protocolVersion": SECURITY_VERSION, "content": ("unsecuredData", content)}
    tbs_data = encoded("ToBeSignedData", {"payload": {"data": data}, "headerInfo": dict(header)})
    certificate = holder.certificate
    signer = ONE_CERTIFICATE + certificate.encoded if with_certificate else DIGEST + certificate.digest
    start = bytes([SECURITY_VERSION, SIGNED_DATA]) + encoded("HashAlgorithm", certificate.hash_name)
    return start + tbs_data + signer + holder.signature(tbs_data)


def revocation_list(root: Holder, issued_s: int, until_s: int, revoked: Sequence[bytes] = ()) -> bytes:
    """List of what a root has revoked, signed by it (TS 102 941)."""
    times = {"version": 1, "thisUpdate": issued_s, "nextUpdate": until_s}
    content = b"\x01\x84" + encoded("RevocationList", {**times, "entries": list(revoked)})
    return sign_data(content, root, {"psid": CRL_PSID, "generationTime": issued_s * 1_000_000})


def _signature(key: ec.EllipticCurvePrivateKey, data: bytes, signer: bytes) -> bytes:
    name = NAMES[key.curve.name]
    algorithm = ec.ECDSA(Prehashed(HASHES[hash_of(name)]), deterministic_signing=True)
    r, s = decode_dss_signature(key.sign(signed_hash(data, signer, hash_of(name)), algorithm))
    size = key.curve.key_size // 8
    parts = {"rSig": ("x-only", r.to_bytes(size)), "sSig": s.to_bytes(size)}
    return encoded("Signature", (f"{name}Signature", parts))
