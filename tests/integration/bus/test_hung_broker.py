"""A broker that hangs is noticed by a probe, which needs no rights, and is killed where a container runs it."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from broker import keys, local_config, probe
from cli.demo.local import free_port
from shared.runtime.config import parse_vehicle
from tests.support.bus import mosquitto

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.broker
WITHIN_S = 20.0


@pytest.fixture
def running(tmp_path: Path) -> Iterator[mosquitto.Mosquitto]:
    broker = mosquitto.start(tmp_path)
    yield broker
    broker.stop()


def program_on(port: int) -> psutil.Process:
    """Find the Mosquitto that listens on a port."""
    found = [c.pid for c in psutil.net_connections("tcp4") if c.laddr and c.laddr.port == port and c.status == "LISTEN"]
    (pid,) = set(found)
    return psutil.Process(pid)


def test_a_broker_answers_its_probe_until_it_hangs(
    running: mosquitto.Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "ANSWER_S", 0.5)
    asked = probe.Probe(running.port)
    assert asked.ask() and asked.ask()
    broker = program_on(running.port)
    broker.send_signal(signal.SIGSTOP)
    try:
        assert not asked.ask()
        assert not asked.ask(), "a new connection is accepted by the kernel, and not answered"
    finally:
        broker.send_signal(signal.SIGCONT)
    assert asked.ask()
    asked.close()


def test_a_refusal_is_an_answer_and_nothing_that_listens_is_none(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        asked = probe.Probe(server.getsockname()[1], "secret")
        client = subprocess.Popen(
            [sys.executable, "-c", "import socket, sys; s = socket.socket(fileno=int(sys.argv[1])); c, _ = s.accept(); "
             "p = c.recv(100); assert b'broker.watch' in p and b'secret' in p; c.sendall(bytes([0x20, 2, 0, 5]))",
             str(server.fileno())], pass_fds=[server.fileno()],
        )  # fmt: skip
        assert asked.ask()
        assert client.wait(WITHIN_S) == 0
    assert not asked.ask()


def test_the_program_of_the_probe_tells_the_service_manager_and_ends_with_the_broker(
    running: mosquitto.Mosquitto, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(WITHIN_S)
        shell = subprocess.Popen(
            ["sh", "-c", f"{sys.executable} -I -S {ROOT}/broker/probe.py {running.port} & exec sleep 60"],
            env={"NOTIFY_SOCKET": str(tmp_path / "notify"), "PATH": os.environ["PATH"]},
        )
        assert manager.recv(100) == b"READY=1\nWATCHDOG=1"
        assert manager.recv(100) == b"WATCHDOG=1"
        (program,) = psutil.Process(shell.pid).children()
        shell.kill()
        shell.wait()
        program.wait(WITHIN_S)


def test_the_simulated_broker_tells_the_service_manager_itself(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(WITHIN_S)
        broker = subprocess.Popen(
            [sys.executable, "-m", "broker.simulated", "--port", "0"], cwd=ROOT, stdout=subprocess.DEVNULL,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")},
        )  # fmt: skip
        try:
            assert manager.recv(1000).startswith(b"READY=1")
            assert manager.recv(1000) == b"WATCHDOG=1"
        finally:
            broker.terminate()
            broker.wait(WITHIN_S)


@pytest.mark.slow
def test_in_a_container_a_hung_broker_is_killed_and_its_script_ends(tmp_path: Path) -> None:
    program, busybox = local_config.executable(), shutil.which("busybox")
    if program is None or (busybox is None and shutil.which("nc") is None):
        pytest.skip("neither busybox nor nc is installed: `apt install busybox`")
    tools = tmp_path / "tools"
    tools.mkdir()
    if busybox:  # as in the image of Mosquitto
        for name in ("sh", "sed", "tail", "cat", "cut", "dd", "wc", "timeout", "nc", "sleep", "stat", "tr"):
            (tools / name).symlink_to(busybox)
    port = free_port()
    rules = tmp_path / "rules"
    keys.make(tmp_path / "credentials", parse_vehicle(""), keys.KeyFileOwners("", str(rules)))
    config = local_config.write(tmp_path, port, rules)
    with (tmp_path / "log").open("wb") as log:
        script = subprocess.Popen(
            ["sh", str(ROOT / "broker" / "start.sh"), program, str(config)], stderr=log, stdout=log,
            env={"PATH": f"{tools}:{os.environ['PATH']}", "OBU_BROKER_WATCH": "1"},
        )  # fmt: skip
    deadline = time.monotonic() + WITHIN_S
    while b"as broker.watch" not in (tmp_path / "log").read_bytes():
        assert time.monotonic() < deadline, (tmp_path / "log").read_text()
        time.sleep(0.1)
    program_on(port).send_signal(signal.SIGSTOP)
    assert script.wait(WITHIN_S) == 128 + signal.SIGKILL
    assert "the broker hangs" in (tmp_path / "log").read_text()
