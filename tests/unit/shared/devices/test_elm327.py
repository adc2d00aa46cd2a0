import random
import time

import pytest

from shared.devices.can_device import check_can_url, open_can
from shared.devices.device import DeviceBusy, DeviceLost
from shared.devices.elm327 import FAILURES, LONGEST_REST_S, Elm327
from shared.devices.elm327_lines import AnswerLines, ElmFrame
from shared.errors import UserError
from shared.messages.operation import DeviceFound
from tests.support.cases import each
from tests.support.fake_elm327 import BANNER, AdapterBehaviour, FakeElm327, SerialFake, TcpFake
from tests.support.patience import HANGS_S

SPEED = bytes.fromhex("010D")
OBD = bytes.fromhex("02010D0000000000")
ANSWER = ElmFrame(0x7E8, False, bytes.fromhex("03410D32"))


class Bench:
    """An adapter and a fake without ports: time is counted, and answers arrive after `latency_s`."""

    def __init__(
        self, habits: AdapterBehaviour | None = None, *, rate: int | None = None, identifier: int = 0x7DF
    ) -> None:
        self.adapter, self.fake = Elm327(rate, identifier), FakeElm327(habits or AdapterBehaviour())
        self.now_s = 100.0
        self.frames: list[ElmFrame] = []
        self.written: list[tuple[float, str]] = []
        self.deaf = False
        self.right_rate: int | None = None  # at which the fake understands

    def run(self, seconds: float, period_s: float = 0.5, pieces: int = 1) -> None:
        until, next_request = self.now_s + seconds, self.now_s
        while self.now_s < until:
            if self.now_s >= next_request:
                self.adapter.request(SPEED)
                next_request += period_s
            written = self.adapter.due(self.now_s)
            self.adapter.take_rate()
            for command in written.decode().split("\r")[:-1]:
                self.written.append((self.now_s, command))
                if self.deaf:
                    continue
                data = self.fake.answer(command)
                if self.right_rate not in {None, self.adapter.rate_baud}:
                    data = b"\xf8\x00\xe0" * 5
                size = -(-len(data) // pieces)
                for k in range(0, len(data), size):
                    self.frames += self.adapter.take(data[k : k + size], self.now_s)
            self.now_s += 0.05


def test_an_adapter_is_set_up_and_gives_the_frames_of_its_answers() -> None:
    bench = Bench()
    bench.run(5.0)
    commands = [command for _, command in bench.written]
    assert commands[:8] == ["ATZ", "ATE0", "ATL0", "ATS0", "ATH1", "ATSP0", "0100", "ATDPN"]
    assert set(commands[8:]) == {"010D"}
    assert bench.frames == [ANSWER] * len(bench.frames) and len(bench.frames) >= 8
    assert bench.adapter.found is DeviceFound.WORKING
    assert bench.adapter.protocols == (BANNER.upper(), "ISO 15765-4, 11 bit, 500 kbit/s")
    assert not bench.adapter.rejects


@each(
    "habits",
    [
        AdapterBehaviour(echoes_always=True), AdapterBehaviour(spaces_always=True), AdapterBehaviour(no_headers=True),
        AdapterBehaviour(no_headers=True, spaces_always=True, echoes_always=True),
        AdapterBehaviour(banner="OBDII  v1.5"),
        AdapterBehaviour(searching="SEARCHING..."), AdapterBehaviour(searching="BUS INIT: ...OK\r"),
        AdapterBehaviour(searching=""),
        AdapterBehaviour(refuses=("ATL0", "ATS0", "ATSP0")), AdapterBehaviour(refuses=("ATDPN",)),
    ],
)  # fmt: skip
@each("pieces", [1, 4, 1000])
def test_habits_of_clones_give_the_same_frames(habits: AdapterBehaviour, pieces: int) -> None:
    bench = Bench(habits)
    bench.run(5.0, pieces=pieces)
    assert set(bench.frames) == {ANSWER} and len(bench.frames) >= 8
    assert ("ignores ATH1" in bench.adapter.sentence()) == habits.no_headers


def test_bytes_00_and_ff_are_counted_and_cost_nothing() -> None:
    bench = Bench(AdapterBehaviour(noise=b"\x00\xff"))
    bench.run(5.0)
    assert set(bench.frames) == {ANSWER} and bench.adapter.rejects["adapter_byte"] > 20


def test_lost_prompts_are_waited_for_and_then_the_adapter_is_set_up_again() -> None:
    bench = Bench(AdapterBehaviour(loses_prompts=5))
    bench.run(90.0)
    assert bench.adapter.rejects["adapter_silent"] == 5
    assert [command for _, command in bench.written].count("ATZ") == 2
    assert bench.frames[-1] == ANSWER and bench.adapter.found is DeviceFound.WORKING


@each(
    ("error", "found"),
    [
        ("NO DATA", DeviceFound.SILENT), ("UNABLE TO CONNECT", DeviceFound.SILENT),
        ("BUS INIT: ...ERROR", DeviceFound.SILENT), ("BUS INIT: ERROR", DeviceFound.SILENT),
        ("CAN ERROR", DeviceFound.NOISE), ("BUS BUSY", DeviceFound.NOISE), ("STOPPED", DeviceFound.SILENT),
        ("?", DeviceFound.SILENT), ("BUFFER FULL", DeviceFound.SILENT), ("<DATA ERROR", DeviceFound.SILENT),
        ("SEARCHING...UNABLE TO CONNECT", DeviceFound.SILENT),
    ],
)  # fmt: skip
def test_a_vehicle_that_does_not_answer_is_asked_ever_less_often_and_wakes(error: str, found: DeviceFound) -> None:
    bench = Bench(AdapterBehaviour(error=error))
    bench.run(600.0)
    assert bench.adapter.found is found
    times = [at for at, command in bench.written if command == "0100"]
    rests = [round(after - before, 3) for before, after in zip(times[FAILURES:], times[FAILURES + 1 :], strict=False)]
    assert rests == sorted(rests) and rests[-1] == pytest.approx(LONGEST_REST_S, abs=0.2)
    assert all(frame.is_error for frame in bench.frames) and bool(bench.frames) == (found is DeviceFound.NOISE)
    assert sum(bench.adapter.rejects.values()) == len(times)
    assert bench.adapter.sentence().count(":") >= 1
    bench.fake.habits.error = None
    bench.frames.clear()
    bench.run(LONGEST_REST_S + 10.0)
    assert bench.adapter.found is DeviceFound.WORKING and len(bench.frames) > 10


def test_a_request_that_the_vehicle_does_not_know_leaves_the_others_alone() -> None:
    bench = Bench()
    bench.run(5.0)
    n = len(bench.frames)
    bench.adapter.request(bytes.fromhex("0902"))
    bench.run(5.0)
    assert len(bench.frames) >= n + 9 and bench.adapter.found is DeviceFound.WORKING
    assert bench.adapter.rejects == {"adapter_no_data": 1}


def test_an_adapter_that_resets_itself_is_set_up_again() -> None:
    bench = Bench()
    bench.run(5.0)
    bench.fake.answer("ATZ")  # its settings are gone
    list(bench.adapter.take(b"\r\rELM327 v1.5\r\r>", bench.now_s))
    n, written = len(bench.frames), len(bench.written)
    bench.run(5.0)
    assert [command for _, command in bench.written[written:]][:2] == ["ATE0", "ATL0"]
    assert len(bench.frames) > n


def test_the_rate_of_the_port_is_found_and_said() -> None:
    bench = Bench(rate=38400)
    bench.right_rate = 115200
    bench.run(60.0)
    assert bench.adapter.found is DeviceFound.WORKING and bench.adapter.rate_baud == 115200
    assert "write baud=115200" in bench.adapter.sentence()


def test_no_adapter_is_said_with_what_to_check() -> None:
    bench = Bench(rate=38400)
    bench.deaf = True
    bench.run(1.0)
    found = [bench.adapter.found]
    bench.run(60.0)
    assert [*found, bench.adapter.found] == [DeviceFound.SEARCHING, DeviceFound.SILENT]
    assert "does not answer at 9600, 38400" in bench.adapter.sentence()
    assert {command for _, command in bench.written} == {"ATZ", ""}


@pytest.mark.parametrize(
    ("identifier", "commands"),
    [(0x7DF, []), (0x18DB33F1, []), (0x7E0, ["ATSH7E0"]), (0x18DA10F1, ["ATCP18", "ATSHDA10F1"])],
)
def test_a_physical_request_identifier_is_set(identifier: int, commands: list[str]) -> None:
    bench = Bench(identifier=identifier)
    bench.run(3.0)
    assert [command for _, command in bench.written if command[:4] in {"ATSH", "ATCP"}] == commands


@each(
    ("line", "protocol", "frame"),
    [
        ("7E803410D32", "6", ANSWER),
        ("7EA03410D32AAAAAAAA", "6", ElmFrame(0x7EA, False, bytes.fromhex("03410D32AAAAAAAA"))),
        ("18DAF11003410D32", "7", ElmFrame(0x18DAF110, True, bytes.fromhex("03410D32"))),
        ("7E81014490201314434", "6", ElmFrame(0x7E8, False, bytes.fromhex("1014490201314434"))),
        ("486B10410D3243", "3", ElmFrame(0x18DAF110, True, bytes.fromhex("03410D32"))),
        ("83F111410D3205", "5", ElmFrame(0x18DAF111, True, bytes.fromhex("03410D32"))),
        ("486B10410D325E", "2", ElmFrame(0x18DAF110, True, bytes.fromhex("03410D32"))),
        ("014", "6", None),
        ("410D32", "6", ANSWER),
    ],
)
def test_lines_are_frames(line: str, protocol: str, frame: ElmFrame | None) -> None:
    assert AnswerLines().frame(line, protocol) == frame


@each(
    ("line", "protocol"),
    [
        ("7E8", "6"), ("7E80", "6"), ("7E803", "6"), ("7E80341", "6"), ("7E803410D", "6"), ("XYZ", "6"),
        ("7E803410D32AAAAAAAAAA", "6"), ("486B10410D3244", "3"), ("486B10", "3"), ("48", "3"), ("0:490201314434", "6"),
        ("0D32", "6"), ("F" * 60, "6"), ("18DAF11000", "7"), ("486B10410D324", "3"),
    ],
)  # fmt: skip
def test_half_lines_are_rejected(line: str, protocol: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        AnswerLines().frame(line, protocol)


def test_numbered_lines_without_identifiers_are_the_frames_they_were_in() -> None:
    lines = AnswerLines()
    assert lines.frame("014", "6") is None
    parts = ["0:490201314434", "1:47503030523535", "2:42313233343536"]
    frames = [lines.frame(part, "6") for part in parts]
    assert [frame.data.hex() for frame in frames if frame] == [
        "1014490201314434", "2147503030523535", "2242313233343536"
    ]  # fmt: skip


def test_any_bytes_are_survived_within_bounds() -> None:
    """A thousand damaged answers, and noise without an end: no error, memory bounded, and the adapter recovers."""
    random_ = random.Random(7)
    bench = Bench()
    for _ in range(300):
        bench.adapter.request(SPEED)
        written = bench.adapter.due(bench.now_s)
        data = bytearray(b"".join(bench.fake.answer(c) for c in written.decode().split("\r")[:-1]) or b"7E803410D32\r>")
        for _ in range(random_.randrange(4)):
            data[random_.randrange(len(data))] = random_.randrange(256)
        list(bench.adapter.take(bytes(data), bench.now_s))
        bench.now_s += random_.choice((0.05, 1.0, 13.0))
    for _ in range(300):
        list(bench.adapter.take(random_.choice((random_.randbytes(100), b"\r" * 100, b"A" * 100)), bench.now_s))
        assert len(bench.adapter._buffer) <= 64 and len(bench.adapter._pending) <= 8
        bench.now_s += 0.1
    bench.frames.clear()
    bench.run(120.0)
    assert bench.frames[-1] == ANSWER


def read_three(url: str, fake: SerialFake | TcpFake) -> list[str]:
    device, data = open_can(url, 0x7DF, time.monotonic_ns), b""
    with fake:
        until = time.monotonic() + HANGS_S
        while time.monotonic() < until and data.count(b"\n") < 3:
            device.write(OBD)
            data += device.read(0.02)
        device.close()
    return [line.split(") ")[1] for line in data.decode().splitlines()]


def test_a_serial_adapter_gives_candump_lines() -> None:
    fake = SerialFake(AdapterBehaviour(delay_s=0.005))
    lines = read_three(fake.url, fake)
    assert len(lines) == 3
    assert {line.split()[1] for line in lines} == {"7E8#03410D32"}


def test_an_adapter_over_tcp_gives_candump_lines() -> None:
    fake = TcpFake()
    assert read_three(fake.url, fake) == ["127.0.0.1 7E8#03410D32"] * 3


def test_an_unplugged_adapter_is_lost() -> None:
    fake = SerialFake()
    with fake:
        device = open_can(fake.url, 0x7DF, time.monotonic_ns)
        device.read(0.05)
        fake.unplug()
        with pytest.raises(DeviceLost):
            for _ in range(10):
                device.read(0.02)
        device.close()


def test_requests_are_bounded() -> None:
    fake = SerialFake()
    device = open_can(fake.url, 0x7DF, time.monotonic_ns)
    with pytest.raises(DeviceBusy):
        for pid in range(20):
            device.write(bytes((2, 1, pid, 0, 0, 0, 0, 0)))
    device.close()


@pytest.mark.parametrize(
    "url", ["elm327+tcp://host", "elm327+tcp://:5", "elm327+tcp://h:x", "elm327://", "slcan:///dev/x?bitrate=7"]
)
def test_an_invalid_url_says_what_to_write(url: str) -> None:
    with pytest.raises(UserError, match=r"elm327\+tcp://192|no name|bitrate must be"):
        check_can_url(url)
