"""A byte-stream device that is recognised by its bytes, and whose rate is found out."""

import contextlib
import os
import time
from pathlib import Path
from urllib.parse import urlsplit

from .device import Device, DeviceBusy, SerialDevice, open_device
from .search import Search, Step

BY_ID = Path("/dev/serial/by-id")  # links that udev makes of vendor, product and serial number
WITHOUT_RATE = ("ttyACM",)  # USB devices that ignore the rate of their port


class RateRecognition:
    """Passes bytes on, unless they came at a rate that is not known to be right."""

    def __init__(self, device: Device, search: Search) -> None:
        self.search = search
        self._device = device

    def read(self, wait_s: float) -> bytes:
        """Return the received bytes."""
        data = self._device.read(wait_s)
        passed = self.search.sure
        if (step := self.search.take(data, time.monotonic())) is not None:
            self._carry_out(step)
        return data if passed or self.search.sure else b""

    def write(self, data: bytes) -> None:
        """Send bytes; raises `DeviceBusy` while the rate is not known."""
        if not self.search.sure:
            raise DeviceBusy("the rate of the port is being found out")
        self._device.write(data)

    def close(self) -> None:
        """Close the device."""
        self._device.close()

    def _carry_out(self, step: Step) -> None:
        with contextlib.suppress(DeviceBusy):  # the search goes on without an answer
            if step.before:
                self._device.write(step.before)
        if step.rate_baud is not None and isinstance(self._device, SerialDevice):
            self._device.set_rate(step.rate_baud)
        with contextlib.suppress(DeviceBusy):
            if step.write:
                self._device.write(step.write)


class Port:
    """A configured device that is opened again and again, and found under another name after it was unplugged."""

    def __init__(self, url: str, kind: str, by_id: Path = BY_ID) -> None:
        self.url, self._kind, self._by_id = url, kind, by_id
        self._link: Path | None = None  # stable name of the port that worked
        self.opened_as: str | None = None

    def open(self, *, may_write: bool = True) -> RateRecognition:
        """Open the device, which may be asked what it is; raises `DeviceLost`."""
        parts = urlsplit(self.url)
        named = parts.scheme == "serial" and not parts.netloc
        path = Path(parts.path)
        if named and not path.exists() and self._link is not None and self._link.exists():
            path = self._link
        self.opened_as = parts._replace(path=str(path)).geturl() if named else self.url
        device = open_device(self.opened_as)
        if named:
            self._link = self._stable_name(path) or self._link
        rate = device.rate_baud if isinstance(device, SerialDevice) and has_rate(Path(device.name)) else None
        search = Search(self._kind, rate, may_write=may_write and parts.scheme != "file")
        if parts.scheme != "serial":
            search.remedy = "check that its server has data" if parts.scheme == "tcp" else "the file has ended"
        return RateRecognition(device, search)

    def _stable_name(self, path: Path) -> Path | None:
        """The link of udev that leads to a port."""
        try:
            links = list(self._by_id.iterdir())
        except OSError:
            return None
        real = os.path.realpath(path)
        return next((link for link in sorted(links) if os.path.realpath(link) == real), None)


def has_rate(path: Path) -> bool:
    """Whether the rate of a port means anything to its device."""
    return not Path(os.path.realpath(path)).name.startswith(WITHOUT_RATE)
