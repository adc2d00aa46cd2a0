from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from services.parsers.imu.process import Config as ImuConfig
from services.sensors.simulator.imu.simulated_xsens import Tracker
from services.sensors.simulator.process import Config, Process
from services.sensors.simulator.world import messages
from shared.bus.bus import Envelope
from shared.messages.base import Message, RawBytes
from shared.messages.gnss import GnssRaw, GnssWrite
from shared.messages.imu import ImuRaw
from shared.messages.simulation import RoadNetwork, SimulationState
from shared.runtime.config import load_vehicle
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.bus.fake_bus import FakeBus
from tests.support.gnss.ublox import valset

NS = 1_000_000_000
START_NS = 1_790_000_000 * NS
STEP_NS = 5_000_000


def drive(tmp_path: Path, envelopes: dict[int, Envelope], calls: int = 600, config: Config | None = None) -> FakeBus:
    """Run the process for a number of calls of `receive`, 5 ms each."""
    bus = FakeBus(
        tmp_path,
        lambda n: None if n >= calls else [envelopes[n]] if n in envelopes else [],
        start_ns=START_NS,
        step_ns=STEP_NS,
    )
    Process(config or Config(pause_s=0.0)).run(bus.as_bus())
    return bus


def write(data: bytes, source: str = "gnss0") -> Envelope:
    return sent(GnssWrite(received_ns=1, source=source, data=data), received_ns=1)


def command(period_ms: int) -> bytes:
    return valset([("CFG_RATE_MEAS", period_ms)])


def gnss_bytes(published: list[Message]) -> bytes:
    return b"".join(message.data for message in published if isinstance(message, GnssRaw))


def test_the_messages_of_the_world_are_published_when_they_are_due(tmp_path: Path) -> None:
    bus = drive(tmp_path, {})
    expected = list(messages("parking_lot", 1, 2.9, START_NS))
    assert len(bus.published) >= len(expected) > 300
    assert bus.published[0] == SimulationState(sampled_ns=START_NS)
    assert isinstance(bus.published[1], RoadNetwork)
    assert bus.published[2 : len(expected) + 2] == expected
    late = max(message.received_ns for message in bus.published if isinstance(message, RawBytes))
    assert late <= bus.now_ns()


def test_a_command_to_the_receiver_is_acknowledged_and_one_to_another_source_is_not(tmp_path: Path) -> None:
    assert b"\xb5\x62\x05\x01\x02\x00\x06\x8a" in gnss_bytes(drive(tmp_path, {50: write(command(500))}).published)
    assert b"\xb5\x62\x05" not in gnss_bytes(drive(tmp_path, {50: write(command(500), "another")}).published)


def test_an_invalid_message_is_counted_and_the_drive_continues(tmp_path: Path) -> None:
    bus = drive(tmp_path, {50: sent_bytes("gnss/write", b'{"data":"x"}', received_ns=1)})
    assert bus.rejects["payload"] == 1
    assert sum(isinstance(message, ImuRaw) for message in bus.published) > 250


def test_messages_overdue_after_a_suspend_of_the_host_are_dropped_and_counted(tmp_path: Path) -> None:
    class SuspendedBus(FakeBus):
        def receive(self, timeout_s: float) -> list[Envelope]:
            if len(self.published) == 100 and self._now_ns < START_NS + 3 * NS:
                self._now_ns += 3 * NS
            return super().receive(timeout_s)

    bus = SuspendedBus(tmp_path, lambda n: None if n >= 1500 else [], start_ns=START_NS, step_ns=STEP_NS)
    Process(Config(pause_s=0.0)).run(bus.as_bus())
    stamps = [message.received_ns for message in bus.published if isinstance(message, ImuRaw)]
    assert max(b - a for a, b in pairwise(stamps)) > 2 * NS
    assert bus.rejects["late"] > 250
    assert bus.now_ns() - stamps[-1] < NS


@pytest.mark.parametrize("settings", [{"scenario": "moon"}, {"seed": -1}, {"protocols": ("sirf",)}, {"speed": 2.0}])
def test_invalid_settings_are_rejected(settings: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Config.model_validate(settings)


def test_the_demo_vehicle_has_the_same_imu_mounting_for_simulator_and_parser() -> None:
    vehicle = load_vehicle(Path(__file__).parents[4] / "deploy" / "vehicles" / "simulated.toml")
    simulator = vehicle.section("sensors.simulator", Config)
    tracker = Tracker(simulator.seed, 0, np.random.default_rng(1), simulator.mounting_rpy_deg)
    expected = vehicle.section("parsers.imu", ImuConfig).vehicle.imu.body_from_sensor
    assert np.array(expected) == pytest.approx(tracker.body_from_sensor, abs=1e-6)
