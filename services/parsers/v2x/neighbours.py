"""Neighbours of which CAM are received, as core.cooperative takes them: states of one time, with stated quality.

A CAM states confidences of 95 %: the half-axes of its ellipse are divided by 2.45, a scalar by 1.96. A station that
states no position, height, speed or heading, or no quality of one, is not a neighbour that an estimate can use. What a
CAM does not state is the offset of its sender's oscillator: 1 m/s of range-rate is 19.7 Hz of carrier frequency, and an
oscillator of 20 ppm is off by 118 kHz.
"""

from collections import Counter, OrderedDict
from math import cos, radians, remainder, sin

import numpy as np
from pydantic import ValidationError

from shared.maths.confidence import ELLIPSE_95, SCALAR_95
from shared.messages.neighbours import MAX_NEIGHBOURS, Neighbour, NeighbourStates
from shared.messages.v2x import Authentication, Cam, DriveDirection, StationType

HEIGHT_OFFSET_SD_M = 1.0  # [m] of the receiver above the reference point, which lies on the ground
NEWEST_S = 1.1  # [s] age of a CAM; one comes at least every second
MAX_STATIONS = 1024
MAX_OFFSETS = 4096  # frames whose offset is kept until their CAM is made
PREFIX_BYTES = 48  # by which a frame is recognised, within a reception time
ACCELERATION_SD = 1.0  # [m/s²] of a neighbour, since its CAM
MOST_LATITUDE_DEG = 89.9995
NS = 1_000_000_000


class ReceivedNeighbours:
    """The newest CAM of each station, and the carrier frequency offsets of the frames that carried them."""

    def __init__(self, rejects: Counter[str]) -> None:
        self._rejects = rejects
        self._newest: OrderedDict[int, tuple[Cam, float | None]] = OrderedDict()
        self._unsigned: OrderedDict[int, None] = OrderedDict()  # those of them that are not authenticated, oldest first
        self._offsets: OrderedDict[tuple[int, bytes], float | None] = OrderedDict()

    def note_offset(self, received_ns: int, frame: bytes, cfo_hz: float | None) -> None:
        """Keep the offset of a frame until its CAM is made."""
        self._offsets[received_ns, frame[:PREFIX_BYTES]] = cfo_hz
        while len(self._offsets) > MAX_OFFSETS:
            self._offsets.popitem(last=False)

    def note(self, cam: Cam, frame: bytes) -> None:
        """Keep a CAM; one that is not authenticated replaces none that is."""
        offset = self._offsets.pop((cam.received_ns, frame[:PREFIX_BYTES]), None)
        before = self._newest.pop(cam.station_id, None)
        fresh = before is not None and cam.received_ns - before[0].received_ns <= NEWEST_S * NS
        if before is not None and fresh and _is_authenticated(before[0]) and not _is_authenticated(cam):
            self._newest[cam.station_id] = before
            self._rejects["neighbour_unsigned"] += 1
            return
        self._newest[cam.station_id] = cam, offset
        self._unsigned.pop(cam.station_id, None)
        if not _is_authenticated(cam):
            self._unsigned[cam.station_id] = None
        while len(self._newest) > MAX_STATIONS:
            self._evict()

    def _evict(self) -> None:
        """Forget the oldest station, one that is not authenticated first: a flood of those displaces no other."""
        if self._unsigned:
            station, _ = self._unsigned.popitem(last=False)
            del self._newest[station]
        else:
            self._newest.popitem(last=False)

    def states(self, now_ns: int, source: str) -> NeighbourStates | None:
        """States of the neighbours at a time, authenticated ones first; None without any."""
        for station, (cam, _) in list(self._newest.items()):
            if now_ns - cam.sampled_ns > NEWEST_S * NS:
                del self._newest[station]
                self._unsigned.pop(station, None)
        ranked = sorted(self._newest.values(), key=lambda item: (not _is_authenticated(item[0]), -item[0].received_ns))
        found = [state for cam, offset in ranked if (state := self._state(cam, offset, now_ns)) is not None]
        if not found:
            return None
        return NeighbourStates(
            sampled_ns=now_ns, received_ns=now_ns, source=source, neighbours=tuple(found[:MAX_NEIGHBOURS])
        )

    def _state(self, cam: Cam, cfo_hz: float | None, at_ns: int) -> Neighbour | None:
        """State of a station; one that cannot be is counted, and ends no other one."""
        try:
            return neighbour_of(cam, cfo_hz, at_ns)
        except (ValidationError, ArithmeticError):
            self._rejects["neighbour_impossible"] += 1
            return None


def neighbour_of(cam: Cam, cfo_hz: float | None, at_ns: int) -> Neighbour | None:
    """State of a station at a time, moved on by its velocity; None where its CAM does not state one with quality.

    Within 50 m of a pole, where a heading says nothing, there is no neighbour.

    Raises
    ------
    ValidationError
        What it states lies beyond what a message may hold.
    """
    ellipse = cam.position_semi_major_m, cam.position_semi_minor_m, cam.position_semi_major_orientation_rad
    position = cam.latitude_deg, cam.longitude_deg, cam.height_ellipsoid_m, cam.height_confidence_m
    motion = cam.speed_m_s, cam.speed_confidence_m_s, cam.heading_rad, cam.heading_confidence_rad
    if cam.position_out_of_range or cam.station_type is StationType.ROAD_SIDE_UNIT:
        return None
    if cam.latitude_deg is not None and abs(cam.latitude_deg) >= MOST_LATITUDE_DEG:
        return None
    if None in ellipse or None in position or None in motion or cam.drive_direction is DriveDirection.BACKWARD:
        return None
    major, minor, orientation = (float(value or 0.0) for value in ellipse)
    latitude, longitude, height, height_95 = (float(value or 0.0) for value in position)
    speed, speed_95, heading, heading_95 = (float(value or 0.0) for value in motion)
    age_s = (at_ns - cam.sampled_ns) / NS
    north, east = cos(heading), sin(heading)
    moved = speed * age_s
    along = np.array([cos(orientation), sin(orientation)])
    across = np.array([-along[1], along[0]])
    horizontal = (major / ELLIPSE_95) ** 2 * np.outer(along, along)
    horizontal += (minor / ELLIPSE_95) ** 2 * np.outer(across, across)
    horizontal += (0.5 * ACCELERATION_SD * age_s**2) ** 2 * np.eye(2)
    course, aside = np.array([north, east]), np.array([-east, north])
    speed_sd, heading_sd = speed_95 / SCALAR_95, heading_95 / SCALAR_95
    velocity = (speed_sd**2 + (ACCELERATION_SD * age_s) ** 2) * np.outer(course, course)
    velocity += ((speed * heading_sd) ** 2 + (ACCELERATION_SD * age_s) ** 2 + 1e-4) * np.outer(aside, aside)
    height_var = (height_95 / SCALAR_95) ** 2 + HEIGHT_OFFSET_SD_M**2
    metres_a_degree = 111_320.0  # to a metre over the distance of a second
    return Neighbour(
        station_id=cam.station_id,
        latitude_deg=latitude + moved * north / metres_a_degree,
        longitude_deg=remainder(longitude + moved * east / (metres_a_degree * cos(radians(latitude))), 360.0),
        height_ellipsoid_m=height,
        velocity_ned_m_s=(speed * north, speed * east, 0.0),
        position_cov_ned_m2=(horizontal[0, 0], horizontal[0, 1], 0.0, horizontal[1, 1], 0.0, height_var),
        velocity_cov_ned_m2_s2=(velocity[0, 0], velocity[0, 1], 0.0, velocity[1, 1], 0.0, 0.25),
        cfo_hz=cfo_hz,
        authenticated=_is_authenticated(cam),
    )


def _is_authenticated(cam: Cam) -> bool:
    return cam.authentication is Authentication.AUTHENTICATED
