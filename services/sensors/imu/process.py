"""Reads the inertial measurement unit."""

from shared.bus.bus import Bus
from shared.devices.device import open_device, split_url
from shared.devices.driver import Link, run_driver
from shared.messages.base import DeviceName
from shared.messages.imu import ImuRaw
from shared.runtime.config import Section


class Config(Section):
    """Settings of the IMU driver; `shared/devices/device.py` lists the kinds of device."""

    device: str = "serial:///dev/obu-imu?baud=115200"
    source: DeviceName = "imu0"


class Process:
    """Publishes the unit's bytes as they are."""

    def __init__(self, config: Config) -> None:
        split_url(config.device)  # a wrong one is the user's to mend, at once
        self._config = config

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        run_driver(bus, Link(lambda: open_device(self._config.device)), self._config.device, self._raw)

    def _raw(self, data: bytes, received_ns: int) -> ImuRaw:
        return ImuRaw(received_ns=received_ns, source=self._config.source, data=data)
