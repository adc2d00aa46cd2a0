"""The unit's own processes connect by a socket in a folder of their own, which others of the machine cannot occupy."""

import contextlib
import socket
import stat
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from broker import local_config
from cli.commands.unit import _await_broker
from cli.demo.local import LocalBroker, free_port, local_broker, reaches_broker
from cli.doctor import _broker
from shared.bus.bus import Bus
from shared.runtime.config import MAX_SOCKET, SOCKET, BrokerAddress, broker_address, parse_vehicle
from shared.topics import BY_NAME
from tests.support.bus import brokers
from tests.support.patience import HANGS_S

CAR = '[vehicle]\nname = "car"\n[sensors.simulator]\n'
CONNECT = b"\x10\xff\xff\x0f"  # and the length of the rest, 262,143 bytes, which never come


@pytest.fixture(params=brokers.KINDS)
def unit(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[LocalBroker, int, Path]]:
    """A broker as `obu broker` starts it: its command and address, its port, and the state folder."""
    if request.param == brokers.MOSQUITTO and local_config.executable() is None:
        pytest.skip("no mosquitto on this machine: `apt install mosquitto` brings it")
    port = free_port()
    started = local_broker(tmp_path, port, request.param, parse_vehicle(CAR))
    with (tmp_path / "broker.log").open("wb") as log:
        program = subprocess.Popen(started.command, stderr=log, stdout=log)
    try:
        eventually(lambda: reached(BrokerAddress(port=port)))
        yield started, port, tmp_path
        assert program.poll() is None, (tmp_path / "broker.log").read_text()
    finally:
        program.terminate()
        program.wait(HANGS_S)


def reached(address: BrokerAddress) -> bool:
    try:
        reaches_broker(address)
    except OSError:
        return False
    return True


def eventually(happened: Callable[[], bool], *buses: Bus) -> None:
    deadline = time.monotonic() + HANGS_S
    while not happened():
        assert time.monotonic() < deadline, [bus.last_error for bus in buses]
        for bus in buses:
            bus.receive(0.01)


@contextlib.contextmanager
def process(name: str, address: BrokerAddress, state: Path, topics: tuple[str, ...] = ()) -> Iterator[Bus]:
    bus = Bus(name, "car", address, [BY_NAME[topic] for topic in topics], state, observer=name == "observer")
    if name == "monitoring.health":
        bus.hear_broker()
    eventually(lambda: bus.connected, bus)
    yield bus
    bus.close()


def test_processes_and_programs_of_the_unit_find_the_socket_and_exchange_messages(
    unit: tuple[LocalBroker, int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    started, port, state = unit
    path = state / SOCKET
    assert started.address == BrokerAddress.at(path)
    monkeypatch.setenv("OBU_STATE", str(state))
    monkeypatch.delenv("OBU_BROKER", raising=False)
    assert broker_address() == started.address == BrokerAddress.parse(started.address.url)
    assert _await_broker() == started.address.url, "with it `obu up` starts the processes"
    assert _broker().what == f"broker at {path}", "and `obu doctor` asks there"
    found = path.stat()
    assert stat.S_ISSOCK(found.st_mode) and not found.st_mode & 0o007
    assert path.parent.stat().st_mode & 0o777 == 0o700
    with (
        process("monitoring.health", broker_address(), state) as health,
        process("observer", broker_address(), state, ("health/+",)) as observer,
        process("observer", BrokerAddress(port=port), state, ("health/+",)) as by_port,
    ):
        health.receive(0.0)
        received: dict[str, list[str]] = {"socket": [], "port": []}

        def both_have_it() -> bool:
            received["socket"] += [envelope.topic for envelope in observer.receive(0.01)]
            received["port"] += [envelope.topic for envelope in by_port.receive(0.01)]
            return all("health/monitoring.health" in topics for topics in received.values())

        eventually(both_have_it, health)


def occupy(port: int, first: bytes, count: int = 600) -> list[socket.socket]:
    """Open connections to the port until the broker takes no more."""
    held = []
    for _ in range(count):
        connection = socket.create_connection(("127.0.0.1", port), timeout=HANGS_S)
        with contextlib.suppress(OSError):
            connection.sendall(first)
        held.append(connection)
    return held


@pytest.mark.parametrize("first", [b"", CONNECT, CONNECT + bytes(200_000)], ids=["silent", "begun", "nearly whole"])
def test_connections_that_do_not_say_who_they_are_keep_no_process_of_the_unit_out(
    unit: tuple[LocalBroker, int, Path], first: bytes
) -> None:
    started, port, state = unit
    with process("core.fusion", started.address, state) as before:
        held = occupy(port, first)
        try:
            with process("monitoring.health", started.address, state) as after:
                eventually(lambda: after.messages_out >= 3, before, after)
                if not first:  # of the others our own broker has ended those that state too great a length
                    held += occupy(port, first, 70)  # ours ends the silent ones after 5 s as well
                    eventually(lambda: after.crowded >= 3, before, after)
                assert (before.reconnections, after.reconnections) == (0, 0)
        finally:
            for connection in held:
                connection.close()
        eventually(lambda: reached(BrokerAddress(port=port)))


def test_a_broker_that_accepts_no_connection_does_not_hold_a_process(tmp_path: Path) -> None:
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen(0)
        first = socket.socket(socket.AF_UNIX)
        first.connect(str(path))
        with first:
            bus = Bus("core.fusion", "car", BrokerAddress.at(path), (), tmp_path)
            eventually(lambda: bus.last_error is not None, bus)
            assert str(path) in str(bus.last_error)
            bus.close()


def test_where_the_path_is_too_long_for_a_socket_the_port_is_taken_and_that_is_said(tmp_path: Path) -> None:
    state = tmp_path / ("s" * MAX_SOCKET)
    state.mkdir()
    started = local_broker(state, 1883, brokers.SIMULATED, parse_vehicle(CAR))
    assert started.address == BrokerAddress() and "OBU_STATE" in str(started.remark)
    assert "--socket" not in started.command
