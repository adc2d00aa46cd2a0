"""Decodes the UBX messages of a fix to SI units; invalid values are None.

Each message is a `struct` here: pyubx2 takes 58 % of the time of an epoch of NAV-PVT. Tests compare every field with
what pyubx2 reads from the same bytes.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), section 3.15 UBX-NAV; NAV-SOL, NAV-VELNED and
NAV-POSLLH as in u-blox M8 (UBX-13003221); NAV-PVAT as in u-blox F9 HPS 1.30 (UBX-22010984).
"""

import math
import struct
from dataclasses import dataclass

from shared.maths.dates import GPS_EPOCH_UTC_NS, NS, WEEK_NS
from shared.maths.ellipsoid import Geodetic, geodetic_from_ecef
from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierSolution, Constellation, FixType, GnssSignal, Satellite, SignalQuality

from ..dialect import ContentError
from ..gnss_time import MS, utc_ns

WEEK_MS = 604_800_000
SIZES = {
    "EOE": 4, "STATUS": 16, "TIMEGPS": 16, "DOP": 18, "TIMEUTC": 20, "POSLLH": 28, "HPPOSLLH": 36, "VELNED": 36,
    "SOL": 52, "PL": 52, "COV": 64, "RELPOSNED": 64, "PVT": 78, "PVAT": 116,
}  # [bytes] minimum payload  # fmt: skip
_PVT_WITH_FLAGS3 = 92  # [bytes] since protocol 15; reserved in the earlier 84-byte form
_VERSION_FIRST = {"HPPOSLLH": 4, "RELPOSNED": 4, "PL": 12}  # offset of the time of week where it is not the first field
_UNKNOWN_TIME_NS = 1_000_000_000  # accuracies of a second and more: the time is not known
_PVT = struct.Struct("<IH6BIi4B4i2I5i2IH")
_PVAT = struct.Struct("<IxBH5B3x4xi4B4i2I4iI12xi")
_DOP = struct.Struct("<I5H")
_COV = struct.Struct("<IxBB9x12f")
_POSITION = struct.Struct("<I4i2I")
_HIGH_PRECISION = struct.Struct("<3xBI4i4b2I")
_BASELINE = struct.Struct("<8x12xii20x4xI4xI")
_SOLUTION = struct.Struct("<I6xBB3iI3iIHxB4x")
_VELOCITY = struct.Struct("<I3i4xIiI4x")
_TIME_UTC = struct.Struct("<I4xiH6B")
_TIME_GPS = struct.Struct("<IihbB")
_LEVELS = struct.Struct("<3x3B6xI3I")
_SAT = struct.Struct("<BBBbhhI")
_SIG = struct.Struct("<BBBxhBBxxH4x")
# Signals by (gnssId, sigId), as the observation codes of RINEX 3.05 name them.
SIGNALS = {
    (0, 0): "1C", (0, 3): "2L", (0, 4): "2S", (0, 6): "5I", (0, 7): "5Q",
    (1, 0): "1C",
    (2, 0): "1C", (2, 1): "1B", (2, 3): "5I", (2, 4): "5Q", (2, 5): "7I", (2, 6): "7Q",
    (3, 0): "2I", (3, 1): "2I", (3, 2): "7I", (3, 3): "7I", (3, 5): "1P", (3, 7): "5P",
    (5, 0): "1C", (5, 1): "1Z", (5, 4): "2S", (5, 5): "2L", (5, 8): "5I", (5, 9): "5Q",
    (6, 0): "1C", (6, 2): "2C", (7, 0): "5A",
}  # fmt: skip
_FIX_TYPES = tuple(FixType)
_CARRIER = (CarrierSolution.NONE, CarrierSolution.FLOAT, CarrierSolution.FIXED, CarrierSolution.NONE)
_QUALITIES = (*SignalQuality, SignalQuality.CARRIER_LOCKED, SignalQuality.CARRIER_LOCKED)  # 5 to 7: carrier locked
_HEALTH = (None, True, False, None)
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
# Upper bounds [s] of the classes of the correction age; class 0 is "not available".
_CORRECTION_AGES = (None, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120, 120)
_NO_ACCURACY = 0xFFFFFFFF  # [resolution of the field] "unknown"
HIGHEST_M = 100e3
MIN_RADIUS_CM = 6e8  # below it coordinates in ECEF are those of no place on Earth: a receiver without a fix says 0


class UbxError(ContentError):
    """A message with a valid checksum and invalid content; a reject `ubx_<fault>`."""

    def __str__(self) -> str:
        """The kind of reject."""
        return f"ubx_{self.args[0]}"


@dataclass(frozen=True, slots=True)
class Position:
    """A position and its accuracy as the receiver states it."""

    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float | None
    horizontal_sd_m: float | None  # of the horizontal distance (root sum of squares of both axes)
    vertical_sd_m: float | None


@dataclass(frozen=True, slots=True)
class Status:
    """What kind of fix it is, by UBX-NAV-SOL or NAV-STATUS."""

    fix_type: FixType
    fix_ok: bool
    differential: bool


@dataclass(frozen=True, slots=True)
class Motion:
    """A velocity by UBX-NAV-VELNED or NAV-SOL."""

    velocity_ned_m_s: tuple[float, float, float]
    speed_sd_m_s: float | None  # of the length of the error in space
    ground_speed_m_s: float
    course_rad: float


@dataclass(frozen=True, slots=True)
class Solution:
    """UBX-NAV-SOL: the fix in ECEF."""

    status: Status
    position: Position | None
    motion: Motion | None
    satellites_used: int
    pdop: float | None


@dataclass(frozen=True, slots=True)
class Pvt:
    """UBX-NAV-PVT, NAV-PVAT, or what several older messages tell together."""

    itow_ms: int
    utc_ns: int | None  # None for an impossible date
    time_valid: bool
    time_sd_ns: int | None
    fix_type: FixType
    fix_ok: bool
    differential: bool
    carrier_solution: CarrierSolution
    satellites_used: int | None
    position: Position | None
    velocity_ned_m_s: tuple[float, float, float] | None
    speed_sd_m_s: float | None
    ground_speed_m_s: float | None
    course_rad: float | None
    pdop: float | None
    correction_age_s: float | None


@dataclass(frozen=True, slots=True)
class Dop:
    """UBX-NAV-DOP."""

    pdop: float | None
    vdop: float | None
    hdop: float | None
    gdop: float | None = None
    tdop: float | None = None


@dataclass(frozen=True, slots=True)
class Covariance:
    """UBX-NAV-COV; a matrix that is not valid is None."""

    position_ned_m2: Symmetric3 | None
    velocity_ned_m2_s2: Symmetric3 | None


@dataclass(frozen=True, slots=True)
class Baseline:
    """UBX-NAV-RELPOSNED of a moving base: the baseline from the base antenna to the rover antenna."""

    heading_rad: float | None  # None unless both antennas are on the vehicle and the ambiguities are fixed
    heading_sd_rad: float | None
    length_m: float | None


@dataclass(frozen=True, slots=True)
class Levels:
    """UBX-NAV-PL: the protection levels of the receiver itself."""

    horizontal_m: float | None
    vertical_m: float | None
    ned_m: tuple[float, float, float] | None = None  # of the axes, where they are those of north and east


def itow_of(kind: str, payload: bytes) -> int:
    """Time of week of a message of `SIZES` [ms]; raises UbxError for a truncated or an invalid one."""
    if len(payload) < SIZES[kind]:
        raise UbxError("short")
    start = _VERSION_FIRST.get(kind, 0)
    return _in_week(int.from_bytes(payload[start : start + 4], "little"))


def decode_pvt(payload: bytes) -> Pvt:
    """Decode UBX-NAV-PVT; raises UbxError for an unknown fix type."""
    (
        itow, year, month, day, hour, minute, second, valid, t_acc, nano, fix_type, flags, _, satellites, lon, lat,
        height, msl, h_acc, v_acc, vel_n, vel_e, vel_d, speed, course, s_acc, _, pdop,
    ) = _PVT.unpack_from(payload)  # fmt: skip
    flags3 = int.from_bytes(payload[78:80], "little") if len(payload) >= _PVT_WITH_FLAGS3 else 0
    age = flags3 >> 1 & 15
    return Pvt(
        itow_ms=itow,
        utc_ns=utc_ns((year, month, day, hour, minute, second), nano),
        time_valid=valid & 7 == 7,
        time_sd_ns=t_acc if 0 < t_acc < _UNKNOWN_TIME_NS else None,
        fix_type=_fix_type(fix_type),
        fix_ok=bool(flags & 1),
        differential=bool(flags & 2),
        carrier_solution=_CARRIER[flags >> 6],
        satellites_used=satellites,
        position=None if flags3 & 1 else _position(lon / 1e7, lat / 1e7, height, msl, h_acc, v_acc),
        velocity_ned_m_s=(vel_n * 1e-3, vel_e * 1e-3, vel_d * 1e-3),
        speed_sd_m_s=_accuracy(s_acc, 1e-3),
        ground_speed_m_s=speed * 1e-3,
        course_rad=math.radians(course / 1e5),
        pdop=_dop(pdop),
        correction_age_s=_CORRECTION_AGES[age] if age < len(_CORRECTION_AGES) else None,
    )


def decode_pvat(payload: bytes) -> Pvt:
    """Decode UBX-NAV-PVAT; raises UbxError for an unknown fix type. Its attitude is that of the receiver's filter."""
    (
        itow, valid, year, month, day, hour, minute, second, nano, fix_type, flags, _, satellites, lon, lat, height,
        msl, h_acc, v_acc, vel_n, vel_e, vel_d, speed, s_acc, course,
    ) = _PVAT.unpack_from(payload)  # fmt: skip
    return Pvt(
        itow_ms=itow,
        utc_ns=utc_ns((year, month, day, hour, minute, second), nano),
        time_valid=valid & 7 == 7,
        time_sd_ns=None,
        fix_type=_fix_type(fix_type),
        fix_ok=bool(flags & 1),
        differential=bool(flags & 2),
        carrier_solution=_CARRIER[flags >> 6],
        satellites_used=satellites,
        position=_position(lon / 1e7, lat / 1e7, height, msl, h_acc, v_acc),
        velocity_ned_m_s=(vel_n * 1e-3, vel_e * 1e-3, vel_d * 1e-3),
        speed_sd_m_s=_accuracy(s_acc, 1e-3),
        ground_speed_m_s=speed * 1e-3,
        course_rad=math.radians(course / 1e5),
        pdop=None,
        correction_age_s=None,
    )


def decode_dop(payload: bytes) -> Dop:
    """Decode UBX-NAV-DOP."""
    _, gdop, pdop, tdop, vdop, hdop = _DOP.unpack_from(payload)
    return Dop(_dop(pdop), _dop(vdop), _dop(hdop), _dop(gdop), _dop(tdop))


def decode_covariance(payload: bytes) -> Covariance:
    """Decode UBX-NAV-COV; raises UbxError for a matrix marked valid that is not positive definite."""
    _, position_valid, velocity_valid, *values = _COV.unpack_from(payload)
    return Covariance(
        _symmetric(values[:6]) if position_valid else None, _symmetric(values[6:]) if velocity_valid else None
    )


def decode_position(payload: bytes) -> Position | None:
    """Decode UBX-NAV-POSLLH."""
    _, lon, lat, *rest = _POSITION.unpack_from(payload)
    return _position(lon / 1e7, lat / 1e7, *rest)


def decode_high_precision(payload: bytes) -> Position | None:
    """Decode UBX-NAV-HPPOSLLH: each coordinate has a second field with its further digits."""
    flags, _, lon, lat, height, msl, lon_hp, lat_hp, height_hp, msl_hp, h_acc, v_acc = _HIGH_PRECISION.unpack_from(
        payload
    )
    if flags & 1:
        return None
    lon_deg, lat_deg = (lon * 100 + lon_hp) / 1e9, (lat * 100 + lat_hp) / 1e9
    return _position(lon_deg, lat_deg, height + height_hp * 0.1, msl + msl_hp * 0.1, h_acc, v_acc, digit=1e-4)


def decode_baseline(payload: bytes) -> Baseline:
    """Decode UBX-NAV-RELPOSNED; only a moving base gives the heading of the vehicle."""
    length_cm, heading, heading_sd, flags = _BASELINE.unpack_from(payload)
    wanted = 1 | 4 | 32 | 256  # gnssFixOK, relPosValid, isMoving, relPosHeadingValid
    if flags & wanted != wanted or _CARRIER[flags >> 3 & 3] is not CarrierSolution.FIXED or heading_sd <= 0:
        return Baseline(None, None, None)
    return Baseline(math.radians(heading / 1e5), math.radians(heading_sd / 1e5), length_cm * 1e-2)


def decode_status(payload: bytes) -> Status:
    """Decode the kind of fix of UBX-NAV-STATUS; raises UbxError for an unknown one."""
    return Status(_fix_type(payload[4]), bool(payload[5] & 1), bool(payload[5] & 2))


def decode_solution(payload: bytes) -> Solution:
    """Decode UBX-NAV-SOL, which has no height above the geoid; raises UbxError for an unknown fix type."""
    _, fix_type, flags, x, y, z, p_acc, v_x, v_y, v_z, s_acc, pdop, satellites = _SOLUTION.unpack_from(payload)
    status = Status(_fix_type(fix_type), bool(flags & 1), bool(flags & 2))
    if math.hypot(x, y, z) < MIN_RADIUS_CM:
        return Solution(status, None, None, satellites, _dop(pdop))
    place = geodetic_from_ecef((x * 1e-2, y * 1e-2, z * 1e-2))
    velocity = _ned_from_ecef(place, (v_x * 1e-2, v_y * 1e-2, v_z * 1e-2))
    axis_sd = _accuracy(p_acc, 1e-2 / math.sqrt(3))
    position = Position(
        math.degrees(place.latitude), math.degrees(place.longitude), place.height, None,
        None if axis_sd is None else axis_sd * math.sqrt(2), axis_sd,
    )  # fmt: skip
    motion = Motion(
        velocity, _accuracy(s_acc, 1e-2), math.hypot(velocity[0], velocity[1]),
        math.atan2(velocity[1], velocity[0]) % (2 * math.pi),
    )  # fmt: skip
    within = abs(place.height) < HIGHEST_M
    return Solution(status, position if within else None, motion if within else None, satellites, _dop(pdop))


def decode_velocity(payload: bytes) -> Motion:
    """Decode UBX-NAV-VELNED."""
    _, north, east, down, speed, course, s_acc = _VELOCITY.unpack_from(payload)
    velocity = (north * 1e-2, east * 1e-2, down * 1e-2)
    return Motion(velocity, _accuracy(s_acc, 1e-2), speed * 1e-2, math.radians(course / 1e5))


def decode_time_utc(payload: bytes) -> tuple[int | None, bool]:
    """Decode UBX-NAV-TIMEUTC to UTC [ns], None for an impossible date, and whether it is valid."""
    _, nano, year, month, day, hour, minute, second, valid = _TIME_UTC.unpack_from(payload)
    return utc_ns((year, month, day, hour, minute, second), nano), bool(valid & 4)


def decode_time_gps(payload: bytes) -> tuple[int | None, bool]:
    """Decode UBX-NAV-TIMEGPS to UTC [ns], and whether week, time and leap seconds are valid."""
    itow, fraction_ns, week, leap_s, valid = _TIME_GPS.unpack_from(payload)
    gps_ns = week * WEEK_NS + itow * MS + fraction_ns
    return GPS_EPOCH_UTC_NS + gps_ns - leap_s * NS, valid & 7 == 7


def decode_levels(payload: bytes) -> Levels:
    """Decode UBX-NAV-PL of version 1, whose axes are north and east, along and across, or of an ellipse."""
    valid, frame, _, _, first, second, third = _LEVELS.unpack_from(payload)
    if not valid or frame not in (1, 2, 3):
        return Levels(None, None)
    horizontal = first if frame == 3 else math.hypot(first, second)  # 3: the greater half-axis is the first
    ned_m = (first * 1e-3, second * 1e-3, third * 1e-3) if frame == 1 else None
    return Levels(horizontal * 1e-3, third * 1e-3, ned_m)


def itow_ms(payload: bytes) -> int:
    """Time of week of UBX-NAV-SAT or NAV-SIG [ms]."""
    if len(payload) < 4:
        raise UbxError("short")
    return _in_week(int.from_bytes(payload[:4], "little"))


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
        constellation=constellation_of(system),
        number=number,
        cn0_db_hz=float(cn0) if cn0 else None,
        elevation_rad=math.radians(elevation) if located else None,
        azimuth_rad=math.radians(azimuth) if located else None,
        residual_m=residual * 0.1 if flags & 8 else None,
        used=bool(flags & 8),
        quality=_QUALITIES[flags & 7],
        healthy=_HEALTH[flags >> 4 & 3],
        orbit_known=bool(flags >> 8 & 7),
    )


def decode_signals(payload: bytes) -> tuple[GnssSignal, ...]:
    """Decode the signals of UBX-NAV-SIG; raises UbxError for a length that does not fit their number."""
    if len(payload) < 8 or len(payload) != 8 + 16 * payload[5]:
        raise UbxError("short")
    return tuple(_signal(*fields) for fields in _SIG.iter_unpack(payload[8:]))


def _signal(system: int, number: int, kind: int, residual: int, cn0: int, quality: int, flags: int) -> GnssSignal:
    used = bool(flags & 8)
    return GnssSignal(
        constellation=constellation_of(system),
        number=number,
        signal=SIGNALS.get((system, kind)),
        cn0_db_hz=float(cn0) if cn0 else None,
        quality=_QUALITIES[quality & 7],
        healthy=_HEALTH[flags & 3],
        residual_m=residual * 0.1 if used else None,
        pseudorange_used=used,
        carrier_phase_used=bool(flags & 16),
        doppler_used=bool(flags & 32),
        corrected=bool(flags & 64),
    )


def constellation_of(gnss_id: int) -> Constellation:
    """Name the constellation of a gnssId; `UNKNOWN` for one that is not assigned."""
    return _CONSTELLATIONS[gnss_id] if gnss_id < len(_CONSTELLATIONS) else Constellation.UNKNOWN


def _in_week(itow_ms: int) -> int:
    if itow_ms >= WEEK_MS:
        raise UbxError("time_of_week")
    return itow_ms


def _fix_type(number: int) -> FixType:
    if number >= len(_FIX_TYPES):
        raise UbxError("fix_type")
    return _FIX_TYPES[number]


def _position(
    longitude_deg: float,
    latitude_deg: float,
    height_mm: float,
    msl_mm: float,
    h_acc: int,
    v_acc: int,
    *,
    digit: float = 1e-3,
) -> Position | None:
    """Position with accuracies of a digit [m]; None for an impossible place."""
    height_m = height_mm * 1e-3
    if abs(latitude_deg) > 90 or abs(longitude_deg) > 180 or abs(height_m) >= HIGHEST_M:
        return None
    accuracies = _accuracy(h_acc, digit), _accuracy(v_acc, digit)
    return Position(latitude_deg, longitude_deg, height_m, msl_mm * 1e-3, *accuracies)


def _accuracy(value: int, digit: float) -> float | None:
    return value * digit if 0 < value < _NO_ACCURACY else None


def _dop(value: int) -> float | None:
    return value / 100 if 0 < value < 9999 else None


def _symmetric(values: list[float]) -> Symmetric3:
    nn, ne, nd, ee, ed, dd = values
    minors = (nn, nn * ee - ne * ne, nn * (ee * dd - ed * ed) - ne * (ne * dd - ed * nd) + nd * (ne * ed - ee * nd))
    if not all(math.isfinite(minor) and minor > 0 for minor in minors):
        raise UbxError("covariance")
    return nn, ne, nd, ee, ed, dd


def _ned_from_ecef(place: Geodetic, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Turn a vector of ECEF to north, east, down at a place (Groves 2.150)."""
    sin_lat, cos_lat = math.sin(place.latitude), math.cos(place.latitude)
    sin_lon, cos_lon = math.sin(place.longitude), math.cos(place.longitude)
    outward = vector[0] * cos_lon + vector[1] * sin_lon
    return (
        vector[2] * cos_lat - outward * sin_lat,
        vector[1] * cos_lon - vector[0] * sin_lon,
        -outward * cos_lat - vector[2] * sin_lat,
    )
