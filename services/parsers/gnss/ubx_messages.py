"""Decodes the UBX messages of a fix (parsed by pyubx2) to SI units; invalid values are None.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), section 3.15 UBX-NAV.
"""

import math
import struct
from dataclasses import dataclass
from typing import Any

from pyubx2.exceptions import UBXMessageError, UBXTypeError
from pyubx2.ubxmessage import UBXMessage

from shared.faults import FOREIGN
from shared.messages.base import Symmetric3
from shared.messages.gnss import CarrierSolution, Constellation, FixType, GnssSignal, Satellite, SignalQuality

NAV = 0x01
KINDS = {
    0x04: "DOP",
    0x07: "PVT",
    0x14: "HPPOSLLH",
    0x35: "SAT",
    0x36: "COV",
    0x3C: "RELPOSNED",
    0x43: "SIG",
    0x61: "EOE",
}
WEEK_MS = 604_800_000

_IDS = {kind: bytes((number,)) for number, kind in KINDS.items()}
_SIZES = {
    "DOP": 18,
    "PVT": 78,
    "HPPOSLLH": 36,
    "COV": 64,
    "RELPOSNED": 64,
    "EOE": 4,
}  # [bytes] minimum payload; pyubx2 reads missing bytes as 0
_PVT_WITH_FLAGS3 = 92  # [bytes] since protocol 15; reserved in the earlier 84-byte form
# Only NAV-SAT and NAV-SIG are unpacked here: pyubx2 takes 2 ms for 32 satellites and 7.5 ms for 120; this takes 0.06
# and 0.22 ms.
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


class UbxError(ValueError):
    """A message with a valid checksum and invalid content."""


@dataclass(frozen=True, slots=True)
class Position:
    """A position and its accuracy as the receiver states it."""

    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float
    horizontal_sd_m: float | None  # of the horizontal distance (root sum of squares of both axes)
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


@dataclass(frozen=True, slots=True)
class Baseline:
    """UBX-NAV-RELPOSNED of a moving base: the baseline from the base antenna to the rover antenna."""

    itow_ms: int
    heading_rad: float | None  # None unless both antennas are on the vehicle and the ambiguities are fixed
    heading_sd_rad: float | None
    length_m: float | None


def parse(kind: str, payload: bytes) -> Any:
    """Parse a message with pyubx2, which creates the fields at run time (hence Any).

    Raises UbxError for a truncated message or an invalid time of week.
    """
    if len(payload) < _SIZES[kind]:
        raise UbxError("short")
    if kind == "PVT" and len(payload) < _PVT_WITH_FLAGS3:
        payload = payload[: _SIZES[kind]]
    try:
        message: Any = UBXMessage(bytes((NAV,)), _IDS[kind], 0, payload=payload)  # 0: output message (GET)
    except (UBXMessageError, UBXTypeError, *FOREIGN) as error:
        raise UbxError("content") from error
    _in_week(message.iTOW)
    return message


def decode_pvt(message: Any) -> Pvt:
    """Decode UBX-NAV-PVT; raises UbxError for an unknown fix type."""
    if message.fixType >= len(_FIX_TYPES):
        raise UbxError("fix_type")
    age = message.lastCorrectionAge
    return Pvt(
        itow_ms=message.iTOW,
        calendar=(message.year, message.month, message.day, message.hour, message.min, message.second),
        nanosecond=message.nano,
        time_valid=bool(message.validDate and message.validTime and message.fullyResolved),
        fix_type=_FIX_TYPES[message.fixType],
        fix_ok=bool(message.gnssFixOk),
        differential=bool(message.diffSoln),
        carrier_solution=_CARRIER[message.carrSoln],
        satellites_used=message.numSV,
        position=_position(message, digit_mm=1.0),
        velocity_ned_m_s=(message.velN * 1e-3, message.velE * 1e-3, message.velD * 1e-3),
        speed_sd_m_s=_accuracy(message.sAcc, digit_mm=1.0),
        ground_speed_m_s=message.gSpeed * 1e-3,
        course_rad=math.radians(message.headMot),
        pdop=_dop(message.pDOP),
        correction_age_s=_CORRECTION_AGES[age] if age < len(_CORRECTION_AGES) else None,
    )


def decode_dop(message: Any) -> Dop:
    """Decode UBX-NAV-DOP."""
    return Dop(message.iTOW, _dop(message.pDOP), _dop(message.vDOP), _dop(message.hDOP))


def decode_covariance(message: Any) -> Covariance:
    """Decode UBX-NAV-COV; raises UbxError for a matrix marked valid that is not positive definite."""
    position = _symmetric(message, "posCov") if message.posCovValid else None
    return Covariance(message.iTOW, position, _symmetric(message, "velCov") if message.velCovValid else None)


def decode_high_precision(message: Any) -> HighPrecision:
    """Decode UBX-NAV-HPPOSLLH; pyubx2 has already added the high-precision parts to the coordinates."""
    return HighPrecision(message.iTOW, _position(message, digit_mm=0.1))


def decode_baseline(message: Any) -> Baseline:
    """Decode UBX-NAV-RELPOSNED; only a moving base gives the heading of the vehicle."""
    good = message.gnssFixOK and message.relPosValid and message.isMoving and message.relPosHeadingValid
    if not good or _CARRIER[message.carrSoln] is not CarrierSolution.FIXED or message.accHeading <= 0:
        return Baseline(message.iTOW, None, None, None)
    heading, sd = math.radians(message.relPosHeading), math.radians(message.accHeading)
    return Baseline(message.iTOW, heading, sd, message.relPosLength * 1e-2)


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


def _position(message: Any, *, digit_mm: float) -> Position | None:
    height_m = message.height * 1e-3
    if message.invalidLlh or abs(message.lat) > 90 or abs(message.lon) > 180 or abs(height_m) >= 100e3:
        return None
    accuracies = (_accuracy(message.hAcc, digit_mm=digit_mm), _accuracy(message.vAcc, digit_mm=digit_mm))
    return Position(message.lat, message.lon, height_m, message.hMSL * 1e-3, *accuracies)


def _accuracy(value_mm: float, *, digit_mm: float) -> float | None:
    return value_mm * 1e-3 if 0 < value_mm < _NO_ACCURACY * digit_mm else None


def _dop(value: float) -> float | None:
    return value if 0 < value < 99.99 else None


def _symmetric(message: Any, name: str) -> Symmetric3:
    nn, ne, nd, ee, ed, dd = (float(getattr(message, name + axes)) for axes in ("NN", "NE", "ND", "EE", "ED", "DD"))
    minors = (nn, nn * ee - ne * ne, nn * (ee * dd - ed * ed) - ne * (ne * dd - ed * nd) + nd * (ne * ed - ee * nd))
    if not all(math.isfinite(minor) and minor > 0 for minor in minors):
        raise UbxError("covariance")
    return nn, ne, nd, ee, ed, dd
