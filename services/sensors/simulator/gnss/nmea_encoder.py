"""Encodes NMEA 0183 sentences of a multi-constellation receiver, version 4.11."""

from collections.abc import Callable
from functools import reduce
from math import degrees
from operator import xor

import numpy as np

from .simulated_epoch import GEOID_M, Epoch

KNOT = 1852.0 / 3600.0  # [m/s]
_QUALITY = {"none": 1, "float": 5, "fixed": 4}
_MODE = {"none": "A", "float": "F", "fixed": "R"}


def sentence(*fields: str) -> bytes:
    """Join fields to a sentence with its checksum and line end."""
    body = ",".join(fields)
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def rmc(epoch: Epoch) -> bytes:
    """Recommended minimum: time, date, position, speed and course over ground."""
    valid = epoch.fix.valid
    moving = (f"{epoch.ground_speed_m_s / KNOT:.3f}", f"{epoch.course_deg:.2f}") if valid else ("", "")
    mode = _MODE[epoch.fix.carrier] if valid else "N"
    return sentence("GNRMC", _clock(epoch), "A" if valid else "V", *_position(epoch), *moving, f"{epoch.utc:%d%m%y}",
                    "", "", mode, "V")  # fmt: skip


def gga(epoch: Epoch) -> bytes:
    """Fix data: quality, satellites, heights."""
    fix = epoch.fix
    heights = (f"{fix.position.height - GEOID_M:.1f}", "M", f"{GEOID_M:.1f}", "M") if fix.valid else ("", "M", "", "M")
    corrections = ("1.0", "0000") if fix.carrier != "none" else ("", "")
    quality = _QUALITY[fix.carrier] if fix.valid else 0
    return sentence("GNGGA", _clock(epoch), *_position(epoch), str(quality), f"{min(12, epoch.satellites_used):02d}",
                    f"{epoch.sky.dop.horizontal:.2f}", *heights, *corrections)  # fmt: skip


def gsa(epoch: Epoch) -> bytes:
    """Used satellites and dilution of precision, one sentence per constellation."""
    dop, sentences = epoch.sky.dop, []
    for index, row in enumerate(epoch.constellations):
        used = epoch.sky.used & (epoch.sky.system == index) & epoch.fix.valid
        numbers = [f"{number + row.nmea_offset:02d}" for number in epoch.sky.number[np.flatnonzero(used)[:12]].tolist()]
        values = (f"{value:.2f}" for value in (dop.position, dop.horizontal, dop.vertical))
        sentences.append(sentence("GNGSA", "A", "3" if epoch.fix.valid else "1", *numbers, *[""] * (12 - len(numbers)),
                                  *values, str(row.nmea_id)))  # fmt: skip
    return b"".join(sentences)


def _clock(epoch: Epoch) -> str:
    return f"{epoch.utc:%H%M%S}.{epoch.utc.microsecond // 10_000:02d}"


def _position(epoch: Epoch) -> tuple[str, str, str, str]:
    if not epoch.fix.valid:
        return "", "", "", ""
    latitude, longitude = degrees(epoch.fix.position.latitude), degrees(epoch.fix.position.longitude)
    north, east = "N" if latitude >= 0.0 else "S", "E" if longitude >= 0.0 else "W"
    return _degrees_minutes(latitude, 2), north, _degrees_minutes(longitude, 3), east


def _degrees_minutes(angle: float, digits: int) -> str:
    whole, minutes = divmod(round(abs(angle) * 60e5), 6_000_000)
    return f"{whole:0{digits}d}{minutes / 1e5:08.5f}"


ENCODERS: dict[str, Callable[[Epoch], bytes]] = {"NMEA_ID_RMC": rmc, "NMEA_ID_GGA": gga, "NMEA_ID_GSA": gsa}
