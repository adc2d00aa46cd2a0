"""Received frames that are kept, back to the CAM that they were, and what tells a message from others."""

import hashlib

from pydantic import ValidationError

from ..errors import RejectedFrame
from ..messages.toll import EvidenceFrame
from ..messages.v2x import Authentication, Cam
from . import cam, geonetworking
from .security.envelope import SignedPacket, without_envelope


def cam_of(frame: EvidenceFrame) -> Cam:
    """Decode a frame as `parsers.v2x` did; its times, and what is known of its sender, are those of the evidence.

    The label `authentication` is believed: it is that of `parsers.v2x` then, on a topic that it alone may write.
    Whoever has the frame from a file verifies its signature as well (`frame_faults` of the ledger's packs).

    Raises
    ------
    RejectedFrame
        The frame is no CAM.
    """
    payload, signed = _opened(frame.data)
    content, delta_time = cam.decode(payload)
    authentication, signer = Authentication.UNSIGNED, None
    if frame.authentication is Authentication.AUTHENTICATED:  # by certificates and lists that were there then
        authentication, signer = frame.authentication, frame.signer
    elif signed is not None:
        authentication, signer = Authentication.SIGNED_NOT_VERIFIED, signed.signer.hex()
    try:
        return Cam(
            **content, sampled_ns=frame.sampled_ns, received_ns=frame.received_ns, generation_delta_time=delta_time,
            frame=frame.data, authentication=authentication, signer=signer,
        )  # fmt: skip
    except ValidationError as error:
        raise RejectedFrame("range", error) from error


def message_digest(frame: bytes) -> bytes:
    """SHA-256 that tells a received CAM from others.

    That of a signed one is of ToBeSignedData and signer: who forwards it may change its hop limit, and (r, n - s) in
    the place of (r, s), and it is the same message. That of an unsigned one is of the frame.

    Raises
    ------
    RejectedFrame
        The frame is no secured packet with a CAM, though it begins as one.
    """
    signed = None if _is_bare(frame) else without_envelope(frame)[1]
    return signed.data.digest if signed else hashlib.sha256(frame).digest()


def replay_digest(frame: bytes) -> bytes:
    """SHA-256 by which a CAM is recognised when somebody sends it again: as `message_digest`, unsigned without headers.

    Raises
    ------
    RejectedFrame
        The frame is no CAM.
    """
    payload, signed = _opened(frame)
    return signed.data.digest if signed else hashlib.sha256(payload).digest()


def _opened(frame: bytes) -> tuple[bytes, SignedPacket | None]:
    """Payload of a frame, and its security envelope."""
    if _is_bare(frame):
        return frame, None
    packet, signed = without_envelope(frame)
    return geonetworking.decode_payload(packet), signed


def _is_bare(frame: bytes) -> bool:
    """Whether a frame is UPER without headers."""
    return frame[:1] == bytes([cam.PROTOCOL_VERSION])
