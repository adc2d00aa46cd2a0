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

from services.parsers.gnss.process import Config, Process
from shared.maths.dates import GPS_EPOCH_UTC_NS, NS, WEEK_NS
from shared.maths.earth import FloatArray
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.gnss import (
    Constellation,
    FixType,
    GnssFix,
    GnssRaw,
    GnssRawEpoch,
    GnssSatellites,
    RawMeasurement,
    Satellite,
)
from shared.messages.imu import ImuSamples

SOURCE = "phone0"
MS = 1_000_000
LEAP_SECONDS = 18  # GPS - UTC since 2017, for logs that state none
L1_HZ = 1_575_420_030.0
RANGES_M = (1.5e7, 6e7)  # pseudoranges of satellites in medium and geostationary orbits
MAX_SV_TIME_SD_NS = 500.0
BATCH = 10  # inertial samples a message
SENSORS = ("UncalAccel", "Accel"), ("UncalGyro", "Gyro")
MIN_SAMPLES = 2  # accelerations, between which those at the rates' times are interpolated
GAP_NS = 100 * MS  # between accelerations, over which none is interpolated
# Bits of State. A time of week or of day is decoded from this satellite, or known from others. A Galileo E1 signal has
# a bit of its own for the lock to its code.
CODE_LOCK = 1 | 1 << 10  # STATE_CODE_LOCK, STATE_GAL_E1BC_CODE_LOCK
TIME_OF_WEEK = 1 << 3 | 1 << 14  # STATE_TOW_DECODED, STATE_TOW_KNOWN
TIME_OF_DAY = 1 << 7 | 1 << 15  # STATE_GLO_TOD_DECODED, STATE_GLO_TOD_KNOWN
RANGE_VALID, RANGE_INTERRUPTED, HALF_CYCLE_RESOLVED = 1, 2 | 4, 8  # bits of AccumulatedDeltaRangeState
# Time of each system behind GPS time [ns]; GLONASS gives the time of day instead and is not read.
SYSTEMS = {
    1: (Constellation.GPS, 0), 4: (Constellation.QZSS, 0), 5: (Constellation.BEIDOU, 14 * NS),
    6: (Constellation.GALILEO, 0),
}  # fmt: skip
GLONASS = 3
CONSTELLATIONS = {
    1: Constellation.GPS, 2: Constellation.SBAS, 3: Constellation.GLONASS, 4: Constellation.QZSS,
    5: Constellation.BEIDOU, 6: Constellation.GALILEO, 7: Constellation.NAVIC,
}  # fmt: skip
# Observation codes by constellation and band; the band is known by its frequency [MHz].
SIGNALS = {
    (Constellation.GPS, 1575): "1C", (Constellation.GPS, 1176): "5Q", (Constellation.QZSS, 1575): "1C",
    (Constellation.QZSS, 1176): "5Q", (Constellation.GALILEO, 1575): "1C", (Constellation.GALILEO, 1176): "5Q",
    (Constellation.BEIDOU, 1561): "2I", (Constellation.BEIDOU, 1176): "5P", (Constellation.BEIDOU, 1575): "1P",
}  # fmt: skip
# Names of the same field in several versions, in lower case.
NAMES = {
    "latitude": "latitudedegrees", "longitude": "longitudedegrees", "altitude": "altitudemeters", "speed": "speedmps",
    "accuracy": "accuracymeters", "(utc)timeinms": "unixtimemillis", "bearing": "bearingdegrees",
}  # fmt: skip
OLDEST_FIX = ("provider", "latitudedegrees", "longitudedegrees", "altitudemeters", "speedmps", "accuracymeters")
NMEA_LINE = re.compile(r"NMEA,\s*(\$[^*]*\*[0-9A-Fa-f]{2})\s*,\s*(\d{1,16})\s*")
Row = dict[str, str]
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
                names = (name.lower() for name in fields[1:])
                headers[fields[0]] = tuple(NAMES.get(name, name) for name in names)
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
        if (utc := _number(row, "utctimemillis")) and (elapsed := _number(row, "elapsedrealtimenanos"))
    ]
    return int(np.median(pairs)) if pairs else None


def _fixes(log: Log, offset_ns: int | None) -> Iterator[GnssFix]:
    """Fixes of the receiver; those by network or of several sources are rejected."""
    last_ns = 0
    for row in log.rows.get("Fix", ()):
        if row["provider"].lower() != "gps":
            log.rejects["fix of another provider"] += 1
            continue
        found = [_number(row, name) for name in ("latitudedegrees", "longitudedegrees", "unixtimemillis")]
        latitude, longitude, utc_ms = found
        if latitude is None or longitude is None or utc_ms is None or abs(latitude) > 90.0 or abs(longitude) > 180.0:
            log.rejects["fix without position or time"] += 1
            continue
        elapsed = _number(row, "elapsedrealtimenanos")
        utc_ns = round(utc_ms) * MS
        stamp_ns = utc_ns if elapsed is None or offset_ns is None else round(elapsed) + offset_ns
        if stamp_ns <= last_ns:
            log.rejects["fix not later than the previous one"] += 1
            continue
        last_ns = stamp_ns
        speed, bearing = _number(row, "speedmps"), _number(row, "bearingdegrees")
        horizontal, vertical = _number(row, "accuracymeters"), _number(row, "verticalaccuracymeters")
        # Android's horizontal accuracy is the radius of 68 %: 1.51 standard deviations of an axis.
        axis = None if not horizontal else horizontal / math.sqrt(-2.0 * math.log(0.32))
        yield GnssFix(
            sampled_ns=stamp_ns, received_ns=stamp_ns, source=SOURCE, utc_ns=utc_ns, fix_type=FixType.THREE_D,
            latitude_deg=latitude, longitude_deg=longitude, height_ellipsoid_m=_number(row, "altitudemeters"),
            ground_speed_m_s=speed, course_rad=None if bearing is None else math.radians(bearing),
            position_sd_ned_m=(axis, axis, vertical) if axis and vertical else None,
        )  # fmt: skip


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
        utc_ms, system, number = (_number(row, name) for name in ("unixtimemillis", "constellationtype", "svid"))
        if utc_ms is None or system is None or number is None or not 0 < number < 300:
            log.rejects["status without time or satellite"] += 1
            continue
        elevation, azimuth = _number(row, "elevationdegrees"), _number(row, "azimuthdegrees")
        located = elevation is not None and azimuth is not None and abs(elevation) <= 90.0
        epochs[round(utc_ms) * MS].append(Satellite(
            constellation=CONSTELLATIONS.get(round(system), Constellation.UNKNOWN), number=round(number),
            cn0_db_hz=_number(row, "cn0dbhz") or None, used=_number(row, "usedinfix") == 1.0,
            elevation_rad=math.radians(elevation or 0.0) if located else None,
            azimuth_rad=math.radians(azimuth or 0.0) if located else None,
        ))  # fmt: skip
    for stamp_ns, satellites in sorted(epochs.items()):
        yield GnssSatellites(
            sampled_ns=stamp_ns, received_ns=stamp_ns, source=SOURCE, satellites=tuple(satellites[:128])
        )  # fmt: skip


def _raw_epochs(log: Log) -> Iterator[GnssRawEpoch]:
    """Pseudoranges of all signals of one time of the receiver's clock.

    Notes
    -----
    With the times of reception and transmission by the receiver's clock and by the satellite's::

        t_rx = TimeNanos - (FullBiasNanos + BiasNanos),    t_tx = ReceivedSvTimeNanos
        pseudorange = c ((t_rx + TimeOffsetNanos - t_system - t_tx) mod week)

    References
    ----------
    European GNSS Agency, Using GNSS raw measurements on Android devices, 2017, section 2.4.
    """
    epochs: dict[tuple[int, int], list[RawMeasurement]] = defaultdict(list)
    stamps: dict[tuple[int, int], int | None] = {}
    for row in log.rows.get("Raw", ()):
        clock = _integer(row, "timenanos"), _integer(row, "fullbiasnanos")
        if clock[0] is None or not clock[1]:
            log.rejects["raw without the receiver's clock"] += 1
            continue
        gps_ns = clock[0] - clock[1] - round(_number(row, "biasnanos") or 0.0)
        key = gps_ns, round(_number(row, "leapsecond") or LEAP_SECONDS)
        measured = _measurement(row, gps_ns)
        if isinstance(measured, str):
            log.rejects[f"raw: {measured}"] += 1
            continue
        epochs[key].append(measured)
        stamps[key] = _integer(row, "utctimemillis")
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


def _measurement(row: Row, gps_ns: int) -> RawMeasurement | str:
    """One signal, or why it is rejected."""
    system, number, state = (_integer(row, name) for name in ("constellationtype", "svid", "state"))
    sent_ns, offset_ns = _integer(row, "receivedsvtimenanos"), _number(row, "timeoffsetnanos") or 0.0
    if reason := _without_time(system, state or 0):
        return reason
    if system not in SYSTEMS or number is None or not 0 < number < 300:
        return "constellation"
    sent_sd_ns = _number(row, "receivedsvtimeuncertaintynanos")
    if sent_ns is None or sent_sd_ns is None or not 0.0 <= sent_sd_ns <= MAX_SV_TIME_SD_NS:
        return "time of transmission"
    constellation, behind_ns = SYSTEMS[system]
    flight_ns = (gps_ns - behind_ns - sent_ns + WEEK_NS // 2) % WEEK_NS - WEEK_NS // 2 + offset_ns
    pseudorange = flight_ns / NS * SPEED_OF_LIGHT
    if not RANGES_M[0] <= pseudorange <= RANGES_M[1]:
        return "pseudorange beyond any orbit"
    frequency = _number(row, "carrierfrequencyhz") or L1_HZ
    if not 1.1e9 <= frequency <= 1.7e9:
        return "carrier frequency"
    wavelength = SPEED_OF_LIGHT / frequency
    rate, rate_sd = (
        _number(row, "pseudorangeratemeterspersecond"),
        _number(row, "pseudorangerateuncertaintymeterspersecond"),
    )
    phase_state, distance = _integer(row, "accumulateddeltarangestate"), _number(row, "accumulateddeltarangemeters")
    phase_state = phase_state or 0
    carrier = phase_state & RANGE_VALID and distance is not None
    return RawMeasurement(
        constellation=constellation, number=number, signal=SIGNALS.get((constellation, int(frequency // 1e6))),
        pseudorange_m=pseudorange, pseudorange_sd_m=max(sent_sd_ns, 1.0) / NS * SPEED_OF_LIGHT,
        carrier_phase_cycles=distance / wavelength if carrier and distance is not None else None,
        half_cycle_resolved=bool(phase_state & HALF_CYCLE_RESOLVED),
        lock_time_s=0.0 if phase_state & RANGE_INTERRUPTED else None,  # reset, or a cycle slip
        doppler_hz=None if rate is None else -rate / wavelength,
        doppler_sd_hz=None if rate_sd is None else rate_sd / wavelength, cn0_db_hz=_number(row, "cn0dbhz"),
    )  # fmt: skip


def _without_time(system: int | None, state: int) -> str:
    """Why the time of transmission of a signal is not known, or not used; empty where it is."""
    if not state & CODE_LOCK:
        return "no lock to the code"
    if system == GLONASS:
        return "GLONASS is not used" if state & TIME_OF_DAY else "no time of day"
    return "" if state & TIME_OF_WEEK else "no time of week"


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
        elapsed = _number(row, "elapsedrealtimenanos")
        found = [_number(row, name) for name in list(row)[2:5]]
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
        elapsed, values = _number(row, "elapsedrealtimenanos"), [_number(row, name) for name in list(row)[2 : 2 + size]]
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


def _number(row: Row, name: str) -> float | None:
    try:
        value = float(row.get(name, ""))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _integer(row: Row, name: str) -> int | None:
    """An integer, to the last digit; nanoseconds since 1980 do not fit a double."""
    text = row.get(name, "")
    try:
        return int(text)
    except ValueError:
        value = _number(row, name)
        return None if value is None or abs(value) > 1e15 else round(value)
