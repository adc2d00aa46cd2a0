"""The process: sockets, rates, clients that are slow, silent or too many, and ports that are in use."""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

import pytest
from pydantic import ValidationError

from cli.demo.local import free_port
from services.monitoring.outputs import process as process_module
from services.monitoring.outputs import server as server_module
from services.monitoring.outputs.process import Config, Process, host_and_port
from services.monitoring.outputs.server import QUEUE_BYTES, Listener, Servers, TcpServer
from shared.messages.operation import OriginKind
from tests.support.bus.live_bus import LiveBus, eventually, running
from tests.support.outputs import fix, origin, satellites, solution, verdict
from tests.support.patience import HANGS_S

NS = 1_000_000_000


@contextmanager
def unit(**settings: object) -> Iterator[tuple[LiveBus, Process]]:
    config = Config(**{"gpsd_port": free_port(), "nmea_port": free_port(), "rate_hz": 10, **settings})  # type: ignore[arg-type]
    process = Process(config)
    with running(process.run) as bus:
        opened = [s for s in (process.gpsd, process.nmea) if s.address[1]]
        eventually(lambda: all(s.socket or s.fault for s in opened))
        deliver(bus)
        yield bus, process


def deliver(bus: LiveBus, step_ns: int = 0) -> None:
    now_ns = bus.now_ns() + step_ns
    for message in (origin(now_ns, OriginKind.LIVE), verdict(now_ns), fix(now_ns, now_ns), satellites(now_ns),
                    solution(now_ns)):  # fmt: skip
        bus.deliver(message)


def first_line(bus: LiveBus, client: socket.socket) -> str:
    """Drive until the client receives something."""
    client.settimeout(0.05)
    received = b""
    deadline = time.monotonic() + HANGS_S
    while b"\n" not in received:
        assert time.monotonic() < deadline
        deliver(bus)
        with suppress(TimeoutError):
            received += client.recv(4096)
    return received.decode().split("\n")[0]


def connected(server: TcpServer) -> socket.socket:
    client = socket.create_connection(server.address, HANGS_S)
    client.settimeout(HANGS_S)
    return client


def test_a_client_of_gpsd_receives_reports_after_its_watch() -> None:
    with unit() as (bus, process), connected(process.gpsd) as client, client.makefile() as lines:
        assert json.loads(lines.readline())["class"] == "VERSION"
        client.sendall(b'?WATCH={"enable":true,"json":true};')
        assert [json.loads(lines.readline())["class"] for _ in range(2)] == ["DEVICES", "WATCH"]
        deliver(bus)
        assert json.loads(lines.readline())["mode"] == 3
        client.sendall(b"?POLL;")
        poll = next(answer for answer in map(json.loads, lines) if answer["class"] == "POLL")
        assert poll["tpv"][0]["status"] == 6
        assert poll["sky"][0]["uSat"] == 8


def test_a_request_that_only_a_pause_ends_is_answered() -> None:
    with unit() as (_, process), connected(process.gpsd) as client, client.makefile() as lines:
        assert json.loads(lines.readline())["class"] == "VERSION"
        client.sendall(b"?DEVICES")
        assert json.loads(lines.readline())["class"] == "DEVICES"
        client.sendall(b'?WATCH={"enable":true}')
        assert [json.loads(lines.readline())["class"] for _ in range(2)] == ["DEVICES", "WATCH"]
        client.sendall(b"?POLL")  # nothing was streamed in between
        poll = json.loads(lines.readline())
        assert poll["class"] == "POLL" and len(poll["tpv"]) == len(poll["gst"]) == len(poll["sky"]) == 1


def test_a_reader_of_nmea_receives_sentences_at_once_and_may_send_anything() -> None:
    with unit() as (bus, process), connected(process.nmea) as client:
        client.sendall(b"\x00\xff" * 5000)
        eventually(bus.all_received)
        assert first_line(bus, client).startswith("$GNRMC")


def test_datagrams_reach_their_address() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(HANGS_S)
        with unit(nmea_udp=(f"127.0.0.1:{receiver.getsockname()[1]}",), nmea_port=0, gpsd_port=0):
            assert receiver.recv(2000).startswith(b"$GN")


def test_the_rate_is_kept_and_solutions_between_are_not_decoded() -> None:
    process = Process(Config(rate_hz=2))
    bus = LiveBus()
    due = 0
    for number in range(100):
        bus.deliver(solution(NS + number * NS // 10))
        due += process._is_due(bus.receive(0.0)[0])
    assert due == 20


def test_a_port_in_use_is_a_sentence_and_the_other_output_is_served() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with unit(gpsd_port=port) as (bus, process):
            eventually(lambda: bus.last_error is not None)
            assert bus.last_error is not None
            assert f"port {port} of 127.0.0.1 is in use" in bus.last_error and "gpsd.socket" in bus.last_error
            assert len(bus.last_error) <= 400
            with connected(process.nmea) as client:
                assert first_line(bus, client).startswith("$GN")


def test_a_port_that_becomes_free_is_served_and_the_error_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "RETRY_S", 0.05)
    other = socket.socket()
    other.bind(("127.0.0.1", 0))
    other.listen()
    with unit(gpsd_port=other.getsockname()[1]) as (bus, process):
        eventually(lambda: bus.last_error is not None)
        other.close()
        eventually(lambda: process.gpsd.socket is not None)
        eventually(lambda: bus.last_error is None)


def test_clients_beyond_the_limit_are_closed_and_counted() -> None:
    with ExitStack() as stack:
        bus, process = stack.enter_context(unit(clients_maximum=2))
        clients = [stack.enter_context(connected(process.gpsd)) for _ in range(3)]
        assert all(client.recv(100) for client in clients[:2])
        assert clients[2].recv(100) == b""
        assert bus.rejects["too_many_clients"] == 1
        clients[0].close()
        eventually(lambda: is_served(process.gpsd))


def test_a_client_that_sends_rubbish_is_dropped_and_counted() -> None:
    with unit() as (bus, process), connected(process.gpsd) as client:
        client.sendall(b"x" * 5000)
        eventually(lambda: bus.rejects["request_length"] == 1)
        assert is_closed(client)


def is_served(server: TcpServer) -> bool:
    with connected(server) as client:
        return client.recv(100) != b""


def is_closed(client: socket.socket) -> bool:
    """Read until the other side has closed."""
    with suppress(ConnectionResetError):
        while client.recv(4096):
            pass
    return True


def test_a_slow_client_is_dropped_and_others_receive_on() -> None:
    rejects = LiveBus().rejects
    servers = Servers(rejects, 4)
    listening = TcpServer(("127.0.0.1", 0), Listener, "")
    servers.add(listening)
    servers.serve()
    with connected(listening) as slow, connected(listening) as quick:
        while len(servers.clients) < 2:
            servers.serve()
        received = 0
        for _ in range(4000):
            servers.send(b"x" * 1000, lambda _peer: True)
            servers.serve()
            received += len(quick.recv(1 << 20))
            if rejects["slow_client"]:
                break
        assert rejects["slow_client"] == 1
        assert len(servers.clients) == 1
        assert received > QUEUE_BYTES
        assert slow.fileno() >= 0
    servers.close()


def test_a_client_that_disappears_costs_nothing() -> None:
    with unit() as (bus, process):
        for _ in range(5):
            client = connected(process.nmea)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
            client.close()  # with a reset
            deliver(bus)
            time.sleep(0.02)
        with connected(process.nmea) as client:
            assert first_line(bus, client).startswith("$GN")


def test_without_solutions_reports_without_fix_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_module, "SILENT_PERIOD_NS", NS // 4)
    process = Process(Config(gpsd_port=0, nmea_port=free_port()))
    with running(process.run):
        eventually(lambda: process.nmea.socket is not None)
        with connected(process.nmea) as client, client.makefile() as lines:
            first = lines.readline()
            while not lines.readline().startswith("$GNRMC"):
                pass
            assert first.startswith("$GNRMC,,V,")


def test_messages_that_are_no_messages_are_counted() -> None:
    with unit() as (bus, _):
        envelope = LiveBus()
        envelope.deliver(solution(NS))
        (good,) = envelope.receive(0.0)
        bus._inbox.append(good._replace(payload=good.payload[:100] + b"}"))
        eventually(lambda: bus.rejects["payload"] == 1)


@pytest.mark.parametrize("text", ["10110", ":10110", "host:", "host:0", "host:70000", "host:1e3", "host:٣"])
def test_an_address_without_host_or_port_is_an_error_of_the_settings(text: str) -> None:
    with pytest.raises(ValidationError, match="is not host:port"):
        Config(nmea_udp=(text,))


def test_addresses() -> None:
    assert host_and_port("192.168.1.255:10110") == ("192.168.1.255", 10110)
    assert host_and_port("[::1]:1") == ("::1", 1)
