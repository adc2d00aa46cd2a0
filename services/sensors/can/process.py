"""Reads the vehicle's CAN bus; requests the OBD-II speed only if the configuration sets a period."""

import time
from collections.abc import Sequence

from pydantic import Field

from shared.bus.bus import Bus, Envelope
from shared.devices.can_device import check_can_url, open_can
from shared.devices.driver import Link, run_driver
from shared.messages.base import DeviceName
from shared.messages.vehicle import CanRaw
from shared.runtime.config import Section

SPEED_REQUEST = bytes.fromhex("02010D0000000000")  # SAE J1979 mode 01, PID 0D


class Config(Section):
    """Settings of the CAN driver; `shared/devices/can_device.py` lists the kinds of device."""

    device: str = Field(default="socketcan://can0", description="URL of the CAN interface")
    source: DeviceName = Field(default="can0", description="name of this CAN bus in the published messages")
    obd_period_s: float = Field(
        default=0.0, ge=0.0, description="period of the OBD-II speed requests; 0: nothing is transmitted"
    )
    obd_identifier: int = Field(
        default=0x7DF,
        ge=0,
        le=0x1FFFFFFF,
        description="CAN identifier of the OBD-II requests; 0x18DB33F1 on vehicles with 29-bit identifiers",
    )


class Process:
    """Publishes the received frames in batches of at most 0.1 s, as lines of a candump log."""

    def __init__(self, config: Config) -> None:
        check_can_url(config.device)  # an invalid URL is a configuration error, raised at the start
        self._config = config
        self._next_request = 0.0

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        config = self._config
        link = Link(lambda: open_can(config.device, config.obd_identifier, bus.now_ns), gap_s=0.03, chunk_s=0.07)

        def request_speed(_envelopes: Sequence[Envelope]) -> None:
            if config.obd_period_s and link.present and time.monotonic() >= self._next_request:
                self._next_request = time.monotonic() + config.obd_period_s
                link.write(bus, SPEED_REQUEST)

        run_driver(bus, link, config.device, self._raw, request_speed, source=config.source)

    def _raw(self, data: bytes, received_ns: int) -> CanRaw:
        return CanRaw(received_ns=received_ns, source=self._config.source, data=data)
