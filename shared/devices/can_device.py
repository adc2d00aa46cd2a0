"""CAN interfaces as devices of `device.py`; their bytes are the lines of a candump log.

socketcan://can0                            a network interface of the kernel
slcan:///dev/ttyACM1?bitrate=500000         a serial adapter with the Lawicel (SLCAN) protocol; baud=115200 of its port
elm327:///dev/ttyUSB0?baud=38400            an OBD adapter with an ELM327 or a clone, on USB or Bluetooth (RFCOMM)
elm327+tcp://192.168.0.10:35000             the same over WLAN
udp-multicast://239.74.163.2?port=43113     frames of python-can's virtual bus in a local network
file:///drive.log                           a candump log (candump -L), or what candump shows on a screen, replayed
                                            at its recorded rate, or at 100 frames a second without time stamps
"""

import re
import time
from collections.abc import Callable
from pathlib import Path

import can

from ..errors import UserError
from .bus_watch import BusWatch, LogWatch
from .device import Device, DeviceBusy, DeviceLost, open_device, split_url
from .elm327_device import ElmDevice

NS = 1_000_000_000
MAX_FRAMES = 500  # in one read
KNOWN_OPTIONS: dict[str, set[str]] = {
    "socketcan": set(), "slcan": {"bitrate", "baud"}, "elm327": {"baud"}, "elm327+tcp": set(),
    "udp-multicast": {"port"}, "virtual": set(), "file": set(),
}  # fmt: skip
EXAMPLES = (
    "socketcan://can0, slcan:///dev/ttyACM1?bitrate=500000, elm327:///dev/ttyUSB0?baud=38400, "
    "elm327+tcp://192.168.0.10:35000 or file:///drive.log"
)
BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # of the Lawicel protocol
ELM_BAUD, SLCAN_BAUD = 38400, 115200  # as delivered
MULTICAST_PORT = 43113  # of python-can
FLOW_CONTROL = bytes.fromhex("3000000000000000")  # ISO 15765-2: continue to send, any number of frames, without a pause
FLOW_CONTROL_S = 2.0  # after a request, for which an answer of several frames may come
LOG_LINE = "(1436509052.249713) can0 7E8#03410D3200000000"
MAX_LINE = 1024  # as candump shows a frame of 64 bytes with its text: 310
WITHOUT_STAMPS_NS = 10_000_000  # between the frames of a log without time stamps
ERROR_FLAG = 0x20000000  # of the identifier of an error frame, as in the kernel and in candump's logs
_STAMP = (
    r"(?:\((?:\d{4}-\d{2}-\d{2} )?(?:(?P<hours>\d{1,2}):(?P<minutes>\d{2}):)?"
    r"(?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\)\s+)?"
)
_LINE = re.compile(rf"\s*{_STAMP}(?P<bus>\S{{1,16}})\s+(?P<frame>[0-9A-Fa-f]+#\S*)")
# `can0  7E8   [8]  03 41 0D 32 00 00 00 00`, with `RX - -` after the interface or the text of the bytes at the end.
_SHOWN = re.compile(
    rf"\s*{_STAMP}(?P<bus>\S{{1,16}})\s+(?:[TR]X\s+\S+\s+\S+\s+)?(?P<identifier>[0-9A-Fa-f]{{3}}|[0-9A-Fa-f]{{8}})"
    r"\s+\[\s*(?P<length>\d{1,2})\](?P<bytes>\s+remote request|(?:\s+[0-9A-Fa-f]{2})*)(?:\s.*)?"
)
Clock = Callable[[], int]


def check_can_url(url: str) -> None:
    """Raise `UserError` for an invalid URL."""
    parts, options = split_url(url, KNOWN_OPTIONS, EXAMPLES)
    if parts.scheme == "slcan" and options.get("bitrate", 500_000) not in BITRATES:
        raise UserError(f"device {url!r}: bitrate must be one of {', '.join(map(str, BITRATES))}")
    if parts.scheme == "elm327+tcp":
        try:
            named = parts.hostname and parts.port
        except ValueError:
            named = None
        if not named:
            raise UserError(f"device {url!r}: host and port are needed, as in elm327+tcp://192.168.0.10:35000")
    if not (parts.netloc or parts.path.strip("/")):
        raise UserError(f"device {url!r} has no name: try {EXAMPLES}")


def only_answers(url: str) -> bool:
    """Whether a device gives nothing unless it is asked."""
    return url.startswith(("elm327:", "elm327+tcp:"))


def open_can(url: str, request_identifier: int, now_ns: Clock) -> Device:
    """Open a CAN interface or a log; raises `DeviceLost` if it is not available, `UserError` if the URL is invalid."""
    check_can_url(url)
    parts, options = split_url(url, KNOWN_OPTIONS, EXAMPLES)
    name = parts.netloc + parts.path
    if parts.scheme == "elm327":
        port = open_device(f"serial://{name}?baud={options.get('baud', ELM_BAUD)}")
        return ElmDevice(port, Path(name).name, request_identifier, now_ns)
    if parts.scheme == "elm327+tcp":
        return ElmDevice(open_device(f"tcp://{parts.netloc}"), str(parts.hostname), request_identifier, now_ns)
    try:
        if parts.scheme == "file":
            return LogDevice(Path(name), now_ns)
        if parts.scheme == "slcan":  # python-can would sleep for two seconds after opening
            bus = can.Bus(
                name, "slcan", bitrate=options.get("bitrate", 500_000), tty_baudrate=options.get("baud", SLCAN_BAUD),
                sleep_after_open=0.0,
            )  # fmt: skip
        elif parts.scheme == "udp-multicast":
            bus = can.Bus(name, "udp_multicast", port=options.get("port", MULTICAST_PORT))
        else:
            bus = can.Bus(name, parts.scheme)
    except (can.CanError, OSError) as error:
        raise DeviceLost(f"cannot open {url}: {error}; check that the interface or the adapter exists") from error
    return CanDevice(bus, name, request_identifier, now_ns)


class CanDevice:
    """A CAN interface; `write` transmits the data of one request.

    Answers of several frames to it are let on by flow control, which nothing else sends on a bus without a tester.
    """

    def __init__(self, bus: can.BusABC, channel: str, request_identifier: int, now_ns: Clock) -> None:
        self._bus, self._channel, self._identifier, self._now_ns = bus, channel, request_identifier, now_ns
        self.search = BusWatch(Path(channel).name, time.monotonic())
        self._asked_until_s = 0.0

    def read(self, wait_s: float) -> bytes:
        """Return the received frames as candump lines."""
        lines: list[bytes] = []
        try:
            while len(lines) < MAX_FRAMES and (frame := self._bus.recv(0 if lines else wait_s)) is not None:
                lines.append(self._line(frame))
                self._watch(frame)
        except (can.CanError, OSError) as error:
            hint = f"ip link set {self._channel} up type can bitrate 500000"
            raise DeviceLost(f"lost {self._channel}: {error}; check its cable, or try: {hint}") from error
        return b"".join(lines)

    def write(self, data: bytes) -> None:
        """Transmit one request; raises `DeviceBusy` if the queue is full, as without an acknowledging node."""
        self._asked_until_s = time.monotonic() + FLOW_CONTROL_S
        self._send(self._identifier, data)

    def _watch(self, frame: can.Message) -> None:
        now_s = time.monotonic()
        self.search.take(frame.is_error_frame, now_s)
        # Only where this device has asked: nothing is transmitted otherwise.
        if now_s < self._asked_until_s and frame.dlc and not frame.is_error_frame and frame.data[0] >> 4 == 1:
            target = flow_control_target(frame.arbitration_id, frame.is_extended_id)
            if target is not None:
                self._send(target, FLOW_CONTROL)

    def _send(self, identifier: int, data: bytes) -> None:
        message = can.Message(arbitration_id=identifier, is_extended_id=identifier > 0x7FF, data=data)
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
    """A candump log, replayed at its recorded rate; no bytes after its end.

    Lines of a log and lines as candump shows them are read, other ones are counted; raises `DeviceLost` if there is no
    line that can be read.
    """

    def __init__(self, path: Path, now_ns: Clock) -> None:
        self._file, self._now_ns = path.open(encoding="ascii", errors="replace"), now_ns
        self._last_ns = 0
        self.search = LogWatch()
        self._next = self._scan()
        if self._next is None:
            self._file.close()
            raise DeviceLost(
                f"{path} holds no line of a candump log; write one with `candump -L can0`, whose lines are {LOG_LINE!r}"
            )
        self._offset_ns = now_ns() - (self._next[0] if self._next else 0)

    def read(self, wait_s: float) -> bytes:
        """Return the lines that are due, with their time stamps shifted to the present."""
        lines: list[bytes] = []
        until_s = (self._next[0] + self._offset_ns - self._now_ns()) / NS if self._next else wait_s
        time.sleep(min(max(until_s, 0.0), wait_s))
        while self._next and len(lines) < MAX_FRAMES and self._next[0] + self._offset_ns <= self._now_ns():
            lines.append(stamped_line(self._next[0] + self._offset_ns, self._next[1]))
            self.search.frames += 1
            self._next = self._scan()
        return b"".join(lines)

    @property
    def rejects(self) -> dict[str, int]:
        """Lines that are none of candump."""
        return self.search.rejects

    def write(self, data: bytes) -> None:
        """Ignored: a recording has no input."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _scan(self) -> tuple[int, str] | None:
        """Time stamp [ns] and remainder of the next valid line; None at the end."""
        # A file without ends of lines is read in pieces.
        while line := self._file.readline(MAX_LINE):
            if found := frame_of(line):
                time_ns, rest = found
                self._last_ns = self._last_ns + WITHOUT_STAMPS_NS if time_ns is None else time_ns
                return self._last_ns, rest
            self.search.count_line(line)
        self.search.ended = True
        return None


def frame_of(line: str) -> tuple[int | None, str] | None:
    """Time stamp [ns], if there is one, and frame of a line, as in a log; None if it is none of candump."""
    if match := _LINE.match(line):
        return _time_ns(match), f"{match['bus']} {match['frame']}"
    match = _SHOWN.fullmatch(line.rstrip())
    if match is None:
        return None
    data = "R" if match["bytes"].strip() == "remote request" else "".join(match["bytes"].split())
    if data != "R" and len(data) != 2 * int(match["length"]):
        return None
    flags = "#0" if len(match["length"]) == 2 else ""  # candump shows the length of a CAN FD frame with two digits
    return _time_ns(match), f"{match['bus']} {match['identifier']}#{flags}{data}"


def _time_ns(match: re.Match[str]) -> int | None:
    if match["seconds"] is None:
        return None
    seconds = int(match["hours"] or 0) * 3600 + int(match["minutes"] or 0) * 60 + int(match["seconds"])
    return seconds * NS + int(match["fraction"].ljust(9, "0"))


def candump_line(time_ns: int, channel: str, frame: can.Message) -> bytes:
    """Format a frame as a line of `candump -L`."""
    name = f"{frame.arbitration_id:08X}" if frame.is_extended_id else f"{frame.arbitration_id:03X}"
    if frame.is_error_frame:
        name = f"{frame.arbitration_id | ERROR_FLAG:08X}"
    data = frame.data.hex().upper()
    if frame.is_remote_frame:
        data = "R"
    elif frame.is_fd:
        data = f"#{frame.bitrate_switch + 2 * frame.error_state_indicator:X}{data}"
    return stamped_line(time_ns, f"{channel} {name}#{data}")


def stamped_line(time_ns: int, rest: str) -> bytes:
    """Join a time stamp, and interface and frame, to a line of a candump log."""
    return f"({time_ns // NS}.{time_ns % NS // 1000:06d}) {rest}\n".encode()


def flow_control_target(identifier: int, extended: bool) -> int | None:
    """Identifier of the flow control to the sender of an OBD answer (ISO 15765-4, 6.3.2); None for other frames."""
    if extended:
        return 0x18DA00F1 | (identifier & 0xFF) << 8 if identifier >> 8 == 0x18DAF1 else None
    return identifier - 8 if 0x7E8 <= identifier <= 0x7EF else None
