"""Reads RINEX 2 observation files: C1 pseudoranges, L1 phases, D1 Doppler and S1 strength of GPS and Galileo.

Reference: RINEX 2.11 (W. Gurtner, L. Estey, 2007), tables A1 and A2.
"""

from collections.abc import Iterator
from datetime import datetime, timedelta

from shared.maths.rotation import Vector

from ..measurements import Constellation, Measurement, RawEpoch, SatelliteId
from .rinex import GPS_EPOCH

CONSTELLATIONS = {"G": Constellation.GPS, " ": Constellation.GPS, "E": Constellation.GALILEO}
OBSERVATIONS_PER_LINE, SATELLITES_PER_LINE = 5, 12
LOST_LOCK, HALF_CYCLE = 1, 2  # bits of the loss-of-lock indicator
NEW_EPOCH = "01"  # flags of epochs with observations; 2 to 5 are events with header lines, 6 are cycle slips


def read_rinex_observations(text: str) -> tuple[list[RawEpoch], Vector | None]:
    """Read an observation file.

    Parameters
    ----------
    text : str
        The whole file, RINEX 2.

    Returns
    -------
    list of RawEpoch, tuple of float or None
        The epochs, in which satellites of other systems are left out, and [m, ECEF] the header's position.

    Raises
    ------
    ValueError
        It is no RINEX 2 observation file, or it is broken; says the line.
    """
    lines = text.splitlines()
    if not lines or lines[0][60:].strip() != "RINEX VERSION / TYPE" or lines[0][20:21] != "O":
        raise ValueError("no RINEX observation file: its first line must be 'RINEX VERSION / TYPE' of type O")
    if not 2.0 <= float(lines[0][:9]) < 3.0:
        raise ValueError("only observation files of RINEX 2 are read: convert the file")
    types: list[str] = []
    position: Vector | None = None
    for at, line in enumerate(lines):
        label = line[60:].strip()
        if label == "# / TYPES OF OBSERV":
            types += line[6:60].split()
        elif label == "APPROX POSITION XYZ":
            x, y, z = (float(line[k : k + 14]) for k in (0, 14, 28))
            position = x, y, z
        elif label == "END OF HEADER":
            return list(_epochs(lines, at + 1, types)), position
    raise ValueError("the RINEX header has no END OF HEADER: the file is cut")


def _epochs(lines: list[str], start: int, types: list[str]) -> Iterator[RawEpoch]:
    rows = -(-len(types) // OBSERVATIONS_PER_LINE)
    at = start
    while at < len(lines):
        head = lines[at]
        try:
            flag, count = head[28:29], int(head[29:32])
            if flag not in NEW_EPOCH:
                at += 1 + count
                continue
            more = (count - 1) // SATELLITES_PER_LINE if count else 0
            names = "".join(line[32:68].ljust(36) for line in lines[at : at + 1 + more])
            found = []
            for k in range(count):
                first = at + 1 + more + k * rows
                block = "".join(line.ljust(80) for line in lines[first : first + rows])
                name = names[3 * k : 3 * k + 3]
                if measurement := _measurement(name, block, types):
                    found.append(measurement)
            yield RawEpoch(_time_ns(head), tuple(found))
        except ValueError as error:
            raise ValueError(f"RINEX epoch at line {at + 1}: {error}") from error
        at += 1 + more + count * rows


def _measurement(name: str, block: str, types: list[str]) -> Measurement | None:
    constellation = CONSTELLATIONS.get(name[0])
    fields = {kind: block[16 * k : 16 * k + 14].strip() for k, kind in enumerate(types)}
    flags = {kind: int(block[16 * k + 14].strip() or 0) for k, kind in enumerate(types)}
    if constellation is None or not fields.get("C1"):
        return None
    doppler, strength, phase = fields.get("D1"), fields.get("S1"), fields.get("L1")
    return Measurement(
        SatelliteId(constellation, int(name[1:])),
        float(fields["C1"]),
        float(doppler) if doppler else None,
        float(strength) if strength else None,
        float(phase) if phase else None,
        half_cycle_resolved=not flags.get("L1", 0) & HALF_CYCLE,
        slipped=bool(flags.get("L1", 0) & LOST_LOCK),
    )


def _time_ns(head: str) -> int:
    year, month, day, hour, minute = (int(head[k : k + 3]) for k in range(0, 15, 3))
    whole, fraction = head[15:26].split(".")
    day_start = datetime(year + (1900 if year >= 80 else 2000), month, day, hour, minute)
    seconds = (day_start - GPS_EPOCH) // timedelta(seconds=1) + int(whole)
    return seconds * 1_000_000_000 + int(fraction.ljust(9, "0"))
