"""The simulated broker against clients that are not ours, bytes that are not MQTT, and its own limits."""

import contextlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from broker import simulated
from broker.simulated import Handle, Limits
from tests.support.bus import raw_mqtt
from tests.support.bus.mqtt import Client
from tests.support.patience import HANGS_S

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def handle() -> Iterator[Handle]:
    with simulated.start() as running:
        yield running


def serves(handle: Handle) -> bool:
    """Whether a well-behaved pair of clients is served as usual."""
    with Client(handle.port) as alice, Client(handle.port) as bob:
        alice.connect()
        bob.connect()
        bob.subscribe("still/there")
        alice.publish("still/there", "yes")
        return bob.payloads() == ["yes"]


# Clients that are not ours


def mosquitto_client(program: str, port: int, *arguments: str) -> list[str]:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"no {program} on this machine: `apt install mosquitto-clients` brings it")
    return [found, "-V", "mqttv311", "-h", "127.0.0.1", "-p", str(port), *arguments]


def listen(handle: Handle, *arguments: str, client_id: str = "listener") -> subprocess.Popen[str]:
    """Start mosquitto_sub and wait until it is subscribed."""
    command = mosquitto_client("mosquitto_sub", handle.port, "-i", client_id, *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + HANGS_S
    while not (found := handle.broker.sessions.get(client_id)) or not found.subscriptions:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


@pytest.mark.broker
def test_mosquittos_own_clients_exchange_messages(handle: Handle) -> None:
    listener = listen(handle, "-t", "car/+", "-q", "1", "-C", "2", "-F", "%t %q %r %p")
    for qos in ("0", "1"):
        command = mosquitto_client("mosquitto_pub", handle.port, "-t", "car/speed", "-q", qos, "-m", f"qos {qos}")
        subprocess.run(command, check=True, timeout=HANGS_S)
    output, _ = listener.communicate(timeout=HANGS_S)
    assert output.splitlines() == [f"car/speed {qos} 0 qos {qos}" for qos in (0, 1)]


@pytest.mark.broker
def test_mosquitto_sub_receives_the_retained_message(handle: Handle) -> None:
    command = mosquitto_client("mosquitto_pub", handle.port, "-t", "car/state", "-r", "-m", "kept")
    subprocess.run(command, check=True, timeout=HANGS_S)
    command = mosquitto_client("mosquitto_sub", handle.port, "-t", "car/state", "-C", "1", "-F", "%r %p")
    output = subprocess.run(command, check=True, timeout=HANGS_S, capture_output=True, text=True).stdout
    assert output.split() == ["1", "kept"]


@pytest.mark.broker
@pytest.mark.parametrize("killed", [True, False])
def test_the_will_of_mosquitto_sub_is_published_when_it_is_killed_and_not_when_it_ends(
    handle: Handle, killed: bool
) -> None:
    will = ("--will-topic", "car/lost", "--will-payload", "lost", "--will-qos", "1")
    with Client(handle.port) as client:
        client.connect()
        client.subscribe("car/lost")
        listener = listen(handle, "-t", "enough", "-C", "1", *will, client_id=f"doomed-{killed}")
        if killed:
            listener.kill()
        else:
            client.publish("enough", "x")
        listener.communicate(timeout=HANGS_S)
        assert client.receives_nothing() is not killed


@pytest.mark.broker
def test_mosquitto_pub_with_mqtt_5_is_rejected_for_its_version(handle: Handle) -> None:
    command = [*mosquitto_client("mosquitto_pub", handle.port), "-t", "x", "-m", "x", "-V", "5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode
    assert "protocol" in done.stderr


# Bytes that are not MQTT


def connect_of(level: int, client_id: str = "a", flags: int = 2) -> bytes:
    return raw_mqtt.packet(0x10, raw_mqtt.string("MQTT") + bytes((level, flags, 0, 60)) + raw_mqtt.string(client_id))


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        (b"GET / HTTP/1.1\r\nHost: " + b"x" * 60 + b"\r\n\r\n", ""),
        (b"\x10\xff\xff\xff\xff\xff", ""),  # a length of five bytes
        (b"\x10\xff\xff\xff\x7f", ""),  # a length of 256 MB
        (b"\xc0\x00", ""),  # a ping before CONNECT
        (connect_of(3), "20020001"),
        (connect_of(5), "20020001"),
        (connect_of(4, "a" * 300), "20020002"),
        (connect_of(4, "", flags=0), "20020002"),  # a session without a name
        (connect_of(4)[:-1] + b"\xff", ""),  # a name that is not UTF-8
    ],
)
def test_a_client_of_another_protocol_is_rejected_and_disconnected(handle: Handle, sent: bytes, answer: str) -> None:
    with socket.create_connection(("127.0.0.1", handle.port), timeout=HANGS_S) as raw:
        raw.sendall(sent)
        assert raw_mqtt.read_all(raw).hex() == answer
    assert serves(handle)


@pytest.mark.parametrize(
    "sent",
    [
        raw_mqtt.packet(0x34, raw_mqtt.string("a") + b"\0\1x"),  # QoS 2
        raw_mqtt.packet(0x36, raw_mqtt.string("a") + b"\0\1x"),  # QoS 3
        raw_mqtt.packet(0x30, raw_mqtt.string("a/+") + b"x"),
        raw_mqtt.packet(0x30, raw_mqtt.string("") + b"x"),
        raw_mqtt.packet(0x30, b"\0\2\xc3\x28x"),  # not UTF-8
        raw_mqtt.packet(0x30, raw_mqtt.string("a\0b") + b"x"),
        raw_mqtt.packet(0x30, b"\0\x09a"),  # a topic beyond the end
        raw_mqtt.packet(0x32, raw_mqtt.string("a") + b"\0\0x"),  # packet identifier 0
        raw_mqtt.subscribe("a", qos=3),
        raw_mqtt.packet(0x82, b"\0\1"),  # no filter
        raw_mqtt.packet(0xA2, b"\0\1"),
        raw_mqtt.packet(0x80, b"\0\1\0\1a\0"),  # wrong flags
        raw_mqtt.packet(0x40, b"\0\1x"),  # bytes after the end
        raw_mqtt.connect_packet("b", "b"),  # a second CONNECT
        raw_mqtt.packet(0xF0, b""),
    ],
)
def test_a_client_that_violates_the_protocol_is_disconnected_and_its_will_published(
    handle: Handle, sent: bytes
) -> None:
    refused = handle.broker.counters.counts["protocol error"]
    with raw_mqtt.connect(handle.port, "breaker", user="tester") as raw:
        raw.sendall(sent)
        assert raw.recv(100) == b"", "closed"
    assert handle.broker.counters.counts["protocol error"] == refused + 1
    assert serves(handle)


def test_the_broker_survives_any_stream_of_bytes(handle: Handle, caplog: pytest.LogCaptureFixture) -> None:
    """300 connections send packets with changed bytes; asyncio would log an exception that the broker lets out."""
    generator = random.Random(7)
    proper = [
        raw_mqtt.packet(0x32, raw_mqtt.string("a/b") + b"\0\1" + b"payload"),
        raw_mqtt.packet(0x31, raw_mqtt.string("a/b") + b"payload"),
        raw_mqtt.subscribe("a/#", qos=1),
        raw_mqtt.packet(0xA2, b"\0\2" + raw_mqtt.string("a/#")),
        raw_mqtt.packet(0x40, b"\0\1"),
        raw_mqtt.packet(0xC0, b""),
        raw_mqtt.packet(0xE0, b""),
    ]
    for number in range(300):
        stream = bytearray(b"".join(generator.choices(proper, k=6)))
        for _ in range(generator.randrange(4)):
            stream[generator.randrange(len(stream))] = generator.randrange(256)
        with socket.create_connection(("127.0.0.1", handle.port), timeout=HANGS_S) as raw:
            raw.sendall(raw_mqtt.connect_packet(f"fuzz-{number % 10}", "tester"))
            cut = generator.randrange(len(stream))
            with contextlib.suppress(OSError):  # the broker may have closed meanwhile
                raw.sendall(stream[:cut])
                raw.sendall(stream[cut:])
                raw.shutdown(socket.SHUT_WR)
                while raw.recv(4096):
                    pass  # the broker has read this stream once it closes: none is refused for the number of others
    assert "too many connections" not in handle.broker.counters.counts
    assert serves(handle)
    assert [record.getMessage() for record in caplog.records if record.name == "asyncio"] == []


# Its own limits


def test_connections_without_a_connect_packet_are_closed() -> None:
    with simulated.start(limits=Limits(connect_within_s=0.2)) as handle:
        with socket.create_connection(("127.0.0.1", handle.port), timeout=HANGS_S) as raw:
            assert raw.recv(100) == b"", "closed"
        assert serves(handle)


def test_the_numbers_of_sessions_subscriptions_and_retained_messages_are_bounded() -> None:
    limits = Limits(sessions=2, subscriptions=2, retained=2)
    with simulated.start(limits=limits) as handle, Client(handle.port) as first, Client(handle.port) as second:
        assert first.connect() == 0
        assert second.connect() == 0
        with Client(handle.port) as third:
            assert third.connect() == "Server unavailable"
        assert first.subscribe("a", "b", "c", "b") == [1, 1, 0x80, 1]
        for topic in ("a", "b", "c", "a"):
            second.publish(topic, "x", retain=True)
        assert set(handle.broker.retained) == {"a", "b"}
        assert handle.broker.counters.counts["retained full"] == 1


def test_a_client_with_many_requests_that_reads_stays_connected() -> None:
    with simulated.start(limits=Limits(unread_bytes=0)) as handle:
        with raw_mqtt.connect(handle.port, "curious", "tester") as curious:
            curious.sendall(raw_mqtt.packet(0xC0, b"") * 10_000)
            assert raw_mqtt.read_all(curious) == raw_mqtt.packet(0xD0, b"") * 10_000
        assert handle.broker.counters.counts["unread"] == 0


def test_shared_subscriptions_are_rejected(handle: Handle) -> None:
    with Client(handle.port) as client:
        client.connect()
        assert client.subscribe("$share/group/a") == [0x80]


# As a process


@pytest.fixture
def process(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    acl = tmp_path / "acl.conf"
    acl.write_text("user tester\ntopic readwrite #\n")
    command = [sys.executable, "-m", "broker.simulated", "--port", "0", "--acl", str(acl)]
    with (tmp_path / "log").open("w") as log:
        running = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True)
    yield running
    if running.poll() is None:
        running.kill()
    running.communicate()


def test_the_process_prints_its_port_and_ends_on_sigterm_beside_a_connection(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("listening on 127.0.0.1:")
    with Client(int(line.split(":")[1])) as client:
        client.will("test/lost", "lost")
        client.connect()
        os.kill(process.pid, signal.SIGTERM)
        client.ends()
        assert process.wait(HANGS_S) == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pattern read %c/#\n", "line 1 is neither"),
        ("user a\ntopic read a/#/b\n", "line 2: 'a/#/b' is not a topic filter"),
        (None, "cannot be read"),
    ],
)
def test_an_invalid_access_list_is_an_error_with_a_remedy(tmp_path: Path, text: str | None, words: str) -> None:
    acl = tmp_path / "acl.conf"
    if text is not None:
        acl.write_text(text)
    command = [sys.executable, "-m", "broker.simulated", "--port", "0", "--acl", str(acl)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode == 1
    assert words in done.stderr
    assert done.stderr.rstrip().endswith("try `python -m broker.acl` for a valid one")
    assert done.stderr.count("\n") == 1


def test_a_port_in_use_is_reported(handle: Handle) -> None:
    command = [sys.executable, "-m", "broker.simulated", "--port", str(handle.port)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode == 1
    assert "address already in use" in done.stderr
    assert done.stderr.rstrip().endswith("try --port 0 for any free port")
    with pytest.raises(OSError, match="address already in use"):
        simulated.start(handle.port)
