"""V2X frames as received and sent, and Cooperative Awareness Messages (CAM) in SI units."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import (
    Base64,
    Count,
    Deviation,
    Height,
    Latitude,
    Longitude,
    Message,
    Name,
    Nanoseconds,
    Quantity,
    RawBytes,
    Speed,
    unit,
)

MAX_FRAME_BYTES = 2304  # largest MSDU of IEEE 802.11
MAX_CAMS = 1024  # of one batch
CertificateDigest = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]  # HashedId8 of IEEE 1609.2, hexadecimal
ItsMilliseconds = Annotated[int, Field(ge=0, lt=1 << 42), unit("ms")]


class Encapsulation(StrEnum):
    """Protocols around the UPER bytes of a frame."""

    GEONETWORKING = "geonetworking"  # basic header, common header, single-hop broadcast, BTP-B
    NONE = "none"  # bare UPER


class CamFrames(RawBytes):
    """Frames of at most 20 ms as records of `shared/v2x/frames.py`: each with its own stamp and length."""

    encapsulation: Encapsulation = Encapsulation.GEONETWORKING
    # carrier frequency offset of each frame, by radios that measure it; empty: by one that does not
    cfo_hz: Annotated[tuple[Quantity | None, ...], Field(max_length=MAX_CAMS, exclude_if=lambda value: not value)] = ()


class Authentication(StrEnum):
    """What is known of the sender of a frame by its signature, from the least on."""

    UNSIGNED = "unsigned"
    SIGNED_NOT_VERIFIED = "signed_not_verified"  # no check of signature and certificate: no more known than unsigned
    AUTHENTICATED = "authenticated"  # signature, chain, validity, region and permissions hold; `signer` is the ticket


class Unverified(StrEnum):
    """Why the sender of a signed frame is not authenticated, though nothing of it is refused."""

    NO_TRUST = "no_trust"  # this unit has no trusted certificates
    NO_CERTIFICATE = "no_certificate"  # only its digest was received
    UNKNOWN_ISSUER = "unknown_issuer"  # no trusted authority has issued the ticket
    TEST_ROOT = "test_root"  # and the traffic is not simulated
    NO_REVOCATIONS = "no_revocations"  # there is no list of what the root has revoked
    LISTS_EXPIRED = "lists_expired"  # the next trust list is overdue
    TOO_MANY = "too_many"  # more new tickets, or frames without certificate, than are examined


class V2xSend(RawBytes):
    """One frame to be sent by the V2X radio."""


class StationType(StrEnum):
    """Kinds of ITS station; values without a name in TS 102 894-2 V1.3.1 are `other`."""

    UNKNOWN = "unknown"
    PEDESTRIAN = "pedestrian"
    CYCLIST = "cyclist"
    MOPED = "moped"
    MOTORCYCLE = "motorcycle"
    PASSENGER_CAR = "passenger_car"
    BUS = "bus"
    LIGHT_TRUCK = "light_truck"
    HEAVY_TRUCK = "heavy_truck"
    TRAILER = "trailer"
    SPECIAL_VEHICLE = "special_vehicle"
    TRAM = "tram"
    ROAD_SIDE_UNIT = "road_side_unit"
    OTHER = "other"


class DriveDirection(StrEnum):
    """Whether the vehicle drives forward or backward; the heading is that of the movement in both cases."""

    FORWARD = "forward"
    BACKWARD = "backward"


class TrailerPresence(StrEnum):
    """Whether the vehicle has a trailer, and whether its length is part of the stated one."""

    NONE = "none"
    KNOWN_LENGTH = "known_length"
    UNKNOWN_LENGTH = "unknown_length"
    UNKNOWN = "unknown"


class VehicleRole(StrEnum):
    """Role of a vehicle, after TS 102 894-2."""

    DEFAULT = "default"
    PUBLIC_TRANSPORT = "public_transport"
    SPECIAL_TRANSPORT = "special_transport"
    DANGEROUS_GOODS = "dangerous_goods"
    ROAD_WORK = "road_work"
    RESCUE = "rescue"
    EMERGENCY = "emergency"
    SAFETY_CAR = "safety_car"
    AGRICULTURE = "agriculture"
    COMMERCIAL = "commercial"
    MILITARY = "military"
    ROAD_OPERATOR = "road_operator"
    TAXI = "taxi"
    RESERVED_1 = "reserved_1"
    RESERVED_2 = "reserved_2"
    RESERVED_3 = "reserved_3"


class PathPoint(Message):
    """A point of the path behind a vehicle, relative to the point before it (the first: to the reference position)."""

    delta_latitude_deg: Annotated[float, Field(ge=-0.0131071, le=0.0131072)] | None = None
    delta_longitude_deg: Annotated[float, Field(ge=-0.0131071, le=0.0131072)] | None = None
    delta_height_m: Annotated[float, Field(ge=-127.0, le=128.0)] | None = None
    delta_time_s: Annotated[float, Field(gt=0.0, le=655.35)] | None = None


class LowFrequencyContainer(Message):
    """Part of a CAM that a vehicle sends every 500 ms."""

    vehicle_role: VehicleRole = VehicleRole.DEFAULT
    exterior_lights: Annotated[Count, Field(ge=0, le=255)] = 0  # bit 7: low beam ... bit 0: parking lights
    path: Annotated[tuple[PathPoint, ...], Field(max_length=40)] = ()


class CamContent(Message):
    """Data elements of a CAM in SI units; None where the sender states "unavailable".

    Confidences are those of the standard, for a level of 95 %; one that is out of the range of its code is None.
    """

    station_id: Annotated[Count, Field(ge=0, lt=1 << 32)]  # a pseudonym
    station_type: StationType
    latitude_deg: Latitude | None = None  # of the reference point: ground below the middle of the front
    longitude_deg: Longitude | None = None
    position_semi_major_m: Deviation | None = None  # of the 95 % ellipse
    position_semi_minor_m: Deviation | None = None
    position_semi_major_orientation_rad: Quantity | None = None  # clockwise from true north
    position_out_of_range: bool = False  # code 4094 of an axis, more than 40.93 m: the position cannot be trusted
    height_ellipsoid_m: Height | None = None
    height_confidence_m: Deviation | None = None
    heading_rad: Quantity | None = None  # of the movement, clockwise from true north, [0, 2 pi)
    heading_confidence_rad: Deviation | None = None
    speed_m_s: Annotated[Speed, Field(ge=0.0)] | None = None
    speed_confidence_m_s: Deviation | None = None
    drive_direction: DriveDirection | None = None
    vehicle_length_m: Deviation | None = None
    trailer: TrailerPresence | None = None
    vehicle_width_m: Deviation | None = None
    longitudinal_acceleration_m_s2: Quantity | None = None
    longitudinal_acceleration_confidence_m_s2: Deviation | None = None
    curvature: Annotated[Quantity, unit("1/m")] | None = None  # positive: left turn
    curvature_confidence: Annotated[Deviation, unit("1/m")] | None = None
    yaw_rate_rad_s: Quantity | None = None  # positive: left turn, anticlockwise seen from above
    yaw_rate_confidence_rad_s: Deviation | None = None
    low_frequency: LowFrequencyContainer | None = None  # None in a CAM without it


class Cam(CamContent):
    """One received CAM, and what is known of its sender."""

    # Generation time on the OBU time line: reconstructed from `generation_delta_time`, correct if both clocks are.
    sampled_ns: Nanoseconds
    received_ns: Nanoseconds
    generation_delta_time: Annotated[int, Field(ge=0, lt=65536), unit("ms")]  # ITS time modulo 65536 ms
    frame: Annotated[Base64, Field(max_length=MAX_FRAME_BYTES)]  # as received, for digests and evidence
    authentication: Authentication = Authentication.UNSIGNED
    signer: CertificateDigest | None = None  # that a signed frame states; None: unsigned
    unverified: Unverified | None = None  # why a signed frame is not authenticated; None as well in evidence


class CamList(Message):
    """The CAMs of one batch of frames, in order of reception."""

    received_ns: Nanoseconds  # of the last frame of the batch
    source: Name
    cams: Annotated[tuple[Cam, ...], Field(max_length=MAX_CAMS)]


class OwnCam(CamContent):
    """A CAM that this unit is about to send."""

    sampled_ns: Nanoseconds
    its_time_ms: ItsMilliseconds  # TAI since 2004-01-01 at `sampled_ns`
