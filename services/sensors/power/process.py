"""Reads the power supply once a second, and switches the host off where the operator has given a command for it."""

import logging
import shlex
import subprocess
import time
from collections.abc import Sequence

from pydantic import Field

from shared.bus.bus import Bus, Envelope, decoded
from shared.devices.device import DeviceLost
from shared.devices.driver import BACK_OFF_S
from shared.errors import ConfigError
from shared.messages.base import DeviceName
from shared.messages.operation import ModeState
from shared.messages.power import PowerRaw
from shared.runtime.config import Section

from .supply import Supply, check_supply, open_supply

log = logging.getLogger(__name__)

READ_S = 1.0
RETRY_S = 60.0  # after a command that failed
COMMAND_S = 10.0  # a command that starts a shutdown returns at once


class Config(Section):
    """Settings of the driver of the supply; `services/sensors/power/supply.py` lists the kinds."""

    device: str = Field(default="ina219:///dev/i2c-1?address=0x42", description="URL of the supply")
    source: DeviceName = Field(default="ups", description="name of the supply in the published messages")
    power_off_command: str = Field(
        default="",
        description="command that switches the host off when the battery is nearly empty, such as `systemctl "
        "poweroff`; if not given, the unit saves its state and goes on until the supply ends",
    )
    power_off_delay_s: float = Field(
        default=10.0,
        ge=0.0,
        le=600.0,
        description="time from `power_off` of the mode to the command, in which recordings are closed",
    )


class Process:
    """Publishes readings; runs the command once the mode has asked for it without a break for the delay."""

    def __init__(self, config: Config) -> None:
        check_supply(config.device)  # an invalid URL is a configuration error, raised at the start
        try:
            self._command = shlex.split(config.power_off_command)
        except ValueError as error:
            raise ConfigError(f"[sensors.power] power_off_command: {error}") from error
        self._config = config
        self._supply: Supply | None = None
        self._next_s = 0.0
        self._attempts = 0
        self._asked_s: float | None = None  # since when the host is to be switched off
        self._retry_s = 0.0

    def run(self, bus: Bus) -> None:
        """Read until the bus stops."""
        while not bus.stopping and not bus.connected:
            bus.receive(0.1)
        while not bus.stopping:
            self._handle(bus, bus.receive(0.2))
            now_s = time.monotonic()
            if now_s >= self._next_s:
                self._next_s = now_s + READ_S
                self._read(bus, now_s)
            self._switch_off(bus, now_s)
        self._close()

    def _read(self, bus: Bus, now_s: float) -> None:
        try:
            self._supply = self._supply or open_supply(self._config.device)
            data = self._supply.read()
        except DeviceLost as error:
            self._close()
            if bus.last_error != str(error):
                log.warning("%s; retrying", error)
            bus.rejects["device_lost"] += 1
            bus.last_error = str(error)[:400]
            self._next_s = now_s + BACK_OFF_S[min(self._attempts, len(BACK_OFF_S) - 1)]
            self._attempts += 1
            return
        if self._attempts:
            self._attempts, bus.last_error = 0, None
        bus.publish(PowerRaw(
            received_ns=bus.now_ns(), source=self._config.source, data=data, protocol=self._supply.protocol,
        ))  # fmt: skip

    def _handle(self, bus: Bus, envelopes: Sequence[Envelope]) -> None:
        for envelope in envelopes:
            if envelope.retained:
                continue  # of a time before this process; the mode comes every second
            match decoded(bus, envelope):
                case ModeState(power_off=True):
                    self._asked_s = self._asked_s or time.monotonic()
                case ModeState():
                    self._asked_s = None

    def _switch_off(self, bus: Bus, now_s: float) -> None:
        if not self._command or self._asked_s is None or now_s < self._retry_s:
            return
        if now_s - self._asked_s < self._config.power_off_delay_s:
            return
        self._retry_s = now_s + RETRY_S
        log.warning("battery nearly empty: running %s", self._command[0])
        try:
            done = subprocess.run(self._command, capture_output=True, timeout=COMMAND_S, check=False)
            fault = f"it ended with {done.returncode}" if done.returncode else None
        except (OSError, subprocess.TimeoutExpired) as error:
            fault = str(error)
        if fault is not None:
            bus.last_error = f"power_off_command {self._command[0]} failed: {fault}; run it as the unit's user"[:400]
            log.error("%s", bus.last_error)

    def _close(self) -> None:
        if self._supply is not None:
            self._supply.close()
            self._supply = None
