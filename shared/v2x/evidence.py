"""Received frames that are kept, back to the CAM that they were."""

from pydantic import ValidationError

from ..errors import RejectedFrame
from ..messages.toll import EvidenceFrame
from ..messages.v2x import Authentication, Cam
from . import cam, geonetworking, security


def cam_of(frame: EvidenceFrame) -> Cam:
    """Decode a frame as `parsers.v2x` did; its times are those of the evidence.

    Raises
    ------
    RejectedFrame
        The frame is no CAM.
    """
    bare = frame.data[:1] == bytes([cam.PROTOCOL_VERSION])  # UPER without headers, else GeoNetworking
    packet, signed = (frame.data, None) if bare else security.without_envelope(frame.data)
    content, delta_time = cam.decode(packet if bare else geonetworking.decode_payload(packet))
    try:
        sender = security.provenance(signed)
        if frame.authentication is Authentication.AUTHENTICATED:  # by certificates that were there then
            sender = {"authentication": frame.authentication, "signer": frame.signer}
        return Cam(
            **content, sampled_ns=frame.sampled_ns, received_ns=frame.received_ns, generation_delta_time=delta_time,
            frame=frame.data, **sender,
        )  # fmt: skip
    except ValidationError as error:
        raise RejectedFrame("range", error) from error
