"""A receiver without a fix, at a port: recognised, configured and told by the processes of a vehicle."""

import contextlib
import os
import pty
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from cli.doctor.unit import unit as unit_findings
from services.parsers.gnss.protocols import FRAMINGS
from shared.messages.base import Message
from shared.messages.gnss import GnssConfiguration, GnssReceiver
from shared.messages.operation import DeviceFound, DeviceState
from shared.protocols.framing.framer import Framer
from shared.runtime.config import load_vehicle
from tests.integration.test_monitoring import Unit
from tests.support.bus import brokers
from tests.support.gnss.generation8 import Generation8

WITHOUT_FIX = b"$GNRMC,,V,,,,,,,,,,N*4D\r\n$GNGGA,,,,,,0,00,99.99,,,,,,*56\r\n"


class Port:
    """A pseudo-terminal with an M8 at its far end, which sends NMEA once a second and answers to UBX."""

    def __init__(self, folder: Path) -> None:
        self.receiver = Generation8()
        self._far, near = pty.openpty()
        tty.setraw(near)
        self.path = folder / "receiver"
        self.path.symlink_to(os.ttyname(near))
        os.close(near)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._thread.start()

    def _speak(self) -> None:
        framer, next_s = Framer(FRAMINGS), 0.0
        os.set_blocking(self._far, False)
        while not self._stop.wait(0.02):
            with contextlib.suppress(BlockingIOError, OSError):
                for frame in framer.feed(os.read(self._far, 4096)):
                    os.write(self._far, self.receiver.answer(frame.data))
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + 1.0
                with contextlib.suppress(BlockingIOError, OSError):
                    os.write(self._far, WITHOUT_FIX)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._far)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Port]:
    made = Port(tmp_path)
    yield made
    made.close()


def test_an_m8_without_a_fix_is_recognised_configured_and_told(
    port: Port, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(
        f'[vehicle]\nname = "car"\n[sensors.gnss]\ndevice = "serial://{port.path}?baud=9600"\n'
        "[controller.mode]\nnavigation_period_s = 0.2\n"
    )
    for name, value in (
        ("OBU_BROKER", f"mqtt://127.0.0.1:{broker.port}"), ("OBU_STATE", str(tmp_path)), ("OBU_VEHICLE", str(vehicle)),
    ):  # fmt: skip
        monkeypatch.setenv(name, value)
    unit = Unit(broker.port, tmp_path)
    try:
        for name in ("parsers.gnss", "controller.mode", "sensors.gnss"):
            unit.start(name)
        unit.until(lambda: bool(of(unit, "gnss/configuration", GnssConfiguration)))
        unit.until(
            lambda: any(gnss_receiver.gives_position for gnss_receiver in of(unit, "gnss/receiver", GnssReceiver))
        )
        (result, *_) = of(unit, "gnss/configuration", GnssConfiguration)
        assert result.accepted and (result.reason or "").startswith("9600 baud carry 1.0 kB/s; "), "the fix first"
        assert (result.model, result.protocol, result.dynamic_model) == ("NEO-M8N-0", "UBX 18.00", "automotive")
        assert port.receiver.period_ms == 200 and port.receiver.rates["NAV-PVT"] == 1
        state = of(unit, "device/state", DeviceState)[-1]
        assert (state.found, state.rate_baud) == (DeviceFound.WORKING, 9600)
        assert "NMEA" in state.protocols
        findings = {finding.what: finding for finding in unit_findings(load_vehicle(None))}
        said = [what for what in findings if what.startswith("the GNSS receiver has taken its configuration")]
        assert said and findings[said[0]].ok and "NEO-M8N-0 SPG 3.01 UBX 18.00; a fix every 0.2 s" in said[0]
        assert any(what.startswith("gnss0 at serial://") and "at 9600 baud" in what for what in findings)
        assert any("parsers.gnss: used:" in what and "NMEA RMC" in what for what in findings)
        assert not findings["the GNSS receiver has a position"].ok, findings
    finally:
        unit.close()
        broker.stop()


M = TypeVar("M", bound=Message)


def of(unit: Unit, topic: str, kind: type[M]) -> list[M]:
    return [message for message in unit.published(topic) if isinstance(message, kind)]
