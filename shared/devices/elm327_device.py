"""An ELM327 on a serial port or a socket, as a CAN device: its answers are the lines of a candump log."""

import time
from collections.abc import Callable

from .device import Device, DeviceBusy, SerialDevice
from .elm327 import Elm327
from .elm327_lines import ElmFrame

NS = 1_000_000_000
BUS_ERROR = 0x20000080  # identifier of an error frame of class CAN_ERR_BUSERROR, as in the kernel
CHANNEL_CHARACTERS = 16  # of an interface in a line of candump


class ElmDevice:
    """An adapter; `write` queues the request of a frame, and `read` sets it up, asks, and returns what came."""

    def __init__(self, device: Device, channel: str, request_identifier: int, now_ns: Callable[[], int]) -> None:
        rate = device.rate_baud if isinstance(device, SerialDevice) else None
        self.search = Elm327(rate, request_identifier)
        self._device, self._now_ns = device, now_ns
        self._channel = channel[:CHANNEL_CHARACTERS]

    @property
    def rejects(self) -> dict[str, int]:
        """What the adapter answered that is no frame, by kind."""
        return self.search.rejects

    def read(self, wait_s: float) -> bytes:
        """Return the vehicle's frames as candump lines."""
        adapter = self.search
        self._write_due()
        frames = adapter.take(self._device.read(wait_s), time.monotonic())
        lines = b"".join(map(self._line, frames))
        self._write_due()
        return lines

    def write(self, data: bytes) -> None:
        """Queue a request, the data of a single frame of ISO 15765-2; raises `DeviceBusy` where too many wait."""
        if not self.search.request(data[1 : 1 + data[0]]):
            raise DeviceBusy("the adapter has not answered earlier requests")

    def close(self) -> None:
        """Close the port."""
        self._device.close()

    def _write_due(self) -> None:
        if not (data := self.search.due(time.monotonic())):
            return
        if (rate := self.search.take_rate()) is not None and isinstance(self._device, SerialDevice):
            self._device.set_rate(rate)
        try:
            self._device.write(data)
        except DeviceBusy:  # a socket that is not connected yet
            self.search.not_sent(time.monotonic())

    def _line(self, frame: ElmFrame) -> bytes:
        stamp_ns = self._now_ns()
        name = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
        if frame.is_error:
            name = f"{BUS_ERROR:08X}"
        text = f"({stamp_ns // NS}.{stamp_ns % NS // 1000:06d}) {self._channel} {name}#{frame.data.hex().upper()}\n"
        return text.encode()
