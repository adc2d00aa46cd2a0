"""Reads the bytes of the inertial measurement unit."""

from pydantic import Field

from shared.bus.bus import Bus
from shared.devices.device import split_url
from shared.devices.driver import Link, run_driver
from shared.devices.recognising import Port
from shared.messages.base import DeviceName
from shared.messages.imu import ImuRaw
from shared.runtime.config import Section


class Config(Section):
    """Settings of the IMU driver; `shared/devices/device.py` lists the kinds of device."""

    device: str = Field(default="serial:///dev/obu-imu?baud=115200", description="URL of the inertial measurement unit")
    source: DeviceName = Field(default="imu0", description="name of this IMU in the published messages")


class Process:
    """Publishes the IMU's bytes unchanged."""

    def __init__(self, config: Config) -> None:
        split_url(config.device)  # an invalid URL is a configuration error, raised at the start
        self._config = config

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        link = Link(Port(self._config.device, "imu").open)
        run_driver(bus, link, self._config.device, self._raw, source=self._config.source)

    def _raw(self, data: bytes, received_ns: int) -> ImuRaw:
        return ImuRaw(received_ns=received_ns, source=self._config.source, data=data)
