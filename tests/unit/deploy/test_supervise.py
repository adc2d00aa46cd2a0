"""The shell in front of a container's process: passes signals and exit codes on, and kills what hangs."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from tests.support.patience import HANGS_S

SCRIPT = Path(__file__).resolve().parents[3] / "deploy" / "supervise.sh"
BEATING = """
import signal, sys, time
from shared.runtime.alive import LivenessSignal
signal.signal(signal.SIGTERM, lambda *_: sys.exit(78))
alive = LivenessSignal()
while True:
    alive.beat(connected=False)
    time.sleep(0.1)
"""
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    started: list[subprocess.Popen[bytes]] = []

    def start(*command: str, script: Path = SCRIPT) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "OBU_ALIVE": str(tmp_path / "alive")}
        with (tmp_path / "log").open("wb") as log:
            started.append(subprocess.Popen(["sh", str(script), *command], env=environment, stderr=log))
        return started[-1]

    yield start
    for shell in started:
        shell.terminate()
        shell.wait(HANGS_S)


def beating(folder: Path, shell: subprocess.Popen[bytes]) -> psutil.Process:
    """Wait for the first turn of the loop, and find the program."""
    deadline = time.monotonic() + HANGS_S
    while not (folder / "alive.loop").exists():
        assert time.monotonic() < deadline and shell.poll() is None
        time.sleep(0.05)
    return next(child for child in psutil.Process(shell.pid).children() if "python" in child.name())


def test_exit_codes_pass_and_a_command_that_gives_no_signs_is_left_alone(start: Start) -> None:
    assert start(sys.executable, "-c", "raise SystemExit(78)").wait(HANGS_S) == 78
    assert start("true").wait(HANGS_S) == 0


def test_the_exit_code_of_a_command_that_ends_before_the_shell_waits_for_it_is_kept(
    start: Start, tmp_path: Path
) -> None:
    """As on a busy machine: another program runs and ends in between, and the shell learns of both."""
    slow = tmp_path / "supervise.sh"
    text = SCRIPT.read_text()
    assert "child=$!\n" in text
    slow.write_text(text.replace("child=$!\n", "child=$!\nsleep 0.3\n/bin/true\n"))
    assert start("sh", "-c", "exit 78", script=slow).wait(HANGS_S) == 78


def test_sigterm_reaches_the_process_whose_exit_code_is_kept(start: Start, tmp_path: Path) -> None:
    shell = start(sys.executable, "-c", BEATING, "run", "x")
    beating(tmp_path, shell)
    shell.terminate()
    assert shell.wait(HANGS_S) == 78


@pytest.mark.slow
def test_a_process_that_is_stopped_is_killed(start: Start, tmp_path: Path) -> None:
    shell = start(sys.executable, "-c", BEATING, "run", "x")
    child = beating(tmp_path, shell)
    child.send_signal(signal.SIGSTOP)
    assert shell.wait(HANGS_S) == 128 + signal.SIGKILL
    assert "hangs: no turn of its loop for 14 s" in (tmp_path / "log").read_text()


def test_it_takes_less_than_five_megabytes(start: Start, tmp_path: Path) -> None:
    shell = start(sys.executable, "-c", BEATING, "run", "x")
    child = beating(tmp_path, shell)
    root = psutil.Process(shell.pid)
    cost = [process for process in (root, *root.children(recursive=True)) if process.pid != child.pid]
    assert cost and sum(process.memory_full_info().pss for process in cost) < 5e6
