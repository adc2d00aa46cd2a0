"""Signed packets: those of a test PKI, and those that stations have sent."""

import hashlib
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import RejectedFrame
from shared.messages.toll import EvidenceFrame
from shared.messages.v2x import MAX_FRAME_BYTES, Authentication
from shared.v2x import cam, geonetworking
from shared.v2x.evidence import cam_of, message_digest, replay_digest
from shared.v2x.security import envelope, signatures
from shared.v2x.security.certificates import Certificate, take_certificate
from shared.v2x.security.reader import Reader, encoded
from tests.support.cases import each
from tests.support.data import recording
from tests.support.gnss.captures import dissect, packets
from tests.support.patience import HANGS_S
from tests.support.v2x import cams
from tests.support.v2x.signing import CURVES, SSP, Ticket, dss_signature, signed

TIME_MS = 649_421_182_620
PLAIN = cams.packet(cams.BRAKING, TIME_MS)
TICKET = Ticket()
SIGNED = signed(PLAIN, TICKET, TIME_MS)
SIGNATURE = 64  # bytes of r and s at the end of a packet that P-256 signs


def reason_of(packet: bytes) -> str:
    with pytest.raises(RejectedFrame) as rejected:
        envelope.unwrap(packet)
    return rejected.value.reason


def field_frames() -> list[bytes]:
    return [packet for _, packet in packets(recording("cam_secured/field_secured_cam.pcapng"))]


def stack_frame() -> bytes:
    """The frame of a test stack: the only record of a pcap file, behind 24 + 16 bytes and an Ethernet header."""
    return (recording("cam_secured/vanetza_cam_v3.pcap")).read_bytes()[40 + 14 :]


def certificate_of(encoded_certificate: bytes) -> Certificate:
    return take_certificate(Reader(encoded_certificate))


def is_signed(found: envelope.SignedPacket, certificate: Certificate) -> bool:
    return signatures.is_signed_by(certificate, found.data.tbs_data, found.data.signature)


@pytest.mark.parametrize("with_certificate", [True, False])
def test_a_signed_packet_is_the_packet_that_was_signed(with_certificate: bool) -> None:
    found = envelope.unwrap(signed(PLAIN, TICKET, TIME_MS, with_certificate=with_certificate))
    assert found.packet == PLAIN
    assert (found.generation_time_us, found.generation_time_ms) == (TIME_MS * 1000 + 7, TIME_MS)
    assert found.data.header["psid"] == 36
    assert found.signer == TICKET.digest
    if with_certificate:
        assert found.certificate is not None
        assert (found.certificate.encoded, found.certificate.digest) == (TICKET.certificate, TICKET.digest)
        assert found.certificate.ssp == SSP
    else:
        assert found.certificate is None


def test_the_bytes_as_received_are_those_that_the_signature_covers() -> None:
    certificate = certificate_of(TICKET.certificate)
    assert is_signed(envelope.unwrap(SIGNED), certificate)
    assert not is_signed(envelope.unwrap(SIGNED[:40] + b"\x01" + SIGNED[41:]), certificate)
    assert not is_signed(envelope.unwrap(SIGNED), certificate_of(Ticket().certificate))


def test_neither_a_hop_limit_nor_another_form_of_the_signature_makes_another_message() -> None:
    found = envelope.unwrap(SIGNED)
    order = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
    negated = SIGNED[:3] + bytes([SIGNED[3] + 5]) + SIGNED[4:-32] + (order - int.from_bytes(SIGNED[-32:])).to_bytes(32)
    other = envelope.unwrap(negated)
    assert is_signed(other, certificate_of(TICKET.certificate))
    assert (other.data.digest, message_digest(negated)) == (found.data.digest, message_digest(SIGNED))
    assert message_digest(SIGNED) != message_digest(signed(PLAIN, Ticket(), TIME_MS))
    assert message_digest(PLAIN) != message_digest(PLAIN[:3] + b"\x05" + PLAIN[4:])
    assert replay_digest(PLAIN) == replay_digest(PLAIN[:3] + b"\x05" + PLAIN[4:])


@pytest.mark.parametrize("curve", [ec.SECP256R1(), ec.BrainpoolP256R1(), ec.SECP384R1(), ec.BrainpoolP384R1()])
@pytest.mark.parametrize("uncompressed", [False, True])
def test_the_digest_is_that_of_the_canonical_certificate(curve: ec.EllipticCurve, uncompressed: bool) -> None:
    ticket = Ticket(ec.generate_private_key(curve), uncompressed=uncompressed)
    found = envelope.unwrap(signed(PLAIN, ticket, TIME_MS))
    assert found.certificate is not None and found.certificate.encoded == ticket.certificate
    assert found.signer == ticket.digest
    algorithm = CURVES[curve.name][3].name
    is_digest_of_received = hashlib.new(algorithm, ticket.certificate).digest()[-8:] == found.signer
    assert is_digest_of_received is not uncompressed


def test_an_unsecured_packet_has_no_envelope() -> None:
    assert envelope.without_envelope(PLAIN) == (PLAIN, None)
    assert envelope.without_envelope(b"") == (b"", None)
    packet, found = envelope.without_envelope(SIGNED)
    assert found is not None and packet == found.packet == PLAIN


def test_extensions_that_are_not_known_are_skipped() -> None:
    """Two additions behind the extension mark of HeaderInfo, of three bytes each."""
    plain = envelope.unwrap(SIGNED).data.tbs_data
    at = SIGNED.index(plain)
    preamble = plain.index(bytes([0x40, 0x01, 36]))  # of HeaderInfo: only generationTime; then the psid
    additions = bytes.fromhex("0206c0 03010203 03040506")
    extended = plain[:preamble] + b"\xc0" + plain[preamble + 1 :] + additions
    found = envelope.unwrap(SIGNED[:at] + extended + SIGNED[at + len(plain) :])
    assert found.data.tbs_data == extended
    assert (found.packet, found.signer) == (PLAIN, TICKET.digest)


LOCATION = {"latitude": 1, "longitude": 2, "elevation": 3}


def changed(place: int, value: int) -> bytes:
    return SIGNED[:place] + bytes([value]) + SIGNED[place + 1 :]


@each(
    ("packet", "reason"),
    [
        (SIGNED[:6], "truncated"),
        (SIGNED[:-1], "security_encoding"),
        (SIGNED[:100], "security_encoding"),
        (SIGNED + bytes(MAX_FRAME_BYTES), "frame_length"),
        (changed(4, 2), "security_version"),
        (changed(5, 0x80), "security_content"),  # unsecured
        (changed(5, 0x82), "security_content"),  # encrypted
        (changed(6, 0x07), "security_algorithm"),
        (changed(8, 2), "security_version"),  # of what is signed
        (SIGNED[: -SIGNATURE - 2] + b"\x8f\x42" + SIGNED[-SIGNATURE - 2 :], "security_algorithm"),
        (signed(PLAIN, TICKET, TIME_MS, header={"psid": 37}), "security_psid"),
        (signed(PLAIN, TICKET, TIME_MS, header={"generationTime": None}), "generation_time"),
        (signed(PLAIN, TICKET, TIME_MS, header={"expiryTime": 1}), "security_header"),
        (signed(PLAIN, TICKET, TIME_MS, header={"generationLocation": LOCATION}), "security_header"),
    ],
)  # fmt: skip
def test_other_secured_packets_are_rejected_with_their_reason(packet: bytes, reason: str) -> None:
    assert reason_of(packet) == reason


def test_a_hash_that_is_not_that_of_the_key_is_no_algorithm() -> None:
    assert reason_of(SIGNED[:6] + b"\x01" + SIGNED[7:]) == "security_algorithm"


def test_a_payload_that_is_only_a_hash_is_no_content() -> None:
    payload = encoded("SignedDataPayload", {"extDataHash": ("sha256HashedData", bytes(32))})
    inner = payload + encoded("HeaderInfo", {"psid": 36, "generationTime": 1})
    tbs_data = envelope.unwrap(SIGNED).data.tbs_data
    at = SIGNED.index(tbs_data)
    assert reason_of(SIGNED[:at] + inner + SIGNED[at + len(tbs_data) :]) == "security_content"


@pytest.mark.parametrize("signer", ["82", "810100", "810102", "83"])
def test_a_signer_is_a_digest_or_one_certificate(signer: str) -> None:
    tbs_data = envelope.unwrap(SIGNED).data.tbs_data
    head = SIGNED[: SIGNED.index(tbs_data) + len(tbs_data)]
    assert reason_of(head + bytes.fromhex(signer) + 2 * TICKET.certificate + bytes(70)) == "security_signer"


IMPLICIT: dict[str, Any] = {"verifyKeyIndicator": ("reconstructionValue", ("compressed-y-0", bytes(32)))}


def test_an_implicit_certificate_is_no_signer() -> None:
    assert reason_of(signed(PLAIN, Ticket(extra=IMPLICIT), TIME_MS)) == "security_signer"


def test_unknown_alternatives_of_a_certificate_are_rejected_or_skipped() -> None:
    """Behind an extension mark they are a tag and a length, as written here in place of a known one."""
    point = bytes([0xAA]) * 33
    encryption = {"supportedSymmAlg": "aes128Ccm", "publicKey": ("eciesNistP256", ("compressed-y-1", point[1:]))}
    ticket = Ticket(extra={"encryptionKey": encryption})
    packet = signed(PLAIN, ticket, TIME_MS)
    other = packet.replace(b"\x80\x83" + point[1:], b"\x8f\x21" + point)
    found = envelope.unwrap(other)
    assert found.certificate is not None
    assert found.signer == hashlib.sha256(found.certificate.encoded).digest()[-8:] != ticket.digest
    point = certificate_of(ticket.certificate).point
    tag, x = bytes([0x80 + point[0]]), point[1:]
    assert packet.count(b"\x80\x80" + tag + x) == 1
    assert reason_of(packet.replace(b"\x80\x80" + tag + x, b"\x80\x8f\x21" + tag + x)) == "security_algorithm"


def test_a_certificate_that_is_not_canonical_and_extended_has_no_known_digest() -> None:
    encryption = {
        "supportedSymmAlg": "aes128Ccm",
        "publicKey": ("eciesNistP256", ("compressed-y-1", bytes([0xAA]) * 32)),
    }
    packet = signed(PLAIN, Ticket(uncompressed=True, extra={"encryptionKey": encryption}), TIME_MS)
    assert envelope.unwrap(packet)
    other = packet.replace(b"\x80\x83" + bytes([0xAA]) * 32, b"\x8f\x21" + bytes([0xAA]) * 33)
    assert reason_of(other) == "security_encoding"


def test_a_ticket_without_permission_for_cam_has_no_ssp() -> None:
    found = envelope.unwrap(signed(PLAIN, Ticket(psid=99), TIME_MS))
    assert found.certificate is not None and found.certificate.ssp is None


REGIONS = [
    ("circularRegion", {"center": {"latitude": 494431234, "longitude": -10993217}, "radius": 500}),
    ("rectangularRegion", [{"northWest": {"latitude": 1, "longitude": 2}, "southEast": {"latitude": 0, "longitude": 3}}
    ]),
    ("polygonalRegion", [{"latitude": k, "longitude": -k} for k in range(3)]),
    ("identifiedRegion", [("countryOnly", 276), ("countryAndRegions", {"countryOnly": 250, "regions": [1, 2]})]),
]  # fmt: skip


@pytest.mark.parametrize("region", REGIONS, ids=lambda region: region[0])
def test_tickets_with_every_other_member_are_read(region: object, tmp_path: Path) -> None:
    ticket = Ticket(
        extra={
            "id": ("name", "Testfahrzeug"),
            "region": region,
            "assuranceLevel": b"\x80",
            "canRequestRollover": None,
            "encryptionKey": {
                "supportedSymmAlg": "aes128Ccm",
                "publicKey": ("eciesNistP256", ("compressed-y-1", bytes(range(32)))),
            },
        }
    )
    packet = signed(PLAIN, ticket, TIME_MS)
    found = envelope.unwrap(packet)
    assert found.certificate is not None and found.signer == ticket.digest
    (seen,) = dissect([packet], tmp_path)
    assert not seen.malformed
    assert seen.all("ieee1609dot2.region") == [str([kind for kind, _ in REGIONS].index(region[0]))]  # type: ignore[index]
    assert seen.number("its.stationID") == cams.BRAKING.station_id


def test_evidence_decodes_a_signed_frame_to_the_same_cam() -> None:
    found = Authentication.SIGNED_NOT_VERIFIED
    plain, from_signed = (
        cam_of(EvidenceFrame(sampled_ns=1, received_ns=2, data=data, authentication=found)) for data in (PLAIN, SIGNED)
    )
    assert plain.authentication is Authentication.UNSIGNED and plain.signer is None
    assert from_signed.authentication is Authentication.SIGNED_NOT_VERIFIED
    assert from_signed.signer == TICKET.digest.hex()
    provenance = {"authentication": plain.authentication, "signer": None, "frame": PLAIN}
    assert from_signed.model_copy(update=provenance) == plain


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300), st.integers(4, len(SIGNED)))
def test_random_bytes_behind_a_valid_start_are_unwrapped_or_rejected(tail: bytes, keep: int) -> None:
    try:
        assert len(envelope.unwrap(SIGNED[:keep] + tail).packet) < keep + len(tail)
    except RejectedFrame as error:
        assert error.reason


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(4, len(SIGNED) - 1), st.integers(0, 255)), min_size=1, max_size=6))
def test_damaged_packets_are_unwrapped_or_rejected(damage: list[tuple[int, int]]) -> None:
    damaged = bytearray(SIGNED)
    for place, value in damage:
        damaged[place] = value
    try:
        assert envelope.unwrap(bytes(damaged)).data.tbs_data in bytes(damaged)
    except RejectedFrame as error:
        assert error.reason


@pytest.mark.recording
def test_the_nine_field_frames_are_unwrapped_and_their_signatures_are_of_the_bytes_read() -> None:
    frames = field_frames()
    found = [envelope.unwrap(packet) for packet in frames]
    assert [signed_packet.certificate is not None for signed_packet in found] == [k in (0, 5) for k in range(9)]
    (certificate,) = {replace(packet.certificate, region=None) for packet in found if packet.certificate}
    assert certificate.ssp == bytes.fromhex("010000")
    for signed_packet in found:
        content, delta_time = cam.decode(geonetworking.decode_payload(signed_packet.packet))
        # This maker's station ID is the end of the digest, which frames with and without certificate agree on.
        assert content["station_id"].to_bytes(4, "big") == signed_packet.signer[-4:] == certificate.digest[-4:]
        assert 50 <= (signed_packet.generation_time_ms - delta_time) % 65_536 <= 100
        assert is_signed(signed_packet, certificate)
        changed_data = bytes([signed_packet.data.tbs_data[0]]) + bytes(1) + signed_packet.data.tbs_data[2:]
        assert not signatures.is_signed_by(certificate, changed_data, signed_packet.data.signature)


def openssl_says(public_key: bytes, signature: bytes, data: bytes, folder: Path) -> str:
    """Verdict of the program `openssl` on a signature of data that it hashes itself with SHA-256."""
    for name, content in (("key.der", public_key), ("signature.der", signature), ("data", data)):
        (folder / name).write_bytes(content)
    command = ["openssl", "dgst", "-sha256", "-keyform", "DER", "-verify", "key.der", "-signature", "signature.der"]
    done = subprocess.run([*command, "data"], cwd=folder, capture_output=True, text=True, timeout=HANGS_S, check=False)
    return done.stdout.strip()


# SubjectPublicKeyInfo of a P-256 key that is compressed (RFC 5480), before its 33 bytes.
P256_INFO = bytes.fromhex("3039301306072a8648ce3d020106082a8648ce3d030107032200")


@pytest.mark.recording
def test_openssl_agrees_on_the_signatures_of_the_field_frames_cut_where_tshark_finds_the_parts(tmp_path: Path) -> None:
    """Nothing of ours: bytes at tshark's offsets, hashes and signature by a program of others."""
    frames = field_frames()
    cut = dissect(frames, tmp_path, with_bytes=True)
    certificate, *_ = cut[0].cut("ieee1609dot2.Certificate_element")
    (x,) = cut[0].cut("ieee1609dot2.compressed_y_1")
    for frame, seen in zip(frames, cut, strict=True):
        (tbs_data,) = seen.cut("ieee1609dot2.tbsData_element")
        r_point, s = seen.cut("ieee1609dot2.rSig")[-1], seen.cut("ieee1609dot2.sSig")[-1]
        data = envelope.unwrap(frame).data
        assert (tbs_data, r_point[1:], s) == (data.tbs_data, data.signature.r, data.signature.s)
        # e = H(H(data) || H(certificate)): openssl hashes the outer one.
        inner = hashlib.sha256(tbs_data).digest() + hashlib.sha256(certificate).digest()
        key, signature = P256_INFO + b"\x03" + x, dss_signature(r_point[1:], s)
        assert openssl_says(key, signature, inner, tmp_path) == "Verified OK"
        assert openssl_says(key, signature, inner[::-1], tmp_path) == "Verification failure"


@pytest.mark.recording
def test_the_frame_of_a_test_stack_is_unwrapped_with_the_certificate_that_is_known_of_it() -> None:
    found = envelope.unwrap(stack_frame())
    content, _ = cam.decode(geonetworking.decode_payload(found.packet))
    assert content["station_id"] == int.from_bytes(found.signer[-4:], "big") == 1_289_795_728
    assert found.certificate is not None
    assert found.certificate.encoded in (recording("cam_secured/vanetza_cam_v3_certificate.dat")).read_bytes()


@pytest.mark.recording
def test_the_captured_frames_are_read_as_tshark_dissects_them(tmp_path: Path) -> None:
    frames = [*field_frames(), stack_frame()]
    for packet, seen in zip(frames, dissect(frames, tmp_path), strict=True):
        found = envelope.unwrap(packet)
        assert seen.number("ieee1609dot2.generationTime") == found.generation_time_us
        assert seen.all("ieee1609dot2.psid")[0] == "36"
        assert bytes.fromhex(seen.all("ieee1609dot2.unsecuredData")[0].replace(":", "")) == found.packet[4:]
        if found.certificate is None:
            assert bytes.fromhex(seen.all("ieee1609dot2.digest")[0].replace(":", "")) == found.signer
        else:
            assert seen.all("ieee1609dot2.bitmapSsp")[0] == "01:00:00"
            assert seen.all("ieee1609dot2.start") == [str(found.certificate.start_s)]


@pytest.mark.parametrize("octets", [9, 1_790])
def test_a_number_of_thousands_of_digits_is_a_reject(octets: int) -> None:
    packet = signed(PLAIN, TICKET, TIME_MS, with_certificate=False, header={"psid": 1 << 8 * octets - 2})
    assert reason_of(packet) == "security_encoding"


@each("member", ("minChainLength", "chainLengthRange"))
def test_a_chain_length_of_thousands_of_digits_is_a_reject(member: str) -> None:
    group = {"subjectPermissions": ("all", None), member: 1 << 14_000}
    ticket = Ticket(extra={"certIssuePermissions": [group]})
    with pytest.raises(RejectedFrame, match="security_encoding"):
        certificate_of(ticket.certificate)


def test_a_service_of_another_length_is_read_as_before() -> None:
    for psid in (0, 127, 128, 624, 2**32, 2**64):
        octets = max(1, (psid.bit_length() + 7) // 8)
        assert encoded("Psid", psid) == bytes([octets]) + psid.to_bytes(octets)
        assert Reader(encoded("Psid", psid)).take("Psid")[0] == psid


def test_a_reject_has_a_short_text_whatever_its_detail_is() -> None:
    class Mute:
        def __str__(self) -> str:
            raise KeyError("no text")

    assert str(RejectedFrame("reason", 10**5000)) == "reason int"
    assert str(RejectedFrame("reason", Mute())) == "reason Mute"
    assert len(str(RejectedFrame("reason", b"x" * 10_000))) < 300


def test_what_no_decoder_foresaw_in_an_envelope_is_a_reject() -> None:
    def fails(_: Reader) -> Certificate:
        raise OverflowError("an unknown case")

    with pytest.raises(RejectedFrame, match="security_encoding"):
        envelope.unwrap(signed(PLAIN, TICKET, TIME_MS), fails)
