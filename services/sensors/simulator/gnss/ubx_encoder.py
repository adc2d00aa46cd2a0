"""Encodes UBX messages of a u-blox receiver of generation 9.

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968), sections 3.10, 3.14, 3.15 and 3.18.
"""

import struct
from collections.abc import Callable
from math import atan2, cos, degrees, hypot, sin

import numpy as np

from shared.protocols.ubx import ubx_frame

from .raw_measurements import CLOCK_DRIFT, clock_bias_s
from .simulated_epoch import GEOID_M, LEAP_SECONDS, WEEK_MS, Epoch, gps_ms
from .sky import MIN_DB_HZ, TRACKED_DB_HZ

NAV, RXM, ACK, CFG, MON, SEC = 0x01, 0x02, 0x05, 0x06, 0x0A, 0x27
VALSET, VALGET = 0x8A, 0x8B
_CARRIER = {"none": 0, "float": 1, "fixed": 2}
_PVT = struct.Struct("<IH5BBIi4B4i2I5i2IHH4xihH")
_DOP = struct.Struct("<I7H")
_COV = struct.Struct("<IBBB9x12f")
_HPPOSLLH = struct.Struct("<B2xBI4i4b2I")
_RELPOSNED = struct.Struct("<BxHI5i4x4b5I4xI")
_SATELLITE = np.dtype([
    ("system", "u1"), ("number", "u1"), ("cn0", "u1"), ("elevation", "i1"), ("azimuth", "<i2"), ("residual", "<i2"),
    ("flags", "<u4"),
])  # fmt: skip
_SIGNAL = np.dtype([
    ("system", "u1"), ("number", "u1"), ("signal", "u1"), ("channel", "u1"), ("residual", "<i2"), ("cn0", "u1"),
    ("quality", "u1"), ("corrections", "u1"), ("ionosphere", "u1"), ("flags", "<u2"), ("reserved", "<u4"),
])  # fmt: skip
# sigId of the second signal of each gnssId, and how much weaker it is received [dB]: L2C, E5b, B2I, GLONASS L2.
_SECOND = {0: (3, 4.0), 2: (6, 1.0), 3: (2, 2.0), 6: (2, 3.0)}
GLONASS, CENTRE_CHANNEL = 6, 7  # gnssId, and freqId of the frequency number 0, whose carrier is simulated
_RAW_HEAD = struct.Struct("<dHbBBB2x")
_RAW = np.dtype([
    ("pseudorange", "<f8"), ("carrier", "<f8"), ("doppler", "<f4"), ("system", "u1"), ("number", "u1"),
    ("signal", "u1"), ("channel", "u1"), ("lock_ms", "<u2"), ("cn0", "u1"), ("code_sd", "u1"), ("carrier_sd", "u1"),
    ("doppler_sd", "u1"), ("status", "u1"), ("reserved", "u1"),
])  # fmt: skip
_TIME_VALID = 0x07  # date, time, fully resolved
_TIME_CONFIRMED = 0xE0
_WORST = 0xFFFFFFFF


def nav_pvt(epoch: Epoch) -> bytes:
    """Position, velocity, time."""
    fix, utc = epoch.fix, epoch.utc
    latitude, longitude = degrees(fix.position.latitude), degrees(fix.position.longitude)
    speed_sd = hypot(*fix.velocity_sd_n)
    course_sd_deg = min(180.0, degrees(atan2(hypot(*fix.velocity_sd_n[:2]), epoch.ground_speed_m_s)))
    corrected = fix.carrier != "none"
    flags = fix.valid | corrected << 1 | _CARRIER[fix.carrier] << 6
    flags3 = (not fix.valid) | (corrected << 1)  # invalid position; corrections younger than 1 s
    north, east, down = (_milli(v) for v in fix.velocity_n)
    height = _milli(fix.position.height)
    course = round(epoch.course_deg * 1e5)
    return ubx_frame(NAV, 0x07, _PVT.pack(
        epoch.itow_ms, utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second, _TIME_VALID, 25,
        utc.microsecond * 1000, 3 if fix.valid else 0, flags, _TIME_CONFIRMED, epoch.satellites_used,
        round(longitude * 1e7), round(latitude * 1e7), height, height - _milli(GEOID_M),
        _milli(epoch.horizontal_sd_m), _milli(fix.position_sd_n[2]), north, east, down,
        _milli(epoch.ground_speed_m_s), course, _milli(speed_sd), round(course_sd_deg * 1e5),
        _centi(epoch.sky.dop.position), flags3, 0, 0, 0,
    ))  # fmt: skip


def nav_dop(epoch: Epoch) -> bytes:
    """Dilution of precision."""
    dop = epoch.sky.dop
    values = (dop.geometric, dop.position, dop.time, dop.vertical, dop.horizontal, dop.north, dop.east)
    return ubx_frame(NAV, 0x04, _DOP.pack(epoch.itow_ms, *(_centi(value) for value in values)))


def nav_cov(epoch: Epoch) -> bytes:
    """Covariance of position and velocity, NED."""
    terms: list[float] = []
    for north, east, down in (epoch.fix.position_sd_n, epoch.fix.velocity_sd_n):
        terms += (north**2, 0.0, 0.0, east**2, 0.0, down**2)
    valid = epoch.fix.valid
    return ubx_frame(NAV, 0x36, _COV.pack(epoch.itow_ms, 0, valid, valid, *terms))


def nav_hpposllh(epoch: Epoch) -> bytes:
    """Position at high precision."""
    fix = epoch.fix
    pairs = [_split(degrees(angle) * 1e9, 100) for angle in (fix.position.longitude, fix.position.latitude)]
    pairs += [_split(height * 1e4, 10) for height in (fix.position.height, fix.position.height - GEOID_M)]
    whole, rest = zip(*pairs, strict=True)
    accuracies = (round(sd * 1e4) for sd in (epoch.horizontal_sd_m, fix.position_sd_n[2]))
    return ubx_frame(NAV, 0x14, _HPPOSLLH.pack(0, not fix.valid, epoch.itow_ms, *whole, *rest, *accuracies))


def nav_sat(epoch: Epoch) -> bytes:
    """Satellites in view."""
    sky = epoch.sky
    rows = np.zeros(len(sky.number), _SATELLITE)
    rows["system"] = np.array([c.gnss_id for c in epoch.constellations], np.uint8)[sky.system]
    rows["number"] = sky.number
    rows["cn0"] = np.rint(sky.cn0_db_hz)
    rows["elevation"] = np.rint(sky.elevation_deg)
    rows["azimuth"] = np.rint(sky.azimuth_deg) % 360
    rows["residual"] = np.where(sky.used, np.rint(10.0 * sky.residual_m), 0)
    quality = np.where(sky.used, 7, np.where(sky.cn0_db_hz > 0.0, 4, 1))  # carrier locked, code locked, searching
    # used, healthy, orbit from an ephemeris that is available
    rows["flags"] = quality | sky.used.astype(np.uint32) << 3 | 1 << 4 | 1 << 8 | 1 << 11
    return ubx_frame(NAV, 0x35, struct.pack("<IBB2x", epoch.itow_ms, 1, len(rows)) + rows.tobytes())


def nav_sig(epoch: Epoch) -> bytes:
    """Two signals of each satellite: the one of NAV-SAT, and a second one that is used if it is strong enough."""
    sky = epoch.sky
    system = np.array([c.gnss_id for c in epoch.constellations], np.uint8)[sky.system]
    second, weaker = (np.array([_SECOND[i][k] for i in system.tolist()]) for k in (0, 1))
    kind = np.column_stack([np.zeros_like(second), second]).ravel().astype(np.uint8)
    cn0 = np.column_stack([sky.cn0_db_hz, np.maximum(sky.cn0_db_hz - weaker, 0.0)]).ravel()
    cn0[cn0 < TRACKED_DB_HZ] = 0.0
    used = np.repeat(sky.used, 2) & (cn0 >= MIN_DB_HZ)
    rows = np.zeros(len(cn0), _SIGNAL)
    rows["system"], rows["number"], rows["signal"] = np.repeat(system, 2), np.repeat(sky.number, 2), kind
    rows["cn0"] = np.rint(cn0)
    rows["residual"] = np.where(used, np.rint(10.0 * np.repeat(sky.residual_m, 2)), 0)
    rows["quality"] = np.where(used, 7, np.where(cn0 > 0.0, 4, 1))
    carrier = used & (epoch.fix.carrier != "none")
    # healthy; pseudorange, carrier phase and Doppler used; pseudorange corrected
    rows["flags"] = 1 | used * 8 | carrier * 16 | used * 32 | carrier * 64
    return ubx_frame(NAV, 0x43, struct.pack("<IBB2x", epoch.itow_ms, 0, len(rows)) + rows.tobytes())


def nav_relposned(epoch: Epoch) -> bytes:
    """Baseline from the first antenna to the second (moving base); empty with a single antenna."""
    line = epoch.baseline
    if line is None:
        return b""
    fixed = epoch.fix.valid and epoch.fix.carrier == "fixed"
    north, east = line.length_m * cos(line.heading), line.length_m * sin(line.heading)
    flags = epoch.fix.valid | 1 << 1 | fixed << 2 | _CARRIER[epoch.fix.carrier] << 3 | 1 << 5 | fixed << 8
    accuracy = round(line.heading_sd * line.length_m * 1e4)
    return ubx_frame(NAV, 0x3C, _RELPOSNED.pack(
        1, 0, epoch.itow_ms, round(north * 100), round(east * 100), 0, round(line.length_m * 100),
        round(degrees(line.heading) % 360.0 * 1e5), 0, 0, 0, 0, accuracy, accuracy, accuracy, accuracy,
        round(degrees(line.heading_sd) * 1e5), flags,
    ))  # fmt: skip


def nav_status(epoch: Epoch) -> bytes:
    """State of the fix, and of the detector of spoofing."""
    fix, started_ms = epoch.fix, 26_000
    flags2 = epoch.signal.spoofing << 3 | _CARRIER[fix.carrier] << 6
    return ubx_frame(NAV, 0x03, struct.pack(
        "<I4B2I", epoch.itow_ms, 3 if fix.valid else 0, fix.valid | 3 << 2, 0, flags2, started_ms, started_ms
    ))  # fmt: skip


def nav_clock(epoch: Epoch) -> bytes:
    """Clock of the receiver, that of RXM-RAWX, with 10 ns and 200 ps/s as their standard deviations."""
    bias_s = clock_bias_s(gps_ms(epoch.utc_ms) * 1e-3) + epoch.signal.clock_s
    bias_ns, drift_ns = round(bias_s * 1e9), round((CLOCK_DRIFT + epoch.signal.drift_s_s) * 1e9)
    return ubx_frame(NAV, 0x22, struct.pack("<I2i2I", epoch.itow_ms, bias_ns, drift_ns, 10, 200))


def mon_rf(epoch: Epoch) -> bytes:
    """Radio paths of L1 and L2: jamming, noise, gain."""
    signal = epoch.signal
    paths = (
        struct.pack("<4BI4x2H5B3x", number, signal.jamming, 2, 1, 0, signal.noise, signal.gain, signal.narrowband,
                    0, 120, 0, 120)
        for number in (0, 1)
    )  # fmt: skip
    return ubx_frame(MON, 0x38, struct.pack("<2B2x", 0, 2) + b"".join(paths))


def sec_sig(epoch: Epoch) -> bytes:
    """Flags of jamming and spoofing, version 1."""
    jamming, spoofing = 1 | epoch.signal.jamming << 1, 1 | epoch.signal.spoofing << 1
    return ubx_frame(SEC, 0x09, struct.pack("<B3xB3xB3x", 1, jamming, spoofing))


def nav_eoe(epoch: Epoch) -> bytes:
    """End of the epoch."""
    return ubx_frame(NAV, 0x61, struct.pack("<I", epoch.itow_ms))


def rxm_rawx(epoch: Epoch) -> bytes:
    """Raw measurements, with 0.64 m, 0.004 cycles and 0.256 Hz as their standard deviations."""
    raw = epoch.raw
    if raw is None:
        return b""
    week, tow_s = divmod(raw.gps_s, WEEK_MS / 1000)
    rows = np.zeros(len(raw.satellite), _RAW)
    rows["pseudorange"], rows["carrier"], rows["doppler"] = raw.pseudorange_m, raw.carrier_cycles, raw.doppler_hz
    rows["system"], rows["number"], rows["cn0"] = raw.gnss_id, raw.number, np.rint(raw.cn0_db_hz)
    rows["channel"] = np.where(np.asarray(raw.gnss_id) == GLONASS, CENTRE_CHANNEL, 0)
    rows["lock_ms"], rows["code_sd"], rows["carrier_sd"], rows["doppler_sd"], rows["status"] = 64500, 6, 1, 7, 7
    head = _RAW_HEAD.pack(tow_s, int(week) % 2**16, LEAP_SECONDS, len(rows), 1, 1)
    return ubx_frame(RXM, 0x15, head + rows.tobytes())


def rxm_sfrbx(epoch: Epoch) -> bytes:
    """Subframes and pages that ended in the epoch, one message each."""
    return b"".join(
        ubx_frame(RXM, 0x13, struct.pack(
            f"<8B{len(sent.words)}I", sent.gnss_id, sent.number, sent.signal, 0, len(sent.words), 0, 2, 0, *sent.words
        ))
        for sent in epoch.words
    )  # fmt: skip


def acknowledge(message_class: int, message_id: int, *, accepted: bool) -> bytes:
    """ACK-ACK or ACK-NAK."""
    return ubx_frame(ACK, int(accepted), bytes((message_class, message_id)))


def mon_ver() -> bytes:
    """Versions of software and hardware."""
    lines = (b"ROM BASE 0x118B2060", b"FWVER=HPG 1.32", b"PROTVER=27.31", b"MOD=ZED-F9P", b"GPS;GLO;GAL;BDS")
    software, hardware = b"EXT CORE 1.00 (simulated)".ljust(30, b"\0"), b"00190000".ljust(10, b"\0")
    return ubx_frame(MON, 0x04, software + hardware + b"".join(line.ljust(30, b"\0") for line in lines))


def _milli(value: float) -> int:
    return min(round(value * 1e3), _WORST)


def _centi(value: float) -> int:
    return min(round(value * 1e2), 9999)


def _split(value: float, parts: int) -> tuple[int, int]:
    """Split a number into whole units (truncated) and remainder, as in u-blox high-precision fields."""
    total = round(value)
    whole = int(total / parts)
    return whole, total - whole * parts


ENCODERS: dict[str, Callable[[Epoch], bytes]] = {
    "UBX_NAV_PVT": nav_pvt,
    "UBX_NAV_HPPOSLLH": nav_hpposllh,
    "UBX_NAV_DOP": nav_dop,
    "UBX_NAV_COV": nav_cov,
    "UBX_NAV_SAT": nav_sat,
    "UBX_NAV_RELPOSNED": nav_relposned,
    "UBX_NAV_STATUS": nav_status,
    "UBX_NAV_CLOCK": nav_clock,
    "UBX_NAV_EOE": nav_eoe,
    "UBX_RXM_RAWX": rxm_rawx,
    "UBX_RXM_SFRBX": rxm_sfrbx,
    "UBX_MON_RF": mon_rf,
    "UBX_SEC_SIG": sec_sig,
    "UBX_NAV_SIG": nav_sig,
}
