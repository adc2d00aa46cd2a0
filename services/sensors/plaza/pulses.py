"""Detectors of lanes: where their pulses arrive, and when each of them was.

udp://127.0.0.1:47360                     lines in datagrams
serial:///dev/ttyUSB0?baud=9600           lines of a detector controller
gpio:///dev/gpiochip0?line=17&lane=n1     the contact of a loop or laser, its rising edge
simulated://?lane=n1&period_s=5           a pulse every few seconds, for tests

A line is the name of the lane, then optionally, after commas, the age of the pulse in milliseconds and `f` or `b`:
forward or backward, as far as the detector states it. `n1,12,f` is a vehicle that drove forward in lane n1 12 ms ago.
"""

import contextlib
import fcntl
import os
import select
import socket
import struct
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import parse_qsl, urlsplit

from shared.devices.device import Device, DeviceLost, open_device
from shared.devices.v2x_device import host_and_port
from shared.errors import UserError

KNOWN = {"udp": set[str](), "serial": {"baud"}, "gpio": {"line", "lane"}, "simulated": {"lane", "period_s"}}
EXAMPLES = "udp://127.0.0.1:47360, serial:///dev/ttyUSB0?baud=9600 or gpio:///dev/gpiochip0?line=17&lane=n1"
MAX_LINE, MAX_DATAGRAM, MAX_DATAGRAMS = 100, 1500, 500
MAX_AGE_MS = 60_000
# Linux GPIO character device, version 2 of its interface: <linux/gpio.h>.
GET_LINE = 0xC250B407
REQUEST = struct.Struct("=64I32sQI5I240sIIi20x")  # lines, consumer, flags, attributes and padding, count, buffer, file
RISING_INPUT, EVENT = 1 << 2 | 1 << 4, struct.Struct("=QIIII24x")


@dataclass(frozen=True)
class LanePulse:
    """A vehicle at the gate line of a lane, so many nanoseconds ago."""

    lane: str
    age_ns: int
    backward: bool = False


class BadLine(ValueError):
    """A line of a detector that cannot be read."""


class Detector(Protocol):
    """An open detector; every method raises `DeviceLost` when it is gone."""

    def read(self) -> list[LanePulse | BadLine]:
        """Return the pulses that have arrived, without waiting."""
        ...

    def write(self, data: bytes, /) -> None:
        """Detectors receive nothing."""
        ...

    def close(self) -> None:
        """Close it; may be called twice."""
        ...


def parse_line(line: bytes) -> LanePulse:
    """Read a line of a detector.

    Raises
    ------
    BadLine
        It is too long, no text, or has another form.
    """
    if len(line) > MAX_LINE or not line.isascii():
        raise BadLine("length or characters")
    lane, *rest = line.decode("ascii").strip().split(",")
    age = rest[0] if rest and rest[0] else "0"
    direction = rest[1] if len(rest) > 1 else "f"
    if not lane or len(rest) > 2 or not age.isdecimal() or int(age) > MAX_AGE_MS or direction not in ("f", "b"):
        raise BadLine("form")
    return LanePulse(lane, int(age) * 1_000_000, direction == "b")


def check_detector(url: str) -> str | None:
    """Raise `UserError` for a URL of no detector; return the lane that it names."""
    parts = urlsplit(url)
    options = dict(parse_qsl(parts.query))
    if parts.scheme not in KNOWN:
        raise UserError(f"unknown detector {url!r}: try {EXAMPLES}")
    if unknown := options.keys() - KNOWN[parts.scheme]:
        raise UserError(f"detector {url!r}: unknown option {min(unknown)!r}; try {EXAMPLES}")
    if parts.scheme == "udp":
        host_and_port(url)
    if parts.scheme == "gpio" and not options.get("line", "").isdecimal():
        raise UserError(f"detector {url!r}: line = the number of the input is missing")
    if parts.scheme in ("gpio", "simulated") and "lane" not in options:
        raise UserError(f"detector {url!r}: lane = the name of its lane is missing")
    if parts.scheme == "simulated" and not float(options.get("period_s", "5")) > 0.0:
        raise UserError(f"detector {url!r}: period_s must be positive")
    return options.get("lane")


def open_detector(url: str) -> Detector:
    """Open the detector of a URL; raises `DeviceLost` if it is not there."""
    parts = urlsplit(url)
    options = dict(parse_qsl(parts.query))
    try:
        if parts.scheme == "udp":
            return UdpDetector(*host_and_port(url))
        if parts.scheme == "gpio":
            return GpioDetector(Path(parts.path), int(options["line"]), options["lane"])
        if parts.scheme == "simulated":
            return SimulatedDetector(options["lane"], float(options.get("period_s", "5")))
        return LineDetector(open_device(url))
    except OSError as error:
        raise DeviceLost(f"cannot open {url}: {error.strerror}; check the detector's address and rights") from error


def _read_line(line: bytes, age_ns: int = 0) -> LanePulse | BadLine:
    try:
        pulse = parse_line(line)
    except BadLine as error:
        return error
    return LanePulse(pulse.lane, pulse.age_ns + age_ns, pulse.backward)


class LineDetector:
    """Lines over a serial port."""

    def __init__(self, device: Device) -> None:
        self._device, self._rest = device, b""

    def read(self) -> list[LanePulse | BadLine]:
        """Return the pulses of the whole lines that have arrived."""
        *lines, self._rest = (self._rest + self._device.read(0.0)).split(b"\n")
        self._rest = self._rest[-MAX_LINE - 1 :]
        return [_read_line(line) for line in lines if line.strip()]

    def write(self, _data: bytes, /) -> None:
        """Detectors receive nothing."""

    def close(self) -> None:
        """Close the port."""
        self._device.close()


class UdpDetector:
    """Lines in datagrams."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]

    def read(self) -> list[LanePulse | BadLine]:
        """Return the pulses of the datagrams that have arrived."""
        found: list[LanePulse | BadLine] = []
        for _ in range(MAX_DATAGRAMS):
            try:
                data = self._socket.recv(MAX_DATAGRAM)
            except BlockingIOError:
                break
            except OSError as error:
                raise DeviceLost(f"the socket of the detectors failed: {error.strerror}") from error
            found += [_read_line(line) for line in data.split(b"\n") if line.strip()]
        return found

    def write(self, _data: bytes, /) -> None:
        """Detectors receive nothing."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class GpioDetector:
    """Rising edges of an input, with the time of the kernel."""

    def __init__(self, chip: Path, line: int, lane: str) -> None:
        self._lane = lane
        request = bytearray(REQUEST.pack(line, *(63 * [0]), b"obu", RISING_INPUT, 0, *(5 * [0]), b"", 1, 0, -1))
        descriptor = os.open(chip, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.ioctl(descriptor, GET_LINE, request)
        finally:
            os.close(descriptor)
        self._file: int = REQUEST.unpack(request)[-1]

    def read(self) -> list[LanePulse | BadLine]:
        """Return the edges since the last call."""
        found: list[LanePulse | BadLine] = []
        try:
            while select.select([self._file], [], [], 0.0)[0] and len(found) < MAX_DATAGRAMS:
                found += edges(os.read(self._file, EVENT.size * 16), self._lane, time.monotonic_ns())
        except (OSError, ValueError) as error:
            raise DeviceLost(f"the input of lane {self._lane} failed: {error}") from error
        return found

    def write(self, _data: bytes, /) -> None:
        """Detectors receive nothing."""

    def close(self) -> None:
        """Give the input back."""
        if self._file >= 0:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = -1


def edges(data: bytes, lane: str, now_ns: int) -> list[LanePulse]:
    """Read the events of an input; their times are those of the kernel's monotonic clock."""
    return [
        LanePulse(lane, max(0, now_ns - event[0]))
        for event in EVENT.iter_unpack(data[: len(data) // EVENT.size * EVENT.size])
    ]


class SimulatedDetector:
    """A pulse every few seconds."""

    def __init__(self, lane: str, period_s: float) -> None:
        self._lane, self._period_s = lane, period_s
        self._next_s = time.monotonic() + period_s

    def read(self) -> list[LanePulse | BadLine]:
        """Return the pulses that are due."""
        found: list[LanePulse | BadLine] = []
        while (age_s := time.monotonic() - self._next_s) >= 0.0 and len(found) < MAX_DATAGRAMS:
            found.append(LanePulse(self._lane, round(age_s * 1e9)))
            self._next_s += self._period_s
        return found

    def write(self, _data: bytes, /) -> None:
        """Detectors receive nothing."""

    def close(self) -> None:
        """Nothing is open."""
