"""CAN interfaces as devices of `device.py`; their bytes are the lines of a candump log.

socketcan://can0                            a network interface of the kernel
slcan:///dev/ttyACM1?bitrate=500000         a serial adapter with the Lawicel (SLCAN) protocol
file:///drive.log                           a candump log, replayed at its recorded rate
"""

import re
import time
from collections.abc import Callable
from pathlib import Path

import can

from .device import Device, DeviceBusy, DeviceLost, split_url

NS = 1_000_000_000
MOST_FRAMES = 500  # in one read
KNOWN: dict[str, set[str]] = {"socketcan": set(), "slcan": {"bitrate"}, "virtual": set(), "file": set()}
EXAMPLES = "socketcan://can0, slcan:///dev/ttyACM1?bitrate=500000 or file:///drive.log"
_LINE = re.compile(r"\((\d{1,10})\.(\d{1,9})\) (\S+ \S+)")
Clock = Callable[[], int]


def check_can_url(url: str) -> None:
    """Raise `UserError` for an invalid URL."""
    split_url(url, KNOWN, EXAMPLES)


def open_can(url: str, request_identifier: int, now_ns: Clock) -> Device:
    """Open a CAN interface or a log; raises `DeviceLost` if it is not available, `UserError` if the URL is invalid."""
    parts, options = split_url(url, KNOWN, EXAMPLES)
    name = parts.netloc + parts.path
    try:
        if parts.scheme == "file":
            return LogDevice(Path(name), now_ns)
        if parts.scheme == "slcan":  # python-can would sleep for two seconds after opening
            bus = can.Bus(name, "slcan", bitrate=options.get("bitrate", 500_000), sleep_after_open=0.0)
        else:
            bus = can.Bus(name, parts.scheme)
    except (can.CanError, OSError) as error:
        raise DeviceLost(f"cannot open {url}: {error}; check that the interface or the adapter exists") from error
    return CanDevice(bus, name, request_identifier, now_ns)


class CanDevice:
    """A CAN interface; `write` transmits the data of one request."""

    def __init__(self, bus: can.BusABC, channel: str, request_identifier: int, now_ns: Clock) -> None:
        self._bus, self._channel, self._identifier, self._now_ns = bus, channel, request_identifier, now_ns

    def read(self, wait_s: float) -> bytes:
        """Return the received frames as candump lines."""
        lines: list[bytes] = []
        try:
            while len(lines) < MOST_FRAMES and (frame := self._bus.recv(0 if lines else wait_s)) is not None:
                lines.append(b"" if frame.is_error_frame else self._line(frame))
        except (can.CanError, OSError) as error:
            hint = f"ip link set {self._channel} up type can bitrate 500000"
            raise DeviceLost(f"lost {self._channel}: {error}; check its cable, or try: {hint}") from error
        return b"".join(lines)

    def write(self, data: bytes) -> None:
        """Transmit one request; raises `DeviceBusy` if the queue is full, as without an acknowledging node."""
        message = can.Message(arbitration_id=self._identifier, is_extended_id=self._identifier > 0x7FF, data=data)
        try:
            self._bus.send(message, timeout=0.01)
        except can.CanError as error:
            raise DeviceBusy(f"{self._channel} accepts no frames: {error}") from error
        except OSError as error:
            raise DeviceLost(f"lost {self._channel}: {error}; check its cable") from error

    def close(self) -> None:
        """Close the interface."""
        try:
            self._bus.shutdown()
        except (can.CanError, OSError):  # the adapter is already disconnected
            return

    def _line(self, frame: can.Message) -> bytes:
        # The kernel stamps in wall-clock time, which may be adjusted: only the age is used, if it is plausible.
        age_ns = round((time.time() - frame.timestamp) * NS)
        stamp_ns = self._now_ns() - (age_ns if 0 <= age_ns < NS else 0)
        return candump_line(stamp_ns, Path(self._channel).name, frame)


class LogDevice:
    """A candump log, replayed at its recorded rate; no bytes after its end."""

    def __init__(self, path: Path, now_ns: Clock) -> None:
        self._file, self._now_ns = path.open(encoding="ascii", errors="replace"), now_ns
        self._next = self._scan()
        self._offset_ns = now_ns() - (self._next[0] if self._next else 0)

    def read(self, wait_s: float) -> bytes:
        """Return the lines that are due, with their time stamps shifted to the present."""
        lines: list[bytes] = []
        until_s = (self._next[0] + self._offset_ns - self._now_ns()) / NS if self._next else wait_s
        time.sleep(min(max(until_s, 0.0), wait_s))
        while self._next and len(lines) < MOST_FRAMES and self._next[0] + self._offset_ns <= self._now_ns():
            lines.append(_stamped(self._next[0] + self._offset_ns, self._next[1]))
            self._next = self._scan()
        return b"".join(lines)

    def write(self, data: bytes) -> None:
        """Ignored: a recording has no input."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _scan(self) -> tuple[int, str] | None:
        """Time stamp [ns] and remainder of the next valid line; None at the end."""
        for line in self._file:
            if match := _LINE.match(line):
                seconds, fraction, rest = match.groups()
                return int(seconds) * NS + int(fraction.ljust(9, "0")), rest
        return None


def candump_line(time_ns: int, channel: str, frame: can.Message) -> bytes:
    """Format a frame as a line of `candump -L`."""
    name = f"{frame.arbitration_id:08X}" if frame.is_extended_id else f"{frame.arbitration_id:03X}"
    data = frame.data.hex().upper()
    if frame.is_remote_frame:
        data = "R"
    elif frame.is_fd:
        data = f"#{frame.bitrate_switch + 2 * frame.error_state_indicator:X}{data}"
    return _stamped(time_ns, f"{channel} {name}#{data}")


def _stamped(time_ns: int, rest: str) -> bytes:
    return f"({time_ns // NS}.{time_ns % NS // 1000:06d}) {rest}\n".encode()
