"""Reads logs of CAN buses to candump lines: those of candump, and the ASC logs of Vector's tools."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import can

from shared.devices.can_device import WITHOUT_STAMPS_NS, candump_line, frame_of, stamped_line
from shared.errors import UserError

from .stamped import ABSOLUTE_FROM_NS, NS, WITHOUT_DATE_NS, ClockKind, FileKind, Portion, Stamped

PORTION_NS = NS // 10  # as the driver publishes them
MOST_LINES = 2000  # of a portion: 100 KB
CHANNEL = "can0"  # of an ASC log, whose channels have numbers
Line = tuple[int, str]  # time [ns] and the rest of a candump line


def read_candump(lines: Iterable[str]) -> Stamped:
    """Read a log of candump, or what candump shows on a screen; lines that are neither are counted."""
    rejects: Counter[str] = Counter()
    found: list[Line] = []
    rows, last_ns, stamps = 0, 0, True
    for line in lines:
        if not line.strip():
            continue
        rows += 1
        if (frame := frame_of(line[:512])) is None:
            rejects["line"] += 1
            continue
        time_ns, rest = frame
        stamps &= time_ns is not None
        last_ns = last_ns + WITHOUT_STAMPS_NS if time_ns is None else time_ns
        found.append((last_ns, rest))
    notes = () if stamps or not found else ("has no time stamps: its frames were taken as 100 a second",)
    return _stamped(found, rows, rejects, notes)


def read_asc(path: Path) -> Stamped:
    """Read an ASC log, without its date, which is in an unknown time zone; raises `UserError` for a broken one."""
    rejects: Counter[str] = Counter()
    found = list(_asc_lines(path, rejects))
    return _stamped(found, len(found), rejects, ())


def _asc_lines(path: Path, rejects: Counter[str]) -> Iterator[Line]:
    try:
        with can.ASCReader(path, relative_timestamp=True) as reader:
            for message in reader:
                if message.is_error_frame:
                    rejects["error_frame"] += 1
                    continue
                channel = f"can{message.channel}" if isinstance(message.channel, int) else CHANNEL
                text = candump_line(0, channel, message).decode()
                yield round(message.timestamp * NS), text.split(") ", 1)[1].rstrip("\n")
    except (ValueError, IndexError, KeyError, AttributeError, can.CanError, UnicodeDecodeError, OSError) as error:
        raise UserError(
            f"{path}: not an ASC log that can be read ({error}); write it with 'base hex timestamps absolute', or "
            "convert it: can_logconvert drive.asc drive.log"
        ) from error


def _stamped(found: list[Line], rows: int, rejects: Counter[str], notes: tuple[str, ...]) -> Stamped:
    ordered = sorted(found, key=lambda line: line[0])
    first_ns = ordered[0][0] if ordered else 0
    absolute = first_ns >= ABSOLUTE_FROM_NS
    start_ns = 0 if absolute else WITHOUT_DATE_NS - first_ns
    clock = ClockKind.UTC if absolute else ClockKind.FREE
    return Stamped(FileKind.CAN, clock, list(_portions(ordered, start_ns)), rows, rejects, notes)


def _portions(lines: list[Line], start_ns: int) -> Iterator[Portion]:
    part: list[Line] = []
    for time_ns, rest in lines:
        if part and (time_ns - part[0][0] >= PORTION_NS or len(part) >= MOST_LINES):
            yield _portion(part, start_ns)
            part = []
        part.append((time_ns, rest))
    if part:
        yield _portion(part, start_ns)


def _portion(part: list[Line], start_ns: int) -> Portion:
    return Portion(part[-1][0] + start_ns, b"".join(stamped_line(time_ns + start_ns, rest) for time_ns, rest in part))


def shifted_lines(data: bytes, by_ns: int) -> bytes:
    """Shift the stamps within candump lines as those of their portion are shifted."""
    lines = (frame_of(line) for line in data.decode("ascii", "replace").splitlines())
    return b"".join(stamped_line((line[0] or 0) + by_ns, line[1]) for line in lines if line is not None)
