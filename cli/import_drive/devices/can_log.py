"""Reads logs of CAN buses to candump lines: those of candump, and the ASC logs of Vector's tools."""

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TextIO, cast

import can

from shared.devices.can_device import WITHOUT_STAMPS_NS, candump_line, frame_of, stamped_line
from shared.errors import UserError

from .stamped import ABSOLUTE_FROM_NS, NS, WITHOUT_DATE_NS, ClockKind, FileKind, Portion, StampedFile

PORTION_NS = NS // 10  # as the driver publishes them
MAX_LINES = 2000  # of a portion: 100 KB
MIN_DIFFERENCES = 10  # stamps from which their order tells what they are
SHARE_FALLING, SHARE_EQUAL = 0.1, 0.9  # [-] of the steps between stamps that are differences
CHANNEL = "can0"  # of an ASC log, whose channels have numbers
ASC_BASE = re.compile(r"base\s+(hex|dec)\b(?:.*\btimestamps\s+(absolute|relative)\b)?", re.IGNORECASE)
ASC_EVENT = re.compile(r"(\d{1,12})[.,](\d{1,9})\s+(\S.*)", re.ASCII)
Line = tuple[int, str]  # time [ns] and the rest of a candump line


def read_candump(lines: Iterable[str]) -> StampedFile:
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
    if _are_differences([time_ns for time_ns, _ in found]):
        found = list(zip(accumulate(time_ns for time_ns, _ in found), (rest for _, rest in found), strict=True))
        notes = ("has the times since the frame before (candump -td), which were added up",)
    return _stamped(found, rows, rejects, notes)


def _are_differences(times_ns: list[int]) -> bool:
    """Whether stamps are the times since the frame before: short, and they fall often, or are one period."""
    if len(times_ns) < MIN_DIFFERENCES or max(times_ns) >= ABSOLUTE_FROM_NS:
        return False
    steps = [later - earlier for earlier, later in pairwise(times_ns)]
    falling, equal = sum(step < 0 for step in steps), sum(step == 0 for step in steps)
    return falling > SHARE_FALLING * len(steps) or (equal > SHARE_EQUAL * len(steps) and times_ns[-1] > 0)


def read_asc(path: Path) -> StampedFile:
    """Read an ASC log, without its date, which is in an unknown time zone; raises `UserError` for a broken one."""
    rejects: Counter[str] = Counter()
    found = list(_asc_lines(path, rejects))
    return _stamped(found, len(found), rejects, ())


def _asc_lines(path: Path, rejects: Counter[str]) -> Iterator[Line]:
    try:
        with (
            path.open(encoding="utf-8", errors="replace") as file,
            can.ASCReader(cast(TextIO, _AscEvents(file)), relative_timestamp=True) as reader,
        ):
            for message in reader:
                if message.is_error_frame:
                    rejects["error_frame"] += 1
                    continue
                channel = f"can{message.channel}" if isinstance(message.channel, int) else CHANNEL
                text = candump_line(0, channel, message).decode()
                yield round(message.timestamp * NS), text.split(") ", 1)[1].rstrip("\n")
    except (ValueError, IndexError, KeyError, AttributeError, can.CanError, OSError) as error:
        raise UserError(
            f"{path}: not an ASC log that can be read ({error}); write it with 'base hex timestamps absolute', "
            "or convert it: can_logconvert drive.asc drive.log"
        ) from error


class _AscEvents(io.TextIOBase):
    """An ASC log in the one form that the library reads: a head of its own, then stamped lines alone, in absolute time.

    The library takes the first line behind a head without its last line for a part of it, and relative stamps, which
    are the time since the event before (of any kind), for absolute ones.
    """

    def __init__(self, file: TextIO) -> None:
        self._lines = self._normalised(file)

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override]  # the base names no argument
        """The next line; empty at the end."""
        return next(self._lines, "")

    @staticmethod
    def _normalised(file: TextIO) -> Iterator[str]:
        base, relative, time_ns = "hex", False, 0
        head = True
        for line in file:
            text = line.strip()
            if head and (stated := ASC_BASE.match(text)):
                base, relative = stated[1].lower(), (stated[2] or "").lower() == "relative"
            elif event := ASC_EVENT.match(text):
                if head:
                    yield f"base {base} timestamps absolute\n"
                    yield "internal events logged\n"
                    head = False
                stamp_ns = int(event[1]) * NS + int(event[2].ljust(9, "0"))
                time_ns = time_ns + stamp_ns if relative else stamp_ns
                yield f"{time_ns // NS}.{time_ns % NS:09d} {event[3]}\n"


def _stamped(found: list[Line], rows: int, rejects: Counter[str], notes: tuple[str, ...]) -> StampedFile:
    ordered = sorted(found, key=lambda line: line[0])
    first_ns = ordered[0][0] if ordered else 0
    absolute = first_ns >= ABSOLUTE_FROM_NS
    start_ns = 0 if absolute else WITHOUT_DATE_NS - first_ns
    clock = ClockKind.UTC if absolute else ClockKind.FREE
    return StampedFile(FileKind.CAN, clock, list(_portions(ordered, start_ns)), rows, rejects, notes)


def _portions(lines: list[Line], start_ns: int) -> Iterator[Portion]:
    part: list[Line] = []
    for time_ns, rest in lines:
        if part and (time_ns - part[0][0] >= PORTION_NS or len(part) >= MAX_LINES):
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
