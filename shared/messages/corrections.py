"""GNSS corrections: where they come from, and what of them goes to the receiver."""

from enum import StrEnum
from typing import Annotated, ClassVar

from pydantic import Field

from .base import Bytes, Count, DeviceName, Message, Name, Nanoseconds, Quantity, RawBytes, Reason, Seconds, unit

MAX_CORRECTION_SOURCES = 8
MAX_CORRECTION_TYPES = 64  # counted by name; a receiver of all constellations is sent about 30 kinds


class CorrectionProtocol(StrEnum):
    """Protocols of corrections that a receiver accepts."""

    RTCM3 = "rtcm3"
    SPARTN = "spartn"
    UBX = "ubx"  # RXM-PMP of an L-band receiver and RXM-SPARTNKEY, no other


class CorrectionBytes(RawBytes):
    """Bytes that a source of corrections sent, in portions as they arrived."""

    is_stream: ClassVar[bool] = True


class GnssCorrection(RawBytes):
    """Whole frames with valid checksums, to be written to the GNSS receiver."""

    protocol: CorrectionProtocol
    frames: Count


class SourcePhase(StrEnum):
    """What a source of corrections is doing."""

    IDLE = "idle"  # not needed: a better one delivers
    CONNECTING = "connecting"
    CONNECTED = "connected"  # no bytes yet
    RECEIVING = "receiving"
    WAITING = "waiting"  # for the next attempt
    REFUSED = "refused"  # credentials or mount point: attempts are rare


class CorrectionSource(Message):
    """The connection to one source of corrections."""

    source: DeviceName
    phase: SourcePhase
    reason: Reason
    received_bytes: Bytes = 0
    connections: Count = 0
    next_attempt_s: Seconds | None = None


class CorrectionSources(Message):
    """The connections to all sources of corrections, the preferred one first."""

    now_ns: Nanoseconds
    sources: Annotated[tuple[CorrectionSource, ...], Field(max_length=MAX_CORRECTION_SOURCES)]


class CorrectionStream(Message):
    """One source of corrections: its connection, and the frames found in its bytes."""

    source: DeviceName
    phase: SourcePhase | None = None  # None: the driver has not stated it yet
    reason: Reason = ""
    received_bytes: Bytes = 0
    frames: Count = 0
    frame_age_s: Seconds | None = None  # of the last valid frame
    rate_bytes_s: Annotated[Quantity, unit("bytes/s")] | None = None  # of valid frames


class CorrectionsState(Message):
    """Which source of corrections is in use, and what it delivers."""

    sampled_ns: Nanoseconds
    active: DeviceName | None = None  # the source whose frames go to the receiver
    since_ns: Nanoseconds | None = None
    reason: Reason
    protocol: CorrectionProtocol | None = None
    frame_age_s: Seconds | None = None  # of the last frame that went to the receiver
    forwarded_bytes: Bytes = 0
    types: dict[Name, Count] = Field(default_factory=dict, max_length=MAX_CORRECTION_TYPES + 1)  # frames sent on
    rejects: dict[Name, Count] = Field(default_factory=dict, max_length=MAX_CORRECTION_TYPES)
    streams: Annotated[tuple[CorrectionStream, ...], Field(max_length=MAX_CORRECTION_SOURCES)] = ()
