"""Joins the NMEA 0183 sentences of one epoch (RMC, GGA, GSA, GST) to one fix.

Source: NMEA 0183 version 4.11, as described in u-blox F9 HPG 1.32 (UBX-22008968), section 2.
"""

import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from shared.messages import CarrierSolution, FixType, GnssFix, Vector3

from .gnss_time import NS, utc_ns

KNOT_M_S = 1852 / 3600  # exact
FASTEST_M_S = 600.0
NOT_A_FIX = frozenset("078")  # GGA quality: none, typed in by hand, simulated
Fields = list[str]


class NmeaError(ValueError):
    """A sentence with a good checksum whose content cannot be; the text is the kind of reject."""


@dataclass(slots=True)
class NmeaEpoch:
    """The sentences of one time of day; `sentences` maps RMC, GGA, GST, GSA1, GSA2 ... to their fields."""

    time_of_day_ns: int
    first_received_ns: int
    last_received_ns: int
    sentences: dict[str, Fields] = field(default_factory=dict)


class NmeaAssembler:
    """Collects sentences by their time of day and hands over each epoch once.

    An epoch is complete when every kind of sentence that either of the two epochs before had has arrived, or when the
    next begins.
    """

    def __init__(self) -> None:
        self._epoch: NmeaEpoch | None = None
        self._kinds_before: deque[set[str]] = deque([set()], maxlen=2)
        self._done = True

    def take(self, sentence: bytes, received_ns: int) -> Iterator[NmeaEpoch]:
        """Take one sentence with a good checksum; yield the epochs that it completes."""
        fields = sentence[1:].rstrip().rpartition(b"*")[0].decode("ascii").split(",")
        kind = fields[0][-3:]
        if kind in ("RMC", "GGA", "GST"):
            time_of_day = time_of_day_ns(_text(fields, 1))
            if self._epoch is None or self._epoch.time_of_day_ns != time_of_day:
                yield from self._finish()
                self._kinds_before.append(set(self._epoch.sentences) if self._epoch else set())
                self._epoch, self._done = NmeaEpoch(time_of_day, received_ns, received_ns), False
        elif kind != "GSA" or self._epoch is None:
            return
        if kind == "GSA":
            kind += str(sum(name.startswith("GSA") for name in self._epoch.sentences))
        self._epoch.sentences[kind] = fields
        self._epoch.last_received_ns = received_ns
        if all(self._kinds_before) and set.union(*self._kinds_before) <= self._epoch.sentences.keys():
            yield from self._finish()

    def _finish(self) -> Iterator[NmeaEpoch]:
        if not self._done and self._epoch and self._epoch.sentences.keys() & {"RMC", "GGA"}:
            yield self._epoch
        self._done = True


def fix_from_sentences(epoch: NmeaEpoch, *, sampled_ns: int, source: str, rejects: Counter[str]) -> GnssFix:
    """Make one fix of the sentences of an epoch; a field that cannot be is counted as `nmea_field` and left out.

    NMEA states no vertical velocity, so the velocity is a ground speed and a course; it states an accuracy only
    in GST. The height above the ellipsoid is the height above the geoid plus the geoid's separation.
    """
    rmc, gga = epoch.sentences.get("RMC", []), epoch.sentences.get("GGA", [])
    gsa, gst = epoch.sentences.get("GSA0", []), epoch.sentences.get("GST", [])
    read = _Reader(rejects)
    fix_type = _fix_type(rmc, gga, gsa)
    usable = fix_type is not FixType.NONE
    place = (read.place(gga, 2) or read.place(rmc, 3)) if usable else None
    height_msl_m, separation_m = read.number(gga, 9), read.number(gga, 11)
    speed_knots, course_deg = read.number(rmc, 7), read.number(rmc, 8)
    speed_m_s = speed_knots * KNOT_M_S if speed_knots is not None and usable else None
    if speed_m_s is not None and not 0 <= speed_m_s <= FASTEST_M_S:
        rejects["nmea_field"] += 1
        speed_m_s = None
    satellites, quality = read.number(gga, 7), _text(gga, 6)
    return GnssFix(
        sampled_ns=sampled_ns,
        received_ns=epoch.last_received_ns,
        source=source,
        utc_ns=_utc(rmc, epoch.time_of_day_ns),
        fix_type=fix_type,
        carrier_solution={"4": CarrierSolution.FIXED, "5": CarrierSolution.FLOAT}.get(quality, CarrierSolution.NONE),
        differential=quality in ("2", "4", "5"),
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
        pdop=read.number(gsa, 15),
        hdop=read.number(gsa, 16) or read.number(gga, 8),
        vdop=read.number(gsa, 17),
        correction_age_s=read.number(gga, 13),
    )


def time_of_day_ns(text: str) -> int:
    """Read hhmmss.sss; raises NmeaError for a time that is none."""
    try:
        hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    except ValueError as error:
        raise NmeaError("nmea_time") from error
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise NmeaError("nmea_time")
    return (hour * 3600 + minute * 60) * NS + round(second * 1000) * (NS // 1000)


def _text(fields: Fields, index: int) -> str:
    return fields[index] if index < len(fields) else ""


def _fix_type(rmc: Fields, gga: Fields, gsa: Fields) -> FixType:
    if (rmc and _text(rmc, 2) != "A") or (gga and (_text(gga, 6) or "0") in NOT_A_FIX) or _text(gsa, 2) == "1":
        return FixType.NONE
    if _text(gga, 6) == "6" or _text(rmc, 12) == "E":
        return FixType.DEAD_RECKONING
    return FixType.TWO_D if _text(gsa, 2) == "2" else FixType.THREE_D


def _utc(rmc: Fields, time_of_day: int) -> int | None:
    """Give UTC only where RMC calls its data valid: receivers print a made-up date before."""
    date = _text(rmc, 9)
    if _text(rmc, 2) != "A" or len(date) != 6 or not date.isdigit():
        return None
    midnight = utc_ns((2000 + int(date[4:]), int(date[2:4]), int(date[:2]), 0, 0, 0), 0)
    return None if midnight is None else midnight + time_of_day


class _Reader:
    """Reads numbers out of fields; what is empty is None, what is no number is counted and None."""

    def __init__(self, rejects: Counter[str]) -> None:
        self._rejects = rejects

    def number(self, fields: Fields, index: int) -> float | None:
        text = _text(fields, index)
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
        self._rejects["nmea_field"] += 1
        return None

    def place(self, fields: Fields, index: int) -> tuple[float, float] | None:
        latitude, longitude = self._angle(fields, index, "NS"), self._angle(fields, index + 2, "EW")
        if latitude is None or longitude is None:
            return None
        if abs(latitude) <= 90 and abs(longitude) <= 180:
            return latitude, longitude
        self._rejects["nmea_field"] += 1
        return None

    def deviations(self, gst: Fields) -> Vector3 | None:
        north, east, down = (self.number(gst, index) for index in (6, 7, 8))
        return (north, east, down) if north and east and down else None

    def _angle(self, fields: Fields, index: int, signs: str) -> float | None:
        """Read (d)ddmm.mmmm and its hemisphere."""
        value, hemisphere = self.number(fields, index), _text(fields, index + 1)
        if value is None or hemisphere not in tuple(signs):
            return None
        degrees, minutes = divmod(value, 100)
        angle = degrees + minutes / 60
        return angle if hemisphere == signs[0] else -angle
