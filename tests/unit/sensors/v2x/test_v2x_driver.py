import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest

from cli.demo.local import free_port
from services.sensors.v2x.process import MAX_BATCH_FRAMES, Config, Process
from shared.errors import UserError
from shared.messages.v2x import MAX_FRAME_BYTES, CamFrames, Encapsulation, V2xSend
from shared.v2x import frames
from tests.support.bus.live_bus import LiveBus, eventually, running
from tests.support.patience import HANGS_S


@contextmanager
def peer() -> Iterator[tuple[socket.socket, int]]:
    """Open a UDP socket of a radio, and find a free port for the driver."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        radio.bind(("127.0.0.1", 0))
        radio.settimeout(HANGS_S)
        yield radio, free_port()


def received(bus: LiveBus) -> list[tuple[int, bytes]]:
    return [record for batch in bus.of(CamFrames) for record in frames.unpack(batch.data)]


def until_open(bus: LiveBus, radio: socket.socket, port: int) -> None:
    """Send until the first frame has arrived."""
    deadline = time.monotonic() + HANGS_S
    while not bus.of(CamFrames):
        assert time.monotonic() < deadline, "the driver did not open its socket"
        radio.sendto(b"first", ("127.0.0.1", port))
        time.sleep(0.01)
    time.sleep(0.1)
    bus.published.clear()


def test_frames_are_published_in_batches_of_at_most_20_ms_with_their_arrival_times_and_none_is_lost() -> None:
    with peer() as (radio, port), running(Process(Config(device=f"udp://127.0.0.1:{port}")).run) as bus:
        until_open(bus, radio, port)
        sent_ns = []
        for number in range(60):
            sent_ns.append(time.monotonic_ns())  # the time line of the test's bus
            radio.sendto(b"frame %d" % number, ("127.0.0.1", port))
            time.sleep(0.005)
        eventually(lambda: len(received(bus)) == 60)
    records, batches = received(bus), bus.of(CamFrames)
    assert [data for _, data in records] == [b"frame %d" % number for number in range(60)]
    assert all(batch.encapsulation is Encapsulation.GEONETWORKING for batch in batches)
    assert all(batch.received_ns == list(frames.unpack(batch.data))[-1][0] for batch in batches)
    delays_s = [(arrived - sent) / 1e9 for (arrived, _), sent in zip(records, sent_ns, strict=True)]
    assert sorted(delays_s)[30] < 0.003, "stamped at arrival, not at the end of the batch"
    assert len(batches) >= 10
    assert all(later > earlier for (earlier, _), (later, _) in pairwise(records))


def test_frames_of_the_bus_are_sent_to_the_radio() -> None:
    with peer() as (radio, port):
        to = f"udp://127.0.0.1:{radio.getsockname()[1]}"
        with running(Process(Config(device=f"udp://127.0.0.1:{port}", send_to=to)).run) as bus:
            until_open(bus, radio, port)
            bus.deliver(V2xSend(received_ns=0, source="1", data=b"own frame"))
            assert radio.recv(100) == b"own frame"


def test_without_an_address_to_send_to_frames_are_counted() -> None:
    with peer() as (radio, port), running(Process(Config(device=f"udp://127.0.0.1:{port}")).run) as bus:
        until_open(bus, radio, port)
        bus.deliver(V2xSend(received_ns=0, source="1", data=b"own frame"))
        eventually(lambda: bus.rejects["write_lost"] == 1)


def test_empty_and_too_long_datagrams_are_counted() -> None:
    with peer() as (radio, port), running(Process(Config(device=f"udp://127.0.0.1:{port}")).run) as bus:
        until_open(bus, radio, port)
        for data in (b"", bytes(MAX_FRAME_BYTES + 1), bytes(60_000), bytes(MAX_FRAME_BYTES)):
            radio.sendto(data, ("127.0.0.1", port))
        eventually(lambda: bool(received(bus)))
        assert [len(data) for _, data in received(bus)] == [MAX_FRAME_BYTES]
        assert bus.rejects["frame_length"] == 3


def test_frames_above_the_limit_of_the_rate_are_counted_and_dropped() -> None:
    with peer() as (radio, port):
        config = Config(device=f"udp://127.0.0.1:{port}", max_frames_s=100)
        with running(Process(config).run) as bus:
            until_open(bus, radio, port)
            time.sleep(0.6)  # a full allowance: half a second of frames
            for number in range(400):
                radio.sendto(b"%d" % number, ("127.0.0.1", port))
            eventually(lambda: len(received(bus)) + bus.rejects["frame_rate"] == 400)
            assert 50 <= len(received(bus)) <= 60


def test_a_burst_is_published_in_batches_that_the_bus_carries() -> None:
    with peer() as (radio, port), running(Process(Config(device=f"udp://127.0.0.1:{port}")).run) as bus:
        until_open(bus, radio, port)
        for number in range(500):
            radio.sendto(b"%d" % number, ("127.0.0.1", port))
        eventually(lambda: len(received(bus)) == 500)
        assert max(len(list(frames.unpack(batch.data))) for batch in bus.of(CamFrames)) <= MAX_BATCH_FRAMES


def test_an_address_that_is_in_use_is_reported_and_tried_again() -> None:
    with peer() as (radio, port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        with running(Process(Config(device=f"udp://127.0.0.1:{port}")).run) as bus:
            eventually(lambda: bus.last_error is not None)
            assert "check the address" in str(bus.last_error)
            other.close()
            until_open(bus, radio, port)
            assert bus.last_error is None


@pytest.mark.parametrize(
    "url",
    [
        "udp://127.0.0.1",
        "tcp://127.0.0.1:1",
        "udp://127.0.0.1:99999",
        "udp://127.0.0.1:1/path",
        "mqtt://127.0.0.1:1883",
        "mqtt://127.0.0.1:1883/a/+",
        "nonsense",
    ],
)
def test_an_invalid_url_is_a_configuration_error_with_an_example(url: str) -> None:
    with pytest.raises(UserError, match="try udp://"):
        Process(Config(device=url))
