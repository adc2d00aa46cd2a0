"""Secured GeoNetworking packets (EN 302 636-4-1, TS 103 097, IEEE 1609.2): what a signed packet states, and its bytes.

Signatures, certificate chains, permissions and validity are not checked here: whatever this module returns is signed,
not verified. Layout of a secured packet, in OER: basic header 4 bytes, version of the security protocol 1, tag of
`signedData` 1, hash algorithm 1, ToBeSignedData, signer, signature. The content of ToBeSignedData is what follows the
basic header in an unsecured packet.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from ...errors import RejectedFrame
from ...faults import FOREIGN
from ...messages.v2x import MAX_FRAME_BYTES
from ..geonetworking import BASIC, BASIC_NEXT_COMMON, BASIC_NEXT_SECURED, VERSION
from .certificates import CAM_PSID, Certificate, Signature, hash_of, signature_of, take_certificate
from .certificates import VERSION as SECURITY_VERSION
from .reader import ENCODING, Reader, Record

SIGNED_DATA = 0x81  # tag of the content; 0x80 unsecured, 0x82 encrypted, 0x83 certificate request
DIGEST, ONE_CERTIFICATE = b"\x80", b"\x81\x01\x01"  # signer: HashedId8, or a list of one certificate (TS 103 097)
US_PER_MS, US_PER_S = 1_000, 1_000_000
HASHES = ("sha256", "sha384")
# Members of HeaderInfo that the profile of the CAM excludes (TS 103 097, 7.1.1).
NOT_IN_CAM = ("expiryTime", "generationLocation", "p2pcdLearningRequest", "missingCrlIdentifier", "encryptionKey")

Take = Callable[[Reader], Certificate]


@dataclass(frozen=True)
class SignedData:
    """Parts of signed data; nothing is verified."""

    header: Record  # HeaderInfo
    content: bytes  # what is signed
    tbs_data: bytes  # ToBeSignedData as received, for its hash
    signer: bytes  # HashedId8 of the signer's certificate
    certificate: Certificate | None  # None: only the digest of its signer's certificate is there
    signature: Signature
    end: int = 0  # [bytes] position behind the signature

    @property
    def digest(self) -> bytes:
        """SHA-256 of what is signed and by whom: neither a hop limit nor another form of the signature changes it."""
        return hashlib.sha256(self.signer + self.tbs_data).digest()


@dataclass(frozen=True)
class SignedPacket:
    """What a signed packet with a CAM states; its signature is not verified."""

    packet: bytes  # without the security envelope: basic header and what was signed
    data: SignedData

    @property
    def signer(self) -> bytes:
        """HashedId8 of the signer's certificate."""
        return self.data.signer

    @property
    def certificate(self) -> Certificate | None:
        """Certificate of the signer; None: the packet has only its digest."""
        return self.data.certificate

    @property
    def generation_time_us(self) -> int:
        """Time64 of the signature: TAI since 2004-01-01 00:00 UTC, as ITS time."""
        return int(self.data.header["generationTime"])

    @property
    def generation_time_ms(self) -> int:
        """ITS time [ms] at which the packet was signed, rounded down."""
        return self.generation_time_us // US_PER_MS

    @property
    def generation_time_s(self) -> float:
        """ITS time [s] at which the packet was signed."""
        return self.generation_time_us / US_PER_S


def without_envelope(packet: bytes, take: Take = take_certificate) -> tuple[bytes, SignedPacket | None]:
    """Return a packet without its security envelope, and what the envelope states; None for an unsecured packet.

    Raises
    ------
    RejectedFrame
        As `unwrap`.
    """
    if packet[:1] != bytes([VERSION << 4 | BASIC_NEXT_SECURED]):
        return packet, None
    signed = unwrap(packet, take)
    return signed.packet, signed


def unwrap(packet: bytes, take: Take = take_certificate) -> SignedPacket:
    """Unwrap a secured packet with a CAM; bytes behind the signature are ignored.

    `take` reads a certificate, for a caller that knows some already.

    Raises
    ------
    RejectedFrame
        With the reason `frame_length`, `truncated`, `security_psid` (no CAM), `generation_time` (absent),
        `security_header` (a member that the profile of the CAM excludes), or as `read_signed`.
    """
    if len(packet) > MAX_FRAME_BYTES:
        raise RejectedFrame("frame_length", len(packet))
    try:
        data = read_signed(packet, BASIC.size, take)
    except FOREIGN as error:  # bytes of a stranger: whatever they lead to is a reject, not a fault of this program
        raise RejectedFrame(ENCODING, error) from error
    if data.header["psid"] != CAM_PSID:
        raise RejectedFrame("security_psid", data.header["psid"])
    if "generationTime" not in data.header:
        raise RejectedFrame("generation_time", "absent")
    if excluded := [name for name in NOT_IN_CAM if name in data.header]:
        raise RejectedFrame("security_header", excluded[0])
    return SignedPacket(bytes([VERSION << 4 | BASIC_NEXT_COMMON]) + packet[1 : BASIC.size] + data.content, data)


def read_signed(data: bytes, position: int = 0, take: Take = take_certificate) -> SignedData:
    """Read signed data of any service.

    Raises
    ------
    RejectedFrame
        With the reason `truncated`, `security_version`, `security_content` (encrypted, or not signed data with a
        payload), `security_encoding`, `security_algorithm` or `security_signer` (neither a digest nor one explicit
        certificate).
    """
    if len(data) < position + 3:
        raise RejectedFrame("truncated", len(data))
    version, content = data[position], data[position + 1]
    if version != SECURITY_VERSION:
        raise RejectedFrame("security_version", version)
    if content != SIGNED_DATA:
        raise RejectedFrame("security_content", hex(content))
    reader = Reader(data, position + 2)
    hash_algorithm, _ = reader.take("HashAlgorithm")
    tbs, tbs_data = reader.take("ToBeSignedData")
    signer, certificate = _signer(reader, take)
    kind, parts = reader.take("Signature")[0]
    if hash_algorithm not in HASHES or kind is None:
        raise RejectedFrame("security_algorithm")
    signature = signature_of((kind, parts))
    if hash_algorithm != hash_of(signature.curve):
        raise RejectedFrame("security_algorithm", hash_algorithm)
    return SignedData(
        header=tbs["headerInfo"],
        content=_content(tbs["payload"]),
        tbs_data=tbs_data,
        signer=signer,
        certificate=certificate,
        signature=signature,
        end=reader.position,
    )


def _content(payload: Record) -> bytes:
    data = payload.get("data")
    if data is None:
        raise RejectedFrame("security_content", "no payload")
    if data["protocolVersion"] != SECURITY_VERSION:
        raise RejectedFrame("security_version", data["protocolVersion"])
    content: bytes = data["content"][1]
    return content


def _signer(reader: Reader, take: Take) -> tuple[bytes, Certificate | None]:
    if reader.accept(DIGEST):
        digest: bytes = reader.take("HashedId8")[0]
        return digest, None
    if not reader.accept(ONE_CERTIFICATE):
        raise RejectedFrame("security_signer")
    certificate = take(reader)
    return certificate.digest, certificate
