"""Reads the lines of a candump log: `(1436509052.249713) can0 7E8#03410D3200000000`."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

MAX_LINE = 256  # a CAN FD frame of 64 bytes takes 170
ERROR_FLAG = 0x20000000  # of the identifier of an error frame
# Remote frames (#R) and CAN FD frames (##) are well-formed lines without a speed: skipped, not counted as rejects.
_LINE = re.compile(rb"\((\d{1,10})\.(\d{1,9})\) (\S{1,16}) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#([0-9A-Fa-f]*)( [TR])?")
_OTHER = re.compile(rb"\(\d{1,10}\.\d{1,9}\) \S{1,16} ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(R\d?|#[0-9A-Fa-f]+)( [TR])?")


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One classic data frame of an interface; `extended` is true for a 29-bit identifier."""

    time_ns: int
    interface: str
    identifier: int
    extended: bool
    data: bytes


class LineReader:
    """Splits bytes into lines and parses each as a frame.

    Invalid lines are counted as the reject `line`, error frames (of the controller: the bus is disturbed) as
    `error_frame`.
    """

    def __init__(self, rejects: Counter[str]) -> None:
        self._rejects = rejects
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[CanFrame]:
        """Process the next bytes; yield the frames of the completed lines."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MAX_LINE:
            self._rejects["line"] += 1
            self._rest = b""
        for line in lines:
            frame = parse_line(line.strip())
            if frame and frame.extended and frame.identifier & ERROR_FLAG:
                self._rejects["error_frame"] += 1
            elif frame:
                yield frame
            elif line.strip() and not _OTHER.fullmatch(line.strip()):
                self._rejects["line"] += 1


def parse_line(line: bytes) -> CanFrame | None:
    """Parse one line; None unless it is a classic data frame."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    seconds, fraction, interface, identifier, data = match.groups()[:5]
    if len(data) % 2 or len(data) > 16:
        return None
    time_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, b"0"))
    name = interface.decode(errors="replace")
    return CanFrame(time_ns, name, int(identifier, 16), len(identifier) == 8, bytes.fromhex(data.decode()))
