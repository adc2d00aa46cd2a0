"""The UBX messages that make up a fix, decoded to SI units.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), section 3.15 UBX-NAV.
"""

import math
import struct
from dataclasses import dataclass

from shared.messages import CarrierSolution, Constellation, FixType, Satellite, Symmetric3

NAV = 0x01
KINDS = {0x04: "DOP", 0x07: "PVT", 0x14: "HPPOSLLH", 0x35: "SAT", 0x36: "COV", 0x61: "EOE"}
WEEK_MS = 604_800_000

_PVT = struct.Struct("<IH5BBIi4B4iII4iiIIH")
_DOP = struct.Struct("<I7H")
_COV = struct.Struct("<IBBB9x12f")
_HPPOSLLH = struct.Struct("<B2xBI4i4bII")
_SAT = struct.Struct("<BBBbhhI")
_FIX_TYPES = tuple(FixType)
_CARRIER = (CarrierSolution.NONE, CarrierSolution.FLOAT, CarrierSolution.FIXED, CarrierSolution.NONE)
_CONSTELLATIONS = (
    Constellation.GPS,
    Constellation.SBAS,
    Constellation.GALILEO,
    Constellation.BEIDOU,
    Constellation.UNKNOWN,  # IMES
    Constellation.QZSS,
    Constellation.GLONASS,
    Constellation.NAVIC,
)
# Upper ends [s] of the classes of the age of the corrections; class 0 is "not available".
_CORRECTION_AGES = (None, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120, 120)
_NO_ACCURACY = 0xFFFFFFFF


class UbxError(ValueError):
    """A message with a good checksum whose content cannot be."""


@dataclass(frozen=True, slots=True)
class Position:
    """A position and its accuracy as the receiver states it."""

    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float
    horizontal_sd_m: float | None  # of the distance, not of one axis
    vertical_sd_m: float | None


@dataclass(frozen=True, slots=True)
class Pvt:
    """UBX-NAV-PVT."""

    itow_ms: int
    calendar: tuple[int, int, int, int, int, int]  # UTC: year, month, day, hour, minute, second
    nanosecond: int
    time_valid: bool
    fix_type: FixType
    fix_ok: bool
    differential: bool
    carrier_solution: CarrierSolution
    satellites_used: int
    position: Position | None
    velocity_ned_m_s: tuple[float, float, float]
    speed_sd_m_s: float | None
    ground_speed_m_s: float
    course_rad: float
    pdop: float | None
    correction_age_s: float | None


@dataclass(frozen=True, slots=True)
class Dop:
    """UBX-NAV-DOP."""

    itow_ms: int
    pdop: float | None
    vdop: float | None
    hdop: float | None


@dataclass(frozen=True, slots=True)
class Covariance:
    """UBX-NAV-COV; a matrix that is not valid is None."""

    itow_ms: int
    position_ned_m2: Symmetric3 | None
    velocity_ned_m2_s2: Symmetric3 | None


@dataclass(frozen=True, slots=True)
class HighPrecision:
    """UBX-NAV-HPPOSLLH."""

    itow_ms: int
    position: Position | None


def itow_ms(kind: str, payload: bytes) -> int:
    """Read the time of week, which every message of an epoch carries."""
    offset = 4 if kind == "HPPOSLLH" else 0
    if len(payload) < offset + 4:
        raise UbxError("short")
    (value,) = struct.unpack_from("<I", payload, offset)
    if value >= WEEK_MS:
        raise UbxError("time_of_week")
    return int(value)


def decode_pvt(payload: bytes) -> Pvt:
    """Decode UBX-NAV-PVT."""
    (
        itow, year, month, day, hour, minute, second, valid, _, nanosecond,
        fix_type, flags, _, satellites, longitude, latitude, height, msl, h_acc, v_acc,
        north, east, down, ground_speed, course, s_acc, _, pdop,
    ) = _unpack(_PVT, payload)  # fmt: skip
    flags3 = payload[78] if len(payload) >= 92 else 0  # 84 bytes before protocol 15
    if fix_type >= len(_FIX_TYPES):
        raise UbxError("fix_type")
    position = _position((latitude * 1e-7, longitude * 1e-7), (height * 1e-3, msl * 1e-3), (h_acc, v_acc, 1e-3))
    age = flags3 >> 1 & 15
    return Pvt(
        itow_ms=itow,
        calendar=(year, month, day, hour, minute, second),
        nanosecond=nanosecond,
        time_valid=valid & 7 == 7,  # date, time, and no uncertainty of whole seconds
        fix_type=_FIX_TYPES[fix_type],
        fix_ok=bool(flags & 1),
        differential=bool(flags & 2),
        carrier_solution=_CARRIER[flags >> 6],
        satellites_used=satellites,
        position=None if flags3 & 1 else position,
        velocity_ned_m_s=(north * 1e-3, east * 1e-3, down * 1e-3),
        speed_sd_m_s=_accuracy(s_acc, 1e-3),
        ground_speed_m_s=ground_speed * 1e-3,
        course_rad=math.radians(course * 1e-5),
        pdop=_dop(pdop),
        correction_age_s=_CORRECTION_AGES[age] if age < len(_CORRECTION_AGES) else None,
    )


def decode_dop(payload: bytes) -> Dop:
    """Decode UBX-NAV-DOP."""
    itow, _, position, _, vertical, horizontal, _, _ = _unpack(_DOP, payload)
    return Dop(itow, _dop(position), _dop(vertical), _dop(horizontal))


def decode_covariance(payload: bytes) -> Covariance:
    """Decode UBX-NAV-COV; raises UbxError for a matrix that is called valid and is none."""
    itow, _, position_valid, velocity_valid, *terms = _unpack(_COV, payload)
    position = _symmetric(terms[:6]) if position_valid else None
    return Covariance(itow, position, _symmetric(terms[6:]) if velocity_valid else None)


def decode_high_precision(payload: bytes) -> HighPrecision:
    """Decode UBX-NAV-HPPOSLLH."""
    (
        _, flags, itow, longitude, latitude, height, msl, longitude_hp, latitude_hp, height_hp, msl_hp, h_acc, v_acc,
    ) = _unpack(_HPPOSLLH, payload)  # fmt: skip
    place = (latitude * 1e-7 + latitude_hp * 1e-9, longitude * 1e-7 + longitude_hp * 1e-9)
    heights = (height * 1e-3 + height_hp * 1e-4, msl * 1e-3 + msl_hp * 1e-4)
    return HighPrecision(itow, None if flags & 1 else _position(place, heights, (h_acc, v_acc, 1e-4)))


def decode_satellites(payload: bytes) -> tuple[Satellite, ...]:
    """Decode the satellites of UBX-NAV-SAT."""
    if len(payload) < 8 or len(payload) != 8 + 12 * payload[5]:
        raise UbxError("short")
    return tuple(_satellite(*fields) for fields in _SAT.iter_unpack(payload[8:]))


def _satellite(
    system: int, number: int, cn0: int, elevation: int, azimuth: int, residual: int, flags: int
) -> Satellite:
    located = -90 <= elevation <= 90 and 0 <= azimuth <= 360
    return Satellite(
        constellation=_CONSTELLATIONS[system] if system < len(_CONSTELLATIONS) else Constellation.UNKNOWN,
        number=number,
        cn0_db_hz=float(cn0) if cn0 else None,
        elevation_rad=math.radians(elevation) if located else None,
        azimuth_rad=math.radians(azimuth) if located else None,
        residual_m=residual * 0.1 if flags & 8 else None,
        used=bool(flags & 8),
    )


def _unpack(layout: struct.Struct, payload: bytes) -> tuple[int, ...]:
    if len(payload) < layout.size:
        raise UbxError("short")
    return layout.unpack_from(payload)


def _position(
    place_deg: tuple[float, float], heights_m: tuple[float, float], accuracy: tuple[int, int, float]
) -> Position | None:
    latitude_deg, longitude_deg = place_deg
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and abs(heights_m[0]) < 100e3):
        return None
    horizontal, vertical, unit_m = accuracy
    return Position(latitude_deg, longitude_deg, *heights_m, _accuracy(horizontal, unit_m), _accuracy(vertical, unit_m))


def _accuracy(raw: int, unit: float) -> float | None:
    return raw * unit if 0 < raw < _NO_ACCURACY else None


def _dop(raw: int) -> float | None:
    return raw * 0.01 if 0 < raw < 9999 else None


def _symmetric(terms: "list[int] | list[float]") -> Symmetric3:
    nn, ne, nd, ee, ed, dd = (float(term) for term in terms)
    minors = (nn, nn * ee - ne * ne, nn * (ee * dd - ed * ed) - ne * (ne * dd - ed * nd) + nd * (ne * ed - ee * nd))
    if not all(math.isfinite(minor) and minor > 0 for minor in minors):
        raise UbxError("covariance")
    return nn, ne, nd, ee, ed, dd
