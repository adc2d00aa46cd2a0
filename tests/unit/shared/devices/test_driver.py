import contextlib
import logging
import os
import pty
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest

from shared.bus.bus import HUNG_S, Bus
from shared.devices.device import open_device
from shared.devices.driver import Link, run_driver
from shared.messages.imu import ImuRaw
from shared.messages.operation import Origin, OriginKind
from tests.support.bus.live_bus import LiveBus, eventually, running


class Script:
    """A device whose reads are listed; an exception in the list is raised."""

    def __init__(self, *reads: bytes) -> None:
        self.reads = list(reads)
        self.closed = 0

    def read(self, wait_s: float) -> bytes:
        return self.reads.pop(0) if self.reads else b""

    def write(self, data: bytes) -> None:
        self.reads.append(data)

    def close(self) -> None:
        self.closed += 1


def plug(folder: Path) -> int:
    """Connect a device under a constant name, as udev does; return its far end."""
    far, near = pty.openpty()
    tty.setraw(near)
    link = folder / "device"
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(near))
    os.close(near)
    return far


def driving(url: str) -> Callable[[Bus], None]:
    return lambda bus: run_driver(bus, Link(lambda: open_device(url)), url, raw)


def raw(data: bytes, received_ns: int) -> ImuRaw:
    return ImuRaw(received_ns=received_ns, source="imu0", data=data)


def test_contiguous_bytes_are_one_chunk_that_ends_after_a_gap() -> None:
    bus = LiveBus()
    link = Link(lambda: Script(b"ab", b"cd", b"", b"ef"))
    assert link.read(bus.as_bus(), 0.0)[0] == b"abcd"
    assert link.read(bus.as_bus(), 0.0)[0] == b"ef"


def test_a_chunk_ends_at_its_maximum_duration() -> None:
    bus = LiveBus()
    link = Link(lambda: Script(*[b"x"] * 1000), chunk_s=0.0)
    assert link.read(bus.as_bus(), 0.0)[0] == b"x"


def test_writes_to_an_absent_device_are_counted() -> None:
    bus = LiveBus()
    Link(lambda: open_device("serial:///dev/there-is-no-such-port")).write(bus.as_bus(), b"x")
    assert bus.rejects["write_lost"] == 1


def test_the_loss_and_return_of_a_device_are_logged_once_each(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept_s, sleep = list[float](), time.sleep
    others = set(threading.enumerate())  # threads that earlier tests have left

    def wait(wait_s: float) -> None:
        if threading.current_thread() not in others:
            slept_s.append(wait_s)
        sleep(wait_s)

    monkeypatch.setattr(time, "sleep", wait)
    url = f"serial://{tmp_path / 'device'}"
    with caplog.at_level(logging.INFO), running(driving(url)) as bus:
        eventually(lambda: bus.last_error is not None)
        assert "check the cable" in (bus.last_error or "")
        far = plug(tmp_path)
        eventually(lambda: _says(far, b"here", bus))
        assert bus.last_error is None
        assert bus.longest_gap_s < HUNG_S, "the process would end itself"
        assert max(slept_s) < 0.2, "it looks at the bus also while the device is away"
    os.close(far)
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]
    assert bus.rejects["device_lost"] == 0


def test_a_reconnected_device_is_read_again(tmp_path: Path) -> None:
    url = f"serial://{tmp_path / 'device'}"
    far = plug(tmp_path)
    with running(driving(url)) as bus:
        eventually(lambda: _says(far, b"before", bus))
        os.close(far)
        eventually(lambda: bus.rejects["device_lost"] == 1)
        far = plug(tmp_path)
        eventually(lambda: _says(far, b"after", bus))
    os.close(far)


def test_a_lost_device_is_closed_before_it_is_opened_again(tmp_path: Path) -> None:
    far = plug(tmp_path)
    bus = LiveBus()
    link = Link(lambda: open_device(f"serial://{tmp_path / 'device'}"))
    link.read(bus.as_bus(), 0.0)
    name = str((tmp_path / "device").readlink())
    assert name in _open_files()
    os.close(far)
    for _ in range(3):
        link.read(bus.as_bus(), 0.02)
    assert not link.present
    assert not [path for path in _open_files() if path.startswith(name)]


def test_chunks_are_stamped_with_their_arrival_time(tmp_path: Path) -> None:
    far = plug(tmp_path)
    url = f"serial://{tmp_path / 'device'}"
    with running(driving(url)) as bus:
        eventually(lambda: _says(far, b"x", bus))
        sent_ns = bus.now_ns()
        os.write(far, b"now")
        eventually(lambda: any(b"now" in message.data for message in bus.of(ImuRaw)))
        received_ns = bus.now_ns()
    stamp_ns = next(message.received_ns for message in bus.of(ImuRaw) if b"now" in message.data)
    assert sent_ns <= stamp_ns <= received_ns
    os.close(far)


def test_the_origin_of_a_live_device_is_live() -> None:
    with running(driving("serial:///dev/there-is-no-such-port")) as bus:
        eventually(lambda: bool(bus.of(Origin)))
    assert (bus.of(Origin)[0].kind, bus.of(Origin)[0].name) == (OriginKind.LIVE, "car")


def test_the_origin_of_a_recorded_file_is_replay(tmp_path: Path) -> None:
    (tmp_path / "drive.xbus").write_bytes(b"abc")
    with running(driving(f"file://{tmp_path / 'drive.xbus'}")) as bus:
        eventually(lambda: bool(bus.of(Origin)))
    assert (bus.of(Origin)[0].kind, bus.of(Origin)[0].name) == (OriginKind.REPLAY, "drive")


def _says(far: int, data: bytes, bus: LiveBus) -> bool:
    """Send bytes until they are received; the driver may not have opened the port yet."""
    os.write(far, data)
    return any(data in message.data for message in bus.of(ImuRaw))


def _open_files() -> list[str]:
    names = []
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the descriptor of this very listing
            names.append(str(path.readlink()))
    return names
