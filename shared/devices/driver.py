"""Main loop of a device driver: reads a device, stamps and publishes its bytes, and reconnects after a loss."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Generic, Protocol, TypeVar
from urllib.parse import urlsplit

from ..bus.bus import Bus, Envelope
from ..messages.base import Message
from ..messages.operation import DeviceFound, DeviceState, HostClock, Origin, OriginKind
from ..runtime.clock import maximum_error_s
from .device import Device, DeviceBusy, DeviceFindings, DeviceLost

log = logging.getLogger(__name__)

BACK_OFF_S = (0.5, 1.0, 2.0, 5.0)
WAIT_TIMEOUT_S = 0.02  # timeout of the first byte of a chunk
CHUNK_BYTES = 16384
ORIGIN_S = 2.0
HOST_CLOCK_S = 10.0
FAULTY = (DeviceFound.SILENT, DeviceFound.NOISE, DeviceFound.OTHER)


class WritableDevice(Protocol):
    """What a device and a radio have in common."""

    def write(self, data: bytes, /) -> None:
        """Send bytes; raises `DeviceBusy` or `DeviceLost`."""
        ...

    def close(self) -> None:
        """Close the device; may be called twice."""
        ...


D = TypeVar("D", bound=WritableDevice)


class Connection(Generic[D]):
    """A device that may be disconnected and reconnected.

    A loss is logged once and counted in `bus.rejects["device_lost"]`; `bus.last_error` states what to check until
    the device works again. The device is closed before it is reopened, since a serial port that is still open
    reappears under another name.
    """

    def __init__(self, open_it: Callable[[], D]) -> None:
        self._open = open_it
        self._device: D | None = None
        self._attempts = 0
        self._next_attempt = 0.0
        self._fault: str | None = None
        self._reported: str | None = None

    def opened(self) -> D | None:
        """The device, opened when an attempt is due, otherwise None; raises `DeviceLost`."""
        if self._device is None and time.monotonic() >= self._next_attempt:
            self._device = self._open()
        return self._device

    def write(self, bus: Bus, data: bytes) -> bool:
        """Send bytes; they are dropped and counted as `write_lost` if the device is absent or does not accept them.

        Returns whether the device has accepted them.
        """
        try:
            if self._device is None:
                raise DeviceBusy("device not open")
            self._device.write(data)
        except DeviceBusy:
            bus.rejects["write_lost"] += 1
            return False
        except DeviceLost as error:
            self.lose(bus, error)
            return False
        return True

    @property
    def fault(self) -> str | None:
        """Why the device is absent."""
        return self._fault

    def report(self, bus: Bus, sentence: str | None) -> None:
        """Make what is wrong with an open device the last error of the process; None: nothing is."""
        if sentence is not None and self._reported != sentence:
            log.warning("%s", sentence)
        if bus.last_error is None or bus.last_error == self._reported:
            bus.last_error = self._reported = sentence

    @property
    def present(self) -> bool:
        """Whether the device is open."""
        return self._device is not None

    def close(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.close()
            self._device = None

    def note_working(self, bus: Bus) -> None:
        """End the fault of a lost device."""
        self._attempts = 0
        if self._fault is not None:
            log.info("device reconnected")
            if bus.last_error == self._fault:
                bus.last_error = None
            self._fault = None

    def lose(self, bus: Bus, error: DeviceLost) -> None:
        """Close the device until the next attempt."""
        if self._device is not None:
            bus.rejects["device_lost"] += 1
        self.close()
        if self._fault is None:
            log.warning("%s; retrying", error)
        self._fault = bus.last_error = str(error)
        self._next_attempt = time.monotonic() + BACK_OFF_S[min(self._attempts, len(BACK_OFF_S) - 1)]
        self._attempts += 1


class Link(Connection[Device]):
    """A byte stream, read in chunks: each ends after `gap_s` without a byte, or `chunk_s` after its first byte."""

    def __init__(self, open_it: Callable[[], Device], *, gap_s: float = 0.002, chunk_s: float = 0.01) -> None:
        super().__init__(open_it)
        self._gap_s, self._chunk_s = gap_s, chunk_s

    @property
    def search(self) -> DeviceFindings | None:
        """What is known of the open device; None while it is absent, or where it is not watched."""
        return getattr(self._device, "search", None)

    @property
    def rejects(self) -> Mapping[str, int]:
        """What the open device itself has rejected, by kind."""
        return getattr(self._device, "rejects", {})

    def read(self, bus: Bus, wait_s: float) -> tuple[bytes, int]:
        """Return one chunk and the arrival time of its last byte; empty without data or without a device."""
        chunk, received_ns = b"", 0
        try:
            device = self.opened()
            if device is None:
                return b"", 0
            chunk = device.read(wait_s)
            received_ns, end = bus.now_ns(), time.monotonic() + self._chunk_s
            if chunk:
                self.note_working(bus)
            while chunk and len(chunk) < CHUNK_BYTES and time.monotonic() < end and (more := device.read(self._gap_s)):
                received_ns, chunk = bus.now_ns(), chunk + more
        except DeviceLost as error:
            self.lose(bus, error)
        return chunk, received_ns


class DevicePublisher:
    """Publishes what was found at a port: when it changes, and every two seconds."""

    def __init__(self, process: str, source: str, url: str) -> None:
        self._process, self._source, self._url = process, source, url
        self._next = 0.0
        self._said: tuple[DeviceFound, tuple[str, ...], int | None] | None = None

    def publish_if_due(self, bus: Bus, link: Link) -> None:
        """Publish the state if it is due; faults that the driver does not notice otherwise are its last error."""
        search = link.search
        present = DeviceFound.WORKING if link.present else DeviceFound.ABSENT
        found = present if search is None else search.found
        said = found, search.protocols if search else (), search.rate_baud if search else None
        if said == self._said and time.monotonic() < self._next:
            return
        sentence = (link.fault or "") if search is None else search.sentence()
        if search is not None and said != self._said and found is not DeviceFound.SEARCHING:
            log.info("%s: %s", self._source, sentence)
        self._next, self._said = time.monotonic() + ORIGIN_S, said
        if search is not None:
            link.report(bus, sentence if found in FAULTY and not self._url.startswith("file:") else None)
        bus.publish(
            DeviceState(
                sampled_ns=bus.now_ns(), source=self._source, process=self._process, device=self._url[:200],
                found=found, protocols=said[1], rate_baud=said[2], sentence=sentence[:400],
            )
        )  # fmt: skip


class OriginPublisher:
    """Publishes every two seconds whether the data of this bus are live or from a recorded file."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._recording = Path(parts.netloc + parts.path).stem[:64] if parts.scheme == "file" else None
        self._next = 0.0

    def publish_if_due(self, bus: Bus) -> None:
        """Publish the origin if it is due."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + ORIGIN_S
        kind = OriginKind.LIVE if self._recording is None else OriginKind.REPLAY
        bus.publish(Origin(now_ns=bus.now_ns(), kind=kind, name=self._recording or bus.vehicle))


class HostClockPublisher:
    """Publishes every ten seconds what the host's clock shows on the OBU time line, and whether NTP holds it."""

    def __init__(self) -> None:
        self._next = 0.0

    def publish_if_due(self, bus: Bus) -> None:
        """Publish the clock if it is due."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + HOST_CLOCK_S
        error_s = maximum_error_s()
        clock = HostClock(
            sampled_ns=bus.now_ns(), utc_ns=time.time_ns(), synchronised=error_s is not None, maximum_error_s=error_s
        )
        bus.publish(clock)


def run_driver(
    bus: Bus,
    link: Link,
    url: str,
    make_raw: Callable[[bytes, int], Message],
    handle: Callable[[Sequence[Envelope]], None] = lambda envelopes: None,
    *,
    source: str = "device",
) -> None:
    """Read a device until the bus stops.

    `make_raw` creates the message of a chunk and its time stamp; `handle` processes the messages received from the bus.
    """
    origin, found = OriginPublisher(url), DevicePublisher(bus.process, source, url)
    while not bus.stopping and not bus.connected:  # data published before would be lost
        bus.receive(0.1)
    while not bus.stopping:
        data, received_ns = link.read(bus, WAIT_TIMEOUT_S)
        if data:
            bus.publish(make_raw(data, received_ns))
        handle(bus.receive(0.0 if link.present else 0.1))
        origin.publish_if_due(bus)
        found.publish_if_due(bus, link)
    link.close()
