"""Detectors of a toll plaza and its camera: every kind of detector, numbering, bad lines, orders and answers."""

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.sensors.plaza.camera import ATTEMPTS, REPEAT_NS, SimulatedCamera, UdpCamera, open_camera
from services.sensors.plaza.process import MAX_PULSES_S, Config, LaneCount, Process
from services.sensors.plaza.pulses import EVENT, BadLine, LanePulse, LineDetector, edges, open_detector, parse_line
from shared.devices.device import DeviceLost
from shared.errors import UserError
from shared.messages.toll import PictureAction, PictureOrder, PictureState, PlazaDetector
from tests.support.bus.live_bus import eventually, running
from tests.support.cases import each

SECOND_NS = 10**9


@each(
    ("line", "pulse"),
    [
        (b"n1", LanePulse("n1", 0)),
        (b"n1,12\r", LanePulse("n1", 12_000_000)),
        (b"n1,12,f", LanePulse("n1", 12_000_000)),
        (b"s2,,b", LanePulse("s2", 0, True)),
    ],
)
def test_a_line_states_lane_age_and_direction(line: bytes, pulse: LanePulse) -> None:
    assert parse_line(line) == pulse


@each("line", [b"", b",1", b"n1,x", b"n1,-1", b"n1,60001", b"n1,1,x", b"n1,1,f,2", b"n" * 101, b"\xff1"])
def test_a_line_of_another_form_is_no_pulse(line: bytes) -> None:
    with pytest.raises(BadLine):
        parse_line(line)


class FakePort:
    """A serial port that has received some bytes."""

    def __init__(self, *chunks: bytes) -> None:
        self.chunks = list(chunks)

    def read(self, _wait_s: float) -> bytes:
        return self.chunks.pop(0) if self.chunks else b""

    def write(self, _data: bytes) -> None: ...

    def close(self) -> None: ...


def test_lines_of_a_serial_port_may_come_in_pieces_and_without_end() -> None:
    detector = LineDetector(FakePort(b"n1,5", b"0,f\n\nn", b"2\nbad,\n", b"x" * 500))
    found = [detector.read() for _ in range(4)]
    assert found[:2] == [[], [LanePulse("n1", 50_000_000)]]
    assert found[2][0] == LanePulse("n2", 0)
    assert found[3] == [] and len(detector._rest) <= 101


def test_edges_of_an_input_have_the_time_of_the_kernel() -> None:
    data = EVENT.pack(5 * SECOND_NS, 1, 17, 1, 1) + EVENT.pack(6 * SECOND_NS, 1, 17, 2, 2)
    assert edges(data + b"rest", "n1", 6 * SECOND_NS + 7) == [LanePulse("n1", SECOND_NS + 7), LanePulse("n1", 7)]


def test_a_chip_that_is_none_is_a_lost_device(tmp_path: Path) -> None:
    (tmp_path / "chip").write_bytes(b"")
    for path in (tmp_path / "chip", tmp_path / "gone"):
        with pytest.raises(DeviceLost, match="check the detector"):
            open_detector(f"gpio://{path}?line=1&lane=n1")


@each(
    ("detectors", "text"),
    [
        (("loop:1",), "unknown detector"),
        (("gpio:///dev/gpiochip0?lane=n1",), "line ="),
        (("gpio:///dev/gpiochip0?line=1",), "lane ="),
        (("gpio:///dev/gpiochip0?line=1&lane=x",), "no lane 'x'"),
        (("udp://127.0.0.1:0?lane=n1",), "unknown option"),
        (("simulated://?lane=n1&period_s=0",), "period_s"),
    ],
)
def test_a_wrong_url_is_an_error_at_the_start(detectors: tuple[str, ...], text: str) -> None:
    with pytest.raises(UserError, match=text):
        Process(Config(detectors=detectors))


def test_a_wrong_camera_is_an_error_at_the_start() -> None:
    with pytest.raises(UserError, match="unknown camera"):
        Process(Config(camera="http://camera"))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        return int(opened.getsockname()[1])


def test_datagrams_are_published_with_running_numbers_and_bad_ones_are_counted() -> None:
    port = free_port()
    process = Process(Config(detectors=(f"udp://127.0.0.1:{port}",)))
    with running(process.run) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        eventually(lambda: not _is_free(port))
        for data in (b"n1,0,f", b"n1,3,b", b"n1\nn2,1", b"nonsense,x", b"nowhere"):
            sender.sendto(data, ("127.0.0.1", port))
        eventually(lambda: len(bus.of(PlazaDetector)) >= 4 and sum(bus.rejects.values()) >= 2)
    pulses = bus.of(PlazaDetector)
    assert [(pulse.lane, pulse.pulse, len(pulse.earlier_ns)) for pulse in pulses] == [
        ("n1", 0, 0), ("n1", 1, 1), ("n1", 2, 2), ("n2", 0, 0)
    ]  # fmt: skip
    assert [len(pulse.backward_ns) for pulse in pulses] == [0, 1, 1, 0]
    assert bus.rejects == {"detector_line": 1, "detector_lane": 1}


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        try:
            opened.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def test_a_detector_that_chatters_is_counted_and_not_believed() -> None:
    count = LaneCount("example", "n1", 0)
    taken = [count.add(n * 1_000_000, backward=False) for n in range(MAX_PULSES_S + 5)]
    assert taken == [True] * MAX_PULSES_S + [False] * 5
    message = count.message(SECOND_NS)
    assert message is not None and message.pulse == MAX_PULSES_S - 1
    assert count.add(10 * SECOND_NS, backward=False)


def test_the_simulated_detector_and_camera_need_no_device() -> None:
    process = Process(Config(detectors=("simulated://?lane=n2&period_s=0.05",), camera="simulated:"))
    with running(process.run) as bus:
        eventually(lambda: len(bus.of(PlazaDetector)) >= 3)
        bus.deliver(order(until_ns=bus.now_ns() + 60 * SECOND_NS))
        eventually(lambda: any(state.pictures == 1 for state in bus.of(PictureState)))
    assert [pulse.pulse for pulse in bus.of(PlazaDetector)[:3]] == [0, 1, 2]


def order(action: PictureAction = PictureAction.TAKE, until_ns: int = 100 * SECOND_NS, name: str = "a") -> PictureOrder:
    return PictureOrder(
        sampled_ns=1, plaza="example", lane="n1", picture=name * 64, pulse_ns=1, action=action, until_ns=until_ns
    )


def test_a_camera_deletes_on_order_and_at_the_end() -> None:
    camera = SimulatedCamera()
    camera.obey(order(), 0)
    camera.obey(order(), 0)
    camera.obey(order(name="b", until_ns=10), 0)
    camera.obey(order(PictureAction.KEEP, name="c"), 0)
    assert list(camera.pictures) == ["a" * 64, "b" * 64], "what was not taken cannot be kept"
    camera.expire(10)
    assert list(camera.pictures) == ["a" * 64]
    camera.obey(order(PictureAction.DELETE), 11)
    assert not camera.pictures


@pytest.fixture
def far_camera() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5.0)
        yield opened


def test_an_order_is_repeated_until_the_camera_has_answered(far_camera: socket.socket) -> None:
    camera = open_camera(f"udp://127.0.0.1:{far_camera.getsockname()[1]}")
    camera.obey(order(), 0)
    camera.expire(REPEAT_NS)
    first, _ = far_camera.recvfrom(4000)
    second, address = far_camera.recvfrom(4000)
    assert first == second and PictureOrder.model_validate_json(first) == order()
    assert not camera.pictures
    for answer in (b"x" * 600, b"[]", b"{}", json.dumps({"picture": "a" * 64, "action": "take"}).encode()):
        far_camera.sendto(answer, address)
    deadline = time.monotonic() + 5.0
    while not camera.pictures and time.monotonic() < deadline:
        camera.expire(REPEAT_NS)
    assert list(camera.pictures) == ["a" * 64]
    camera.expire(101 * SECOND_NS)
    assert not camera.pictures
    camera.close()


def test_orders_that_no_camera_answers_are_counted(far_camera: socket.socket) -> None:
    camera = UdpCamera(f"udp://127.0.0.1:{far_camera.getsockname()[1]}")
    camera.obey(order(), 0)
    for n in range(ATTEMPTS + 2):
        camera.expire(n * REPEAT_NS)
    assert camera.failed == 1
    camera.close()


def test_an_answer_counts_only_from_the_whole_address_of_the_camera(far_camera: socket.socket) -> None:
    port = far_camera.getsockname()[1]
    camera = UdpCamera(f"udp://127.0.0.1:{port}")
    camera.obey(order(), 0)
    data, address = far_camera.recvfrom(4000)
    answer = json.dumps({key: json.loads(data)[key] for key in ("picture", "action")}).encode()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.2", port))
        stranger.sendto(answer, address)
        time.sleep(0.05)
        camera.expire(1)
        assert not camera.answered
    far_camera.sendto(answer, address)
    deadline = time.monotonic() + 5.0
    while not camera.answered and time.monotonic() < deadline:
        camera.expire(1)
    assert [(done.picture, done.action) for done in camera.answered] == [("a" * 64, PictureAction.TAKE)]
    camera.close()
