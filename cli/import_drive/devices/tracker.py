"""Stamps the Xbus messages of an Xsens tracker by its UTC, or else by its clock."""

import struct
from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime

from shared.maths.dates import is_plausible
from shared.protocols import xbus

from .stamped import NS, WITHOUT_DATE_NS, ClockKind, FileKind, Portion, StampedFile

UTC_TIME = 0x1010  # ns, year, month, day, hour, minute, second, flags
UTC_VALID = 4  # flag: UTC is valid, as the receiver of the tracker knows it
TICK_NS, TICK_WRAP = 100_000, 1 << 32
PORTION_NS = 50_000_000  # of a live driver's chunk, at most


def read_tracker(chunks: Iterable[bytes]) -> StampedFile:
    """Read a dump of Xbus messages.

    Returns
    -------
    Stamped
        Its clock is UTC if a message told it, else free: `SampleTimeFine` from its first value on. `rejects` are those
        of the reader, and `no_sample_time` for measurements without `SampleTimeFine`.
    """
    rejects: Counter[str] = Counter()
    reader = xbus.XbusReader(rejects)
    found: list[tuple[int, bytes]] = []
    offset_ns: int | None = None  # UTC - clock of the tracker
    ticks = number = 0
    for chunk in chunks:
        for message in reader.feed(chunk):
            number += 1
            if message.mid != xbus.MTDATA2:
                continue
            fine, utc_ns = _times(message.payload)
            if fine is None:
                rejects["no_sample_time"] += 1
                continue
            step = (fine - ticks) % TICK_WRAP
            ticks = fine if not found else ticks + step if step < TICK_WRAP // 2 else ticks + 1
            if offset_ns is None and utc_ns is not None:
                offset_ns = utc_ns - ticks * TICK_NS
            found.append((ticks, xbus.encode_message(message.mid, message.payload)))
    start_ns = offset_ns if offset_ns is not None else WITHOUT_DATE_NS - (found[0][0] * TICK_NS if found else 0)
    clock = ClockKind.FREE if offset_ns is None else ClockKind.UTC
    return StampedFile(FileKind.TRACKER, clock, _portions(found, start_ns), number, rejects)


def _portions(found: list[tuple[int, bytes]], start_ns: int) -> list[Portion]:
    portions: list[Portion] = []
    parts: list[bytes] = []
    began_ns = at_ns = 0
    for ticks, data in found:
        time_ns = start_ns + ticks * TICK_NS
        if parts and time_ns - began_ns >= PORTION_NS:
            portions.append(Portion(at_ns, b"".join(parts)))
            parts = []
        if not parts:
            began_ns = time_ns
        parts.append(data)
        at_ns = time_ns
    if parts:
        portions.append(Portion(at_ns, b"".join(parts)))
    return portions


def _times(payload: bytes) -> tuple[int | None, int | None]:
    """`SampleTimeFine` and UTC [ns] of a measurement, each None if it is missing or not valid."""
    fine: int | None = None
    utc_ns: int | None = None
    try:
        for data_id, data in xbus.split_mtdata2(payload):
            kind = data_id & 0xFFF0
            if kind == xbus.SAMPLE_TIME_FINE and len(data) == 4:
                fine = int.from_bytes(data, "big")
            elif kind == UTC_TIME and len(data) == 12:
                utc_ns = _utc_ns(data)
    except ValueError:  # a truncated field: what is before it is used, as by the parser of the unit
        return fine, utc_ns
    return fine, utc_ns


def _utc_ns(data: bytes) -> int | None:
    nano, year, month, day, hour, minute, second, flags = struct.unpack(">IH6B", data)
    if not flags & UTC_VALID:
        return None
    try:
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    utc_ns = round(moment.timestamp()) * NS + nano
    return utc_ns if is_plausible(utc_ns) else None
