"""Supplies: a fake INA219, a signal file, the simulated UPS; and the command that switches the host off."""

import sys
import time
from pathlib import Path

import pytest

from services.sensors.power import process as module
from services.sensors.power.process import Config, Process
from services.sensors.power.supply import BUS, SHUNT, Ina219, Signal, SimulatedUps, open_supply
from shared.devices.device import DeviceLost
from shared.errors import ConfigError
from shared.messages.operation import Mode, ModeState
from shared.messages.power import PowerProtocol, PowerRaw
from tests.support.bus.live_bus import eventually, running


class FakeRegisters:
    """A fake INA219: registers by number, or a bus that fails."""

    def __init__(self, registers: dict[int, bytes]) -> None:
        self.registers, self.closed = registers, False

    def read(self, register: int) -> bytes:
        if register not in self.registers:
            raise OSError(121, "Remote I/O error")
        return self.registers[register]

    def close(self) -> None:
        self.closed = True


def test_shunt_and_bus_voltage_are_read_in_this_order() -> None:
    registers = FakeRegisters({SHUNT: b"\xd8\xf0", BUS: b"\x3e\x82"})
    supply = Ina219("ups", registers)
    assert (supply.read(), supply.protocol) == (b"\xd8\xf0\x3e\x82", PowerProtocol.INA219)
    supply.close()
    assert registers.closed


@pytest.mark.parametrize("registers", [{}, {SHUNT: b"\0\0"}, {SHUNT: b"\0", BUS: b"\0\0"}])
def test_a_bus_that_fails_is_a_lost_device(registers: dict[int, bytes]) -> None:
    with pytest.raises(DeviceLost, match="answer"):
        Ina219("ups", FakeRegisters(registers)).read()


def test_a_signal_is_read_anew_each_time_and_a_missing_file_is_a_lost_device(tmp_path: Path) -> None:
    path = tmp_path / "online"
    path.write_text("1\n")
    supply = Signal(path)
    assert supply.read() == b"1\n"
    path.write_text("0" * 1000)
    assert supply.read() == b"0" * 64
    path.unlink()
    with pytest.raises(DeviceLost, match="device in"):
        supply.read()


def test_the_simulated_ups_discharges_from_full_to_empty_and_begins_again() -> None:
    now = [0.0]
    supply = SimulatedUps(60.0, 300.0, lambda: now[0])

    def volts() -> float:
        return (int.from_bytes(supply.read()[2:], "big") >> 3) * 0.004

    assert volts() == pytest.approx(8.4) and supply.read()[0] < 0x80
    now[0] = 210.0
    assert volts() == pytest.approx(7.2, abs=0.004) and supply.read()[0] >= 0x80
    now[0] = 359.9
    assert volts() == pytest.approx(6.0, abs=0.01)
    now[0] = 361.0
    assert volts() == pytest.approx(8.4)


@pytest.mark.parametrize(
    "device",
    ["ups", "ina219:///dev/i2c-1?address=0", "ina219:///dev/i2c-1?address=200", "ina219://x/dev/i2c-1", "signal:online",
     "signal:///sys/x?mains=0", "simulated://ups?mains_s=a"],
)  # fmt: skip
def test_a_supply_that_cannot_be_is_a_wrong_configuration(device: str) -> None:
    with pytest.raises(ConfigError, match="device"):
        Process(Config(device=device))


def test_a_missing_bus_says_what_to_do() -> None:
    with pytest.raises(DeviceLost, match="raspi-config"):
        open_supply("ina219:///dev/i2c-none")


def test_readings_are_published_and_a_lost_supply_is_said_until_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "READ_S", 0.02)
    monkeypatch.setattr(module, "BACK_OFF_S", (0.02,))
    path = tmp_path / "online"
    with running(Process(Config(device=f"signal://{path}")).run) as bus:
        eventually(lambda: bus.last_error is not None and "cannot read" in bus.last_error)
        path.write_text("1\n")
        eventually(lambda: bool(bus.of(PowerRaw)) and bus.last_error is None)
        assert bus.of(PowerRaw)[-1].data == b"1\n" and bus.rejects["device_lost"] >= 1


def mode(*, power_off: bool) -> ModeState:
    return ModeState(sampled_ns=1, mode=Mode.SHUTTING_DOWN, since_ns=1, reason="", power_off=power_off)


def test_the_command_runs_once_after_the_delay_and_not_when_the_mains_come_back(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    command = f"{sys.executable} -c \"open('{trace}', 'a').write('x')\""
    config = Config(device="simulated://ups", power_off_command=command, power_off_delay_s=0.3)
    with running(Process(config).run) as bus:
        bus.deliver(mode(power_off=True))
        eventually(bus.all_received)
        bus.deliver(mode(power_off=False))
        time.sleep(0.6)
        assert not trace.exists()
        bus.deliver(mode(power_off=True))
        eventually(trace.exists)
        time.sleep(0.4)
        assert trace.read_text() == "x" and bus.last_error is None


def test_without_a_command_nothing_runs_and_a_command_that_fails_is_said() -> None:
    with running(Process(Config(device="simulated://ups", power_off_delay_s=0.0)).run) as bus:
        bus.deliver(mode(power_off=True))
        eventually(bus.all_received)
        assert bus.last_error is None
    config = Config(device="simulated://ups", power_off_delay_s=0.0, power_off_command="/no/such/command now")
    with running(Process(config).run) as bus:
        bus.deliver(mode(power_off=True))
        eventually(lambda: bus.last_error is not None and "power_off_command /no/such/command failed" in bus.last_error)
