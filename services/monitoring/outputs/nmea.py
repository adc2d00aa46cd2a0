"""NMEA 0183 sentences, version 4.11, of a report; each at most 82 characters with its line end.

The verdict stands in three places: quality of GGA, mode indicator of RMC and VTG, navigational status of RMC
(S safe, C caution, U unsafe, V not valid). A position of dead reckoning or of a simulator has status A, as receivers of
u-blox send it: with status V, which the standard asks for, readers drop the position and do not look at the indicator.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from typing import Literal

from shared.messages.gnss import Constellation, GnssSatellites
from shared.messages.trust import TrustLevel

from .report import Place, Quality, Report

KNOT_M_S = 1852.0 / 3600.0
TALKER = "GN"  # more than one system; readers know it better than IN, integrated navigation
MAX_DOP = 99.9  # sentences stay within their length
MAX_OF_CONSTELLATION = 12  # numbers in one GSA sentence
INDICATORS = {
    Quality.INVALID: "N",
    Quality.AUTONOMOUS: "A",
    Quality.DIFFERENTIAL: "D",
    Quality.RTK_FIXED: "R",
    Quality.RTK_FLOAT: "F",
    Quality.ESTIMATED: "E",
    Quality.SIMULATOR: "S",
}
STATUS_OF_VERDICT = {TrustLevel.SAFE: "S", TrustLevel.CAUTION: "C", TrustLevel.DEAD_RECKONING: "C",
                     TrustLevel.UNSAFE: "U"}  # fmt: skip
# System ID of GSA, and what is added to the number within the constellation: table 20 of version 4.11.
SYSTEMS = {
    Constellation.GPS: ("1", 0),
    Constellation.SBAS: ("1", -87),
    Constellation.GLONASS: ("2", 64),
    Constellation.GALILEO: ("3", 0),
    Constellation.BEIDOU: ("4", 0),
    Constellation.QZSS: ("5", 192),
    Constellation.NAVIC: ("6", 0),
}


def sentence(name: str, *fields: str) -> str:
    """Join fields to a sentence with its checksum, the exclusive or of all characters between $ and *, and line end."""
    body = ",".join((TALKER + name, *fields))
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n"


def rmc(report: Report) -> Iterator[str]:
    """Recommended minimum: time, status, position, speed, course, date, mode and navigational status."""
    place, moment = report.place, _moment(report)
    motion = ("", "") if place is None else (f"{place.speed_m_s / KNOT_M_S:.2f}", _number(place.course_deg, 1))
    status = STATUS_OF_VERDICT.get(report.verdict, "V") if report.verdict else "V"
    yield sentence("RMC", _clock(moment), "V" if place is None else "A", *_position(place), *motion,
                   f"{moment:%d%m%y}" if moment else "", "", "", INDICATORS[report.quality], status)  # fmt: skip


def gga(report: Report) -> Iterator[str]:
    """Position, quality, satellites, dilution of precision, heights."""
    place, fix = report.place, report.fix
    used = fix.satellites_used if fix is not None and not report.coasting and place is not None else None
    hdop = fix.hdop if fix is not None and used is not None else None
    msl, separation = (None, None) if place is None else (place.height_msl_m, place.separation_m)
    count = f"{min(used or 0, MAX_OF_CONSTELLATION):02d}"  # as of a sentence of one GSA
    yield sentence("GGA", _clock(_moment(report)), *_position(place), str(int(report.quality)), count, _dop(hdop),
                   _number(msl, 2), "M", _number(separation, 1), "M", "", "")  # fmt: skip


def gsa(report: Report) -> Iterator[str]:
    """Dimension of the fix, used satellites and dilution of precision: one sentence a constellation, at least one."""
    place, fix = report.place, report.fix
    mode = "1" if place is None else "3"
    dops = ("", "", "") if fix is None or place is None or report.coasting else (
        _dop(fix.pdop), _dop(fix.hdop), _dop(fix.vdop))  # fmt: skip
    used = {} if place is None or report.coasting else _used(report.satellites)
    for system, numbers in used.items() or (("1", []),):
        shown = [f"{number:02d}" for number in numbers[:MAX_OF_CONSTELLATION]]
        yield sentence("GSA", "A", mode, *shown, *[""] * (MAX_OF_CONSTELLATION - len(shown)), *dops, system)


def gst(report: Report) -> Iterator[str]:
    """Standard deviations: axes and orientation of the ellipse, latitude, longitude and height."""
    if (place := report.place) is None:
        return
    north, east, down = place.position_sd_ned_m
    major, minor = place.ellipse_sd_m
    yield sentence("GST", _clock(_moment(report)), "", f"{major:.3f}", f"{minor:.3f}",
                   f"{place.ellipse_orientation_deg:.1f}", f"{north:.3f}", f"{east:.3f}", f"{down:.3f}")  # fmt: skip


def vtg(report: Report) -> Iterator[str]:
    """Course and speed over ground."""
    place = report.place
    knots, km_h = ("", "") if place is None else (f"{place.speed_m_s / KNOT_M_S:.2f}", f"{place.speed_m_s * 3.6:.2f}")
    course = "" if place is None else _number(place.course_deg, 1)
    yield sentence("VTG", course, "T", "", "M", knots, "N", km_h, "K", INDICATORS[report.quality])


def zda(report: Report) -> Iterator[str]:
    """Date and time, where UTC is known."""
    if (moment := _moment(report)) is not None:
        yield sentence("ZDA", _clock(moment), f"{moment:%d}", f"{moment:%m}", f"{moment:%Y}", "00", "00")


def hdt(report: Report) -> Iterator[str]:
    """Heading of the vehicle, where it is measured."""
    if report.place is not None and report.place.attitude_deg is not None:
        yield sentence("HDT", f"{report.place.attitude_deg[2] % 360.0:.2f}", "T")


SentenceName = Literal["RMC", "VTG", "GGA", "GSA", "GST", "ZDA", "HDT"]
ENCODERS: dict[SentenceName, Callable[[Report], Iterator[str]]] = {
    "RMC": rmc, "VTG": vtg, "GGA": gga, "GSA": gsa, "GST": gst, "ZDA": zda, "HDT": hdt,
}  # fmt: skip


def burst(report: Report, names: tuple[SentenceName, ...]) -> bytes:
    """Encode the sentences of a report, in the order of `ENCODERS`."""
    return "".join(text for name in ENCODERS if name in names for text in ENCODERS[name](report)).encode("ascii")


def _used(satellites: GnssSatellites | None) -> dict[str, list[int]]:
    found: dict[str, list[int]] = defaultdict(list)
    for satellite in satellites.satellites if satellites else ():
        system, offset = SYSTEMS.get(satellite.constellation, ("", 0))
        if satellite.used and system and 0 < satellite.number + offset < 1000:
            found[system].append(satellite.number + offset)
    return found


def _moment(report: Report) -> datetime | None:
    """UTC, rounded to the hundredths that a sentence shows."""
    return None if report.utc_ns is None else datetime.fromtimestamp(round(report.utc_ns / 1e7) / 100, UTC)


def _clock(moment: datetime | None) -> str:
    return "" if moment is None else f"{moment:%H%M%S}.{round(moment.microsecond / 1e4):02d}"


def _position(place: Place | None) -> tuple[str, str, str, str]:
    if place is None:
        return "", "", "", ""
    north, east = "N" if place.latitude_deg >= 0.0 else "S", "E" if place.longitude_deg >= 0.0 else "W"
    return _degrees_minutes(place.latitude_deg, 2), north, _degrees_minutes(place.longitude_deg, 3), east


def _degrees_minutes(angle_deg: float, digits: int) -> str:
    """Degrees and minutes to 1e-6, which is 2 mm; rounded together, so that no minute is 60."""
    whole, minutes = divmod(round(abs(angle_deg) * 60e6), 60_000_000)
    return f"{whole:0{digits}d}{minutes / 1e6:09.6f}"


def _number(value: float | None, decimals: int) -> str:
    return "" if value is None else f"{value:.{decimals}f}"


def _dop(value: float | None) -> str:
    return "" if value is None else f"{min(max(value, 0.0), MAX_DOP):.1f}"
