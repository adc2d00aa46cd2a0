"""Byte-stream devices with one interface: a serial port, a TCP socket or a recorded file, selected by a URL.

serial:///dev/ttyACM0?baud=115200   a port by its path (recommended: one of /dev/serial/by-id)
serial://1546:01a9?baud=115200      the first port of a USB vendor and product
tcp://host:port                     a TCP server that sends raw bytes
file:///path?rate=11520             a recorded file, replayed at a rate in bytes per second
"""

import contextlib
import errno
import os
import re
import select
import socket
import termios
import time
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Protocol
from urllib.parse import SplitResult, parse_qsl, urlsplit

from ..errors import ObuError, UserError
from ..messages.operation import DeviceFound

CHUNK = 4096
CONNECT_S = 5.0
WRITE_S = 0.1
_USB_ID = re.compile(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})")
_KNOWN: dict[str, set[str]] = {"serial": {"baud"}, "tcp": set(), "file": {"rate"}}
_EXAMPLES = "serial:///dev/ttyACM0?baud=115200 or tcp://host:port"


class DeviceLost(ObuError):
    """The device is missing or was disconnected; the text names it and what to check."""


class DeviceBusy(ObuError):
    """The device is connected but did not accept the written bytes."""


class Device(Protocol):
    """An open device; every method raises `DeviceLost` when it is disconnected."""

    def read(self, wait_s: float) -> bytes:
        """Return the received bytes, waiting up to `wait_s` for the first; empty after the timeout."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the device; raises `DeviceBusy` if it does not accept them."""
        ...

    def close(self) -> None:
        """Close the device; may be called twice."""
        ...


class DeviceFindings(Protocol):
    """What a device finds out about itself while it is read."""

    @property
    def found(self) -> DeviceFound:
        """Whether it works, or how not."""
        ...

    @property
    def protocols(self) -> tuple[str, ...]:
        """What it speaks."""
        ...

    @property
    def rate_baud(self) -> int | None:
        """[Bd] Rate of its port; None of one without a rate."""
        ...

    def sentence(self) -> str:
        """What was found, and what to do about it."""
        ...


def split_url(
    url: str, known: Mapping[str, Set[str]] = _KNOWN, examples: str = _EXAMPLES
) -> tuple[SplitResult, dict[str, int]]:
    """Split the URL of a device into its parts and options; raises `UserError` for an invalid one."""
    parts = urlsplit(url)
    options = dict(parse_qsl(parts.query))
    if parts.scheme not in known:
        raise UserError(f"unknown device {url!r}: try {examples}")
    if unknown := options.keys() - known[parts.scheme]:
        names = ", ".join(sorted(known[parts.scheme])) or "none"
        raise UserError(f"device {url!r}: unknown option {min(unknown)!r}; known options: {names}")
    for name, value in options.items():
        if not value.isdecimal() or int(value) == 0:
            raise UserError(f"device {url!r}: {name} = {value!r} must be a positive integer")
    return parts, {name: int(value) for name, value in options.items()}


def open_device(url: str) -> Device:
    """Open the device of a URL; raises `DeviceLost` if it is not available, `UserError` if the URL is invalid."""
    parts, options = split_url(url)
    try:
        if parts.scheme == "serial":
            return SerialDevice(parts.netloc or parts.path, options.get("baud", 115200))
        if parts.scheme == "tcp":
            return TcpDevice(parts)
        return FileDevice(Path(parts.netloc + parts.path), options.get("rate", 11520))
    except OSError as error:
        raise DeviceLost(f"cannot open {url}: {_hint(error)}") from error


def _hint(error: OSError) -> str:
    what = os.strerror(error.errno) if error.errno else str(error)
    if error.errno == errno.EACCES:
        return f"{what}; add the user to the group dialout"
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return f"{what}; another program has it open"
    return f"{what}; check the cable and the device in the vehicle file"


class SerialDevice:
    """A serial port with exclusive access; pyserial configures it, reads and writes are system calls."""

    def __init__(self, name: str, baud: int) -> None:
        from serial.serialposix import Serial

        self.name = _port_of(name)
        self._port = Serial(self.name, baud, timeout=0, exclusive=True)  # type: ignore[no-untyped-call]  # no types
        self._descriptor = int(self._port.fd or 0)
        self.rate_baud = baud
        with contextlib.suppress(termios.error):
            termios.tcflush(self._descriptor, termios.TCIFLUSH)  # the arrival time of buffered bytes is unknown

    def read(self, wait_s: float) -> bytes:
        """Return the bytes in the receive buffer of the port."""
        try:
            if not select.select([self._descriptor], [], [], wait_s)[0]:
                return b""
            data = os.read(self._descriptor, CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise DeviceLost(f"lost {self.name}: {error}; check its cable") from error
        if not data:  # readable without data: the port was unplugged
            raise DeviceLost(f"lost {self.name}; check its cable")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes to the port."""
        try:
            while data:
                if not select.select([], [self._descriptor], [], WRITE_S)[1]:
                    raise DeviceBusy(f"{self.name} accepts no bytes")
                data = data[os.write(self._descriptor, data) :]
        except (OSError, ValueError) as error:
            raise DeviceLost(f"lost {self.name}: {error}; check its cable") from error

    def set_rate(self, baud: int) -> None:
        """Change the rate, and forget what came at the former one."""
        try:
            self._port.baudrate = self.rate_baud = baud
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except (OSError, ValueError, termios.error) as error:
            raise DeviceLost(f"lost {self.name}: {error}; check its cable") from error

    def close(self) -> None:
        """Close the port, so that its name is free when the device is reconnected."""
        with contextlib.suppress(OSError):
            self._port.close()  # type: ignore[no-untyped-call]  # no types


def _port_of(name: str) -> str:
    match = _USB_ID.fullmatch(name)
    if match is None:
        return name
    from serial.tools.list_ports_linux import comports

    wanted = tuple(int(part, 16) for part in match.groups())
    ports = comports()  # type: ignore[no-untyped-call]  # pyserial publishes no types
    names = sorted(str(port.device) for port in ports if (port.vid, port.pid) == wanted)
    if not names:
        raise DeviceLost(f"no USB device {name} is plugged in; check the cable and the device in the vehicle file")
    return names[0]


class TcpDevice:
    """A TCP connection to a device server; it is established during `read`, without blocking."""

    def __init__(self, parts: SplitResult) -> None:
        try:
            port = parts.port
        except ValueError:
            port = None
        if not parts.hostname or not port:
            raise UserError(f"device {parts.geturl()!r}: host and port required: try tcp://127.0.0.1:2000")
        self._name = f"{parts.hostname}:{port}"
        family, kind, protocol, _, address = socket.getaddrinfo(parts.hostname, port, type=socket.SOCK_STREAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # detects a peer without power
        for option, value in ((socket.TCP_KEEPIDLE, 5), (socket.TCP_KEEPINTVL, 2), (socket.TCP_KEEPCNT, 3)):
            self._socket.setsockopt(socket.IPPROTO_TCP, option, value)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connected = False
        self._deadline = time.monotonic() + CONNECT_S
        self._socket.connect_ex(address)

    def read(self, wait_s: float) -> bytes:
        """Return the received bytes."""
        if not self._connected and not self._connect(wait_s):
            return b""
        if not select.select([self._socket], [], [], wait_s)[0]:
            return b""
        try:
            data = self._socket.recv(CHUNK)
        except OSError as error:
            raise DeviceLost(f"lost {self._name}: {error.strerror}") from error
        if not data:
            raise DeviceLost(f"{self._name} closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; raises `DeviceBusy` if the peer does not accept all of them."""
        try:
            if not self._connected or self._socket.send(data) < len(data):
                raise DeviceBusy(f"{self._name} does not read")
        except BlockingIOError as error:
            raise DeviceBusy(f"{self._name} does not read") from error
        except OSError as error:
            raise DeviceLost(f"lost {self._name}: {error.strerror}") from error

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _connect(self, wait_s: float) -> bool:
        if select.select([], [self._socket], [], wait_s)[1]:
            if fault := self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise DeviceLost(f"cannot connect to {self._name}: {os.strerror(fault)}; check that the server runs")
            self._connected = True
        elif time.monotonic() > self._deadline:
            raise DeviceLost(f"cannot connect to {self._name}: timeout; check the network")
        return self._connected


class FileDevice:
    """A recorded file, replayed at a constant rate; no bytes after its end."""

    def __init__(self, path: Path, rate_bytes_s: int) -> None:
        self._file = path.open("rb")
        self._rate_bytes_s = rate_bytes_s
        self._sent = 0
        self._start = time.monotonic()

    def read(self, wait_s: float) -> bytes:
        """Return the bytes that are due."""
        due = self._due()
        if due <= 0:
            time.sleep(wait_s)
            due = self._due()
        data = self._file.read(min(max(due, 0), CHUNK))
        self._sent += len(data)
        if due > 0 and not data:
            time.sleep(wait_s)
        return data

    def write(self, data: bytes) -> None:
        """Ignored: a recording has no input."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _due(self) -> int:
        return int((time.monotonic() - self._start) * self._rate_bytes_s) - self._sent
