"""Fixes of Android's receiver."""

import math

from shared.messages.gnss import FixType, GnssFix
from shared.protocols.gnss_logger import Row, number

MS = 1_000_000
MAX_UTC_MS = float((1 << 62) // MS)  # year 2116; in nanoseconds within 64 bits, with room for a mapping of clocks
AXIS = math.sqrt(-2.0 * math.log(0.32))  # radius of 68 %, which Android states, over the deviation of an axis: 1.51


def fix_of(row: Row) -> GnssFix | None:
    """Fix of a row, stamped by its UTC; None without position or time."""
    latitude, longitude, utc_ms = (
        number(row, name) for name in ("latitudedegrees", "longitudedegrees", "unixtimemillis")
    )
    if latitude is None or longitude is None or utc_ms is None or abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return None
    if not 0.0 <= utc_ms < MAX_UTC_MS:
        return None
    speed, bearing = number(row, "speedmps"), number(row, "bearingdegrees")
    horizontal, vertical = number(row, "accuracymeters"), number(row, "verticalaccuracymeters")
    axis = None if not horizontal else horizontal / AXIS
    utc_ns = round(utc_ms) * MS
    return GnssFix(
        sampled_ns=utc_ns, received_ns=utc_ns, source="phone", utc_ns=utc_ns, fix_type=FixType.THREE_D,
        latitude_deg=latitude, longitude_deg=longitude, height_ellipsoid_m=number(row, "altitudemeters"),
        ground_speed_m_s=speed, course_rad=None if bearing is None else math.radians(bearing),
        position_sd_ned_m=(axis, axis, vertical) if axis and vertical else None,
    )  # fmt: skip
