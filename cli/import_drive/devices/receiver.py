"""Stamps the bytes of a GNSS receiver by the times that its own messages tell.

A frame without a time has that of the frame before it. Until a date is known, times of week or of day wait for it; a
file without any date keeps its time of day, by the leap seconds since 2017 where it has times of week alone. Sources:
u-blox F9 HPG 1.32 (UBX-22008968) and M8 (UBX-13003221); NMEA 0183 4.11; RTCM 10403.3, tables 3.5-1 and 3.5-78.
"""

import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime

import numpy as np

from services.parsers.gnss.protocols import FRAMINGS
from shared.maths.dates import DAY_NS, GPS_EPOCH_UTC_NS, WEEK_NS, is_plausible
from shared.protocols.framing.framer import Frame, Framer

from ..conversion.scales import utc_of
from .marks import TimeMark, with_times_without_fix, with_validity, without_steps
from .stamped import NS, WITHOUT_DATE_NS, ClockKind, FileKind, Portion, StampedFile

MS = 1_000_000
MAX_PORTION = 8192  # bytes; a message on the bus may hold 512 KB
MAX_STEP_BACK_NS = 10 * NS  # by which a time may go back within the messages of an epoch
MIN_EARLIER_FRAMES = 20  # frames in a row that tell an earlier time, after which the later ones before them were wrong
LEAP_NS = 18 * NS  # GPS time less UTC since 2017
NAV, RXM = 0x01, 0x02
# Offset of the time of week [ms] in messages of the class NAV that do not begin with it; None where there is none.
TOW_AT: dict[int, int | None] = {
    0x09: 4, 0x10: None, 0x13: 4, 0x14: 4, 0x39: 0, 0x3B: 4, 0x3C: 4, 0x3D: None, 0x62: None,
}  # fmt: skip
# Weeks from that of GPS to the first of Galileo and BeiDou, and leap seconds of GPS at the latter's beginning.
WEEKS_OF_OTHERS = {0x25: (1024, 0), 0x24: (1356, 14)}  # NAV-TIMEGAL, NAV-TIMEBDS


@dataclass(frozen=True)
class Calendar:
    """A message of the class NAV that tells date and time of day."""

    layout: struct.Struct  # time of week [ms], then the fields
    fields: tuple[str, ...]
    size: int  # [bytes] of the shortest form
    valid: int  # bits of the field valid that say that date and time are


_CLOCK = ("year", "month", "day", "hour", "minute", "second")
CALENDAR = {
    0x07: Calendar(struct.Struct("<IH6B4xi"), (*_CLOCK, "valid", "nano"), 84, 3),  # NAV-PVT
    0x17: Calendar(struct.Struct("<IxBH5B7xi"), ("valid", *_CLOCK, "nano"), 116, 3),  # NAV-PVAT
    0x21: Calendar(struct.Struct("<I4xiH6B"), ("nano", *_CLOCK, "valid"), 20, 4),  # NAV-TIMEUTC
}
TIME_AT = {b"RMC": 1, b"GGA": 1, b"GNS": 1, b"GST": 1, b"ZDA": 1, b"GBS": 1, b"GLL": 5}
# Field of the status, quality or modes, and what stands there without a fix
STATUS_AT = {b"RMC": (2, b"V"), b"GLL": (6, b"V"), b"GGA": (6, b"0"), b"GNS": (6, b"N")}
TIME_OF_DAY = re.compile(rb"([0-2]\d)([0-5]\d)([0-6]\d)(?:\.(\d{1,9}))?")
# RTCM 3 messages whose header has the time of week [ms] of GPS, Galileo, SBAS, QZSS or NavIC in bits 24 to 53
RTCM_WITH_TOW = {
    1001, 1002, 1003, 1004, *range(1071, 1078), *range(1091, 1098), *range(1101, 1108), *range(1111, 1118),
    *range(1131, 1138),
}  # fmt: skip
RTCM_BEIDOU = set(range(1121, 1128))  # 14 s behind
BEIDOU_NS = 14 * NS


@dataclass
class _Epochs:
    """Turns marks into times of one clock."""

    now_ns: int | None = None  # UTC
    week_starts_ns: int | None = None  # UTC at which the time of week was 0, leap seconds removed
    back: int = 0  # frames in a row that tell an earlier time
    rejects: Counter[str] = field(default_factory=Counter)

    def time_of(self, mark: TimeMark) -> int | None:
        """UTC of a mark near the newest time; None if nothing is known yet."""
        if mark.utc_ns is not None:
            if mark.week_ns is not None:
                self.week_starts_ns = mark.utc_ns - mark.week_ns
            return mark.utc_ns
        if mark.week_ns is not None and self.week_starts_ns is not None:
            return self._nearest(self.week_starts_ns + mark.week_ns, WEEK_NS)
        if mark.day_ns is not None and self.now_ns is not None:
            return self._nearest(self.now_ns // DAY_NS * DAY_NS + mark.day_ns, DAY_NS)
        return None

    def _nearest(self, time_ns: int, period_ns: int) -> int:
        now_ns = time_ns if self.now_ns is None else self.now_ns
        return time_ns + (now_ns - time_ns + period_ns // 2) // period_ns * period_ns


def read_receiver(chunks: Iterable[bytes], *, week_of_ns: int | None = None) -> StampedFile:
    """Read the bytes of a receiver, or corrections for one.

    Parameters
    ----------
    chunks : iterable of bytes
        The file.
    week_of_ns : int or None
        [ns since 1970, UTC] A time of the same drive, for a file that tells times of week without a date.

    Returns
    -------
    Stamped
        Its clock is UTC, the time of day without a date, or free where no frame tells a time. `rejects` are those of
        the framing, and `time_goes_back` counts frames that tell an earlier time than those before them.
    """
    rejects: Counter[str] = Counter()
    frames = _with_marks(list(_frames(chunks, rejects)))
    first = _first_known(frames)
    epochs = _Epochs(rejects=rejects)
    clock = ClockKind.UTC
    if first is not None:
        epochs.now_ns = epochs.time_of(first)
        # Frames before the one with the date may tell an earlier time.
        valid = (mark for _, mark in frames if mark.valid)
        epochs.now_ns = next((told for mark in valid if (told := epochs.time_of(mark)) is not None), None)
    elif week_of_ns is not None and any(mark.week_ns is not None for _, mark in frames):
        epochs.now_ns, epochs.week_starts_ns = week_of_ns, _week_start(week_of_ns)
    elif (tow_ns := next((mark.week_ns for _, mark in frames if mark.week_ns is not None), None)) is not None:
        epochs.now_ns = WITHOUT_DATE_NS + (tow_ns - LEAP_NS) % DAY_NS
        epochs.week_starts_ns = epochs.now_ns - tow_ns
        clock = ClockKind.DAY
    elif any(mark.day_ns is not None for _, mark in frames):
        epochs.now_ns = WITHOUT_DATE_NS + next(mark.day_ns for _, mark in frames if mark.day_ns is not None)
        clock = ClockKind.DAY
    else:
        epochs.now_ns, clock = WITHOUT_DATE_NS, ClockKind.FREE
    of_rtcm = sum(frame.protocol == "RTCM" for frame, _ in frames)
    kind = FileKind.CORRECTIONS if frames and of_rtcm == len(frames) else FileKind.RECEIVER
    return StampedFile(kind, clock, _portions(frames, epochs), len(frames), rejects)


def _frames(chunks: Iterable[bytes], rejects: Counter[str]) -> Iterator[Frame]:
    framer = Framer(FRAMINGS, rejects)
    for chunk in chunks:
        yield from framer.feed(chunk)


def _with_marks(frames: list[Frame]) -> list[tuple[Frame, TimeMark]]:
    """What each frame tells of time, as far as it is valid and of one clock."""
    marks = with_validity([_mark(frame) for frame in frames])
    names = [frame.data[3:6].decode("ascii", "replace") if frame.protocol == "NMEA" else "" for frame in frames]
    return list(zip(frames, without_steps(names, [frame.data for frame in frames], marks), strict=True))


def _first_known(frames: list[tuple[Frame, TimeMark]]) -> TimeMark | None:
    """The first UTC, with the time of week of the same frame if it has one."""
    dated = [mark for _, mark in frames if mark.valid and mark.utc_ns is not None]
    return next((mark for mark in dated if mark.week_ns is not None), None) or next(iter(dated), None)


def _portions(frames: list[tuple[Frame, TimeMark]], epochs: _Epochs) -> list[Portion]:
    """Portions whose times never go back; what told a later time before a clock was set is left out."""
    marks, times_ns = [mark for _, mark in frames], list[int | None]()
    for mark in marks:
        times_ns.append(_accepted(epochs, mark, times_ns))
    portions: list[Portion] = []
    parts: list[bytes] = []
    size, at_ns = 0, epochs.now_ns or 0
    for (frame, _), time_ns in zip(frames, with_times_without_fix(marks, times_ns), strict=True):
        if time_ns is None:
            continue
        if parts and (time_ns != at_ns or size + len(frame.data) > MAX_PORTION):
            portions.append(Portion(at_ns, b"".join(parts)))
            parts, size = [], 0
        parts.append(frame.data)
        size, at_ns = size + len(frame.data), time_ns
    if parts:
        portions.append(Portion(at_ns, b"".join(parts)))
    return portions


def _accepted(epochs: _Epochs, mark: TimeMark, times_ns: list[int | None]) -> int | None:
    """Time of a frame, at least that of the one before; None for one that tells a much earlier time."""
    told_ns, now_ns = epochs.time_of(mark) if mark.valid else None, epochs.now_ns or 0
    if told_ns is None or now_ns - MAX_STEP_BACK_NS <= told_ns <= now_ns:
        if told_ns is not None:
            epochs.back = 0
        return now_ns
    if told_ns < now_ns:
        epochs.back += 1
        epochs.rejects["time_goes_back"] += 1
        if epochs.back < MIN_EARLIER_FRAMES:
            return None
        for k in reversed(range(len(times_ns))):
            if (time_ns := times_ns[k]) is not None and time_ns <= told_ns:
                break
            if time_ns is not None:
                times_ns[k] = None
                epochs.rejects["before_the_clock_was_set"] += 1
    epochs.back, epochs.now_ns = 0, told_ns
    return told_ns


def _mark(frame: Frame) -> TimeMark:
    if frame.protocol == "UBX":
        return _mark_of_ubx(frame.data[2], frame.data[3], frame.data[6:-2])
    if frame.protocol == "NMEA":
        return _mark_of_nmea(frame.data)
    return _mark_of_rtcm(frame.data)


def _mark_of_ubx(kind: int, number: int, payload: bytes) -> TimeMark:
    if kind == RXM and number == 0x15 and len(payload) >= 16:
        return _mark_of_rawx(payload)
    return _mark_of_nav(number, payload) if kind == NAV else TimeMark()


def _mark_of_nav(number: int, payload: bytes) -> TimeMark:
    if number in CALENDAR and len(payload) >= CALENDAR[number].size:
        return _mark_of_calendar(number, payload)
    if number == 0x20 and len(payload) >= 16:
        tow_ms, fraction_ns, week, leap, valid = struct.unpack_from("<IihbB", payload)
        return _mark_of_week(week, tow_ms * MS + fraction_ns, leap) if valid & 7 == 7 else _tow(payload, 0)
    if number in WEEKS_OF_OTHERS and len(payload) >= 20:
        tow_ms, _, _, week, leap, valid = struct.unpack_from("<IIihbB", payload)
        before, leap_s = WEEKS_OF_OTHERS[number]
        return _mark_of_week(week + before, tow_ms * MS, leap + leap_s) if valid & 7 == 7 else _tow(payload, 0)
    if number == 0x06 and len(payload) >= 52:
        tow_ms, _, week, _, flags = struct.unpack_from("<IihBB", payload)
        return _mark_of_week(week, tow_ms * MS, None) if flags & 0x0C == 0x0C else _tow(payload, 0)
    at = TOW_AT.get(number, 0)
    return TimeMark() if at is None else _tow(payload, at)


def _tow(payload: bytes, at: int) -> TimeMark:
    if len(payload) < at + 4:
        return TimeMark()
    tow_ns = int.from_bytes(payload[at : at + 4], "little") * MS
    return TimeMark(week_ns=tow_ns) if tow_ns < WEEK_NS else TimeMark()


def _mark_of_calendar(number: int, payload: bytes) -> TimeMark:
    """Mark of a message with the date: the time of week stays where that is not valid."""
    form = CALENDAR[number]
    tow_ms, *fields = form.layout.unpack_from(payload)
    told = dict(zip(form.fields, fields, strict=True))
    if told["valid"] & form.valid != form.valid:
        return replace(_tow(payload, 0), valid=False)
    seconds = told["hour"] * 3600 + told["minute"] * 60 + told["second"]
    utc_ns = _utc_ns(told["year"], told["month"], told["day"], seconds * NS + told["nano"])
    if utc_ns is None:
        return _tow(payload, 0)
    # `nano` holds the receiver's clock error as well: the epoch is the time of week, which is in whole ms.
    return TimeMark(utc_ns=round(utc_ns / MS) * MS, week_ns=tow_ms * MS, valid=True)


def _mark_of_rawx(payload: bytes) -> TimeMark:
    tow_s, week, leap, _, status = struct.unpack_from("<dHbBB", payload)
    if not 0.0 <= tow_s < WEEK_NS / NS or not week:
        return TimeMark()
    return _mark_of_week(week, round(tow_s * 1000) * MS, leap if status & 1 else None)


def _mark_of_week(week: int, tow_ns: int, leap: int | None) -> TimeMark:
    gps_ns = GPS_EPOCH_UTC_NS + week * WEEK_NS + tow_ns
    utc_ns = gps_ns - _leap_ns(gps_ns) if leap is None else gps_ns - leap * NS
    return TimeMark(utc_ns=utc_ns, week_ns=tow_ns) if is_plausible(utc_ns) else TimeMark()


def _mark_of_nmea(sentence: bytes) -> TimeMark:
    fields = sentence.split(b"*")[0].split(b",")
    name = fields[0][-3:]
    place = TIME_AT.get(name)
    match = TIME_OF_DAY.fullmatch(fields[place]) if place is not None and place < len(fields) else None
    if match is None:
        return TimeMark()
    fraction_ns = int((match[4] or b"0").ljust(9, b"0"))
    day_ns = (int(match[1]) * 3600 + int(match[2]) * 60 + int(match[3])) * NS + fraction_ns
    valid = _has_fix(name, fields)
    digits = fields[9] if name == b"RMC" and len(fields) > 9 else b"".join(fields[2:5]) if name == b"ZDA" else b""
    if not digits.isdigit() or len(digits) not in (6, 8):
        return TimeMark(day_ns=day_ns, valid=valid)
    day, month, year = int(digits[:2]), int(digits[2:4]), int(digits[4:])
    if len(digits) == 6:
        year += 1900 if year >= 80 else 2000
    return TimeMark(utc_ns=_utc_ns(year, month, day, day_ns), day_ns=day_ns, valid=valid)


def _has_fix(name: bytes, fields: list[bytes]) -> bool | None:
    """Whether a sentence states a fix: without one, its time and date are arbitrary; None where it does not say."""
    place, none = STATUS_AT.get(name, (0, b""))
    if not place or place >= len(fields):
        return None
    return bool(fields[place].strip(none))


def _mark_of_rtcm(frame: bytes) -> TimeMark:
    number = frame[3] << 4 | frame[4] >> 4
    if len(frame) < 13 or number not in RTCM_WITH_TOW | RTCM_BEIDOU:
        return TimeMark()
    tow_ns = (int.from_bytes(frame[3:11], "big") >> 10 & 0x3FFFFFFF) * MS  # bits 24 to 53 of the message
    if number in RTCM_BEIDOU:
        tow_ns += BEIDOU_NS
    return TimeMark(week_ns=tow_ns % WEEK_NS) if tow_ns < WEEK_NS + BEIDOU_NS else TimeMark()


def _utc_ns(year: int, month: int, day: int, day_ns: int) -> int | None:
    try:
        midnight = datetime.combine(date(year, month, day), datetime.min.time(), UTC)
    except ValueError:
        return None
    utc_ns = round(midnight.timestamp()) * NS + day_ns
    return utc_ns if is_plausible(utc_ns) else None


def _leap_ns(gps_ns: int) -> int:
    """GPS time less UTC at a time of the GPS scale [ns since 1970 without leap seconds]."""
    seconds = gps_ns / NS
    return round(seconds - float(utc_of(np.array([seconds]), "gps")[0])) * NS


def _week_start(utc_ns: int) -> int:
    """UTC at which the GPS week of a time began."""
    gps_ns = utc_ns + _leap_ns(utc_ns)
    return gps_ns - (gps_ns - GPS_EPOCH_UTC_NS) % WEEK_NS - _leap_ns(utc_ns)
