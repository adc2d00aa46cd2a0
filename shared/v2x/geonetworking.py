"""GeoNetworking single-hop broadcast with BTP-B, the headers around a CAM on ITS-G5.

Layout (EN 302 636-4-1 clause 9, EN 302 636-5-1 clause 7), big-endian: basic header 4 bytes, common header 8,
source position vector 24, media-dependent data 4, BTP-B 4, payload.
"""

import math
import struct
from dataclasses import dataclass

from ..errors import RejectedFrame

VERSION = 1
CAM_PORT = 2001  # TS 103 248
BASIC_NEXT_COMMON, BASIC_NEXT_SECURED = 1, 2
COMMON_NEXT_BTP_B = 2
SINGLE_HOP_BROADCAST = 0x50  # header type 5 (topologically scoped broadcast), subtype 0
MOBILE = 0x80  # flag of the common header: the station is mobile
LIFETIME_1_S = 1 << 2 | 1  # multiplier 1, base 1 s
TRAFFIC_CLASS_CAM = 2  # TC ID of CAM, TS 102 636-4-2

BASIC = struct.Struct(">BBBB")  # version and next header, reserved, lifetime, remaining hop limit
COMMON = struct.Struct(">BBBBHBB")  # next header, type, traffic class, flags, payload length, maximum hop limit, -
POSITION = struct.Struct(">H6sIiiHH")  # station type, MAC address, time, latitude, longitude, accuracy + speed, heading
MEDIA_DEPENDENT = struct.Struct(">I")
BTP_B = struct.Struct(">HH")  # destination port, destination port info
COMMON_AT = BASIC.size
POSITION_AT = COMMON_AT + COMMON.size
BTP_AT = POSITION_AT + POSITION.size + MEDIA_DEPENDENT.size
PAYLOAD_AT = BTP_AT + BTP_B.size

HEADING_PER_RAD = 1800 / math.pi  # 0.1 degrees
MAX_SPEED = 0x3FFF  # 15 bits, signed, 0.01 m/s
TIME_CYCLE_MS = 1 << 32  # of the time in a position vector: 49.7 days


@dataclass(frozen=True)
class PositionVector:
    """Long position vector of the sender: address, time modulo 2^32 ms, position, speed and heading."""

    mac_address: bytes  # 6 bytes
    station_type: int  # of TS 102 894-2, 5 bits
    its_time_ms: int
    latitude_deg: float
    longitude_deg: float
    accurate: bool  # the station holds its position to be within the configured accuracy
    speed_m_s: float
    heading_rad: float


def decode_payload(packet: bytes) -> bytes:
    """Return the payload of a single-hop broadcast to the BTP port of the CAM.

    Only what delimits the payload is examined: the position of the sender is in the CAM itself.

    Raises
    ------
    RejectedFrame
        With the reason `truncated`, `geonetworking_version`, `network_header` (also of a secured packet, which
        `shared/v2x/security/envelope.py` unwraps), `packet_type`, `transport` or `port`.
    """
    if len(packet) < PAYLOAD_AT:
        raise RejectedFrame("truncated", len(packet))
    version, basic_next = packet[0] >> 4, packet[0] & 0xF
    if version != VERSION:
        raise RejectedFrame("geonetworking_version", version)
    if basic_next != BASIC_NEXT_COMMON:
        raise RejectedFrame("network_header", basic_next)
    next_header, packet_type, _, _, length, _, _ = COMMON.unpack_from(packet, COMMON_AT)
    if packet_type != SINGLE_HOP_BROADCAST:
        raise RejectedFrame("packet_type", hex(packet_type))
    if next_header >> 4 != COMMON_NEXT_BTP_B:
        raise RejectedFrame("transport", next_header >> 4)
    if not BTP_B.size <= length <= len(packet) - BTP_AT:
        raise RejectedFrame("truncated", length)
    port, _ = BTP_B.unpack_from(packet, BTP_AT)
    if port != CAM_PORT:
        raise RejectedFrame("port", port)
    return packet[PAYLOAD_AT : BTP_AT + length]


def stated_length(packet: bytes) -> int:
    """Length [bytes] that a packet states which `decode_payload` accepts; what is behind it is of no layer."""
    return BTP_AT + int(COMMON.unpack_from(packet, COMMON_AT)[4])


def source_time_ms(packet: bytes) -> int:
    """Return the ITS time, modulo 2^32 ms, of the position vector in a packet that `decode_payload` accepts."""
    return int(POSITION.unpack_from(packet, POSITION_AT)[2])


def pseudonymous_address(station_id: int) -> bytes:
    """MAC address made from a pseudonym: locally administered, so that it reveals no more than the station id."""
    return b"\x02\x00" + station_id.to_bytes(4, "big")


def encode_packet(payload: bytes, sender: PositionVector, *, mobile: bool = True) -> bytes:
    """Put a payload into a single-hop broadcast to the BTP port of the CAM."""
    speed = max(-MAX_SPEED - 1, min(MAX_SPEED, round(sender.speed_m_s * 100)))
    return b"".join(
        (
            BASIC.pack(VERSION << 4 | BASIC_NEXT_COMMON, 0, LIFETIME_1_S, 1),
            COMMON.pack(
                COMMON_NEXT_BTP_B << 4,
                SINGLE_HOP_BROADCAST,
                TRAFFIC_CLASS_CAM,
                MOBILE if mobile else 0,
                BTP_B.size + len(payload),
                1,
                0,
            ),
            POSITION.pack(
                (sender.station_type & 0x1F) << 10,
                sender.mac_address,
                sender.its_time_ms % TIME_CYCLE_MS,
                round(sender.latitude_deg * 1e7),
                round(sender.longitude_deg * 1e7),
                sender.accurate << 15 | speed & 0x7FFF,
                round(sender.heading_rad * HEADING_PER_RAD) % 3600,
            ),
            MEDIA_DEPENDENT.pack(0),
            BTP_B.pack(CAM_PORT, 0),
            payload,
        )
    )
