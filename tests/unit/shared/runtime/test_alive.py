"""Signs of life reach a service manager and a container's supervisor."""

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.runtime.alive import LOOP_SUFFIX, LivenessSignal
from tests.support.patience import HANGS_S


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify") if request.param == "path" else "")
        name = listener.getsockname()
        listener.settimeout(HANGS_S)
        yield listener, name if isinstance(name, str) else "@" + name[1:].decode()


def test_the_first_turn_makes_a_process_ready_and_each_feeds_the_watchdog(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    alive = LivenessSignal({"NOTIFY_SOCKET": address})
    alive.beat(connected=False)
    alive.beat(connected=False)
    alive.beat(connected=True)
    alive.stopping()
    said = [listener.recv(1000).decode().split("\n") for _ in range(4)]
    assert said == [
        ["READY=1", "STATUS=waiting for the broker", "WATCHDOG=1"],
        ["WATCHDOG=1"],
        ["READY=1", "STATUS=connected to the broker", "WATCHDOG=1"],
        ["STOPPING=1"],
    ]
    assert alive.fault is None


def test_a_listener_that_does_not_read_holds_nobody_up(manager: tuple[socket.socket, str]) -> None:
    alive = LivenessSignal({"NOTIFY_SOCKET": manager[1]})
    for _ in range(2000):  # more than any queue of datagrams holds
        alive.beat(connected=True)
    assert alive.fault is None
    alive.stopping()


def test_a_listener_that_has_gone_is_said(tmp_path: Path) -> None:
    alive = LivenessSignal({"NOTIFY_SOCKET": str(tmp_path / "nobody")})
    alive.beat(connected=True)
    assert alive.fault == "cannot tell the service manager: No such file or directory"
    alive.stopping()


def test_of_the_files_one_tells_of_the_loop_and_one_of_the_broker(tmp_path: Path) -> None:
    file, loop = tmp_path / "alive", tmp_path / f"alive{LOOP_SUFFIX}"
    alive = LivenessSignal({"OBU_ALIVE": str(file)})
    alive.beat(connected=False)
    assert loop.exists() and not file.exists()
    alive.beat(connected=True)
    assert file.exists() and alive.fault is None


def test_without_a_listener_nothing_is_said() -> None:
    alive = LivenessSignal({})
    alive.beat(connected=True)
    alive.stopping()
    assert alive.fault is None


def test_a_sign_that_the_listener_was_too_late_for_is_given_again(manager: tuple[socket.socket, str]) -> None:
    listener, address = manager
    others = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    others.setblocking(False)
    with others:
        target = "\0" + address[1:] if address.startswith("@") else address
        sent = 0
        with contextlib.suppress(BlockingIOError):
            for sent in range(10_000):  # noqa: B007  # as many as the listener's queue holds
                others.sendto(b"x", target)
    alive = LivenessSignal({"NOTIFY_SOCKET": address})
    alive.beat(connected=True)
    for _ in range(sent):
        assert listener.recv(10) == b"x"
    alive.beat(connected=True)
    assert listener.recv(1000).decode().startswith("READY=1"), "a service manager waits for it"
    alive.stopping()
