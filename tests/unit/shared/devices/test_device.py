import errno
import os
import pty
import socket
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.devices.device import Device, DeviceBusy, DeviceLost, open_device
from shared.errors import UserError
from tests.support.bus.live_bus import eventually
from tests.support.patience import HANGS_S


@pytest.fixture
def port() -> Iterator[tuple[int, str]]:
    """The far end of a serial line, and the name of the near one."""
    far, near = pty.openpty()
    tty.setraw(near)
    name = os.ttyname(near)
    yield far, name
    for descriptor in (far, near):
        try:
            os.close(descriptor)
        except OSError as error:
            assert error.errno == errno.EBADF  # the test has unplugged it


def read_until(device: Device, size: int) -> bytes:
    data = b""
    deadline = time.monotonic() + HANGS_S
    while len(data) < size and time.monotonic() < deadline:
        data += device.read(0.02)
    return data


def test_a_serial_port_is_read_and_written_byte_for_byte(port: tuple[int, str]) -> None:
    far, name = port
    device = open_device(f"serial://{name}?baud=115200")
    everything = bytes(range(256))
    os.write(far, everything)
    assert read_until(device, 256) == everything
    device.write(everything)
    assert os.read(far, 512) == everything
    device.close()
    device.close()


def test_a_read_of_a_silent_serial_port_ends_at_its_timeout(port: tuple[int, str]) -> None:
    device = open_device(f"serial://{port[1]}")
    start = time.monotonic()
    assert device.read(0.02) == b""
    assert time.monotonic() - start > 0.015
    device.close()


def test_bytes_buffered_before_the_port_was_opened_are_dropped(port: tuple[int, str]) -> None:
    far, name = port
    os.write(far, b"stale")
    device = open_device(f"serial://{name}")
    os.write(far, b"fresh")
    assert read_until(device, 5) == b"fresh"
    device.close()


def test_an_unplugged_port_raises_device_lost(port: tuple[int, str]) -> None:
    far, name = port
    device = open_device(f"serial://{name}")
    os.close(far)
    with pytest.raises(DeviceLost, match="check its cable"):
        for _ in range(3):
            device.read(0.02)
    device.close()


def test_a_port_opened_by_another_program_raises_device_lost(port: tuple[int, str]) -> None:
    device = open_device(f"serial://{port[1]}")
    with pytest.raises(DeviceLost, match="another program has it open"):
        open_device(f"serial://{port[1]}")
    device.close()


def test_the_error_for_a_missing_device_states_what_to_check() -> None:
    with pytest.raises(DeviceLost, match=r"No such file or directory; check the cable"):
        open_device("serial:///dev/there-is-no-such-port")


def test_the_error_for_a_missing_usb_device_states_what_to_check() -> None:
    with pytest.raises(DeviceLost, match="check the cable"):
        open_device("serial://dead:beef")


def test_a_tcp_device_is_read_and_written() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        device = open_device(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            peer.sendall(b"from afar")
            assert read_until(device, 9) == b"from afar"
            device.write(b"back")
            assert peer.recv(10) == b"back"
        with pytest.raises(DeviceLost, match="closed the connection"):
            read_until(device, 1)
        device.close()


def test_a_write_to_a_tcp_peer_that_does_not_read_raises_device_busy() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        device = open_device(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer, pytest.raises(DeviceBusy):
            device.read(0.02)
            for _ in range(1000):
                device.write(bytes(1 << 16))
        device.close()


def test_a_missing_tcp_server_raises_device_lost() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    device = open_device(f"tcp://127.0.0.1:{number}")
    with pytest.raises(DeviceLost, match="check that the server runs"):
        read_until(device, 1)
    device.close()


def test_a_file_is_replayed_at_its_rate_and_ends(tmp_path: Path) -> None:
    path = tmp_path / "recording.ubx"
    path.write_bytes(bytes(2000))
    device = open_device(f"file://{path}?rate=10000")
    start = time.monotonic()
    assert len(read_until(device, 2000)) == 2000
    assert time.monotonic() - start > 0.18  # 2000 bytes take 0.2 s
    device.write(b"a recording does not listen")
    assert device.read(0.02) == b""
    device.close()


@pytest.mark.parametrize(
    ("url", "hint"),
    [
        ("usb:///dev/ttyACM0", "try serial:///dev/ttyACM0"),
        ("/dev/ttyACM0", "try serial:///dev/ttyACM0"),
        ("serial:///dev/ttyACM0?boud=9600", "known options: baud"),
        ("serial:///dev/ttyACM0?baud=fast", "must be a positive integer"),
        ("tcp://somewhere", "host and port required"),
        ("tcp://somewhere:port", "host and port required"),
    ],
)
def test_the_error_for_an_invalid_url_states_what_to_try(url: str, hint: str) -> None:
    with pytest.raises(UserError, match=hint):
        open_device(url)


def test_eventually_fails_after_its_timeout() -> None:
    with pytest.raises(AssertionError, match="in time"):
        eventually(lambda: False, within_s=0.02)
