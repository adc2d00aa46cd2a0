"""Reads RINEX 2 and 3 navigation files: GPS and Galileo ephemerides and the Klobuchar coefficients.

References
----------
RINEX 2.11 (W. Gurtner, L. Estey, 2007), tables A3 and A4; RINEX 3.05 (I. Romero, 2020), tables A5, A6 and A8.
"""

from collections.abc import Iterator
from datetime import datetime, timedelta

from shared.maths.gnss_signals import Klobuchar

from ..measurements import Constellation, SatelliteId
from .ephemeris import Ephemeris
from .gps_lnav import nearest_ns

GPS_EPOCH = datetime(1980, 1, 6)  # of GPS time, without leap seconds
ORBIT_LINES = 7
INAV_E1 = 1 << 0  # bit of the data source of Galileo ephemerides that are from I/NAV E1-B
CLOCK_E5B = 1 << 9  # bit that says that af0 to af2 are for E5b and E1
SKIPPED_LINES = {"R": 3, "S": 3}  # orbit lines of GLONASS and SBAS; all others have seven
E1_HEALTH = 0b111  # bits of E1B's data validity and signal health


def read_rinex_navigation(text: str) -> tuple[list[Ephemeris], Klobuchar | None]:
    """Read a navigation file.

    Parameters
    ----------
    text : str
        The whole file.

    Returns
    -------
    list of Ephemeris, Klobuchar or None
        GPS and Galileo I/NAV ephemerides in the file's order; records of other systems are passed over.

    Raises
    ------
    ValueError
        It is no RINEX 2 or 3 navigation file, or a record is broken; says the line.
    """
    lines = text.splitlines()
    if not lines or lines[0][60:].strip() != "RINEX VERSION / TYPE" or lines[0][20:21] != "N":
        raise ValueError("no RINEX navigation file: its first line must be 'RINEX VERSION / TYPE' of type N")
    version = float(lines[0][:9])
    if not 2.0 <= version < 4.0:
        raise ValueError(f"RINEX {version:.2f} is not read: convert the file to version 2 or 3")
    end = next((k for k, line in enumerate(lines) if line[60:].strip() == "END OF HEADER"), None)
    if end is None:
        raise ValueError("the RINEX header has no END OF HEADER: the file is cut")
    ephemerides = list(_records(lines, end + 1, 3 if version >= 3.0 else 2))
    return ephemerides, _ionosphere(lines[:end])


def _records(lines: list[str], start: int, version: int) -> Iterator[Ephemeris]:
    at = start
    while at < len(lines):
        line = lines[at]
        if not line.strip():
            at += 1
            continue
        system = line[0] if version == 3 else "G"
        rows = 1 + SKIPPED_LINES.get(system, ORBIT_LINES)
        try:
            if len(lines) - at < rows:
                raise ValueError("the file is cut")
            if system in "GE":
                found = _ephemeris(lines[at : at + rows], version)
                if found is not None:
                    yield found
        except ValueError as error:
            raise ValueError(f"RINEX navigation record at line {at + 1}: {error}") from error
        at += rows


def _ephemeris(rows: list[str], version: int) -> Ephemeris | None:
    head, margin = (23, 4) if version == 3 else (22, 3)
    system = rows[0][0] if version == 3 else "G"
    constellation = Constellation.GPS if system == "G" else Constellation.GALILEO
    number = int(rows[0][1:3] if version == 3 else rows[0][:2])
    clock = _numbers(rows[0], head)
    orbit = [value for row in rows[1:] for value in (*_numbers(row, margin), 0.0, 0.0, 0.0, 0.0)[:4]]
    af0, af1, af2 = clock
    toc_ns = _toc_ns(rows[0], version)
    source = round(orbit[17])
    if constellation == Constellation.GALILEO and not (source & INAV_E1 and source & CLOCK_E5B):
        return None  # F/NAV, whose clock is for E1 and E5a
    galileo = constellation == Constellation.GALILEO
    health = round(orbit[21])
    return Ephemeris(
        SatelliteId(constellation, number), round(orbit[0]), nearest_ns(round(orbit[8]), toc_ns), toc_ns,
        sqrt_a=orbit[7], eccentricity=orbit[5], mean_anomaly=orbit[3], mean_motion_difference=orbit[2],
        node=orbit[10], node_rate=orbit[15], inclination=orbit[12], inclination_rate=orbit[16], perigee=orbit[14],
        cuc=orbit[4], cus=orbit[6], crc=orbit[13], crs=orbit[1], cic=orbit[9], cis=orbit[11], clock=(af0, af1, af2),
        group_delay_s=orbit[23] if galileo else orbit[22],
        healthy=(health & E1_HEALTH if galileo else health) == 0,
        accuracy_m=orbit[20] if orbit[20] > 0.0 else None,
    )  # fmt: skip


def _toc_ns(row: str, version: int) -> int:
    if version == 3:
        year, month, day, hour, minute, second = (int(part) for part in row[4:23].split())
        whole = second
    else:
        year, month, day, hour, minute = (int(row[k : k + 3]) for k in range(2, 17, 3))
        year += 1900 if year >= 80 else 2000
        whole = round(float(row[17:22]))
    return (
        (datetime(year, month, day, hour, minute) - GPS_EPOCH + timedelta(seconds=whole))
        // timedelta(microseconds=1)
        * 1000
    )


def _numbers(row: str, margin: int) -> tuple[float, ...]:
    """Fields of 19 characters; FORTRAN writes D for the exponent."""
    fields = (row[k : k + 19].strip() for k in range(margin, min(len(row.rstrip()), margin + 76), 19))
    return tuple(float(part.replace("D", "E").replace("d", "e")) if part else 0.0 for part in fields)


def _ionosphere(header: list[str]) -> Klobuchar | None:
    found: dict[str, tuple[float, ...]] = {}
    for line in header:
        label = line[60:].strip()
        if label in ("ION ALPHA", "ION BETA"):
            found[label[4:]] = tuple(float(line[k : k + 12].replace("D", "E")) for k in range(2, 50, 12))
        elif label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            name = "ALPHA" if line[3] == "A" else "BETA"
            found[name] = tuple(float(line[k : k + 12].replace("D", "E")) for k in range(5, 53, 12))
    if found.keys() != {"ALPHA", "BETA"}:
        return None
    (a0, a1, a2, a3), (b0, b1, b2, b3) = found["ALPHA"], found["BETA"]
    return Klobuchar((a0, a1, a2, a3), (b0, b1, b2, b3))
