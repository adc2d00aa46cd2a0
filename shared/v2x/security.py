"""Secured GeoNetworking packets (EN 302 636-4-1, TS 103 097, IEEE 1609.2): what a signed packet states, and its bytes.

Signatures, certificate chains, permissions and validity are not checked here: whatever this module returns is signed,
not verified. Layout of a secured packet, in OER: basic header 4 bytes, version of the security protocol 1, tag of
`signedData` 1, hash algorithm 1, ToBeSignedData, signer, signature. The content of ToBeSignedData is what follows the
basic header in an unsecured packet.
"""

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import asn1tools
from asn1tools.codecs.oer import Decoder
from asn1tools.compiler import Specification
from asn1tools.errors import Error

from ..errors import RejectedFrame
from ..faults import FOREIGN
from ..messages.v2x import MAX_FRAME_BYTES, Authentication
from .geonetworking import BASIC, BASIC_NEXT_COMMON, BASIC_NEXT_SECURED, VERSION

Record = dict[str, Any]  # a SEQUENCE as asn1tools represents it

SECURITY_VERSION = 3  # of Ieee1609Dot2Data and of certificates
SIGNED_DATA = 0x81  # tag of the content; 0x80 unsecured, 0x82 encrypted, 0x83 certificate request
DIGEST, ONE_CERTIFICATE = b"\x80", b"\x81\x01\x01"  # signer: HashedId8, or a list of one certificate (TS 103 097)
CAM_PSID = 36
DIGEST_BYTES = 8  # of a HashedId8: the last bytes of the hash
US_PER_MS = 1_000
HASHES = ("sha256", "sha384")
KEYS_384 = frozenset({"ecdsaBrainpoolP384r1", "ecdsaNistP384"})  # certificates of these keys are hashed by SHA-384


@dataclass(frozen=True)
class Certificate:
    """Certificate that a packet carries."""

    encoded: bytes  # as received
    digest: bytes  # HashedId8 of its canonical form
    ssp: bytes | None  # service-specific permissions for CAM; None: it has no permission for CAM, or no SSP with it


@dataclass(frozen=True)
class SignedPacket:
    """What a signed packet states; its signature is not verified."""

    packet: bytes  # without the security envelope: basic header and what was signed
    tbs_data: bytes  # ToBeSignedData as received, for its hash
    psid: int
    generation_time_us: int  # Time64: TAI since 2004-01-01 00:00 UTC, as ITS time
    signer: bytes  # HashedId8 of the signer's certificate
    certificate: Certificate | None  # None: the packet has only the digest of its signer's certificate

    @property
    def generation_time_ms(self) -> int:
        """ITS time [ms] at which the packet was signed, rounded down."""
        return self.generation_time_us // US_PER_MS


@cache
def specification() -> Specification:
    """Compile the ASN.1 module, once a process."""
    return asn1tools.compile_files(str(Path(__file__).with_name("security.asn")), "oer")


def without_envelope(packet: bytes) -> tuple[bytes, SignedPacket | None]:
    """Return a packet without its security envelope, and what the envelope states; None for an unsecured packet.

    Raises
    ------
    RejectedFrame
        As `unwrap`.
    """
    if packet[:1] != bytes([VERSION << 4 | BASIC_NEXT_SECURED]):
        return packet, None
    signed = unwrap(packet)
    return signed.packet, signed


def provenance(signed: SignedPacket | None) -> Record:
    """Keyword arguments of `Cam` that say how far its sender is known."""
    if signed is None:
        return {"authentication": Authentication.UNSIGNED, "signer": None}
    return {"authentication": Authentication.SIGNED_NOT_VERIFIED, "signer": signed.signer.hex()}


def unwrap(packet: bytes) -> SignedPacket:
    """Unwrap a secured packet with a CAM; bytes behind the signature are ignored.

    Raises
    ------
    RejectedFrame
        With the reason `frame_length`, `truncated`, `security_version`, `security_content` (encrypted, or not signed
        data with a payload), `security_encoding`, `security_algorithm`, `security_signer` (neither a digest nor one
        explicit certificate), `security_psid` (no CAM) or `generation_time` (absent).
    """
    if len(packet) > MAX_FRAME_BYTES:
        raise RejectedFrame("frame_length", len(packet))
    if len(packet) < BASIC.size + 3:
        raise RejectedFrame("truncated", len(packet))
    version, content = packet[BASIC.size], packet[BASIC.size + 1]
    if version != SECURITY_VERSION:
        raise RejectedFrame("security_version", version)
    if content != SIGNED_DATA:
        raise RejectedFrame("security_content", hex(content))
    reader = _Reader(packet, BASIC.size + 2)
    hash_algorithm, _ = reader.take("HashAlgorithm")
    tbs, tbs_data = reader.take("ToBeSignedData")
    signer, certificate = _signer(reader)
    (signature, _), _ = reader.take("Signature")
    if hash_algorithm not in HASHES or signature is None:
        raise RejectedFrame("security_algorithm")
    header, inner = tbs["headerInfo"], _content(tbs["payload"])
    if header["psid"] != CAM_PSID:
        raise RejectedFrame("security_psid", header["psid"])
    if "generationTime" not in header:
        raise RejectedFrame("generation_time", "absent")
    return SignedPacket(
        packet=bytes([VERSION << 4 | BASIC_NEXT_COMMON]) + packet[1 : BASIC.size] + inner,
        tbs_data=tbs_data,
        psid=header["psid"],
        generation_time_us=header["generationTime"],
        signer=signer,
        certificate=certificate,
    )


class _Reader:
    """Decodes the parts of a packet one after the other, each with its bytes as received."""

    def __init__(self, packet: bytes, position: int) -> None:
        self._packet = packet
        self._decoder = Decoder(bytearray(packet))
        self._decoder.skip_bits(8 * position)

    @property
    def position(self) -> int:
        """Number of bytes that are read."""
        return int(self._decoder.number_of_read_bits()) // 8

    def take(self, name: str) -> tuple[Any, bytes]:
        """Decode the next part, of a named type."""
        compiled, begin = specification().types[name], self.position
        try:
            record = compiled.type.decode(self._decoder)
            compiled.check_constraints(record)
        except (Error, *FOREIGN) as error:
            raise RejectedFrame("security_encoding", error) from error
        return record, self._packet[begin : self.position]

    def accept(self, expected: bytes) -> bool:
        """Skip bytes if they are the next ones."""
        is_next = self._packet.startswith(expected, self.position)
        if is_next:
            self._decoder.skip_bits(8 * len(expected))
        return is_next


def _content(payload: Record) -> bytes:
    data = payload.get("data")
    if data is None:
        raise RejectedFrame("security_content", "no payload")
    if data["protocolVersion"] != SECURITY_VERSION:
        raise RejectedFrame("security_version", data["protocolVersion"])
    content: bytes = data["content"][1]
    return content


def _signer(reader: _Reader) -> tuple[bytes, Certificate | None]:
    if reader.accept(DIGEST):
        digest: bytes = reader.take("HashedId8")[0]
        return digest, None
    if not reader.accept(ONE_CERTIFICATE):
        raise RejectedFrame("security_signer")
    record, encoded = reader.take("Certificate")
    if record["version"] != SECURITY_VERSION:
        raise RejectedFrame("security_version", record["version"])
    indicator, key = record["toBeSigned"]["verifyKeyIndicator"]
    if record["type"] != "explicit" or indicator != "verificationKey" or "signature" not in record:
        raise RejectedFrame("security_signer", record["type"])
    if key[0] is None or record["signature"][0] is None:  # alternatives behind an extension mark
        raise RejectedFrame("security_algorithm")
    certificate = Certificate(encoded, _hashed_id_8(record, encoded), _cam_permissions(record["toBeSigned"]))
    return certificate.digest, certificate


def _hashed_id_8(record: Record, encoded: bytes) -> bytes:
    """HashedId8 of a certificate: keys are compressed and r is x-only in the form that is hashed (IEEE 1609.2, 6.4.3).

    A certificate in another form is encoded as that, which its unknown extensions prevent: it is rejected then.
    """
    algorithm = hashlib.sha384 if record["toBeSigned"]["verifyKeyIndicator"][1][0] in KEYS_384 else hashlib.sha256
    canonical = _canonical(record)
    if canonical != record:
        if _encoded(record) != encoded:
            raise RejectedFrame("security_encoding", "no canonical form")
        encoded = _encoded(canonical)
    return algorithm(encoded).digest()[-DIGEST_BYTES:]


def _encoded(record: Record) -> bytes:
    try:
        return bytes(specification().encode("Certificate", record))
    except (Error, *FOREIGN) as error:
        raise RejectedFrame("security_encoding", error) from error


def _canonical(record: Record) -> Record:
    tbs = dict(record["toBeSigned"])
    indicator, (curve, point) = tbs["verifyKeyIndicator"]
    tbs["verifyKeyIndicator"] = indicator, (curve, _compressed(point))
    if encryption := tbs.get("encryptionKey"):
        scheme, point = encryption["publicKey"]
        if scheme is not None:
            tbs["encryptionKey"] = {**encryption, "publicKey": (scheme, _compressed(point))}
    kind, signature = record["signature"]
    return {**record, "toBeSigned": tbs, "signature": (kind, {**signature, "rSig": _x_only(signature["rSig"])})}


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


def _cam_permissions(tbs: Record) -> bytes | None:
    for permission in tbs.get("appPermissions", ()):
        if permission["psid"] == CAM_PSID and "ssp" in permission:
            ssp: bytes | None = permission["ssp"][1]
            return ssp
    return None
