"""The health check of a container, run as a subprocess."""

import os
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.support.patience import HANGS_S

SCRIPT = Path(__file__).resolve().parents[3] / "deploy" / "healthcheck.py"


def check(alive: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-S", str(SCRIPT), *arguments],
        env={"OBU_ALIVE": str(alive)}, capture_output=True, text=True, timeout=HANGS_S, check=False,
    )  # fmt: skip


@pytest.fixture
def beating(tmp_path: Path) -> Path:
    alive = tmp_path / "alive"
    alive.touch()
    return alive


@pytest.fixture
def web_port(request: pytest.FixtureRequest) -> int:
    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(request.param if self.path == "/api/alive" else 404)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Answer)
    thread = threading.Thread(target=server.handle_request, daemon=True)
    thread.start()
    request.addfinalizer(server.server_close)
    return server.server_port


def test_a_process_with_a_fresh_heartbeat_is_healthy(beating: Path) -> None:
    assert check(beating).returncode == 0


def test_a_process_without_a_heartbeat_is_unhealthy(tmp_path: Path) -> None:
    result = check(tmp_path / "never")
    assert result.returncode == 1
    assert "no heartbeat" in result.stderr


def test_a_process_with_an_old_heartbeat_is_unhealthy(beating: Path) -> None:
    long_ago = time.time() - 30
    os.utime(beating, (long_ago, long_ago))
    assert "no heartbeat for 3" in check(beating).stderr


@pytest.mark.parametrize("web_port", [200], indirect=True)
def test_a_responding_web_server_is_healthy(beating: Path, web_port: int) -> None:
    assert check(beating, str(web_port)).returncode == 0


@pytest.mark.parametrize("web_port", [500], indirect=True)
def test_a_failing_web_server_is_unhealthy(beating: Path, web_port: int) -> None:
    result = check(beating, str(web_port))
    assert result.returncode == 1
    assert f"port {web_port}" in result.stderr
