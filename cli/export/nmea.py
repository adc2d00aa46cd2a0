"""Formats positions as NMEA 0183: GGA and RMC of each, with checksums."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime

import pynmea2

from .positions import Position, quality

TALKER = "GN"
KNOT = 1852.0 / 3600.0  # [m/s] by definition
MODES = {1: "A", 2: "D", 4: "R", 5: "F", 6: "E"}  # of RMC, by the quality of GGA


def nmea_lines(positions: Iterable[Position]) -> Iterator[str]:
    """Format positions; a height above mean sea level is given where the receiver stated the geoid's height."""
    for position in positions:
        yield f"{gga(position)}\r\n"
        yield f"{rmc(position)}\r\n"


def gga(position: Position) -> pynmea2.GGA:
    """Make the sentence GGA: fix data."""
    separation = geoid_height_m(position)
    known = separation is not None and position.height_ellipsoid_m is not None
    altitude = "" if not known else f"{(position.height_ellipsoid_m or 0.0) - (separation or 0.0):.3f}"
    fix = position.fix
    return pynmea2.GGA(TALKER, "GGA", (  # type: ignore[no-untyped-call]  # pynmea2 has no types
        _time(position), *_coordinates(position), str(quality(position)),
        _text(fix.satellites_used if fix else None, "{:02d}"), _text(fix.hdop if fix else None, "{:.2f}"),
        altitude, "M", _text(separation, "{:.3f}"), "M", _text(fix.correction_age_s if fix else None, "{:.1f}"), "",
    ))  # fmt: skip


def rmc(position: Position) -> pynmea2.RMC:
    """Make the sentence RMC: the recommended minimum."""
    at = datetime.fromtimestamp(position.time_ns // 1_000_000_000, UTC)
    speed = None if position.speed_m_s is None else position.speed_m_s / KNOT
    return pynmea2.RMC(TALKER, "RMC", (  # type: ignore[no-untyped-call]  # pynmea2 has no types
        _time(position), "A", *_coordinates(position), _text(speed, "{:.3f}"),
        _text(position.course_deg, "{:.2f}"), f"{at:%d%m%y}", "", "", MODES[quality(position)],
    ))  # fmt: skip


def geoid_height_m(position: Position) -> float | None:
    """Give the height of the geoid above the ellipsoid as the receiver stated it [m]."""
    fix = position.fix
    if fix is None or fix.height_msl_m is None or fix.height_ellipsoid_m is None:
        return None
    return fix.height_ellipsoid_m - fix.height_msl_m


def _time(position: Position) -> str:
    milliseconds = position.time_ns // 1_000_000
    at = datetime.fromtimestamp(milliseconds // 1000, UTC)
    return f"{at:%H%M%S}.{milliseconds % 1000:03d}"


def _coordinates(position: Position) -> tuple[str, str, str, str]:
    """Write latitude and longitude in degrees and minutes, to 1e-7 minutes, which is 0.2 mm."""
    return (
        _minutes(abs(position.latitude_deg), 2), "N" if position.latitude_deg >= 0 else "S",
        _minutes(abs(position.longitude_deg), 3), "E" if position.longitude_deg >= 0 else "W",
    )  # fmt: skip


def _minutes(angle_deg: float, digits: int) -> str:
    units = round(angle_deg * 60e7)  # of 1e-7 minutes, so that 59.99999999 minutes do not become 60
    whole, rest = divmod(units, 600_000_000)
    return f"{whole:0{digits}d}{rest // 10_000_000:02d}.{rest % 10_000_000:07d}"


def _text(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
