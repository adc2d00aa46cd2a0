"""Objects of the gpsd protocol, after the manual page gpsd_json(5): SI units, degrees, ISO 8601 UTC.

What is not known is left out, never null. Estimated errors are those of 95 %.
"""

import json
from datetime import UTC, datetime
from math import degrees

from shared.maths.confidence import ELLIPSE_95, SCALAR_95
from shared.messages.gnss import Constellation, GnssSatellites

from .report import Place, Quality, Report

RELEASE = "3.22"  # of gpsd, whose protocol this is: clients compare the numbers of the protocol alone
PROTOCOL = (3, 14)  # major and minor, of that release
MAX_LENGTH = 10_240  # characters of one object: GPS_JSON_RESPONSE_MAX of gpsd
MAX_SATELLITES = 72  # of one SKY: the client library of gpsd before 3.20 has room for as many
DEVICE = "obu"  # path of the one device

NO_FIX, THREE_D = 1, 3  # `mode`
STATUS_OF_FIX = {Quality.DIFFERENTIAL: 2, Quality.RTK_FIXED: 3, Quality.RTK_FLOAT: 4}  # of a receiver alone
DEAD_RECKONING, GNSS_DEAD_RECKONING, SIMULATED = 5, 6, 8  # `status`
# u-blox number of a constellation (`gnssid`), and what is added to the number in it for `PRN`
SYSTEMS = {
    Constellation.GPS: (0, 0),
    Constellation.SBAS: (1, 0),
    Constellation.GALILEO: (2, 300),
    Constellation.BEIDOU: (3, 400),
    Constellation.QZSS: (5, 192),
    Constellation.GLONASS: (6, 64),
    Constellation.NAVIC: (7, 900),
}
Object = dict[str, object]


def encoded(content: Object) -> bytes:
    """Encode an object as a line that ends in CR LF."""
    return json.dumps(content, separators=(",", ":")).encode() + b"\r\n"


def iso(utc_ns: int) -> str:
    """Write UTC [ns since 1970] as ISO 8601 with milliseconds."""
    moment = datetime.fromtimestamp(round(utc_ns / 1e6) / 1e3, UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{round(moment.microsecond / 1e3):03d}Z"


def version() -> Object:
    """VERSION: what a server says first."""
    return {"class": "VERSION", "release": RELEASE, "rev": "obu", "proto_major": PROTOCOL[0],
            "proto_minor": PROTOCOL[1]}  # fmt: skip


def device(since_ns: int) -> Object:
    """DEVICE: the unit as gpsd would show a receiver."""
    return {"class": "DEVICE", "path": DEVICE, "driver": "OBU", "activated": iso(since_ns)}


def error(message: str) -> Object:
    """ERROR: why a request was not answered."""
    return {"class": "ERROR", "message": message}


def status_of(report: Report) -> int | None:
    """`status` of a report: simulated before all, dead reckoning with or without GNSS, else that of the receiver."""
    if report.place is None:
        return None
    if report.quality is Quality.SIMULATOR:
        return SIMULATED
    if report.coasting:
        return DEAD_RECKONING
    return GNSS_DEAD_RECKONING if report.fused else STATUS_OF_FIX.get(report.quality)


def tpv(report: Report) -> Object:
    """TPV: time, position, velocity, and their 95 % errors."""
    place = report.place
    return _known({
        "class": "TPV",
        "device": DEVICE,
        "mode": NO_FIX if place is None else THREE_D,
        "status": status_of(report),
        "time": None if report.utc_ns is None else iso(report.utc_ns),
        **({} if place is None else _position(place) | _motion(place)),
    })  # fmt: skip


def att(report: Report) -> Object | None:
    """ATT: attitude of the vehicle; None where it is not measured."""
    if report.place is None or report.place.attitude_deg is None:
        return None
    roll, pitch, heading = report.place.attitude_deg
    return _known({
        "class": "ATT",
        "device": DEVICE,
        "time": None if report.utc_ns is None else iso(report.utc_ns),
        "heading": round(heading, 3),
        "pitch": round(pitch, 3),
        "roll": round(roll, 3),
    })  # fmt: skip


def gst(report: Report) -> Object | None:
    """GST: standard deviations of the position; None without one."""
    if report.place is None:
        return None
    north, east, down = report.place.position_sd_ned_m
    major, minor = report.place.ellipse_sd_m
    return _known({
        "class": "GST",
        "device": DEVICE,
        "time": None if report.utc_ns is None else iso(report.utc_ns),
        "major": round(major, 3),
        "minor": round(minor, 3),
        "orient": round(report.place.ellipse_orientation_deg, 3),
        "lat": round(north, 3),
        "lon": round(east, 3),
        "alt": round(down, 3),
    })  # fmt: skip


def unknown(name: str) -> Object:
    """What an object of this class states while nothing is known: its device alone, with no fix and no satellites."""
    contents: dict[str, Object] = {"TPV": {"mode": NO_FIX}, "SKY": {"nSat": 0, "uSat": 0, "satellites": []}}
    return {"class": name, "device": DEVICE, **contents.get(name, {})}


def sky(report: Report) -> Object | None:
    """SKY: satellites in view of the receiver and its dilution of precision; None without any."""
    seen = report.satellites
    if seen is None:
        return None
    fix = report.fix
    satellites = _satellites(seen)
    return _known({
        "class": "SKY",
        "device": DEVICE,
        "time": None if report.utc_ns is None else iso(report.utc_ns),
        "hdop": None if fix is None else fix.hdop,
        "pdop": None if fix is None else fix.pdop,
        "vdop": None if fix is None else fix.vdop,
        "nSat": len(satellites),
        "uSat": sum(bool(satellite["used"]) for satellite in satellites),
        "satellites": satellites,
    })  # fmt: skip


def _position(place: Place) -> Object:
    north, east, down = place.position_sd_ned_m
    msl = None if place.height_msl_m is None else round(place.height_msl_m, 3)
    return {
        "lat": round(place.latitude_deg, 9),
        "lon": round(place.longitude_deg, 9),
        "altHAE": round(place.height_ellipsoid_m, 3),
        "altMSL": msl,
        "alt": msl,  # the name of altMSL before gpsd 3.20
        "geoidSep": None if place.separation_m is None else round(place.separation_m, 3),
        "epx": round(SCALAR_95 * east, 3),
        "epy": round(SCALAR_95 * north, 3),
        "epv": round(SCALAR_95 * down, 3),
        "eph": round(ELLIPSE_95 * place.ellipse_sd_m[0], 3),
    }


def _motion(place: Place) -> Object:
    north, east, down = place.velocity_ned_m_s
    return {
        "track": None if place.course_deg is None else round(place.course_deg, 4),
        "speed": round(place.speed_m_s, 3),
        "climb": round(-down, 3),
        "velN": round(north, 3),
        "velE": round(east, 3),
        "velD": round(down, 3),
        "epd": None if place.course_sd_deg is None else round(min(SCALAR_95 * place.course_sd_deg, 180.0), 4),
        "eps": round(SCALAR_95 * place.speed_sd_m_s, 3),
        "epc": round(SCALAR_95 * place.climb_sd_m_s, 3),
    }


def _satellites(seen: GnssSatellites) -> list[Object]:
    """Used ones first, so that a cut does not cost them."""
    ordered = sorted(seen.satellites, key=lambda satellite: not satellite.used)
    rows = []
    for satellite in ordered[:MAX_SATELLITES]:
        if satellite.constellation not in SYSTEMS or satellite.number > 255:
            continue
        system, offset = SYSTEMS[satellite.constellation]
        rows.append(_known({
            "PRN": satellite.number + offset,
            "el": None if satellite.elevation_rad is None else _degrees(satellite.elevation_rad),
            "az": None if satellite.azimuth_rad is None else _degrees(satellite.azimuth_rad) % 360.0,
            "ss": None if satellite.cn0_db_hz is None else round(satellite.cn0_db_hz, 1),
            "used": satellite.used,
            "gnssid": system,
            "svid": satellite.number,
            "health": None if satellite.healthy is None else 1 if satellite.healthy else 2,
        }))  # fmt: skip
    return rows


def _degrees(angle_rad: float) -> float:
    return round(degrees(angle_rad), 1)


def _known(content: Object) -> Object:
    return {name: value for name, value in content.items() if value is not None}
