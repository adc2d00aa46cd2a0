"""Reads the lines of a candump log: `(1436509052.249713) can0 7E8#03410D3200000000`."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from shared.kinds import Kinds
from shared.messages.operation import MessageUse

MAX_LINE = 256  # a CAN FD frame of 64 bytes takes 170
ERROR_FLAG = 0x20000000  # of the identifier of an error frame
ERROR_FRAME, REMOTE_FRAME, UNUSABLE = "CAN error frame", "CAN remote frame", "unusable line"  # kinds of lines
MOST_DATA, MOST_FD_DATA = 8, 64
_LINE = re.compile(
    rb"\((\d{1,10})\.(\d{1,9})\) (\S{1,16}) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?:#([0-9A-Fa-f]))?([0-9A-Fa-f]*)( [TR])?"
)
_REMOTE = re.compile(rb"\(\d{1,10}\.\d{1,9}\) \S{1,16} ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#R\d?( [TR])?")


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One data frame of an interface, with up to 64 bytes (CAN FD); `extended` is true for a 29-bit identifier."""

    time_ns: int
    interface: str
    identifier: int
    extended: bool
    data: bytes


class LineReader:
    """Splits bytes into lines and parses each as a frame.

    Invalid lines are counted as the reject `line`, error frames (of the controller: the bus is disturbed) as
    `error_frame`. Every line that is not blank is a frame or counted in `kinds`.
    """

    def __init__(self, rejects: Counter[str], kinds: Kinds) -> None:
        self._rejects, self._kinds = rejects, kinds
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[CanFrame]:
        """Process the next bytes; yield the frames of the completed lines."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MAX_LINE:
            self._reject()
            self._rest = b""
        for line in lines:
            frame = parse_line(line.strip())
            if frame and frame.extended and frame.identifier & ERROR_FLAG:
                self._rejects["error_frame"] += 1
                self._kinds.count(ERROR_FRAME, MessageUse.UNUSED)
            elif frame:
                yield frame
            elif _REMOTE.fullmatch(line.strip()):
                self._kinds.count(REMOTE_FRAME, MessageUse.UNUSED)
            elif line.strip():
                self._reject()

    def _reject(self) -> None:
        self._rejects["line"] += 1
        self._kinds.count(UNUSABLE, MessageUse.UNKNOWN)
        self._kinds.reject(UNUSABLE, "line")


def parse_line(line: bytes) -> CanFrame | None:
    """Parse one line; None unless it is a data frame."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    seconds, fraction, interface, identifier, flags, data = match.groups()[:6]
    if len(data) % 2 or len(data) > 2 * (MOST_DATA if flags is None else MOST_FD_DATA):
        return None
    time_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, b"0"))
    name = interface.decode(errors="replace")
    return CanFrame(time_ns, name, int(identifier, 16), len(identifier) == 8, bytes.fromhex(data.decode()))
