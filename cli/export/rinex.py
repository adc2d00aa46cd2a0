"""Formats raw measurements as a RINEX 3.05 observation file.

References
----------
RINEX, The Receiver Independent Exchange Format, version 3.05, IGS and RTCM SC104, 2020: tables A2
(header) and A3 (data).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from shared.messages.gnss import Constellation, GnssRawEpoch, RawMeasurement

SYSTEMS = {
    Constellation.GPS: "G", Constellation.GLONASS: "R", Constellation.GALILEO: "E", Constellation.BEIDOU: "C",
    Constellation.QZSS: "J", Constellation.SBAS: "S", Constellation.NAVIC: "I",
}  # fmt: skip
FIRST_NUMBER = {"J": 193, "S": 120}  # PRN of satellites whose RINEX number is smaller
NUMBER_OFFSET = {"J": 192, "S": 100}
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
KINDS = "CLDS"  # pseudorange, carrier phase, Doppler, signal strength
Ecef = tuple[float, float, float]  # [m]
PER_LINE = 13  # observation types in a line of the header
CHANNELS_PER_LINE = 8  # GLONASS satellites in a line of the header
LOSS_OF_LOCK, HALF_CYCLE = 1, 2  # bits of the loss-of-lock indicator


@dataclass
class Content:
    """What the header has to name: observation codes of each system, GLONASS channels, and the first epoch."""

    codes: dict[str, list[str]] = field(default_factory=dict)
    channels: dict[str, int] = field(default_factory=dict)  # frequency number of each GLONASS satellite
    first_ns: int | None = None
    leap_seconds: int | None = None

    def add(self, epoch: GnssRawEpoch) -> None:
        """Take note of an epoch."""
        self.first_ns = epoch.gps_time_ns if self.first_ns is None else self.first_ns
        self.leap_seconds = epoch.leap_seconds if self.leap_seconds is None else self.leap_seconds
        for measurement in epoch.measurements:
            name = satellite(measurement)
            if name is None or measurement.signal is None:
                continue
            if measurement.glonass_frequency_number is not None:
                self.channels[name] = measurement.glonass_frequency_number
            codes = self.codes.setdefault(name[0], [])
            if f"C{measurement.signal}" not in codes:
                codes += [kind + measurement.signal for kind in KINDS]


def satellite(one: RawMeasurement) -> str | None:
    """Give the RINEX name of a satellite, such as G05; None for one that has none."""
    system = SYSTEMS.get(one.constellation)
    if system is None:
        return None
    number = one.number - NUMBER_OFFSET[system] if one.number >= FIRST_NUMBER.get(system, 1000) else one.number
    return f"{system}{number:02d}" if 1 <= number <= 99 else None


def header_lines(content: Content, marker: str, approximate_m: Ecef, made: datetime) -> Iterator[str]:
    """Format the header; `approximate_m` is the ECEF position of the antenna at the start, zeros if unknown."""
    assert content.first_ns is not None, "there is an epoch"
    yield _line(f"{3.05:9.2f}{'':11}{'OBSERVATION DATA':20}{'M (MIXED)':20}", "RINEX VERSION / TYPE")
    yield _line(f"{'obu':20}{'':20}{made:%Y%m%d %H%M%S} UTC", "PGM / RUN BY / DATE")
    yield _line(f"{marker[:60]}", "MARKER NAME")
    yield _line("GROUND_CRAFT", "MARKER TYPE")
    yield _line("", "OBSERVER / AGENCY")
    yield _line("", "REC # / TYPE / VERS")
    yield _line("", "ANT # / TYPE")
    yield _line("".join(f"{value:14.4f}" for value in approximate_m), "APPROX POSITION XYZ")
    yield _line(f"{0.0:14.4f}" * 3, "ANTENNA: DELTA H/E/N")
    for system, codes in content.codes.items():
        for start in range(0, len(codes), PER_LINE):
            head = f"{system}  {len(codes):3d}" if start == 0 else " " * 6
            yield _line(head + "".join(f" {code}" for code in codes[start : start + PER_LINE]), "SYS / # / OBS TYPES")
    yield _line("DBHZ", "SIGNAL STRENGTH UNIT")
    yield _line(f"{_calendar(content.first_ns, '6d', '13.7f')}     GPS", "TIME OF FIRST OBS")
    for system, codes in content.codes.items():
        for code in (code for code in codes if code[0] == "L"):
            yield _line(f"{system} {code}", "SYS / PHASE SHIFT")
    if "R" in content.codes:
        yield from _channel_lines(content.channels)
        yield _line(" C1C" + " " * 9 + " C1P" + " " * 9 + " C2C" + " " * 9 + " C2P", "GLONASS COD/PHS/BIS")
    if content.leap_seconds is not None:
        yield _line(f"{content.leap_seconds:6d}", "LEAP SECONDS")
    yield _line("", "END OF HEADER")


def _channel_lines(channels: dict[str, int]) -> Iterator[str]:
    """Format the frequency numbers of the GLONASS satellites that state theirs: eight in a line."""
    entries = [f"{name} {channels[name]:2d} " for name in sorted(channels)]
    for start in range(0, max(len(entries), 1), CHANNELS_PER_LINE):
        head = f"{len(entries):3d} " if start == 0 else " " * 4
        yield _line(head + "".join(entries[start : start + CHANNELS_PER_LINE]), "GLONASS SLOT / FRQ #")


def epoch_lines(epochs: Iterable[GnssRawEpoch], content: Content) -> Iterator[str]:
    """Format the epochs, one line for each satellite."""
    locks: dict[tuple[str, str], float] = {}
    for epoch in epochs:
        rows: dict[str, dict[str, str]] = {}
        for measurement in epoch.measurements:
            name = satellite(measurement)
            if name is not None and measurement.signal is not None:
                rows.setdefault(name, {}).update(_fields(measurement, _indicator(name, measurement, locks)))
        if not rows:
            continue
        yield f"> {_calendar(epoch.gps_time_ns, '4d', '11.7f', '02d')}  0{len(rows):3d}\n"
        for name in sorted(rows):
            fields = "".join(rows[name].get(code, " " * 16) for code in content.codes[name[0]])
            yield f"{name}{fields}".rstrip() + "\n"


def _fields(one: RawMeasurement, indicator: int) -> dict[str, str]:
    """Format the observations of a signal: value, loss-of-lock indicator and strength from 1 to 9."""
    strength = "" if one.cn0_db_hz is None else str(min(max(int(one.cn0_db_hz // 6), 1), 9))
    values = {
        "C": (one.pseudorange_m, " "),
        "L": (one.carrier_phase_cycles, str(indicator) if indicator else " "),
        "D": (one.doppler_hz, " "),
        "S": (one.cn0_db_hz, " "),
    }
    return {
        f"{kind}{one.signal}": f"{value:14.3f}{mark}{strength if kind in 'CL' else '':1}"
        for kind, (value, mark) in values.items()
        if value is not None
    }


def _indicator(name: str, one: RawMeasurement, locks: dict[tuple[str, str], float]) -> int:
    """Give the loss-of-lock indicator: the lock is younger than before, or half a cycle is not resolved."""
    key, lock_s = (name, one.signal or ""), one.lock_time_s
    lost = lock_s is not None and lock_s < locks.get(key, 0.0)
    if lock_s is not None:
        locks[key] = lock_s
    return (LOSS_OF_LOCK if lost else 0) | (0 if one.half_cycle_resolved else HALF_CYCLE)


def _calendar(gps_time_ns: int, year: str, seconds: str, rest: str | None = None) -> str:
    """Write a GPS time: year, month, day, hour, minute, seconds to 100 ns."""
    at = _instant(gps_time_ns)
    second = at.second + gps_time_ns % 1_000_000_000 // 100 * 1e-7
    parts = (at.month, at.day, at.hour, at.minute)
    joined = "".join(f" {part:{rest}}" for part in parts) if rest else "".join(f"{part:6d}" for part in parts)
    return f"{at.year:{year}}{joined}{second:{seconds}}"


def _instant(gps_time_ns: int) -> datetime:
    return GPS_EPOCH + timedelta(seconds=gps_time_ns // 1_000_000_000)


def _line(text: str, label: str) -> str:
    return f"{text:60}{label:20}".rstrip() + "\n"
