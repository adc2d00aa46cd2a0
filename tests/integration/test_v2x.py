"""The V2X processes of a unit, connected by a broker with the access list of the unit."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.demo.local import free_port
from shared.bus.bus import Bus
from shared.messages.operation import ProcessHealth
from shared.messages.v2x import CamList, OwnCam
from shared.runtime.config import BrokerAddress
from shared.topics import BY_NAME
from shared.v2x import geonetworking, its_time
from tests.support.bus import brokers
from tests.support.patience import HANGS_S
from tests.support.v2x import cams

LIMIT_S = 20.0


@pytest.fixture
def radio() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(0.05)
        yield opened


@pytest.fixture
def unit(tmp_path: Path, radio: socket.socket) -> Iterator[tuple[int, int]]:
    """Run sensors.v2x and parsers.v2x; the ports of the broker and of the driver."""
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    port = free_port()
    file = tmp_path / "vehicle.toml"
    file.write_text(
        f'[sensors.v2x]\ndevice = "udp://127.0.0.1:{port}"\nsend_to = "udp://127.0.0.1:{radio.getsockname()[1]}"\n'
        "[parsers.v2x]\n"
    )
    environment = os.environ | {
        "OBU_VEHICLE": str(file), "OBU_BROKER": f"mqtt://127.0.0.1:{broker.port}", "OBU_STATE": str(tmp_path)
    }  # fmt: skip
    children = [
        subprocess.Popen([sys.executable, "-m", "cli", "run", name], env=environment, stdout=subprocess.DEVNULL)
        for name in ("sensors.v2x", "parsers.v2x")
    ]
    try:
        yield broker.port, port
    finally:
        for child in children:
            child.terminate()
            child.wait(HANGS_S)
        broker.stop()


def bus(process: str, topics: list[str], port: int, folder: Path, *, observer: bool = False) -> Bus:
    rows = [BY_NAME[name] for name in topics]
    return Bus(process, "vehicle", BrokerAddress("127.0.0.1", port), rows, folder, observer=observer)


def until(found: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not found():
        assert time.monotonic() < deadline, f"{what} within {LIMIT_S} s"


def test_a_radio_frame_is_published_as_cam_and_invalid_bytes_are_counted(
    unit: tuple[int, int], radio: socket.socket, tmp_path: Path
) -> None:
    broker_port, port = unit
    listener = bus("observer", ["v2x/cam", "health/+"], broker_port, tmp_path, observer=True)
    received: list[CamList] = []
    rejects: dict[str, int] = {}

    def exchange() -> bool:
        packet = cams.packet(cams.BRAKING, its_time.its_time_ms(time.time_ns()))
        for data in (packet, packet[:-3], b"\x12" + packet[1:], bytes(100)):
            radio.sendto(data, ("127.0.0.1", port))
        for envelope in listener.receive(0.05):
            message = envelope.decode()
            if isinstance(message, CamList):
                received.append(message)
            elif isinstance(message, ProcessHealth):
                rejects.update(message.rejects)
        return bool(received) and {"truncated", "security_version", "geonetworking_version"} <= rejects.keys()

    until(exchange, "a CAM and the counted rejects")
    listener.close()
    found = received[0].cams[0]
    assert (found.station_id, found.speed_m_s) == (4_000_000_123, 23.45)
    assert abs(found.received_ns - found.sampled_ns) < 2e9


def test_an_own_cam_on_the_bus_is_sent_by_the_radio(
    unit: tuple[int, int], radio: socket.socket, tmp_path: Path
) -> None:
    broker_port, _ = unit
    controller = bus("controller.cam", [], broker_port, tmp_path)
    sent: list[bytes] = []

    def exchange() -> bool:
        controller.receive(0.05)
        now_ns = time.time_ns()
        if controller.connected:
            controller.publish(
                OwnCam(**dict(cams.BRAKING), sampled_ns=now_ns, its_time_ms=its_time.its_time_ms(now_ns))
            )
        try:
            sent.append(radio.recv(3000))
        except TimeoutError:
            return False
        return True

    until(exchange, "a frame at the radio")
    controller.close()
    content, _ = cams.decode_content(geonetworking.decode_payload(sent[0]))
    assert content.station_id == 4_000_000_123
