"""Converts the text log of Android's GnssLogger to messages: fixes, satellites, raw measurements, inertial samples.

Every kind of line is named by its first field and described by a header such as `# Fix,Provider,LatitudeDegrees,...`;
the names of the fields differ between versions of the app. Its NMEA log has lines without a header,
`NMEA,$GPGGA,...*63,1699400577561`: the sentence, and the time of its arrival in ms.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from services.parsers.gnss.android.fixes import fix_of
from services.parsers.gnss.android.measurements import gps_time_ns, measurement
from services.parsers.gnss.process import Config, Process
from shared.maths.dates import GPS_EPOCH_UTC_NS, NS
from shared.maths.earth import FloatArray
from shared.messages.gnss import (
    Constellation,
    GnssFix,
    GnssRaw,
    GnssRawEpoch,
    GnssSatellites,
    RawMeasurement,
    Satellite,
)
from shared.messages.imu import ImuSamples
from shared.protocols.gnss_logger import Row, fields_of, integer, number

SOURCE = "phone0"
MS = 1_000_000
LEAP_SECONDS = 18  # GPS - UTC since 2017, for logs that state none
BATCH = 10  # inertial samples a message
SENSORS = ("UncalAccel", "Accel"), ("UncalGyro", "Gyro")
MIN_SAMPLES = 2  # accelerations, between which those at the rates' times are interpolated
GAP_NS = 100 * MS  # between accelerations, over which none is interpolated
CONSTELLATIONS = {
    1: Constellation.GPS, 2: Constellation.SBAS, 3: Constellation.GLONASS, 4: Constellation.QZSS,
    5: Constellation.BEIDOU, 6: Constellation.GALILEO, 7: Constellation.NAVIC,
}  # fmt: skip
OLDEST_FIX = ("provider", "latitudedegrees", "longitudedegrees", "altitudemeters", "speedmps", "accuracymeters")
NMEA_LINE = re.compile(r"NMEA,\s*(\$[^*]*\*[0-9A-Fa-f]{2})\s*,\s*(\d{1,16})\s*")
LogMessage = GnssFix | GnssRawEpoch | GnssSatellites | ImuSamples


@dataclass
class Log:
    """Rows of each kind, NMEA sentences with their arrival [ms], and the counts of lines and rejects."""

    rows: dict[str, list[Row]] = field(default_factory=lambda: defaultdict(list))
    sentences: list[tuple[str, int]] = field(default_factory=list)
    lines: int = 0
    rejects: Counter[str] = field(default_factory=Counter)


def is_log(first_lines: Iterable[str]) -> bool:
    """Whether a file begins as GnssLogger's files do."""
    return any((line.startswith("#") and "Header Description" in line) or NMEA_LINE.match(line) for line in first_lines)


def read_log(lines: Iterable[str]) -> Log:
    """Read all lines; those without a header, or with too few fields, are counted and rejected."""
    log, headers = Log(), dict[str, tuple[str, ...]]()
    for line in lines:
        fields = [name.strip() for name in line.lstrip("# ").strip().split(",")]
        if line.startswith("#"):
            if len(fields) > 1:
                headers[fields[0]] = fields_of(fields[1:])
            continue
        if len(fields) < 2 or not fields[0]:
            continue
        log.lines += 1
        header = headers.get(fields[0])
        if (sentence := NMEA_LINE.match(line)) is not None:
            log.sentences.append((sentence[1], int(sentence[2])))
        elif header is None:
            log.rejects["line without header"] += 1
        elif len(fields) - 1 < min(len(header), len(OLDEST_FIX)):
            log.rejects["too few fields"] += 1
        else:
            log.rows[fields[0]].append(dict(zip(header, fields[1:], strict=False)))
    return log


def messages_of(log: Log, axes: FloatArray) -> list[LogMessage]:
    """Convert a log to messages in order of time.

    Parameters
    ----------
    log : Log
        All rows; its rejects count what cannot be converted.
    axes : ndarray, shape (3, 3)
        Body axes (forward, right, down) from those of the device (right, top, out of the screen).

    Returns
    -------
    list of LogMessage
        Stamped in UTC: those of the sensors' clock (`elapsedRealtimeNanos`) by its median offset to UTC.
    """
    offset_ns = _clock_offset(log)
    made: list[LogMessage] = [
        *(_fixes(log, offset_ns) if log.rows.get("Fix") else _fixes_of_sentences(log)),
        *_satellites(log),
        *_raw_epochs(log),
        *_inertial(log, offset_ns, axes),
    ]
    return sorted(made, key=lambda message: message.received_ns)


def _clock_offset(log: Log) -> int | None:
    pairs = [
        round(utc) * MS - round(elapsed)
        for kind in ("UncalAccel", "Accel", "UncalGyro", "Gyro")
        for row in log.rows.get(kind, ())
        if (utc := number(row, "utctimemillis")) and (elapsed := number(row, "elapsedrealtimenanos"))
    ]
    return int(np.median(pairs)) if pairs else None


def _fixes(log: Log, offset_ns: int | None) -> Iterator[GnssFix]:
    """Fixes of the receiver; those by network or of several sources are rejected."""
    last_ns = 0
    for row in log.rows.get("Fix", ()):
        if row["provider"].lower() != "gps":
            log.rejects["fix of another provider"] += 1
            continue
        fix = fix_of(row)
        if fix is None:
            log.rejects["fix without position or time"] += 1
            continue
        elapsed = number(row, "elapsedrealtimenanos")
        assert fix.utc_ns is not None
        stamp_ns = fix.utc_ns if elapsed is None or offset_ns is None else round(elapsed) + offset_ns
        if stamp_ns <= last_ns:
            log.rejects["fix not later than the previous one"] += 1
            continue
        last_ns = stamp_ns
        yield fix.model_copy(update={"sampled_ns": stamp_ns, "received_ns": stamp_ns, "source": SOURCE})


def _fixes_of_sentences(log: Log) -> Iterator[GnssFix]:
    """Fixes of the receiver's own NMEA sentences, by the parser of the unit."""
    parser = Process(Config())
    for sentence, arrival_ms in log.sentences:
        data = f"{sentence}\r\n".encode()
        for message in parser.handle(GnssRaw(received_ns=arrival_ms * MS, source=SOURCE, data=data, recorded=True)):
            if isinstance(message, GnssFix):
                yield message
    log.rejects.update({f"NMEA: {reason}": count for reason, count in parser.rejects.items()})


def contents(log: Log) -> str:
    """What a log holds and what it lacks, for a log of which nothing can be used."""
    counts = {kind: len(rows) for kind, rows in log.rows.items()} | {"NMEA": len(log.sentences)}
    held = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count) or "no lines of a known kind"
    rejected = ", ".join(f"{count} {reason}" for reason, count in log.rejects.items())
    missing = [f"`{kind}`" for kind in ("Fix", "Raw", "Status") if not counts.get(kind)]
    lacks = [f"{' and '.join(missing)} lines (GNSS)"] if missing else []
    for kinds in SENSORS:
        if (best := max(counts.get(kind, 0) for kind in kinds)) < MIN_SAMPLES:
            names = " or ".join(f"`{kind}`" for kind in kinds)
            lacks.append(f"{names} lines ({best}, at least {MIN_SAMPLES} are required)")
    return f"{held}" + (f"; rejected: {rejected}" if rejected else "") + f"; missing: {', '.join(lacks) or 'nothing'}"


def _satellites(log: Log) -> Iterator[GnssSatellites]:
    epochs: dict[int, list[Satellite]] = defaultdict(list)
    for row in log.rows.get("Status", ()):
        utc_ms, system, satellite = (number(row, name) for name in ("unixtimemillis", "constellationtype", "svid"))
        if utc_ms is None or system is None or satellite is None or not 0 < satellite < 300:
            log.rejects["status without time or satellite"] += 1
            continue
        elevation, azimuth = number(row, "elevationdegrees"), number(row, "azimuthdegrees")
        located = elevation is not None and azimuth is not None and abs(elevation) <= 90.0
        epochs[round(utc_ms) * MS].append(Satellite(
            constellation=CONSTELLATIONS.get(round(system), Constellation.UNKNOWN), number=round(satellite),
            cn0_db_hz=number(row, "cn0dbhz") or None, used=number(row, "usedinfix") == 1.0,
            elevation_rad=math.radians(elevation or 0.0) if located else None,
            azimuth_rad=math.radians(azimuth or 0.0) if located else None,
        ))  # fmt: skip
    for stamp_ns, satellites in sorted(epochs.items()):
        yield GnssSatellites(
            sampled_ns=stamp_ns, received_ns=stamp_ns, source=SOURCE, satellites=tuple(satellites[:128])
        )  # fmt: skip


def _raw_epochs(log: Log) -> Iterator[GnssRawEpoch]:
    """Pseudoranges of all signals of one time of the receiver's clock."""
    epochs: dict[tuple[int, int], list[RawMeasurement]] = defaultdict(list)
    stamps: dict[tuple[int, int], int | None] = {}
    for row in log.rows.get("Raw", ()):
        gps_ns = gps_time_ns(row)
        if gps_ns is None:
            log.rejects["raw without the receiver's clock"] += 1
            continue
        key = gps_ns, round(number(row, "leapsecond") or LEAP_SECONDS)
        measured = measurement(row, gps_ns)
        if isinstance(measured, str):
            log.rejects[f"raw: {measured}"] += 1
            continue
        epochs[key].append(measured)
        stamps[key] = integer(row, "utctimemillis")
    last_ns = 0
    for (gps_ns, leap_seconds), measurements in sorted(epochs.items()):
        utc_ms = stamps[gps_ns, leap_seconds]
        stamp_ns = utc_ms * MS if utc_ms else gps_ns + GPS_EPOCH_UTC_NS - leap_seconds * NS
        if stamp_ns <= last_ns:
            log.rejects["raw: epoch not later than the previous one"] += len(measurements)
            continue
        last_ns = stamp_ns
        yield GnssRawEpoch(
            sampled_ns=stamp_ns, received_ns=stamp_ns, source=SOURCE, gps_time_ns=gps_ns, leap_seconds=leap_seconds,
            measurements=tuple(measurements[:128]),
        )  # fmt: skip


def _inertial(log: Log, offset_ns: int | None, axes: FloatArray) -> Iterator[ImuSamples]:
    """Samples at the gyroscope's times, with the acceleration interpolated; uncalibrated sensors come first."""
    kinds = [next((kind for kind in pair if log.rows.get(kind)), None) for pair in SENSORS]
    if offset_ns is None or None in kinds:
        return
    (force_ns, force), (rate_ns, rate) = (_triples(log, kind, offset_ns) for kind in kinds if kind)
    if len(force_ns) < MIN_SAMPLES:
        return
    after = np.clip(np.searchsorted(force_ns, rate_ns), 1, len(force_ns) - 1)
    inside = (rate_ns >= force_ns[0]) & (rate_ns <= force_ns[-1]) & (force_ns[after] - force_ns[after - 1] <= GAP_NS)
    if not inside.all():
        log.rejects["inertial: no acceleration at the time of the rate"] += int((~inside).sum())
    rate_ns, rate = rate_ns[inside], rate[inside] @ axes.T
    since = (force_ns - force_ns[0]).astype(float)
    columns = [np.interp((rate_ns - force_ns[0]).astype(float), since, force[:, axis]) for axis in range(3)]
    force_b = np.column_stack(columns) @ axes.T
    pressures, fields = _series(log, "Pressure", offset_ns, 1), _series(log, "Mag", offset_ns, 3)
    for first in range(0, len(rate_ns), BATCH):
        part = slice(first, first + BATCH)
        stamp_ns = int(rate_ns[part][-1])
        pressure, magnetic = _last(pressures, stamp_ns), _last(fields, stamp_ns)
        yield ImuSamples(
            received_ns=stamp_ns, source=SOURCE, sampled_ns=tuple(rate_ns[part].tolist()),
            specific_force_body_m_s2=tuple((x, y, z) for x, y, z in force_b[part].tolist()),
            angular_rate_body_rad_s=tuple((x, y, z) for x, y, z in rate[part].tolist()),
            pressure_pa=None if pressure is None else float(pressure[0]) * 100.0,
            magnetic_field_body=None if magnetic is None else _triple(axes @ magnetic / 50.0),  # 50 uT
        )  # fmt: skip


def _triples(log: Log, kind: str, offset_ns: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], FloatArray]:
    """Stamps [ns] and the three values of each row of a sensor, later ones only."""
    stamps, values = list[int](), list[list[float]]()
    for row in log.rows[kind]:
        elapsed = number(row, "elapsedrealtimenanos")
        found = [number(row, name) for name in list(row)[2:5]]
        if elapsed is None or len(found) != 3 or None in found:
            log.rejects[f"{kind}: not a number"] += 1
        elif stamps and round(elapsed) + offset_ns <= stamps[-1]:
            log.rejects[f"{kind}: not later than the previous one"] += 1
        else:
            stamps.append(round(elapsed) + offset_ns)
            values.append([value for value in found if value is not None])
    return np.array(stamps, dtype=np.int64), np.array(values, dtype=float).reshape(-1, 3)


def _series(log: Log, kind: str, offset_ns: int, size: int) -> list[tuple[int, FloatArray]]:
    found = []
    for row in log.rows.get(kind, ()):
        elapsed, values = number(row, "elapsedrealtimenanos"), [number(row, name) for name in list(row)[2 : 2 + size]]
        if elapsed is not None and None not in values:
            found.append((round(elapsed) + offset_ns, np.array(values, dtype=float)))
    return sorted(found, key=lambda pair: pair[0])


def _last(series: list[tuple[int, FloatArray]], time_ns: int) -> FloatArray | None:
    """Newest value of the second before a time."""
    while len(series) > 1 and series[1][0] <= time_ns:
        series.pop(0)
    return series[0][1] if series and 0 <= time_ns - series[0][0] <= NS else None


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
