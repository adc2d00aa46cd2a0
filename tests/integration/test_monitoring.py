"""Recorder, watchdog, `obu record` and `obu replay` on real brokers, with processes that are killed."""

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cli.recordings.onto_bus import play_onto
from cli.recordings.record import record
from shared.bus.bus import Bus, Envelope
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.imu import ImuRaw
from shared.messages.operation import DeadlineReport, Origin, OriginKind, Outage
from shared.protocols import xbus
from shared.recording import Recording, RecordingWriter
from shared.runtime.config import BrokerAddress, broker_address
from shared.topics import TOPICS, subscriptions
from tests.support.bus import brokers
from tests.support.bus.envelopes import sent, sent_bytes
from tests.support.patience import HANGS_S

VEHICLE = '[vehicle]\nname = "car"\n[monitoring.recorder]\nminimum_free_bytes = 0\n'
LIMIT_S = 15.0


@pytest.fixture(params=brokers.KINDS)
def broker(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[brokers.RunningBroker]:
    running = brokers.start(request.param, tmp_path)
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    monkeypatch.setenv("OBU_BROKER", f"mqtt://127.0.0.1:{running.port}")
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setenv("OBU_VEHICLE", str(tmp_path / "vehicle.toml"))
    yield running
    running.stop()


class Unit:
    """Processes of their own, buses of this test, and everything that an observer receives."""

    def __init__(self, port: int, folder: Path) -> None:
        self._address, self._folder = BrokerAddress("127.0.0.1", port), folder
        self.received: list[Envelope] = []
        self.processes: list[subprocess.Popen[bytes]] = []
        self.buses: list[Bus] = []
        self.observer = self.bus("observer")

    def bus(self, name: str) -> Bus:
        observer = name == "observer"
        topics = TOPICS if observer else subscriptions(name)
        made = Bus(name, "car", self._address, topics, self._folder, observer=observer)
        self.buses.append(made)
        self.until(lambda: made.connected)
        return made

    def start(self, name: str) -> subprocess.Popen[bytes]:
        with (self._folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-m", "cli", "run", name]
            process = subprocess.Popen(command, env=os.environ, stdout=log, stderr=log)
        self.processes.append(process)
        self.until(lambda: any(e.topic == f"health/{name}" for e in self.received))
        return process

    def until(self, condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < deadline, "it did not happen in time"
            each()
            for bus in self.buses:
                received = bus.receive(0.004)
                if bus is self.buses[0]:
                    self.received += received

    def wait(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        until = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= until, each)

    def published(self, topic: str) -> list[Message]:
        return [envelope.decode() for envelope in self.received if envelope.topic == topic]

    def outages(self) -> dict[str, Outage]:
        return {message.what: message for message in self.published("outage/event") if isinstance(message, Outage)}

    def causes(self) -> dict[str, str | None]:
        reports = [message for message in self.published("deadline/report")[-1:] if isinstance(message, DeadlineReport)]
        return {age.topic: age.cause for report in reports for age in report.topics}

    def close(self) -> None:
        for process in self.processes:
            if process.poll() is None:
                process.terminate()
        for process in self.processes:
            process.wait(HANGS_S)
        for bus in self.buses:
            bus.close()


@pytest.fixture
def unit(broker: brokers.RunningBroker, tmp_path: Path) -> Iterator[Unit]:
    made = Unit(broker.port, tmp_path)
    yield made
    made.close()


def imu_publisher(bus: Bus) -> Callable[[], None]:
    numbers = itertools.count()
    return lambda: bus.publish(ImuRaw(received_ns=bus.now_ns(), source="imu0", data=b"%d" % next(numbers)))


def run_command(code: str) -> subprocess.Popen[bytes]:
    """Run a command in a process of its own: two observers of one name would end each other's connection."""
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)


def test_a_killed_recorder_loses_at_most_one_second(unit: Unit, tmp_path: Path) -> None:
    recorder = unit.start("monitoring.recorder")
    bus = unit.bus("sensors.imu")
    unit.wait(2.0, imu_publisher(bus))
    recorder.kill()
    killed_ns = bus.now_ns()
    recorder.wait()

    [path] = (tmp_path / "recordings").glob("*.mcap")
    with Recording(path) as recording:
        found = [envelope for envelope in recording if envelope.topic == "imu/raw"]
        assert recording.problems == [f"the recording was not closed: it ends at byte {recording.size}"]
        assert recording.attachments["vehicle.toml"] == VEHICLE.encode()
    raw = [message for envelope in found if isinstance(message := envelope.decode(), ImuRaw)]
    assert [int(message.data) for message in raw] == list(range(len(found)))
    assert killed_ns - found[-1].received_ns < 1_000_000_000
    assert len(found) > 100
    assert raw[0].source == "imu0"


def test_a_killed_process_is_an_outage_at_once_and_the_cause_of_dependent_outages(unit: Unit) -> None:
    unit.start("monitoring.health")
    parser = unit.start("parsers.imu")
    bus = unit.bus("sensors.imu")
    numbers = itertools.count()

    def sample() -> None:
        values = {
            xbus.SAMPLE_TIME_FINE: ((bus.now_ns() // 100_000) & 0xFFFFFFFF,),
            xbus.PACKET_COUNTER: (next(numbers) & 0xFFFF,),
            xbus.ACCELERATION: (0.0, 0.0, 9.8),
            xbus.RATE_OF_TURN: (0.0, 0.0, 0.0),
        }
        data = xbus.encode_mtdata2({kind: xbus.encode_field(kind, *value) for kind, value in values.items()})
        bus.publish(ImuRaw(received_ns=bus.now_ns(), source="imu0", data=data))

    unit.until(lambda: len(unit.published("imu/sample")) > 50, sample)
    parser.kill()
    killed_ns = bus.now_ns()
    unit.until(lambda: "parsers.imu" in unit.outages(), sample)
    outage = unit.outages()["parsers.imu"]
    assert abs(outage.since_ns - killed_ns) < 500_000_000
    assert outage.cause == "parsers.imu was lost: it crashed, was killed or lost its connection"
    unit.until(lambda: unit.causes().get("imu/sample") == outage.cause, sample)
    unit.start("parsers.imu")
    unit.until(lambda: all(outage.until_ns for outage in unit.outages().values()), sample)
    assert {what: outage.affected for what, outage in unit.outages().items()} == {"parsers.imu": ("imu/sample",)}


def test_a_broker_that_restarts_is_one_outage_with_its_duration(unit: Unit, broker: brokers.RunningBroker) -> None:
    unit.start("monitoring.health")
    unit.start("parsers.can")
    unit.wait(0.3)
    unit.received.clear()
    broker.stop()
    stopped = time.monotonic()
    while time.monotonic() < stopped + 0.7:
        unit.observer.receive(0.05)
    broker.restart()
    away_s = time.monotonic() - stopped
    unit.until(lambda: any(outage.until_ns for outage in unit.outages().values()))
    unit.wait(0.5)

    assert set(unit.outages()) == {"broker"}
    outage = unit.outages()["broker"]
    assert outage.until_ns is not None
    assert outage.cause == "the broker is not reachable"
    assert away_s - 0.5 < (outage.until_ns - outage.since_ns) * 1e-9 < away_s + 2.5


def test_a_manual_recording_holds_the_published_messages(unit: Unit, tmp_path: Path) -> None:
    bus = unit.bus("sensors.imu")
    command = run_command(
        "from pathlib import Path; from cli.recordings.record import record;"
        f"raise SystemExit(record(Path({str(tmp_path / 'hand.mcap')!r}), 1.5, None))"
    )
    unit.until(lambda: command.poll() is not None, imu_publisher(bus))
    output, _ = command.communicate()

    assert command.returncode == 0
    assert output.startswith(b"recorded ")
    with Recording(tmp_path / "hand.mcap") as recording:
        raw = [message for envelope in recording if isinstance(message := envelope.decode(), ImuRaw)]
        assert recording.problems == []
    numbers = [int(message.data) for message in raw]
    assert len(numbers) > 50
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


def test_a_replay_publishes_the_bytes_with_present_stamps_and_the_origin_replay(unit: Unit, tmp_path: Path) -> None:
    path, then_ns = tmp_path / "drive.mcap", 1_600_000_000_000_000_000
    writer = RecordingWriter(path)
    for k in range(80):
        stamp_ns = then_ns + k * 20_000_000
        raw = ImuRaw(received_ns=stamp_ns - 1_000_000, source="imu0", data=b"%d" % k)
        writer.write(sent(raw, stamp_ns, "sensors.imu", 1, k + 1))
        writer.write(sent_bytes("mode/state", b'{"k":1}', stamp_ns, "controller.mode", 1, k + 1))
    writer.close()
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(play_onto, path, 2.0, broker_address(), None)
        unit.until(done.done)
    assert done.result() == 0
    unit.wait(0.3)

    played = [envelope for envelope in unit.received if envelope.topic == "imu/raw"]
    bytes_again = [message for envelope in played if isinstance(message := envelope.decode(), ImuRaw)]
    assert [message.data for message in bytes_again] == [b"%d" % k for k in range(80)]
    stamps = [message.received_ns for message in bytes_again]
    assert stamps[-1] - stamps[0] == 79 * 20_000_000
    assert abs(stamps[0] - played[0].received_ns) < 500_000_000
    took_s = (played[-1].received_ns - played[0].received_ns) * 1e-9
    assert took_s == pytest.approx(79 * 0.02 / 2.0, abs=0.3)
    assert not unit.published("mode/state")
    [origin, *_] = unit.published("origin/state")
    assert isinstance(origin, Origin)
    assert (origin.kind, origin.name, origin.speed) == (OriginKind.REPLAY, "drive", 2.0)


def test_a_replay_is_rejected_on_a_bus_with_live_data(unit: Unit, tmp_path: Path) -> None:
    bus = unit.bus("sensors.imu")
    bus.publish(Origin(now_ns=bus.now_ns(), kind=OriginKind.LIVE, name="car"))
    writer = RecordingWriter(tmp_path / "drive.mcap")
    writer.write(sent(ImuRaw(received_ns=1, source="a", data=b"x"), 1, "sensors.imu"))
    writer.close()
    unit.wait(0.2)

    with pytest.raises(UserError, match=r"sensors\.imu already sends live data of car on this bus"):
        play_onto(tmp_path / "drive.mcap", 1.0, broker_address(), None)


def test_commands_without_a_broker_fail_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cli.recordings.common.PATIENCE_S", 0.5)
    monkeypatch.setenv("OBU_BROKER", "mqtt://127.0.0.1:1")
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    with pytest.raises(UserError, match=r"no broker at 127\.0\.0\.1:1: .*; is the unit running\?"):
        record(tmp_path / "a.mcap", 1.0, None)
    assert not (tmp_path / "a.mcap").exists()
