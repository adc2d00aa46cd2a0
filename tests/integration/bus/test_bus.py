"""The bus and the live runtime on real brokers: delivery, losses and reconnection."""

import contextlib
import itertools
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shared.bus.bus import KEEP_ALIVE_S, Bus, Envelope
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssConfigure, GnssRaw
from shared.messages.navigation import LastPosition
from shared.messages.operation import ConsumptionOrder, Mode, ModeState, ProcessHealth, ProcessState
from shared.runtime.config import BrokerAddress
from shared.runtime.live import LiveReactor
from shared.topics import TOPICS, subscriptions
from tests.support.bus import brokers, mqtt
from tests.support.patience import HANGS_S

LAST = LastPosition(
    sampled_ns=1, utc_ns=None, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0, yaw_rad=1.0,
    position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.1,
)  # fmt: skip


@pytest.fixture(params=brokers.KINDS)
def broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[brokers.RunningBroker]:
    running = brokers.start(request.param, tmp_path)
    yield running
    running.stop()


@pytest.fixture
def make_bus(broker: brokers.RunningBroker, tmp_path: Path) -> Iterator[Callable[[str], Bus]]:
    made: list[Bus] = []

    def make(process: str) -> Bus:
        observer = process == "observer"
        topics = TOPICS if observer else subscriptions(process)
        address = BrokerAddress("127.0.0.1", broker.port)
        bus = Bus(process, "car", address, topics, tmp_path, observer=observer)
        made.append(bus)
        wait_for(lambda: bus.connected, bus)
        if not observer:  # an observer receives the retained messages in the test
            pump(0.1, *made)  # the broker has taken the subscriptions
        return bus

    yield make
    for bus in made:
        bus.close()


def pump(seconds: float, *buses: Bus) -> list[Envelope]:
    """Run every bus for a while and return what the last one received."""
    received: list[Envelope] = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for bus in buses:
            got = bus.receive(0.01)
        received += got
    return received


def wait_for(condition: Callable[[], bool], *buses: Bus, limit_s: float = HANGS_S) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        for bus in buses:
            bus.receive(0.02)


def raw(bus: Bus, data: bytes) -> GnssRaw:
    return GnssRaw(received_ns=bus.now_ns(), source="gnss", data=data)


def test_a_message_arrives_as_it_was_sent_with_its_sender_and_number(make_bus: Callable[[str], Bus]) -> None:
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.gnss")
    sent = [raw(sensor, bytes([n])) for n in range(50)]
    for message in sent:
        sensor.publish(message)
    received = pump(0.3, sensor, parser)
    assert [envelope.decode() for envelope in received] == sent
    assert {(e.producer, e.incarnation) for e in received} == {("sensors.gnss", sensor.incarnation)}
    assert [b.sequence - a.sequence for a, b in itertools.pairwise(received)] == [1] * 49


def test_a_process_receives_only_the_topics_of_its_row(make_bus: Callable[[str], Bus]) -> None:
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.imu")
    sensor.publish(raw(sensor, b"x"))
    assert pump(0.2, sensor, parser) == []


def test_a_late_observer_receives_the_state_of_every_process(make_bus: Callable[[str], Bus]) -> None:
    make_bus("core.fusion").receive(0.05)
    observer = make_bus("observer")
    received = [e for e in pump(0.3, observer) if e.topic == "health/core.fusion"]
    health = received[0].decode()
    assert isinstance(health, ProcessHealth)
    assert health.state == ProcessState.READY


def test_a_process_that_ends_regularly_is_not_lost(make_bus: Callable[[str], Bus]) -> None:
    process, observer = make_bus("core.fusion"), make_bus("observer")
    process.close()
    states = [e.decode() for e in pump(0.3, observer) if e.topic == "health/core.fusion"]
    assert isinstance(states[-1], ProcessHealth)
    assert states[-1].state == ProcessState.DISCONNECTED


def test_two_processes_of_one_name_reconnect_with_pauses_and_log_the_reason(
    make_bus: Callable[[str], Bus], caplog: pytest.LogCaptureFixture
) -> None:
    first, second = make_bus("core.fusion"), make_bus("core.fusion")
    pump(4.0, first, second)
    # With a constant pause of 0.05 s it would be more than forty.
    assert 2 <= first.reconnections + second.reconnections <= 16
    assert "does another core.fusion run on this broker?" in caplog.text
    second.close()
    wait_for(lambda: first.connected, first)


def test_the_bus_reconnects_after_the_broker_and_counts_lost_messages(
    broker: brokers.RunningBroker, make_bus: Callable[[str], Bus]
) -> None:
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.gnss")
    controller = make_bus("controller.mode")
    broker.stop()
    wait_for(lambda: not (sensor.connected or parser.connected or controller.connected), sensor, parser, controller)
    sensor.publish(raw(sensor, b"lost"))
    controller.publish(GnssConfigure(request_id=7, source="gnss", navigation_period_s=1.0))
    broker.restart()
    wait_for(lambda: parser.connected, parser)
    pump(0.2, parser)
    wait_for(lambda: sensor.connected and controller.connected, sensor, controller)
    sensor.publish(raw(sensor, b"new"))
    received = [e.decode() for e in pump(0.5, sensor, controller, parser)]
    assert sensor.dropped == 1 and sensor.reconnections == 1
    assert [m.data for m in received if isinstance(m, GnssRaw)] == [b"new"]
    assert [m.request_id for m in received if isinstance(m, GnssConfigure)] == [7]


class StateController:
    """A process of the controller that publishes a state and stores what it received."""

    def __init__(self) -> None:
        self.given: list[Message] = []

    def handle(self, message: Message) -> list[Message]:
        self.given.append(message)
        return []

    def close(self) -> list[Message]:
        return [LAST]


def state(bus: Bus) -> ModeState:
    return ModeState(sampled_ns=bus.now_ns(), mode=Mode.BOOT, since_ns=0, reason="test")


def run_until(reactor: LiveReactor, bus: Bus, condition: Callable[[], bool], others: Callable[[], object]) -> None:
    """Run a reactor in this thread until a condition holds, feeding others from the bus's own receive."""
    original, deadline = bus.receive, time.monotonic() + HANGS_S

    def receive(timeout_s: float) -> list[Envelope]:
        others()
        assert time.monotonic() < deadline, "it did not happen in time"
        bus.stopping = bus.stopping or condition()
        return original(min(timeout_s, 0.02))

    bus.receive = receive  # type: ignore[method-assign]
    reactor.run()


HOSTILE: tuple[dict[str, object], ...] = (
    {"hdop": "NaN"}, {"hdop": float("nan")}, {"sampled_ns": 10**310}, {"received_ns": -(2**63) - 1},
    {"source": 65 * "x"}, {"latitude_deg": True}, {"velocity_ned_m_s": [1.0, 2.0]},
    {"fix_type": {"a": 1}}, {"source": None},
)  # fmt: skip


def test_invalid_payloads_on_a_topic_are_counted_and_the_process_continues(
    broker: brokers.RunningBroker, make_bus: Callable[[str], Bus]
) -> None:
    parser, controller, observer = make_bus("parsers.gnss"), make_bus("controller.mode"), make_bus("observer")
    process = StateController()
    good = {
        "sampled_ns": 1_790_000_000 * 10**9,
        "received_ns": 1_790_000_000 * 10**9,
        "source": "g",
        "fix_type": "none",
    }
    sender = f'{{"sender":{{"process":"parsers.gnss","incarnation":{parser.incarnation},"sequence":1}},'.encode()
    with mqtt.Client(broker.port, "intruder", user="parsers.gnss") as intruder:
        intruder.connect()
        for body in (
            b"\xff\x00", b"{}", json.dumps(good).encode(),  # without a sender
            *(sender + json.dumps(good | wrong).encode()[1:] for wrong in HOSTILE), sender + b'"a":' + b"[" * 100_000,
            sender + b'"received_ns":' + b"9" * 310 + b"}", bytes(100_000),
            sender + json.dumps(good).encode()[1:],
        ):  # fmt: skip
            intruder.publish("obu/car/gnss/fix", body)
    run_until(LiveReactor(process, controller), controller, lambda: bool(process.given), lambda: parser.receive(0.0))
    assert len([m for m in process.given if not isinstance(m, Tick)]) == 1
    assert controller.rejects["payload"] + controller.rejects["envelope"] == 6 + len(HOSTILE)
    assert controller.rejects["payload"] >= len(HOSTILE)
    received = [e for e in pump(0.3, controller, observer) if e.topic == "consumed/controller.mode"]
    journals = [m for e in received if isinstance(m := e.decode(), ConsumptionOrder)]
    runs = [run for journal in journals for run in journal.runs if run[0] == "gnss/fix"]
    assert [(run[1], run[2], run[4]) for run in runs] == [("parsers.gnss", parser.incarnation, 1)]


def test_a_restarted_process_receives_its_retained_state(make_bus: Callable[[str], Bus], tmp_path: Path) -> None:
    first = make_bus("controller.mode")
    run_until(LiveReactor(StateController(), first), first, lambda: True, lambda: None)
    assert (tmp_path / "saved-navigation-last_position.json").exists()
    first.close()
    second, process = make_bus("controller.mode"), StateController()
    run_until(LiveReactor(process, second), second, lambda: bool(process.given), lambda: None)
    assert process.given[0] == LAST


def test_an_undecodable_saved_state_is_ignored_and_counted(make_bus: Callable[[str], Bus], tmp_path: Path) -> None:
    (tmp_path / "saved-navigation-last_position.json").write_bytes(b'{"sampled_ns": 1, "latit')
    bus, process = make_bus("controller.mode"), StateController()
    bus.receive(0.05)
    run_until(LiveReactor(process, bus), bus, lambda: True, lambda: None)
    assert bus.rejects["saved state"] == 1
    assert not any(isinstance(m, LastPosition) for m in process.given)


def start_process(name: str, port: int, folder: Path, vehicle: str = "") -> subprocess.Popen[str]:
    path = folder / "vehicle.toml"
    path.write_text('[vehicle]\nname = "car"\n' + vehicle)
    environment = {
        "OBU_VEHICLE": str(path), "OBU_BROKER": f"mqtt://127.0.0.1:{port}", "OBU_STATE": str(folder),
    }  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-m", "cli", "run", name],
        env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def test_a_killed_process_is_declared_lost_at_once(
    broker: brokers.RunningBroker, make_bus: Callable[[str], Bus], tmp_path: Path
) -> None:
    observer = make_bus("observer")
    states: list[ProcessState] = []

    def saw(state: ProcessState) -> Callable[[], bool]:
        def look() -> bool:
            for envelope in observer.receive(0.02):
                if envelope.topic == "health/parsers.can" and isinstance(m := envelope.decode(), ProcessHealth):
                    states.append(m.state)
            return state in states

        return look

    process = start_process("parsers.can", broker.port, tmp_path)
    wait_for(saw(ProcessState.READY))
    process.kill()
    killed = time.monotonic()
    wait_for(saw(ProcessState.LOST))
    assert time.monotonic() - killed < KEEP_ALIVE_S, "by the end of its connection, and not by its silence"
    process.communicate()


def test_sigterm_ends_a_process_regularly_and_without_an_error(
    broker: brokers.RunningBroker, make_bus: Callable[[str], Bus], tmp_path: Path
) -> None:
    observer = make_bus("observer")
    process = start_process("parsers.can", broker.port, tmp_path)
    wait_for(lambda: any(e.topic == "health/parsers.can" for e in observer.receive(0.02)))
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=HANGS_S)
    assert process.returncode == 0
    assert "Traceback" not in output


def test_without_a_broker_a_process_waits_and_logs_it(tmp_path: Path) -> None:
    process = start_process("parsers.can", 1, tmp_path)
    assert process.stdout
    patience = threading.Timer(20.0, process.kill)
    patience.start()
    output = process.stdout.readline()
    patience.cancel()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    process.send_signal(signal.SIGTERM)
    output += process.communicate(timeout=HANGS_S)[0]
    lines = [json.loads(line) for line in output.splitlines()]
    assert [line["level"] for line in lines] == ["warning"]
    assert "no broker at 127.0.0.1:1" in lines[0]["event"]


def test_a_mistyped_setting_is_an_error_of_one_sentence(tmp_path: Path) -> None:
    process = start_process("core.fusion", 1, tmp_path, "[core.fusion]\nlever_arm_body = [0, 0, 0]\n")
    output, _ = process.communicate(timeout=HANGS_S)
    assert process.returncode == os.EX_CONFIG
    assert output.startswith("obu: ") and "did you mean [vehicle.gnss] lever_arm_body_m?" in output
    assert len(output.strip().splitlines()) == 1


def filler(bus: Bus, number: int) -> GnssConfigure:
    return GnssConfigure(request_id=number, source="gnss", navigation_period_s=1.0)


def test_messages_of_qos_1_wait_for_the_broker_in_a_bounded_queue_that_drops_the_oldest(
    broker: brokers.RunningBroker, make_bus: Callable[[str], Bus], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shared.bus.bus.QUEUE_LENGTH", 20)
    controller = make_bus("controller.mode")
    parser = make_bus("parsers.gnss")
    broker.stop()
    wait_for(lambda: not (parser.connected or controller.connected), parser, controller)
    for number in range(50):
        controller.publish(filler(controller, number))
    assert controller.dropped == 30
    broker.restart()
    wait_for(lambda: parser.connected, parser)
    pump(0.2, parser)
    wait_for(lambda: controller.connected, controller)
    received = [e.decode() for e in pump(1.0, controller, parser)]
    found = [m.request_id for m in received if isinstance(m, GnssConfigure)]
    # Mosquitto has 100 acknowledgements to wait for at most: all 20 come, in order.
    assert found == list(range(30, 50))


def test_an_oversized_message_is_dropped_and_counted(make_bus: Callable[[str], Bus]) -> None:
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.gnss")
    oversized = GnssRaw.model_construct(received_ns=1, source="gnss", data=bytes(1 << 20))
    sensor.publish(oversized)
    sensor.publish(raw(sensor, b"next"))
    received = [e.decode() for e in pump(0.3, sensor, parser)]
    assert sensor.dropped == sensor.rejects["too large"] == 1 and "gnss/raw" in str(sensor.last_error)
    assert sensor.connected and sensor.reconnections == 0
    assert [m.data for m in received if isinstance(m, GnssRaw)] == [b"next"]


def test_the_queue_of_a_blocked_process_keeps_the_newest_messages_and_counts_the_dropped(
    make_bus: Callable[[str], Bus], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shared.bus.bus.QUEUE_LENGTH", 10)
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.gnss")
    for number in range(40):
        sensor.publish(raw(sensor, b"%d" % number))
    pump(0.2, sensor)
    received = [m.data for e in parser.receive(0.5) if isinstance(m := e.decode(), GnssRaw)]
    assert received == [b"%d" % number for number in range(30, 40)]
    assert parser.dropped == 30


@pytest.mark.parametrize(
    "data",
    [
        b"\x20\x02\0\0" + b"\x30\x05\0\x02\xc3\x28x",  # a topic that is not UTF-8
        b"\x20\x02\0\0" + b"\x30\x01\0",  # a PUBLISH that ends inside its topic
        b"\x20\x02\0\0" + b"\x32\x03\0\x01a",  # without its packet identifier
        b"\x20\x02\0\0" + b"\x90\x00",  # an empty SUBACK
        b"\x20\x02\0\0" + b"\x40\x01\0",  # half a PUBACK
        b"\x20\x02\0\0" + b"\xff\xff\xff\xff\xff",  # a length of more than four bytes
        b"\x20\x00", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"",
    ],
)  # fmt: skip
def test_invalid_bytes_from_the_broker_end_neither_the_loop_nor_the_reconnection(data: bytes, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = Bus("core.fusion", "car", BrokerAddress("127.0.0.1", server.getsockname()[1]), (), tmp_path)
        for _ in range(3):
            wait_for(lambda: bool(select.select([server], [], [], 0.0)[0]), bus)
            with contextlib.closing(server.accept()[0]) as connection:
                connection.sendall(data)
                for _ in range(4):
                    bus.receive(0.02)
            wait_for(lambda: not bus.connected, bus)
        bus.close()


def counts(bus: Bus) -> dict[str, tuple[dict[str, int], dict[str, int]]]:
    health = bus.health(ProcessState.READY)
    return {health.process: ({c.topic: c.count for c in health.published}, {c.topic: c.count for c in health.received})}


def test_heartbeats_tell_what_was_sent_and_received_of_fast_topics(make_bus: Callable[[str], Bus]) -> None:
    sensor, parser = make_bus("sensors.gnss"), make_bus("parsers.gnss")
    assert counts(parser) == {"parsers.gnss": ({}, {"gnss/raw": 0})}, "also of which nothing came"
    sent = [raw(sensor, bytes([n])) for n in range(20)]
    for message in sent:
        sensor.publish(message)
    wait_for(lambda: counts(parser)["parsers.gnss"][1] == {"gnss/raw": 20}, sensor, parser)
    assert counts(sensor) == {"sensors.gnss": ({"gnss/raw": 20}, {})}
    [published], [received] = sensor.health(ProcessState.READY).published, parser.health(ProcessState.READY).received
    assert published.stamp_ns == received.stamp_ns == sent[-1].received_ns
    assert (published.producer, received.producer) == (None, "sensors.gnss")
    assert published.newest_ns and received.newest_ns and published.newest_ns <= received.newest_ns


def test_a_stamp_of_no_time_is_not_told(make_bus: Callable[[str], Bus], broker: brokers.RunningBroker) -> None:
    parser = make_bus("parsers.gnss")
    body = b'{"sender":{"process":"sensors.gnss","incarnation":1,"sequence":1},"received_ns":9999999999999999999}'
    with mqtt.Client(broker.port, user="sensors.gnss") as client:
        client.connect()
        client.publish("obu/car/gnss/raw", body)
        wait_for(lambda: counts(parser)["parsers.gnss"][1] == {"gnss/raw": 1}, parser)
    [received] = parser.health(ProcessState.READY).received
    assert received.stamp_ns is None


def test_an_observer_receives_fast_topics_only_while_it_follows_them(
    make_bus: Callable[[str], Bus], broker: brokers.RunningBroker, tmp_path: Path
) -> None:
    sensor = make_bus("sensors.gnss")
    health = Bus("monitoring.health", "car", BrokerAddress("127.0.0.1", broker.port), TOPICS, tmp_path)
    health.follow(frozenset())
    wait_for(lambda: health.connected, health)
    pump(0.1, sensor, health)

    def arrived(names: frozenset[str]) -> set[str]:
        health.follow(names)
        pump(0.2, sensor, health)
        sensor.publish(raw(sensor, b"x"))
        return {envelope.topic for envelope in pump(0.7, sensor, health)}

    assert arrived(frozenset()) == {"health/sensors.gnss", "health/monitoring.health"}
    assert "gnss/raw" in arrived(frozenset({"gnss/raw"}))
    assert health.health(ProcessState.READY).received == (), "an observer tells nothing"
    broker.stop()
    wait_for(lambda: not health.connected, health, sensor)
    health.follow(frozenset())
    broker.restart()
    wait_for(lambda: health.connected and sensor.connected, health, sensor)
    assert "gnss/raw" not in arrived(frozenset())
    health.close()
