"""UPER codec of the CAM (EN 302 637-2 V1.4.1): bytes to and from `CamContent` in SI units.

Code values and their special meanings are those of TS 102 894-2 V1.3.1. A decoded "unavailable" is None; a confidence
beyond the range of its code is None as well, since no bound is known.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import asn1tools
from asn1tools.compiler import Specification
from asn1tools.errors import Error

from ..errors import RejectedFrame
from ..faults import FOREIGN
from ..messages.v2x import (
    CamContent,
    DriveDirection,
    LowFrequencyContainer,
    PathPoint,
    StationType,
    TrailerPresence,
    VehicleRole,
)

Record = dict[str, Any]  # a SEQUENCE as asn1tools represents it

PROTOCOL_VERSION = 2  # of V1.4.1; the coding of version 1 differs
MESSAGE_ID = 2
TENTHS_PER_RAD = 1800 / math.pi  # 0.1 degrees per radian
CENTIDEGREES_PER_RAD = 18000 / math.pi

LATITUDE_UNAVAILABLE = 900_000_001
LONGITUDE_UNAVAILABLE = 1_800_000_001
AXIS_OUT_OF_RANGE, AXIS_UNAVAILABLE = 4094, 4095  # 0.01 m
ALTITUDE_UNAVAILABLE = 800_001  # 0.01 m
HEADING_UNAVAILABLE = 3601  # 0.1 degrees
SPEED_UNAVAILABLE = 16383  # 0.01 m/s
CONFIDENCE_OUT_OF_RANGE, CONFIDENCE_UNAVAILABLE = 126, 127  # of heading and speed
LENGTH_OUT_OF_RANGE, LENGTH_UNAVAILABLE = 1022, 1023  # 0.1 m
WIDTH_OUT_OF_RANGE, WIDTH_UNAVAILABLE = 61, 62  # 0.1 m
ACCELERATION_UNAVAILABLE = 161  # 0.1 m/s2
ACCELERATION_CONFIDENCE_OUT_OF_RANGE, ACCELERATION_CONFIDENCE_UNAVAILABLE = 101, 102
CURVATURE_UNAVAILABLE = 1023  # 1e-4 1/m
YAW_RATE_UNAVAILABLE = 32767  # 0.01 degrees/s
DELTA_DEGREES_UNAVAILABLE, DELTA_ALTITUDE_UNAVAILABLE = 131_072, 12_800
PATH_DELTA_TIMES = range(1, 65_536)  # 0.01 s

ALTITUDE_CONFIDENCE_M = {
    "alt-000-01": 0.01,
    "alt-000-02": 0.02,
    "alt-000-05": 0.05,
    "alt-000-10": 0.1,
    "alt-000-20": 0.2,
    "alt-000-50": 0.5,
    "alt-001-00": 1.0,
    "alt-002-00": 2.0,
    "alt-005-00": 5.0,
    "alt-010-00": 10.0,
    "alt-020-00": 20.0,
    "alt-050-00": 50.0,
    "alt-100-00": 100.0,
    "alt-200-00": 200.0,
}
CURVATURE_CONFIDENCE = {  # 1/m
    "onePerMeter-0-00002": 0.00002,
    "onePerMeter-0-0001": 0.0001,
    "onePerMeter-0-0005": 0.0005,
    "onePerMeter-0-002": 0.002,
    "onePerMeter-0-01": 0.01,
    "onePerMeter-0-1": 0.1,
}
YAW_RATE_CONFIDENCE_RAD_S = {
    "degSec-000-01": math.radians(0.01),
    "degSec-000-05": math.radians(0.05),
    "degSec-000-10": math.radians(0.1),
    "degSec-001-00": math.radians(1.0),
    "degSec-005-00": math.radians(5.0),
    "degSec-010-00": math.radians(10.0),
    "degSec-100-00": math.radians(100.0),
}
STATION_TYPES = {
    0: StationType.UNKNOWN,
    1: StationType.PEDESTRIAN,
    2: StationType.CYCLIST,
    3: StationType.MOPED,
    4: StationType.MOTORCYCLE,
    5: StationType.PASSENGER_CAR,
    6: StationType.BUS,
    7: StationType.LIGHT_TRUCK,
    8: StationType.HEAVY_TRUCK,
    9: StationType.TRAILER,
    10: StationType.SPECIAL_VEHICLE,
    11: StationType.TRAM,
    15: StationType.ROAD_SIDE_UNIT,
}
STATION_TYPE_CODES = {kind: code for code, kind in STATION_TYPES.items()}
DRIVE_DIRECTIONS = {"forward": DriveDirection.FORWARD, "backward": DriveDirection.BACKWARD, "unavailable": None}
DRIVE_DIRECTION_CODES = {direction: code for code, direction in DRIVE_DIRECTIONS.items()}
TRAILERS = {
    "noTrailerPresent": TrailerPresence.NONE,
    "trailerPresentWithKnownLength": TrailerPresence.KNOWN_LENGTH,
    "trailerPresentWithUnknownLength": TrailerPresence.UNKNOWN_LENGTH,
    "trailerPresenceIsUnknown": TrailerPresence.UNKNOWN,
    "unavailable": None,
}
TRAILER_CODES = {trailer: code for code, trailer in TRAILERS.items()}
VEHICLE_ROLES = {
    "".join(part.title() if k else part for k, part in enumerate(role.split("_"))): role for role in VehicleRole
}
VEHICLE_ROLE_CODES = {role: code for code, role in VEHICLE_ROLES.items()}


# Service-specific permissions of a CAM (EN 302 637-2, 6.2.2), as bits of the two octets behind the version.
ZONES_PERMISSION = 0x8000
CONTAINER_PERMISSIONS = {
    "publicTransportContainer": 0x4000,
    "specialTransportContainer": 0x2000,
    "dangerousGoodsContainer": 0x1000,
    "roadWorksContainerBasic": 0x0800,
    "rescueContainer": 0x0400,
    "emergencyContainer": 0x0200,
    "safetyCarContainer": 0x0100,
}
MEMBER_PERMISSIONS = {  # of a container, with this value; None: with any
    ("roadWorksContainerBasic", "closedLanes", None): 0x0080,
    ("safetyCarContainer", "trafficRule", "noPassing"): 0x0010,
    ("safetyCarContainer", "trafficRule", "noPassingForTrucks"): 0x0008,
    ("safetyCarContainer", "speedLimit", None): 0x0004,
}
PRIORITY_PERMISSIONS = {0x80: 0x0040, 0x40: 0x0020}  # of emergencyPriority: right of way, free crossing


@cache
def specification() -> Specification:
    """Compile the ASN.1 module, once a process (0.2 s)."""
    return asn1tools.compile_files(str(Path(__file__).with_name("cam.asn")), "uper")


def decode(payload: bytes) -> tuple[Record, int]:
    """Decode the UPER bytes of a CAM into data elements of `CamContent` and generationDeltaTime.

    Returns
    -------
    dict
        Keyword arguments of `CamContent`; the values are within the ranges of their codes, but not validated by it.
    int
        [ms] Generation time modulo 65536 ms of ITS time.

    Raises
    ------
    RejectedFrame
        With the reason `truncated`, `protocol_version`, `message_id` or `uper`.
    """
    return decode_with_permissions(payload)[:2]


def decode_with_permissions(payload: bytes) -> tuple[Record, int, int]:
    """Decode a CAM as `decode` does, and find the permissions that its containers need.

    Returns
    -------
    dict, int
        As of `decode`.
    int
        Bits of the service-specific permissions behind their version, of the tables of EN 302 637-2, 6.2.2: 16, the
        first one the most significant.
    """
    if len(payload) < 2:
        raise RejectedFrame("truncated", len(payload))
    if payload[0] != PROTOCOL_VERSION:
        raise RejectedFrame("protocol_version", payload[0])
    if payload[1] != MESSAGE_ID:
        raise RejectedFrame("message_id", payload[1])
    try:
        record = specification().decode("CAM", payload, check_constraints=True)
        return _content(record), record["cam"]["generationDeltaTime"], _permissions(record["cam"]["camParameters"])
    except (Error, *FOREIGN) as error:
        raise RejectedFrame("uper", error) from error


def encode(content: CamContent, generation_delta_time: int) -> bytes:
    """Encode a CAM; values beyond the range of their code are saturated, None becomes "unavailable"."""
    low = content.low_frequency
    parameters: Record = {
        "basicContainer": {
            "stationType": STATION_TYPE_CODES.get(content.station_type, 0),
            "referencePosition": _position_record(content),
        },
        "highFrequencyContainer": (
            ("rsuContainerHighFrequency", {})
            if content.station_type is StationType.ROAD_SIDE_UNIT
            else ("basicVehicleContainerHighFrequency", _motion_record(content))
        ),
    }
    if low is not None:
        parameters["lowFrequencyContainer"] = ("basicVehicleContainerLowFrequency", _low_frequency_record(low))
    header = {"protocolVersion": PROTOCOL_VERSION, "messageID": MESSAGE_ID, "stationID": content.station_id}
    body = {"generationDeltaTime": generation_delta_time, "camParameters": parameters}
    return bytes(specification().encode("CAM", {"header": header, "cam": body}))


# Decoding


def _content(record: Record) -> Record:
    parameters = record["cam"]["camParameters"]
    basic = parameters["basicContainer"]
    content = {
        "station_id": record["header"]["stationID"],
        "station_type": STATION_TYPES.get(basic["stationType"], StationType.OTHER),
        **_position(basic["referencePosition"]),
    }
    container, motion = parameters["highFrequencyContainer"]
    if container == "basicVehicleContainerHighFrequency":
        content |= _motion(motion)
    low = parameters.get("lowFrequencyContainer")
    if low is not None and low[0] == "basicVehicleContainerLowFrequency":
        content["low_frequency"] = _low_frequency(low[1])
    return content


def _permissions(parameters: Record) -> int:
    """Bits that a sender's SSP must have for the special containers, and for members of them."""
    container, motion = parameters["highFrequencyContainer"]
    needed = 0
    if container == "rsuContainerHighFrequency" and motion.get("protectedCommunicationZonesRSU"):
        needed |= ZONES_PERMISSION
    kind, special = parameters.get("specialVehicleContainer", (None, {}))
    needed |= CONTAINER_PERMISSIONS.get(kind, 0)
    for (of_kind, member, value), bit in MEMBER_PERMISSIONS.items():
        if kind == of_kind and member in special and (value is None or special[member] == value):
            needed |= bit
    if kind == "emergencyContainer" and "emergencyPriority" in special:
        bits = special["emergencyPriority"][0][0]
        needed |= sum(bit for place, bit in PRIORITY_PERMISSIONS.items() if bits & place)
    return needed


def _position(position: Record) -> Record:
    ellipse, altitude = position["positionConfidenceEllipse"], position["altitude"]
    major, minor = ellipse["semiMajorConfidence"], ellipse["semiMinorConfidence"]
    return {
        "latitude_deg": _scaled(position["latitude"], LATITUDE_UNAVAILABLE, 1e7),
        "longitude_deg": _scaled(position["longitude"], LONGITUDE_UNAVAILABLE, 1e7),
        "position_semi_major_m": _confidence(major, AXIS_OUT_OF_RANGE, 100),
        "position_semi_minor_m": _confidence(minor, AXIS_OUT_OF_RANGE, 100),
        "position_semi_major_orientation_rad": _angle(ellipse["semiMajorOrientation"]),
        "position_out_of_range": AXIS_OUT_OF_RANGE in (major, minor),
        "height_ellipsoid_m": _scaled(altitude["altitudeValue"], ALTITUDE_UNAVAILABLE, 100),
        "height_confidence_m": ALTITUDE_CONFIDENCE_M.get(altitude["altitudeConfidence"]),
    }


def _motion(motion: Record) -> Record:
    heading, speed, length = motion["heading"], motion["speed"], motion["vehicleLength"]
    acceleration, curvature, yaw_rate = motion["longitudinalAcceleration"], motion["curvature"], motion["yawRate"]
    return {
        "heading_rad": _angle(heading["headingValue"]),
        "heading_confidence_rad": _confidence(heading["headingConfidence"], CONFIDENCE_OUT_OF_RANGE, TENTHS_PER_RAD),
        "speed_m_s": _scaled(speed["speedValue"], SPEED_UNAVAILABLE, 100),
        "speed_confidence_m_s": _confidence(speed["speedConfidence"], CONFIDENCE_OUT_OF_RANGE, 100),
        "drive_direction": DRIVE_DIRECTIONS[motion["driveDirection"]],
        "vehicle_length_m": _confidence(length["vehicleLengthValue"], LENGTH_OUT_OF_RANGE, 10),
        "trailer": TRAILERS[length["vehicleLengthConfidenceIndication"]],
        "vehicle_width_m": _confidence(motion["vehicleWidth"], WIDTH_OUT_OF_RANGE, 10),
        "longitudinal_acceleration_m_s2": _scaled(
            acceleration["longitudinalAccelerationValue"], ACCELERATION_UNAVAILABLE, 10
        ),
        "longitudinal_acceleration_confidence_m_s2": _confidence(
            acceleration["longitudinalAccelerationConfidence"], ACCELERATION_CONFIDENCE_OUT_OF_RANGE, 10
        ),
        "curvature": _scaled(curvature["curvatureValue"], CURVATURE_UNAVAILABLE, 1e4),
        "curvature_confidence": CURVATURE_CONFIDENCE.get(curvature["curvatureConfidence"]),
        "yaw_rate_rad_s": _scaled(yaw_rate["yawRateValue"], YAW_RATE_UNAVAILABLE, CENTIDEGREES_PER_RAD),
        "yaw_rate_confidence_rad_s": YAW_RATE_CONFIDENCE_RAD_S.get(yaw_rate["yawRateConfidence"]),
    }


def _low_frequency(low: Record) -> LowFrequencyContainer:
    return LowFrequencyContainer(
        vehicle_role=VEHICLE_ROLES[low["vehicleRole"]],
        exterior_lights=low["exteriorLights"][0][0],
        path=tuple(
            PathPoint(
                delta_latitude_deg=_scaled(point["pathPosition"]["deltaLatitude"], DELTA_DEGREES_UNAVAILABLE, 1e7),
                delta_longitude_deg=_scaled(point["pathPosition"]["deltaLongitude"], DELTA_DEGREES_UNAVAILABLE, 1e7),
                delta_height_m=_scaled(point["pathPosition"]["deltaAltitude"], DELTA_ALTITUDE_UNAVAILABLE, 100),
                delta_time_s=_path_time_s(point.get("pathDeltaTime", 0)),
            )
            for point in low["pathHistory"]
        ),
    )


def _path_time_s(code: int) -> float | None:
    """Decode pathDeltaTime, whose type is extensible: a code without a meaning in this version is as none."""
    return code / 100 if code in PATH_DELTA_TIMES else None


def _scaled(code: int, unavailable: int, per_unit: float) -> float | None:
    return None if code == unavailable else code / per_unit


def _confidence(code: int, out_of_range: int, per_unit: float) -> float | None:
    """Decode a quantity whose two greatest codes mean "greater than can be coded" and "unavailable"."""
    return None if code >= out_of_range else code / per_unit


def _angle(code: int) -> float | None:
    return None if code == HEADING_UNAVAILABLE else code % 3600 / TENTHS_PER_RAD


# Encoding


def _position_record(content: CamContent) -> Record:
    def axis(length_m: float | None) -> int:
        if content.position_out_of_range:
            return AXIS_OUT_OF_RANGE
        return _confidence_code(length_m, 100, AXIS_OUT_OF_RANGE, AXIS_UNAVAILABLE)

    return {
        "latitude": _code(content.latitude_deg, 1e7, (-900_000_000, 900_000_000), LATITUDE_UNAVAILABLE),
        "longitude": _code(content.longitude_deg, 1e7, (-1_800_000_000, 1_800_000_000), LONGITUDE_UNAVAILABLE),
        "positionConfidenceEllipse": {
            "semiMajorConfidence": axis(content.position_semi_major_m),
            "semiMinorConfidence": axis(content.position_semi_minor_m),
            "semiMajorOrientation": _angle_code(content.position_semi_major_orientation_rad),
        },
        "altitude": {
            "altitudeValue": _code(content.height_ellipsoid_m, 100, (-100_000, 800_000), ALTITUDE_UNAVAILABLE),
            "altitudeConfidence": _class(content.height_confidence_m, ALTITUDE_CONFIDENCE_M),
        },
    }


def _motion_record(content: CamContent) -> Record:
    return {
        "heading": {
            "headingValue": _angle_code(content.heading_rad),
            "headingConfidence": _confidence_code(
                content.heading_confidence_rad, TENTHS_PER_RAD, CONFIDENCE_OUT_OF_RANGE, CONFIDENCE_UNAVAILABLE
            ),
        },
        "speed": {
            "speedValue": _code(content.speed_m_s, 100, (0, 16382), SPEED_UNAVAILABLE),
            "speedConfidence": _confidence_code(
                content.speed_confidence_m_s, 100, CONFIDENCE_OUT_OF_RANGE, CONFIDENCE_UNAVAILABLE
            ),
        },
        "driveDirection": DRIVE_DIRECTION_CODES[content.drive_direction],
        "vehicleLength": {
            "vehicleLengthValue": _confidence_code(
                content.vehicle_length_m, 10, LENGTH_OUT_OF_RANGE, LENGTH_UNAVAILABLE
            ),
            "vehicleLengthConfidenceIndication": TRAILER_CODES[content.trailer],
        },
        "vehicleWidth": _confidence_code(content.vehicle_width_m, 10, WIDTH_OUT_OF_RANGE, WIDTH_UNAVAILABLE),
        "longitudinalAcceleration": {
            "longitudinalAccelerationValue": _code(
                content.longitudinal_acceleration_m_s2, 10, (-160, 160), ACCELERATION_UNAVAILABLE
            ),
            "longitudinalAccelerationConfidence": _confidence_code(
                content.longitudinal_acceleration_confidence_m_s2,
                10,
                ACCELERATION_CONFIDENCE_OUT_OF_RANGE,
                ACCELERATION_CONFIDENCE_UNAVAILABLE,
            ),
        },
        "curvature": {
            "curvatureValue": _code(content.curvature, 1e4, (-1023, 1022), CURVATURE_UNAVAILABLE),
            "curvatureConfidence": _class(content.curvature_confidence, CURVATURE_CONFIDENCE),
        },
        "curvatureCalculationMode": "unavailable" if content.curvature is None else "yawRateUsed",
        "yawRate": {
            "yawRateValue": _code(content.yaw_rate_rad_s, CENTIDEGREES_PER_RAD, (-32766, 32766), YAW_RATE_UNAVAILABLE),
            "yawRateConfidence": _class(content.yaw_rate_confidence_rad_s, YAW_RATE_CONFIDENCE_RAD_S),
        },
    }


def _low_frequency_record(low: LowFrequencyContainer) -> Record:
    return {
        "vehicleRole": VEHICLE_ROLE_CODES[low.vehicle_role],
        "exteriorLights": (bytes([low.exterior_lights]), 8),
        "pathHistory": [_path_point_record(point) for point in low.path],
    }


def _path_point_record(point: PathPoint) -> Record:
    degrees = (-131_071, 131_071), DELTA_DEGREES_UNAVAILABLE
    position = {
        "deltaLatitude": _code(point.delta_latitude_deg, 1e7, *degrees),
        "deltaLongitude": _code(point.delta_longitude_deg, 1e7, *degrees),
        "deltaAltitude": _code(point.delta_height_m, 100, (-12_700, 12_799), DELTA_ALTITUDE_UNAVAILABLE),
    }
    record: Record = {"pathPosition": position}
    if point.delta_time_s is not None:
        record["pathDeltaTime"] = max(PATH_DELTA_TIMES[0], min(PATH_DELTA_TIMES[-1], round(point.delta_time_s * 100)))
    return record


def _code(value: float | None, per_unit: float, limits: tuple[int, int], unavailable: int) -> int:
    return unavailable if value is None else max(limits[0], min(limits[1], round(value * per_unit)))


def _confidence_code(value: float | None, per_unit: float, out_of_range: int, unavailable: int) -> int:
    """Code of a length or confidence, rounded up, so that the code never promises more than the value."""
    if value is None:
        return unavailable
    return max(1, min(out_of_range, math.ceil(value * per_unit - 1e-6)))


def _angle_code(angle_rad: float | None) -> int:
    return HEADING_UNAVAILABLE if angle_rad is None else round(angle_rad * TENTHS_PER_RAD) % 3600


def _class(value: float | None, classes: Mapping[str, float]) -> str:
    """Name of the smallest class that holds the value."""
    if value is None:
        return "unavailable"
    names: Sequence[str] = list(classes)
    at = bisect_left(list(classes.values()), value * (1 - 1e-9))
    return names[at] if at < len(names) else "outOfRange"
