"""Reads the GNSS receiver, writes its configuration and corrections to it, and states the host's clock beside it."""

from collections.abc import Sequence

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.devices.device import split_url
from shared.devices.driver import HostClockPublisher, Link, run_driver
from shared.devices.recognising import Port
from shared.messages.base import DeviceName
from shared.messages.corrections import GnssCorrection
from shared.messages.gnss import GnssRaw, GnssWrite
from shared.runtime.config import Section

from .correction_writer import CorrectionWriter


class Config(Section):
    """Settings of the GNSS driver; `shared/devices/device.py` lists the kinds of device."""

    device: str = Field(default="serial:///dev/obu-gnss?baud=115200", description="URL of the GNSS receiver")
    source: DeviceName = Field(default="gnss0", description="name of this receiver in the published messages")


class Process:
    """Publishes the receiver's bytes unchanged."""

    def __init__(self, config: Config) -> None:
        # An invalid URL is a configuration error, raised at the start.
        self._recorded = True if split_url(config.device)[0].scheme == "file" else None
        self._config = config
        self._corrections = CorrectionWriter()

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        link = Link(Port(self._config.device, "gnss").open)
        clock = None if self._recorded else HostClockPublisher()

        def handle(envelopes: Sequence[Envelope]) -> None:
            self._write(bus, link, envelopes)
            if clock is not None:
                clock.publish_if_due(bus)

        run_driver(bus, link, self._config.device, self._raw, handle, source=self._config.source)

    def _raw(self, data: bytes, received_ns: int) -> GnssRaw:
        return GnssRaw(received_ns=received_ns, source=self._config.source, data=data, recorded=self._recorded)

    def _write(self, bus: Bus, link: Link, envelopes: Sequence[Envelope]) -> None:
        for envelope in envelopes:
            message = decoded(bus, envelope)
            if isinstance(message, GnssWrite) and message.source == self._config.source:
                link.write(bus, message.data)
            elif isinstance(message, GnssCorrection):
                self._corrections.take(bus, message)
        self._corrections.write(bus, link)
