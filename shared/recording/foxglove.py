"""Solutions and fixes as messages that Foxglove and Lichtblick draw: `foxglove.LocationFix`, pose and transform.

JSON with JSON schemas, after the public schemas of Foxglove (docs.foxglove.dev/docs/sdk/schemas). Frames are those of
ROS (REP-103): the vehicle is forward-left-up, the map is east-north-up with its origin at the first solution.

A position is stamped in UTC, as the newest fix states it. Pose and transform have the times of the recording, by which
the 3D panel looks them up.
"""

import json
from collections.abc import Iterator
from math import cos, pi, radians, sin

from ..bus.envelope import Envelope
from ..errors import BadPayload
from ..maths.ellipsoid import curvature_radii
from ..messages.base import Symmetric3
from ..messages.gnss import GnssFix
from ..messages.navigation import NavigationSolution

Json = dict[str, object]
PREFIX = "foxglove/"
SOURCES = ("navigation/solution", "gnss/fix")
MAP, VEHICLE = "map", "base_link"
UNKNOWN, KNOWN = 0, 3  # kinds of covariance


def _object(title: str, properties: Json) -> Json:
    return {"title": title, "type": "object", "properties": properties}


_NUMBER: Json = {"type": "number"}
_TIME = _object("time", {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}})
_VECTOR = _object("foxglove.Vector3", dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _object("foxglove.Quaternion", dict.fromkeys("xyzw", _NUMBER))
_POSE = _object("foxglove.Pose", {"position": _VECTOR, "orientation": _QUATERNION})
_FRAME: Json = {"type": "string"}
SCHEMAS = {
    "foxglove.LocationFix": _object("foxglove.LocationFix", {
        "timestamp": _TIME, "frame_id": _FRAME, "latitude": _NUMBER, "longitude": _NUMBER, "altitude": _NUMBER,
        "position_covariance": {"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
        "position_covariance_type": {"type": "integer", "enum": [0, 1, 2, 3]},
    }),
    "foxglove.PoseInFrame": _object("foxglove.PoseInFrame", {"timestamp": _TIME, "frame_id": _FRAME, "pose": _POSE}),
    "foxglove.FrameTransform": _object("foxglove.FrameTransform", {
        "timestamp": _TIME, "parent_frame_id": _FRAME, "child_frame_id": _FRAME,
        "translation": _VECTOR, "rotation": _QUATERNION,
    }),
}  # fmt: skip
TOPICS = {
    f"{PREFIX}solution": "foxglove.LocationFix",
    f"{PREFIX}gnss_fix": "foxglove.LocationFix",
    f"{PREFIX}pose": "foxglove.PoseInFrame",
    f"{PREFIX}transform": "foxglove.FrameTransform",
}


class Foxglove:
    """Makes the messages of one recording; its first solution is the origin of the map."""

    def __init__(self) -> None:
        self._origin: NavigationSolution | None = None
        self._utc_offset_ns = 0  # UTC less the unit's time line, as the newest fix states it

    def messages(self, envelope: Envelope) -> Iterator[tuple[str, bytes]]:
        """Yield topic and payload of the derived messages; none for a message that cannot be decoded."""
        if envelope.topic not in SOURCES:
            return
        try:
            message = envelope.decode()
        except BadPayload:
            return
        if isinstance(message, GnssFix) and message.utc_ns is not None:
            self._utc_offset_ns = message.utc_ns - message.sampled_ns
        if isinstance(message, NavigationSolution):
            for topic, content in self._of_solution(message):
                yield topic, json.dumps(content).encode()
        elif isinstance(message, GnssFix) and message.latitude_deg is not None and message.longitude_deg is not None:
            yield f"{PREFIX}gnss_fix", json.dumps({
                "timestamp": _time(message.sampled_ns + self._utc_offset_ns), "frame_id": "gnss",
                "latitude": message.latitude_deg, "longitude": message.longitude_deg,
                "altitude": message.height_ellipsoid_m or 0.0, **_covariance(message.position_cov_ned_m2),
            }).encode()  # fmt: skip

    def _of_solution(self, s: NavigationSolution) -> Iterator[tuple[str, Json]]:
        self._origin = self._origin or s
        time = _time(s.sampled_ns)
        yield f"{PREFIX}solution", {
            "timestamp": _time(s.sampled_ns + self._utc_offset_ns), "frame_id": VEHICLE,
            "latitude": s.latitude_deg, "longitude": s.longitude_deg,
            "altitude": s.height_ellipsoid_m, **_covariance(s.position_cov_ned_m2),
        }  # fmt: skip
        east, north, up = east_north_up(s, self._origin)
        x, y, z, w = quaternion_enu_from_flu(s.roll_rad, s.pitch_rad, s.yaw_rad)
        position, rotation = {"x": east, "y": north, "z": up}, {"x": x, "y": y, "z": z, "w": w}
        pose = {"position": position, "orientation": rotation}
        yield f"{PREFIX}pose", {"timestamp": time, "frame_id": MAP, "pose": pose}
        yield f"{PREFIX}transform", {
            "timestamp": time, "parent_frame_id": MAP, "child_frame_id": VEHICLE,
            "translation": position, "rotation": rotation,
        }  # fmt: skip


def east_north_up(s: NavigationSolution, origin: NavigationSolution) -> tuple[float, float, float]:
    """Give the offset [m] of a solution from another, by the radii of curvature at the origin."""
    latitude = radians(origin.latitude_deg)
    meridian, transverse = curvature_radii(latitude)
    east_deg = (s.longitude_deg - origin.longitude_deg + 180.0) % 360.0 - 180.0
    return (
        radians(east_deg) * transverse * cos(latitude),
        radians(s.latitude_deg - origin.latitude_deg) * meridian,
        s.height_ellipsoid_m - origin.height_ellipsoid_m,
    )


def quaternion_enu_from_flu(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Give the attitude as x, y, z, w between the frames of ROS.

    Parameters
    ----------
    roll, pitch, yaw : float
        [rad] Of the forward-right-down body against north-east-down, applied in the order yaw, pitch, roll.

    Notes
    -----
    With y and z of both frames turned round, roll stays, pitch changes its sign, and yaw counts from east,
    counter-clockwise: π/2 - yaw.
    """
    cr, sr = cos(roll / 2.0), sin(roll / 2.0)
    cp, sp = cos(-pitch / 2.0), sin(-pitch / 2.0)
    cy, sy = cos((pi / 2.0 - yaw) / 2.0), sin((pi / 2.0 - yaw) / 2.0)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _covariance(ned: Symmetric3 | None) -> Json:
    """Give the covariance [m²] row by row in east-north-up."""
    if ned is None:
        return {"position_covariance": [0.0] * 9, "position_covariance_type": UNKNOWN}
    nn, ne, nd, ee, ed, dd = ned
    return {"position_covariance": [ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd], "position_covariance_type": KNOWN}


def _time(stamp_ns: int) -> Json:
    seconds, rest = divmod(max(stamp_ns, 0), 1_000_000_000)
    return {"sec": seconds, "nsec": rest}
