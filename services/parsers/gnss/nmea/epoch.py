"""Combines the NMEA 0183 sentences of one epoch (RMC, GGA or GNS, VTG, ZDA, GSA, GST), parsed by pynmea2, into one fix.

Source: NMEA 0183 version 4.11, as described in u-blox F9 HPG 1.32 (UBX-22008968), section 2.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import date

from pynmea2.nmea import NMEASentence

from shared.maths.dates import DAY_NS, DeviceDates
from shared.messages.base import Vector3
from shared.messages.gnss import CarrierSolution, FixType, GnssFix

from .burst import NmeaEpoch, Sentence, time_of_day_ns

KNOT_M_S = 1852 / 3600  # exact
# Navigation status of PUBX,00: u-blox M8 interface description (UBX-13003221), 31.3.2.
PUBX_FIXES = {
    "DR": FixType.DEAD_RECKONING, "G2": FixType.TWO_D, "D2": FixType.TWO_D, "G3": FixType.THREE_D,
    "D3": FixType.THREE_D, "RK": FixType.GNSS_DEAD_RECKONING, "TT": FixType.TIME_ONLY,
}  # fmt: skip
MAX_SPEED_M_S = 600.0
MAX_VALUE = 1e6  # limit of every numerical field
NOT_A_FIX = (None, 0, 7, 8)  # GGA quality: absent, no fix, manual input, simulator
# GGA quality of each letter of GNS, one a constellation; the best of them is that of the fix.
QUALITIES = {"R": 4, "F": 5, "P": 2, "D": 2, "A": 1, "E": 6, "M": 7, "S": 8, "N": 0}
_parse: Callable[[str], Sentence] = NMEASentence.parse  # pynmea2 has no type annotations
# Substitute for a sentence that was not received: empty fields that do not invalidate the fix.
_ABSENT = {
    "RMC": _parse("$GNRMC,,A"),
    "GGA": _parse("$GNGGA,,,,,,1"),
    "GSA": _parse("$GNGSA,"),
    "GST": _parse("$GNGST,"),
    "VTG": _parse("$GNVTG,"),
}


def fix_from_sentences(
    epoch: NmeaEpoch, *, sampled_ns: int, source: str, rejects: Counter[str], dates: DeviceDates | None = None
) -> GnssFix:
    """Combine the sentences of an epoch into one fix; an invalid field is counted as `nmea_field` and omitted.

    NMEA has no vertical velocity: the velocity is ground speed and course, of RMC or else of VTG; PUBX,00 of u-blox has
    one, and accuracies, which GST states better. Of several GSA, one a constellation, the best mode decides, and gives
    the dilutions. The ellipsoidal height is the height above the geoid plus the geoid separation. HDT or THS is the
    heading that the receiver states. `dates` gives UTC its era (None: as told); an impossible date is counted as
    `nmea_date`.
    """
    rmc, gst, vtg = (epoch.sentences.get(kind) or _ABSENT[kind] for kind in ("RMC", "GST", "VTG"))
    gga, gsa, read = _position_of(epoch), best_of(epoch.all("GSA")), _Reader(rejects)
    pubx = epoch.sentences.get("PUBX00")
    fix_type = _fix_type(rmc, gga, gsa)
    if pubx is not None and not epoch.sentences.keys() & {"RMC", "GGA", "GNS"}:
        fix_type = PUBX_FIXES.get(pubx.nav_stat, FixType.NONE)
    usable = fix_type is not FixType.NONE
    place = (read.place(gga) or read.place(rmc) or (read.place(pubx) if pubx else None)) if usable else None
    height_msl_m, separation_m = read.number(gga.altitude), read.number(gga.geo_sep)
    speed_m_s, course_deg = read.motion(rmc, vtg, pubx) if usable else (None, None)
    satellites, quality = read.number(gga.num_sats), gga.gps_qual
    return GnssFix(
        sampled_ns=sampled_ns,
        received_ns=epoch.last_received_ns,
        source=source,
        utc_ns=_utc(rmc, epoch, dates or DeviceDates(rejects), usable=usable),
        fix_type=fix_type,
        carrier_solution={4: CarrierSolution.FIXED, 5: CarrierSolution.FLOAT}.get(quality, CarrierSolution.NONE),
        differential=quality in (2, 4, 5),
        satellites_used=None if satellites is None else int(satellites),
        latitude_deg=place and place[0],
        longitude_deg=place and place[1],
        height_ellipsoid_m=(read.number(pubx.alt_ref) if pubx else _sum(height_msl_m, separation_m)) if place else None,
        height_msl_m=height_msl_m if place else None,
        ground_speed_m_s=speed_m_s,
        course_rad=None if course_deg is None or speed_m_s is None else math.radians(course_deg % 360),
        velocity_ned_m_s=read.velocity(pubx, speed_m_s, course_deg) if pubx else None,
        position_sd_ned_m=(read.deviations(gst) or (read.accuracies(pubx) if pubx else None)) if place else None,
        stated_heading_rad=read.heading(epoch.sentences.get("HDT") or epoch.sentences.get("THS")),
        pdop=read.number(gsa.pdop),
        hdop=read.number(gsa.hdop) or read.number(gga.horizontal_dil),
        vdop=read.number(gsa.vdop),
        correction_age_s=read.number(gga.age_gps_data),
    )


def _fix_type(rmc: Sentence, gga: Sentence, gsa: Sentence) -> FixType:
    if rmc.status != "A" or gga.gps_qual in NOT_A_FIX or gsa.mode_fix_type == "1":
        return FixType.NONE
    if gga.gps_qual == 6 or rmc.mode_indicator == "E":
        return FixType.DEAD_RECKONING
    return FixType.TWO_D if gsa.mode_fix_type == "2" else FixType.THREE_D


def _sum(height_m: float | None, separation_m: float | None) -> float | None:
    return None if height_m is None or separation_m is None else height_m + separation_m


def _position_of(epoch: NmeaEpoch) -> Sentence:
    """GGA, or what GNS says in its form; without both an empty one that does not invalidate the fix."""
    gga, gns = epoch.sentences.get("GGA"), epoch.sentences.get("GNS")
    if gga is not None or gns is None:
        return gga or _ABSENT["GGA"]
    time, *place, modes, satellites, hdop, height, separation, age, station = (*gns.data, *[""] * 12)[:12]
    known = [QUALITIES[mode] for mode in modes if mode in QUALITIES]
    quality = next((q for q in (4, 5, 2, 1, 6, 7, 8) if q in known), 0)
    fields = (time, *place, str(quality), satellites, hdop, height, "M", separation, "M", age, station)
    return _parse(f"$GNGGA,{','.join(fields)}")


def best_of(sentences: Sequence[Sentence]) -> Sentence:
    """The GSA with the best mode: those of constellations that are not used say that there is no fix."""
    return max(sentences, key=lambda gsa: gsa.mode_fix_type or "", default=_ABSENT["GSA"])


def _utc(rmc: Sentence, epoch: NmeaEpoch, dates: DeviceDates, *, usable: bool) -> int | None:
    """UTC [ns] if RMC is marked valid (the date before is arbitrary) and holds a date; otherwise by ZDA."""
    day, time_of_day = rmc.datestamp, epoch.time_of_day_ns
    if usable and not day and (zda := epoch.sentences.get("ZDA")) is not None:
        return _utc_of_zda(zda, time_of_day, dates)
    if rmc.status != "A" or not day:
        return None
    known = isinstance(day, date)  # pynmea2 leaves what is no date as text
    return dates.utc_ns((day - date(1970, 1, 1)).days * DAY_NS + time_of_day if known else None, "nmea_date")


def _utc_of_zda(zda: Sentence, time_of_day: int, dates: DeviceDates) -> int | None:
    """UTC [ns] of the epoch next to the date and time of ZDA, which may be those of the next pulse."""
    try:
        day, month, year = (int(text) for text in zda.data[1:4])
        midnight_ns = (date(year, month, day) - date(1970, 1, 1)).days * DAY_NS
        apart_ns = (time_of_day - time_of_day_ns(zda.data[0]) + DAY_NS // 2) % DAY_NS - DAY_NS // 2
        told_ns: int | None = midnight_ns + time_of_day_ns(zda.data[0]) + apart_ns
    except (ValueError, OverflowError):
        if not any(zda.data[1:4]):
            return None
        told_ns = None
    return dates.utc_ns(told_ns, "nmea_date")


class _Reader:
    """Converts fields of pynmea2: an empty field is None, an invalid number is counted and None."""

    def __init__(self, rejects: Counter[str]) -> None:
        self._rejects = rejects

    def number(self, text: str | float | None) -> float | None:
        if text is None or text == "":
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if abs(value) < MAX_VALUE:  # false for NaN
            return value
        self._rejects["nmea_field"] += 1
        return None

    def motion(self, rmc: Sentence, vtg: Sentence, pubx: Sentence | None) -> tuple[float | None, float | None]:
        """Speed [m/s] and course [deg] of RMC; what it lacks is that of VTG, unless that is marked invalid."""
        speed, course_deg = self._speed(rmc.spd_over_grnd, KNOT_M_S), self.number(rmc.true_course)
        if pubx is not None and speed is None:
            return self._speed(pubx.sog, 1 / 3.6), self.number(pubx.cog)
        if vtg.faa_mode == "N":
            return speed, course_deg
        if speed is None:
            speed = self._speed(vtg.spd_over_grnd_kts, KNOT_M_S)
        if speed is None:
            speed = self._speed(vtg.spd_over_grnd_kmph, 1 / 3.6)
        return speed, self.number(vtg.true_track) if course_deg is None else course_deg

    def velocity(self, pubx: Sentence, speed_m_s: float | None, course_deg: float | None) -> Vector3 | None:
        """Velocity [m/s, NED] of the motion over ground with the vertical velocity of PUBX,00."""
        down_m_s = self.number(pubx.v_vel)
        if speed_m_s is None or course_deg is None or down_m_s is None or abs(down_m_s) > MAX_SPEED_M_S:
            return None
        course = math.radians(course_deg)
        return speed_m_s * math.cos(course), speed_m_s * math.sin(course), down_m_s

    def accuracies(self, pubx: Sentence) -> Vector3 | None:
        """Deviations by PUBX,00, whose horizontal accuracy is divided equally among the axes."""
        horizontal_m, vertical_m = self.number(pubx.h_acc), self.number(pubx.v_acc)
        if not horizontal_m or not vertical_m or min(horizontal_m, vertical_m) <= 0.0:
            return None
        axis_m = horizontal_m / math.sqrt(2.0)
        return axis_m, axis_m, vertical_m

    def heading(self, sentence: Sentence | None) -> float | None:
        """Heading [rad] of HDT, or of THS unless its mode says that it is not valid."""
        if sentence is None or (len(sentence.data) > 1 and sentence.data[1] not in ("T", "A", "E")):
            return None
        heading_deg = self.number(sentence.data[0])
        return None if heading_deg is None else math.radians(heading_deg % 360.0)

    def _speed(self, text: str | float | None, unit_m_s: float) -> float | None:
        value = self.number(text)
        if value is not None and not 0 <= value * unit_m_s <= MAX_SPEED_M_S:
            self._rejects["nmea_field"] += 1
            return None
        return None if value is None else value * unit_m_s

    def place(self, sentence: Sentence) -> tuple[float, float] | None:
        directions = sentence.lat_dir + sentence.lon_dir
        if directions not in ("NE", "NW", "SE", "SW") or not (sentence.lat and sentence.lon):
            return None  # pynmea2 would return 0
        try:
            place = float(sentence.latitude), float(sentence.longitude)
        except ValueError:
            place = math.nan, math.nan
        if abs(place[0]) <= 90 and abs(place[1]) <= 180:
            return place
        self._rejects["nmea_field"] += 1
        return None

    def deviations(self, gst: Sentence) -> Vector3 | None:
        north, east, down = map(self.number, (gst.std_dev_latitude, gst.std_dev_longitude, gst.std_dev_altitude))
        return (north, east, down) if north and east and down else None
