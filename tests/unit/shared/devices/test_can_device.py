import os
import pty
import time
import tty
from pathlib import Path

import can
import pytest
from can.io import CanutilsLogReader

from cli.demo.local import free_port
from shared.devices.can_device import candump_line, check_can_url, open_can
from shared.devices.device import Device, DeviceBusy, DeviceLost
from shared.errors import UserError
from tests.support.data import recording
from tests.support.patience import HANGS_S

REQUEST = bytes.fromhex("02010D0000000000")


def read_lines(device: Device, n: int, within_s: float = HANGS_S) -> list[str]:
    data = b""
    deadline = time.monotonic() + within_s
    while data.count(b"\n") < n and time.monotonic() < deadline:
        data += device.read(0.02)
    return data.decode().splitlines()


def commands(far: int, last: bytes) -> list[bytes]:
    """Read commands to an adapter (terminated by carriage return) up to one that begins with `last`."""
    data = b""
    while True:
        data += os.read(far, 1)
        words = [word for word in data.split(b"\r") if word]
        if data.endswith(b"\r") and words and words[-1].startswith(last):
            return words


def without_stamps(lines: list[str]) -> list[str]:
    return [line.split(") ")[1] for line in lines]


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (can.Message(arbitration_id=0x7E8, is_extended_id=False, data=b"\x03\x41\x0d"), "can0 7E8#03410D"),
        (can.Message(arbitration_id=0x7E8, is_extended_id=True, data=b"\x01"), "can0 000007E8#01"),
        (can.Message(arbitration_id=0x1, is_extended_id=False, is_remote_frame=True), "can0 001#R"),
        (can.Message(arbitration_id=0x1, is_extended_id=False, is_fd=True, bitrate_switch=True, data=b"\xab"),
         "can0 001##1AB"),
    ],
)  # fmt: skip
def test_a_line_is_parsed_by_python_can_to_the_same_frame(frame: can.Message, text: str, tmp_path: Path) -> None:
    line = candump_line(1_436_509_052_249_713_999, "can0", frame)
    assert line.decode() == f"(1436509052.249713) {text}\n"
    path = tmp_path / "candump.log"
    path.write_bytes(line)
    (read,) = CanutilsLogReader(path)
    assert read.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)


def test_frames_of_an_interface_are_lines_stamped_in_the_obu_time_line() -> None:
    device = open_can("virtual://lines", 0x7DF, time.monotonic_ns)
    with can.Bus("lines", "virtual") as far:
        before_ns = time.monotonic_ns()
        far.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\xbe\xef"))
        far.send(can.Message(arbitration_id=0x18FEF100, data=bytes(8)))
        far.send(can.Message(is_error_frame=True))
        lines = read_lines(device, 3)
    assert without_stamps(lines) == ["lines 123#BEEF", "lines 18FEF100#0000000000000000", "lines 20000000#"]
    stamp_s = float(lines[0].split(")")[0][1:])
    assert before_ns * 1e-9 - 1e-3 <= stamp_s <= time.monotonic()
    device.close()


@pytest.mark.parametrize(("identifier", "extended"), [(0x7DF, False), (0x18DB33F1, True)])
def test_a_request_is_transmitted_with_its_identifier(identifier: int, extended: bool) -> None:
    device = open_can("virtual://requests", identifier, time.monotonic_ns)
    with can.Bus("requests", "virtual") as far:
        device.write(REQUEST)
        frame = far.recv(HANGS_S)
    assert frame is not None
    assert (frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) == (identifier, extended, REQUEST)
    device.close()


def test_a_closed_interface_raises_device_lost_on_read_and_device_busy_on_write() -> None:
    device = open_can("virtual://closed", 0x7DF, time.monotonic_ns)
    device.close()
    with pytest.raises(DeviceLost, match="check its cable"):
        device.read(0.0)
    with pytest.raises(DeviceBusy):
        device.write(REQUEST)


def test_a_serial_adapter_is_controlled_by_the_lawicel_protocol() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    device = open_can(f"slcan://{os.ttyname(near)}?bitrate=250000", 0x7DF, time.monotonic_ns)
    assert commands(far, b"O") == [b"C", b"S5", b"O"]  # close, 250 kbit/s, open
    os.write(far, b"t7E8803410D3200000000\r")
    (line,) = read_lines(device, 1)
    assert without_stamps([line]) == [f"{Path(os.ttyname(near)).name} 7E8#03410D3200000000"]
    device.write(REQUEST)
    assert commands(far, b"t")[-1] == b"t7DF802010D0000000000"
    os.close(far)
    with pytest.raises(DeviceLost):
        for _ in range(3):
            device.read(0.02)
    device.close()
    os.close(near)


def test_the_error_for_a_missing_interface_states_what_to_check() -> None:
    with pytest.raises(DeviceLost, match="cannot open socketcan://nocan7"):
        open_can("socketcan://nocan7", 0x7DF, time.monotonic_ns)


@pytest.mark.parametrize("url", ["can0", "serial:///dev/ttyACM0", "socketcan://can0?bitrate=5"])
def test_the_error_for_an_invalid_url_states_what_to_try(url: str) -> None:
    with pytest.raises(UserError, match=r"try socketcan://can0|known options"):
        check_can_url(url)


def test_a_log_is_replayed_at_its_recorded_rate_with_present_stamps(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text("(1000.000000) can0 001#01\nrubbish\n(1000.100000) can0 002#02\n(1000.3) can0 003#03\n")
    device = open_can(f"file://{path}", 0x7DF, time.monotonic_ns)
    start = time.monotonic()
    lines = read_lines(device, 3)
    assert without_stamps(lines) == ["can0 001#01", "can0 002#02", "can0 003#03"]
    assert time.monotonic() - start > 0.29
    stamps_s = [float(line.split(")")[0][1:]) for line in lines]
    assert [stamp - stamps_s[0] for stamp in stamps_s] == pytest.approx([0.0, 0.1, 0.3], abs=2e-6)
    assert device.read(0.02) == b""
    device.close()


def test_what_candump_shows_is_read_as_its_log(tmp_path: Path) -> None:
    shown = [
        "  can0  7E8   [8]  03 41 0D 32 00 00 00 00",
        " (1000.050000)  can0  18FEF100   [8]  F7 80 3E 0F FF FF FF FF   '..>.....'",
        " (1000.060000)  vcan1  RX - -  7E9   [4]  03 41 0D 32",
        "  can0  123   [0]  remote request",
        "  can0  123  [02]  AB CD",
        "  can0  20000088   [8]  00 00 00 00 00 00 00 00   ERRORFRAME",
        " (2026-09-21 10:20:00.000000)  can0  001   [1]  01",
        "  can0  7E8   [8]  03 41",
        "$ candump can0",
    ]
    path = tmp_path / "screen.log"
    path.write_text("\n".join(shown) + "\n")
    device = open_can(f"file://{path}", 0x7DF, lambda: 2_000_000_000 * 1_000_000_000)
    lines = [item[1] for item in iter(device._scan, None)]  # type: ignore[attr-defined]  # without waiting
    assert [device._next[1], *lines][:1] == ["can0 7E8#03410D3200000000"]  # type: ignore[attr-defined]
    assert lines == [
        "can0 18FEF100#F7803E0FFFFFFFFF", "vcan1 7E9#03410D32", "can0 123#R", "can0 123##0ABCD",
        "can0 20000088#0000000000000000", "can0 001#01",
    ]  # fmt: skip
    device.close()


def test_frames_without_time_stamps_are_replayed_at_100_a_second(tmp_path: Path) -> None:
    path = tmp_path / "screen.log"
    path.write_text("can0  7E8   [4]  03 41 0D 32\n" * 6)
    device = open_can(f"file://{path}", 0x7DF, time.monotonic_ns)
    lines = read_lines(device, 6)
    assert without_stamps(lines) == ["can0 7E8#03410D32"] * 6
    stamps_s = [float(line.split(")")[0][1:]) for line in lines]
    assert stamps_s[-1] - stamps_s[0] == pytest.approx(0.05, abs=2e-6)
    device.close()


@pytest.mark.parametrize("text", ["", "rubbish\n", "1000.0,7E8,03410D32\n", "can0 7E8 8 03 41 0D 32\n"])
def test_a_log_without_a_usable_line_is_an_error_that_names_the_form(text: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(text)
    with pytest.raises(DeviceLost, match=r"holds no line of a candump log; write one with `candump -L can0`.*7E8#03"):
        open_can(f"file://{path}", 0x7DF, time.monotonic_ns)


@pytest.mark.recording
def test_a_recorded_log_is_replayed_as_parsed_by_python_can(tmp_path: Path) -> None:
    source = recording("can_toyobaru_wheelspeed/can_sample.log")
    path = tmp_path / "part.log"
    with source.open() as file:
        path.write_text("".join(line for line, _ in zip(file, range(200), strict=False)))
    device = open_can(f"file://{path}", 0x7DF, time.monotonic_ns)
    lines = read_lines(device, 200)
    expected = [f"can0 {frame.arbitration_id:03X}#{frame.data.hex().upper()}" for frame in CanutilsLogReader(path)]
    assert without_stamps(lines) == expected
    device.close()


def test_python_cans_multicast_is_read_on_loopback() -> None:
    """In a group and at a port of the test's own: a computer without multicast skips it."""
    port = free_port()
    try:
        device = open_can(f"udp-multicast://239.74.163.45?port={port}", 0x7DF, time.monotonic_ns)
        far = can.Bus("239.74.163.45", "udp_multicast", port=port, hop_limit=0)
    except (DeviceLost, can.CanError, OSError) as error:
        pytest.skip(f"this system has no multicast: {error}")
    with far:
        try:
            far.send(can.Message(arbitration_id=0x7E8, is_extended_id=False, data=bytes.fromhex("03410D32")))
        except (can.CanError, OSError) as error:
            pytest.skip(f"this system has no multicast: {error}")
        lines = read_lines(device, 1)
    device.close()
    assert without_stamps(lines) == ["239.74.163.45 7E8#03410D32"]


@pytest.mark.parametrize(
    ("answer", "extended", "target"), [(0x7E8, False, 0x7E0), (0x7EF, False, 0x7E7), (0x18DAF110, True, 0x18DA10F1)]
)
def test_an_answer_of_several_frames_is_let_on_only_after_a_request(answer: int, extended: bool, target: int) -> None:
    device = open_can(f"virtual://flow{answer}", 0x7DF, time.monotonic_ns)
    first = can.Message(arbitration_id=answer, is_extended_id=extended, data=bytes.fromhex("1014490201575030"))
    other = can.Message(arbitration_id=0x123, is_extended_id=False, data=first.data)
    with can.Bus(f"flow{answer}", "virtual") as far:
        far.send(first)
        assert len(read_lines(device, 1)) == 1
        assert far.recv(0.02) is None  # nothing is transmitted unasked
        device.write(REQUEST)
        assert far.recv(HANGS_S) is not None
        far.send(other)
        far.send(first)
        assert len(read_lines(device, 2)) == 2
        flow = far.recv(HANGS_S)
        assert flow is not None and far.recv(0.02) is None
    device.close()
    assert (flow.arbitration_id, flow.is_extended_id, flow.data[0]) == (target, extended, 0x30)


def test_a_log_counts_the_lines_that_it_leaves_out(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text("(1000.0) can0 001#01\nrubbish\n\nmore rubbish\n(1000.01) can0 002#02\n" + "x" * 5000)
    device = open_can(f"file://{path}", 0x7DF, time.monotonic_ns)
    assert len(read_lines(device, 2)) == 2
    assert device.rejects == {"line": 7}  # type: ignore[attr-defined]  # the long one in five pieces
    said = device.search.sentence()  # type: ignore[attr-defined]
    assert said == "a log, read to its end: 2 frames, 7 lines that are none of candump"
    device.close()
