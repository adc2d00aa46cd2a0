"""Combines the NMEA 0183 sentences of one epoch (RMC, GGA, GSA, GST), parsed by pynmea2, into one fix.

Source: NMEA 0183 version 4.11, as described in u-blox F9 HPG 1.32 (UBX-22008968), section 2.
"""

import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import date
from typing import Any

from pynmea2.nmea import NMEASentence, ParseError

from shared.faults import FOREIGN
from shared.maths.dates import DAY_NS, NS, DeviceDates
from shared.messages.base import Vector3
from shared.messages.gnss import CarrierSolution, FixType, GnssFix

KNOT_M_S = 1852 / 3600  # exact
FASTEST_M_S = 600.0
LARGEST = 1e6  # limit of every numerical field
MOST_GSA = 8  # of one epoch: one or two a constellation
NOT_A_FIX = (None, 0, 7, 8)  # GGA quality: absent, no fix, manual input, simulator
Sentence = Any  # pynmea2 creates the fields at run time; an empty or absent one is None or ""
_WANTED = re.compile(rb"\$(?!P)\w\w(RMC|GGA|GSA|GST),")  # any talker; P marks proprietary sentences
_parse: Callable[[str], Sentence] = NMEASentence.parse  # pynmea2 has no type annotations
# Substitute for a sentence that was not received: empty fields that do not invalidate the fix.
_ABSENT = {
    "RMC": _parse("$GNRMC,,A"),
    "GGA": _parse("$GNGGA,,,,,,1"),
    "GSA0": _parse("$GNGSA,"),
    "GST": _parse("$GNGST,"),
}


class NmeaError(ValueError):
    """A sentence with a valid checksum and invalid content; the text is the kind of reject."""


@dataclass(slots=True)
class NmeaEpoch:
    """The sentences of one time of day; `sentences` maps RMC, GGA, GST, GSA1, GSA2 ... to the parsed sentence."""

    time_of_day_ns: int
    first_received_ns: int
    last_received_ns: int
    sentences: dict[str, Sentence] = field(default_factory=dict)


class NmeaAssembler:
    """Groups sentences by time of day and yields each epoch once.

    An epoch is complete when every kind of sentence of the two previous epochs has been received, or when the next
    epoch begins.
    """

    def __init__(self) -> None:
        self._epoch: NmeaEpoch | None = None
        self._kinds_before: deque[set[str]] = deque([set()], maxlen=2)
        self._done = True

    def take(self, sentence: bytes, received_ns: int) -> Iterator[NmeaEpoch]:
        """Process one sentence with a valid checksum; yield the completed epochs."""
        if (wanted := _WANTED.match(sentence)) is None:
            return
        kind, parsed = wanted[1].decode(), _read(sentence)
        if kind != "GSA":
            time_of_day = time_of_day_ns(parsed.data[0])
            if self._epoch is None or self._epoch.time_of_day_ns != time_of_day:
                yield from self._finish()
                self._kinds_before.append(set(self._epoch.sentences) if self._epoch else set())
                self._epoch, self._done = NmeaEpoch(time_of_day, received_ns, received_ns), False
        elif self._epoch is None:
            return
        else:
            number = sum(name.startswith("GSA") for name in self._epoch.sentences)
            if number == MOST_GSA:
                return
            kind += str(number)
        self._epoch.sentences[kind] = parsed
        self._epoch.last_received_ns = received_ns
        if all(self._kinds_before) and set.union(*self._kinds_before) <= self._epoch.sentences.keys():
            yield from self._finish()

    def _finish(self) -> Iterator[NmeaEpoch]:
        if not self._done and self._epoch and self._epoch.sentences.keys() & {"RMC", "GGA"}:
            yield self._epoch
        self._done = True


def fix_from_sentences(
    epoch: NmeaEpoch, *, sampled_ns: int, source: str, rejects: Counter[str], dates: DeviceDates | None = None
) -> GnssFix:
    """Combine the sentences of an epoch into one fix; an invalid field is counted as `nmea_field` and omitted.

    NMEA has no vertical velocity: the velocity is ground speed and course. The accuracy is taken from GST. The
    ellipsoidal height is the height above the geoid plus the geoid separation. `dates` gives UTC its era (None: as
    told); an impossible date is counted as `nmea_date`.
    """
    rmc, gga, gsa, gst = (epoch.sentences.get(kind) or absent for kind, absent in _ABSENT.items())
    read = _Reader(rejects)
    fix_type = _fix_type(rmc, gga, gsa)
    usable = fix_type is not FixType.NONE
    place = (read.place(gga) or read.place(rmc)) if usable else None
    height_msl_m, separation_m = read.number(gga.altitude), read.number(gga.geo_sep)
    speed_knots, course_deg = read.number(rmc.spd_over_grnd), read.number(rmc.true_course)
    speed_m_s = speed_knots * KNOT_M_S if speed_knots is not None and usable else None
    if speed_m_s is not None and not 0 <= speed_m_s <= FASTEST_M_S:
        rejects["nmea_field"] += 1
        speed_m_s = None
    satellites, quality = read.number(gga.num_sats), gga.gps_qual
    return GnssFix(
        sampled_ns=sampled_ns,
        received_ns=epoch.last_received_ns,
        source=source,
        utc_ns=_utc(rmc, epoch.time_of_day_ns, dates or DeviceDates(rejects)),
        fix_type=fix_type,
        carrier_solution={4: CarrierSolution.FIXED, 5: CarrierSolution.FLOAT}.get(quality, CarrierSolution.NONE),
        differential=quality in (2, 4, 5),
        satellites_used=None if satellites is None else int(satellites),
        latitude_deg=place and place[0],
        longitude_deg=place and place[1],
        height_ellipsoid_m=height_msl_m + separation_m
        if place and height_msl_m is not None and separation_m is not None
        else None,
        height_msl_m=height_msl_m if place else None,
        ground_speed_m_s=speed_m_s,
        course_rad=None if course_deg is None or speed_m_s is None else math.radians(course_deg % 360),
        position_sd_ned_m=read.deviations(gst) if place else None,
        pdop=read.number(gsa.pdop),
        hdop=read.number(gsa.hdop) or read.number(gga.horizontal_dil),
        vdop=read.number(gsa.vdop),
        correction_age_s=read.number(gga.age_gps_data),
    )


def time_of_day_ns(text: str) -> int:
    """Parse hhmmss.sss, leap second included (pynmea2 rejects it); raises NmeaError for an invalid time."""
    try:
        hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    except ValueError as error:
        raise NmeaError("nmea_time") from error
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise NmeaError("nmea_time")
    return (hour * 3600 + minute * 60) * NS + round(second * 1000) * (NS // 1000)


def _read(sentence: bytes) -> Sentence:
    try:
        return _parse(sentence.rpartition(b"*")[0].decode("ascii"))  # the framer has verified the checksum
    except (ParseError, *FOREIGN) as error:
        raise NmeaError("nmea_form") from error


def _fix_type(rmc: Sentence, gga: Sentence, gsa: Sentence) -> FixType:
    if rmc.status != "A" or gga.gps_qual in NOT_A_FIX or gsa.mode_fix_type == "1":
        return FixType.NONE
    if gga.gps_qual == 6 or rmc.mode_indicator == "E":
        return FixType.DEAD_RECKONING
    return FixType.TWO_D if gsa.mode_fix_type == "2" else FixType.THREE_D


def _utc(rmc: Sentence, time_of_day: int, dates: DeviceDates) -> int | None:
    """UTC [ns] if RMC is marked valid (the date before is arbitrary) and holds a date."""
    day = rmc.datestamp
    if rmc.status != "A" or not day:
        return None
    known = isinstance(day, date)  # pynmea2 leaves what is no date as text
    return dates.utc_ns((day - date(1970, 1, 1)).days * DAY_NS + time_of_day if known else None, "nmea_date")


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
        if abs(value) < LARGEST:  # false for NaN
            return value
        self._rejects["nmea_field"] += 1
        return None

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
