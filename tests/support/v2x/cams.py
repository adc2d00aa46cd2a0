"""CAM of our own, on which tests agree, and strategies that draw others."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hypothesis import strategies as st
from pydantic import ValidationError

from shared.errors import RejectedFrame
from shared.messages.v2x import (
    CamContent,
    CamFrames,
    DriveDirection,
    Encapsulation,
    LowFrequencyContainer,
    PathPoint,
    StationType,
    TrailerPresence,
    VehicleRole,
)
from shared.v2x import cam, frames, geonetworking, its_time

# A car that brakes in a left turn, with every data element.
BRAKING = CamContent(
    station_id=4_000_000_123,
    station_type=StationType.PASSENGER_CAR,
    latitude_deg=49.4431234,
    longitude_deg=-1.0993217,
    position_semi_major_m=1.23,
    position_semi_minor_m=0.45,
    position_semi_major_orientation_rad=math.radians(31.7),
    height_ellipsoid_m=-12.34,
    height_confidence_m=5.0,
    heading_rad=math.radians(271.3),
    heading_confidence_rad=math.radians(2.1),
    speed_m_s=23.45,
    speed_confidence_m_s=0.31,
    drive_direction=DriveDirection.FORWARD,
    vehicle_length_m=4.6,
    trailer=TrailerPresence.KNOWN_LENGTH,
    vehicle_width_m=1.9,
    longitudinal_acceleration_m_s2=-3.4,
    longitudinal_acceleration_confidence_m_s2=0.6,
    curvature=0.0123,
    curvature_confidence=0.002,
    yaw_rate_rad_s=math.radians(16.52),
    yaw_rate_confidence_rad_s=math.radians(0.1),
    low_frequency=LowFrequencyContainer(
        vehicle_role=VehicleRole.TAXI,
        exterior_lights=0b1010_0001,
        path=(
            PathPoint(
                delta_latitude_deg=-0.0000123, delta_longitude_deg=0.0000456, delta_height_m=-0.25, delta_time_s=1.5
            ),
            PathPoint(delta_latitude_deg=0.0131071, delta_longitude_deg=-0.0131071),
        ),
    ),
)  # fmt: skip
# Every data element that can be unavailable is.
SILENT = CamContent(station_id=0, station_type=StationType.UNKNOWN)

SENDER = geonetworking.PositionVector(
    mac_address=bytes.fromhex("020012345678"),
    station_type=5,
    its_time_ms=(7 << 32) + 1_535_174_982,
    latitude_deg=49.4431234,
    longitude_deg=-1.0993217,
    accurate=True,
    speed_m_s=23.45,
    heading_rad=math.radians(271.3),
)


def packet(content: CamContent, its_time_ms: int, header_ms: int = 0) -> bytes:
    """Encode a CAM of an ITS time into a packet whose header is `header_ms` later."""
    sender = replace(SENDER, its_time_ms=its_time_ms + header_ms)
    return geonetworking.encode_packet(cam.encode(content, its_time_ms % its_time.CYCLE_MS), sender)


def decode_content(payload: bytes) -> tuple[CamContent, int]:
    """Decode a CAM into a validated message and its generationDeltaTime."""
    content, generation_delta_time = cam.decode(payload)
    try:
        return CamContent.model_validate(content), generation_delta_time
    except ValidationError as error:
        raise RejectedFrame("uper", error) from error


def batch(
    packets: Sequence[bytes], received_ns: int, encapsulation: Encapsulation = Encapsulation.GEONETWORKING
) -> CamFrames:
    """Put frames that arrived at one time into a batch."""
    data = frames.pack([(received_ns, packet) for packet in packets])
    return CamFrames(received_ns=received_ns, source="v2x0", encapsulation=encapsulation, data=data)


def _grid(low: int, high: int, per_unit: float) -> st.SearchStrategy[float | None]:
    return st.none() | st.integers(low, high).map(lambda code: code / per_unit)


_per_rad = 1800 / math.pi
_low_frequency = st.builds(
    LowFrequencyContainer,
    vehicle_role=st.sampled_from(VehicleRole),
    exterior_lights=st.integers(0, 255),
    path=st.lists(
        st.builds(
            PathPoint,
            delta_latitude_deg=_grid(-131_071, 131_071, 1e7),
            delta_longitude_deg=_grid(-131_071, 131_071, 1e7),
            delta_height_m=_grid(-12_700, 12_799, 100),
            delta_time_s=_grid(1, 65_535, 100),
        ),
        max_size=40,
    ).map(tuple),
)
_elements: dict[str, st.SearchStrategy[Any]] = {
    "station_id": st.integers(0, 2**32 - 1),
    "station_type": st.sampled_from([kind for kind in StationType if kind is not StationType.OTHER]),
    "latitude_deg": _grid(-900_000_000, 900_000_000, 1e7),
    "longitude_deg": _grid(-1_800_000_000, 1_800_000_000, 1e7),
    "position_semi_major_m": _grid(1, 4093, 100),
    "position_semi_minor_m": _grid(1, 4093, 100),
    "position_semi_major_orientation_rad": _grid(0, 3599, _per_rad),
    "height_ellipsoid_m": _grid(-100_000, 800_000, 100),
    "height_confidence_m": st.sampled_from([None, 0.01, 0.5, 200.0]),
}
_motion: dict[str, st.SearchStrategy[Any]] = {
    "heading_rad": _grid(0, 3599, _per_rad),
    "heading_confidence_rad": _grid(1, 125, _per_rad),
    "speed_m_s": _grid(0, 16_382, 100),
    "speed_confidence_m_s": _grid(1, 125, 100),
    "drive_direction": st.sampled_from([None, *DriveDirection]),
    "vehicle_length_m": _grid(1, 1021, 10),
    "trailer": st.sampled_from([None, *TrailerPresence]),
    "vehicle_width_m": _grid(1, 60, 10),
    "longitudinal_acceleration_m_s2": _grid(-160, 160, 10),
    "longitudinal_acceleration_confidence_m_s2": _grid(1, 100, 10),
    "curvature": _grid(-1023, 1022, 1e4),
    "curvature_confidence": st.sampled_from([None, 0.00002, 0.002, 0.1]),
    "yaw_rate_rad_s": _grid(-32_766, 32_766, 10 * _per_rad),
    "yaw_rate_confidence_rad_s": st.sampled_from([None, math.radians(0.01), math.radians(100.0)]),
}


@st.composite
def contents(draw: st.DrawFn) -> CamContent:
    """Draw a CAM whose values are on the grid of their codes."""
    elements = {name: draw(strategy) for name, strategy in _elements.items()}
    if elements["station_type"] is not StationType.ROAD_SIDE_UNIT:
        elements |= {name: draw(strategy) for name, strategy in _motion.items()}
    elements["low_frequency"] = draw(st.none() | _low_frequency)
    return CamContent(**elements)
