"""Supplies behind one interface, selected by a URL.

ina219:///dev/i2c-1?address=0x42    a UPS with an INA219 on the I2C bus
signal:///sys/class/power_supply/AC/online   a file that holds 1 with mains and 0 without, as of a GPIO or a charger
simulated://ups?mains_s=60&battery_s=300     a simulated UPS: mains, then a battery that lasts so long, again and again

References
----------
Texas Instruments, INA219, SBOS448: figure 25 (registers), section 8.5.5 (two-wire protocol).
"""

import fcntl
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol
from urllib.parse import SplitResult, parse_qsl, urlsplit

from shared.devices.device import DeviceLost
from shared.errors import ConfigError
from shared.messages.power import PowerProtocol

I2C_SLAVE = 0x0703  # ioctl of the kernel's i2c-dev: address of the peer
SHUNT, BUS = 0x01, 0x02  # registers
MAX_SIGNAL = 64  # [bytes]
_OPTIONS = {"ina219": {"address"}, "signal": set[str](), "simulated": {"mains_s", "battery_s"}}
EXAMPLES = "ina219:///dev/i2c-1?address=0x42 or signal:///sys/class/power_supply/AC/online"


class Supply(Protocol):
    """An open supply."""

    protocol: PowerProtocol

    def read(self) -> bytes:
        """Read it once; raises `DeviceLost`."""
        ...

    def close(self) -> None:
        """Close it; may be called twice."""
        ...


class Registers(Protocol):
    """A device with registers of 16 bits."""

    def read(self, register: int) -> bytes:
        """Read a register, the high byte first; raises `OSError`."""
        ...

    def close(self) -> None:
        """Close the bus."""
        ...


class I2cDevice:
    """A device on an I2C bus, through the kernel's i2c-dev."""

    def __init__(self, bus: str, address: int) -> None:
        self._file: int | None = os.open(bus, os.O_RDWR)
        try:
            fcntl.ioctl(self._file, I2C_SLAVE, address)
        except OSError:
            self.close()
            raise

    def read(self, register: int) -> bytes:
        """Read a register."""
        if self._file is None:
            raise OSError("closed")
        os.write(self._file, bytes((register,)))
        return os.read(self._file, 2)

    def close(self) -> None:
        """Close the bus."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


class Ina219:
    """A UPS with an INA219; gives shunt and bus voltage, four bytes."""

    protocol = PowerProtocol.INA219

    def __init__(self, name: str, registers: Registers) -> None:
        self._name, self._registers = name, registers

    def read(self) -> bytes:
        """Read both registers."""
        try:
            data = self._registers.read(SHUNT) + self._registers.read(BUS)
        except OSError as error:
            raise DeviceLost(
                f"{self._name} does not answer: {error.strerror or error}; check address and cable"
            ) from error
        if len(data) != 4:
            raise DeviceLost(f"{self._name} answers {len(data)} bytes in place of 4")
        return data

    def close(self) -> None:
        """Close the bus."""
        self._registers.close()


class Signal:
    """A file that holds 1 or 0."""

    protocol = PowerProtocol.SIGNAL

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> bytes:
        """Read it from its beginning."""
        try:
            with self._path.open("rb") as file:
                return file.read(MAX_SIGNAL)
        except OSError as error:
            raise DeviceLost(f"cannot read {self._path}: {error.strerror}; check device in [sensors.power]") from error

    def close(self) -> None:
        """Nothing is open between two readings."""


class SimulatedUps:
    """A UPS of two lithium cells whose mains come and go: simulated, for trials without hardware."""

    protocol = PowerProtocol.INA219

    def __init__(self, mains_s: float, battery_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._mains_s, self._battery_s, self._clock = mains_s, battery_s, clock
        self._start_s = clock()

    def read(self) -> bytes:
        """Make the registers of the present time: 8.4 V and 0.2 A with mains, then -1 A and down to 6.0 V."""
        at_s = (self._clock() - self._start_s) % (self._mains_s + self._battery_s)
        used = max(at_s - self._mains_s, 0.0) / self._battery_s
        shunt = 2000 if at_s < self._mains_s else -10_000  # 10 µV each, at 0.1 ohm
        return shunt.to_bytes(2, "big", signed=True) + (round((8.4 - 2.4 * used) / 0.004) << 3).to_bytes(2, "big")

    def close(self) -> None:
        """Nothing is open."""


def check_supply(url: str) -> tuple[SplitResult, dict[str, int]]:
    """Split the URL of a supply into its parts and options; raises `ConfigError` for one that cannot be used."""
    parts = urlsplit(url)
    if parts.scheme not in _OPTIONS:
        raise ConfigError(f"[sensors.power] device {url!r} is not known: try {EXAMPLES}")
    if parts.scheme != "simulated" and (parts.netloc or not parts.path.startswith("/")):
        raise ConfigError(f"[sensors.power] device {url!r} names no file: try {EXAMPLES}")
    options: dict[str, int] = {}
    for name, text in parse_qsl(parts.query):
        try:
            options[name] = int(text, 0)
        except ValueError:
            options[name] = -1
        if name not in _OPTIONS[parts.scheme] or options[name] <= 0:
            known = ", ".join(sorted(_OPTIONS[parts.scheme])) or "none"
            raise ConfigError(f"[sensors.power] device {url!r}: {name} = {text!r}; options with a number: {known}")
    if not 0x08 <= options.get("address", 0x40) <= 0x77:
        raise ConfigError(f"[sensors.power] device {url!r}: an I2C address is from 0x08 to 0x77, such as 0x42")
    return parts, options


def open_supply(url: str) -> Supply:
    """Open a supply; raises `DeviceLost` if it is not there."""
    parts, options = check_supply(url)
    if parts.scheme == "signal":
        return Signal(Path(parts.path))
    if parts.scheme == "simulated":
        return SimulatedUps(options.get("mains_s", 60), options.get("battery_s", 300))
    try:
        return Ina219(url, I2cDevice(parts.path, options.get("address", 0x42)))
    except OSError as error:
        hint = (
            "switch the bus on with raspi-config"
            if isinstance(error, FileNotFoundError)
            else "add the user to the group i2c"
        )
        raise DeviceLost(f"cannot open {parts.path}: {error.strerror}; {hint}") from error
