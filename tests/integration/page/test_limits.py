"""Limits of connections over real sockets: slow clients, too many of them, and what is written about them."""

import logging
import os
import resource
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from services.monitoring.status.web import page_errors
from services.monitoring.status.web.access import login
from shared.page import body
from shared.page.access import limits
from shared.runtime.config import ADDRESS_FILE
from tests.support.dashboard.status_server import RunningServer, eventually, status_server
from tests.support.patience import HANGS_S

ROOT = Path(__file__).parents[3]
REQUEST = b"GET /api/alive HTTP/1.1\r\nHost: localhost\r\n\r\n"
FLOOD = 1100
FILES = 1024
LOG_BYTES = 10_000
SERVER = """
import logging, resource, sys, threading
from pathlib import Path
from services.monitoring.status.process import Config, Process
from tests.support.dashboard.fake_unit import FakeBus
logging.basicConfig(level=logging.INFO)
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
bus = FakeBus(Path(sys.argv[1]))
threading.Thread(target=lambda: (sys.stdin.readline(), setattr(bus, "stopping", True)), daemon=True).start()
Process(Config.model_validate_json(sys.argv[2])).run(bus)
"""


@pytest.fixture
def short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "HEADERS_S", 0.3)


def port_of(server: RunningServer) -> int:
    port = urlsplit(server.address).port
    assert port
    return port


def opened(port: int, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=HANGS_S, source_address=(source, 0))


def is_closed(connection: socket.socket, within_s: float = HANGS_S) -> bool:
    """Whether the server closes a connection; what is still on the way of an answer is read."""
    connection.settimeout(within_s)
    try:
        while connection.recv(4096):
            pass
        return True
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False


def status_of(connection: socket.socket, request: bytes = REQUEST) -> bytes:
    connection.settimeout(HANGS_S)
    connection.sendall(request)
    return connection.recv(4096).split(b"\r\n", 1)[0]


@pytest.mark.usefixtures("short_times")
@pytest.mark.parametrize("begun", [b"", b"GET / HT", b"GET /api/alive HTTP/1.1\r\nHost: localhost\r\nX-Slow: "])
def test_headers_that_do_not_come_end_the_connection(tmp_path: Path, begun: bytes) -> None:
    with status_server(tmp_path, unit=False) as server, opened(port_of(server)) as slow:
        slow.sendall(begun)
        assert is_closed(slow)


@pytest.mark.usefixtures("short_times")
def test_the_headers_of_a_second_request_must_come_in_time_too(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as server, opened(port_of(server)) as slow:
        assert status_of(slow) == b"HTTP/1.1 200 OK"
        slow.sendall(b"GET /api/alive HTTP/1.1\r\nHo")
        assert is_closed(slow)


def test_a_body_that_does_not_come_is_answered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body, "BODY_S", 0.3)
    head = b"POST /api/login HTTP/1.1\r\nHost: localhost\r\nX-OBU-CSRF: a\r\nContent-Length: 100\r\n\r\n{"
    with status_server(tmp_path, unit=False) as server, opened(port_of(server)) as slow:
        assert status_of(slow, head).startswith(b"HTTP/1.1 408")


def test_a_connection_without_a_request_is_closed_after_the_idle_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shared.page.server.IDLE_S", 1)
    with status_server(tmp_path, unit=False) as server, opened(port_of(server)) as idle:
        assert status_of(idle) == b"HTTP/1.1 200 OK"
        assert is_closed(idle)


def test_of_one_address_the_oldest_idle_connection_gives_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits.Connections, "_limit_of", lambda *_: 4)
    with status_server(tmp_path, unit=False) as server, ExitStack() as stack:
        port = port_of(server)
        first, *others = [stack.enter_context(opened(port)) for _ in range(4)]
        assert status_of(first) == b"HTTP/1.1 200 OK"
        last = stack.enter_context(opened(port))
        assert status_of(last) == b"HTTP/1.1 200 OK"
        assert is_closed(first)
        assert [status_of(socket) for socket in others] == [b"HTTP/1.1 200 OK"] * 3


def test_where_every_connection_is_busy_a_further_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits.Connections, "_limit_of", lambda *_: 4)
    events = b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with status_server(tmp_path) as server, ExitStack() as stack:
        port = port_of(server)
        busy = [stack.enter_context(opened(port)) for _ in range(4)]
        assert [status_of(socket, events) for socket in busy] == [b"HTTP/1.1 200 OK"] * 4
        assert is_closed(stack.enter_context(opened(port)))
        busy.pop().close()

        def answered() -> bool:
            with opened(port) as again:
                try:
                    return status_of(again) == b"HTTP/1.1 200 OK"
                except ConnectionError:
                    return False

        eventually(answered)


@contextmanager
def limited_server(folder: Path, settings: str = '{"port": 0}') -> Iterator[tuple[int, Path]]:
    """Run the page as a process with 1024 open files; port and file of its log."""
    log = folder / "log.txt"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SERVER, str(folder), settings]
    with log.open("wb") as output, subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=environment, cwd=ROOT
    ) as process:  # fmt: skip
        address = folder / ADDRESS_FILE
        eventually(lambda: address.exists() and address.read_text().endswith("/"))
        port = urlsplit(address.read_text()).port
        assert port
        try:
            yield port, log
        finally:
            assert process.stdin
            process.stdin.close()
            assert process.wait(timeout=HANGS_S) == 0


@pytest.mark.parametrize("sources", [1, 100], ids=["one address", "a hundred addresses"])
def test_more_connections_than_files_leave_the_page_answering_and_the_log_short(tmp_path: Path, sources: int) -> None:
    """The files of this process are raised for the flood, and those of the page limited to 1024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2 * FLOOD:
        pytest.skip(f"this machine allows {hard} open files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2 * FLOOD), hard))
    try:
        with limited_server(tmp_path) as (port, log), ExitStack() as stack:
            flood = [flooding(stack, port, f"127.0.1.{1 + n % sources}") for n in range(FLOOD)]
            for source in ("127.0.0.9", "127.0.0.10"):
                with opened(port, source) as other:
                    assert status_of(other) == b"HTTP/1.1 200 OK"
            eventually(lambda: ended(flood) >= FLOOD - 1024 + limits.RESERVED_FILES)
            assert log.stat().st_size < LOG_BYTES, log.read_text()[:2000]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def flooding(stack: ExitStack, port: int, source: str) -> socket.socket:
    """Begin to connect, without waiting for it."""
    connection = stack.enter_context(socket.socket())
    connection.bind((source, 0))
    connection.setblocking(False)
    connection.connect_ex(("127.0.0.1", port))
    return connection


def ended(flood: list[socket.socket]) -> int:
    """Number of connections that the server has closed.

    One whose last packet of the handshake was dropped is open for the client alone, until it sends something.
    """
    poll = select.poll()
    for item in flood:
        with suppress(OSError):
            item.send(b"G")
        poll.register(item, select.POLLIN | select.POLLHUP | select.POLLERR)
    return len(poll.poll(0))


def test_garbage_is_written_a_few_times_a_minute(tmp_path: Path) -> None:
    with limited_server(tmp_path) as (port, log):
        for _ in range(200):
            with opened(port) as one:
                one.sendall(b"\x16\x03\x01 garbage\r\n\r\n")
                one.recv(100)
        assert log.stat().st_size < LOG_BYTES


def test_what_visitors_cause_is_written_a_few_times_a_minute(tmp_path: Path) -> None:
    names = (limits.__name__, "uvicorn.error", login.__name__, page_errors.__name__)
    with status_server(tmp_path, unit=False):
        for name in names:
            assert any(isinstance(present, limits.RateLimit) for present in logging.getLogger(name).filters), name
