"""The supervisor: what ends is started again, and the end is the end."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.demo.supervisor import Supervisor

SLEEPER = [sys.executable, "-c", "import time; time.sleep(60)"]
DEAF = """
import pathlib, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
pathlib.Path(sys.argv[1]).touch()
time.sleep(60)
"""


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[Supervisor]:
    made = Supervisor(os.environ, tmp_path)
    yield made
    made.stop()


def watch_until(supervisor: Supervisor, condition: Callable[[], bool], limit_s: float = 10.0) -> float:
    """Watch until something is true; the time just before the last look."""
    last_look = time.monotonic()
    deadline = last_look + limit_s
    while not condition():
        last_look = time.monotonic()
        assert last_look < deadline, "it did not happen in time"
        supervisor.watch()
        time.sleep(0.02)
    return last_look


def test_a_killed_child_is_started_again(supervisor: Supervisor) -> None:
    supervisor.add("sleeper", SLEEPER)
    watch_until(supervisor, lambda: supervisor.alive() == 1)
    child = supervisor.children["sleeper"]
    assert child.process
    child.process.kill()
    watch_until(supervisor, lambda: child.restarts == 1 and supervisor.alive() == 1)
    assert child.exit_codes == [-signal.SIGKILL]


def test_a_child_that_ends_at_once_is_started_with_growing_pauses(supervisor: Supervisor) -> None:
    supervisor.add("failing", [sys.executable, "-c", "raise SystemExit(3)"])
    child = supervisor.children["failing"]
    before_the_last_end_was_seen = watch_until(supervisor, lambda: child.restarts == 2)
    assert before_the_last_end_was_seen + 0.5 <= child.next_start <= time.monotonic() + 0.5
    assert child.exit_codes == [3, 3]


def test_a_child_that_refuses_its_configuration_is_not_started_again(supervisor: Supervisor) -> None:
    supervisor.add("refusing", [sys.executable, "-c", "raise SystemExit(78)"])
    child = supervisor.children["refusing"]
    watch_until(supervisor, lambda: child.refuses)
    supervisor.watch()
    assert child.process is None and child.restarts == 0


def test_what_a_child_says_is_kept(supervisor: Supervisor, tmp_path: Path) -> None:
    supervisor.add("speaker", [sys.executable, "-c", "print('a word')"])
    watch_until(supervisor, lambda: supervisor.children["speaker"].restarts >= 1)
    assert "a word" in (tmp_path / "speaker.log").read_text()


def test_the_end_comes_within_five_seconds_even_for_the_deaf(supervisor: Supervisor, tmp_path: Path) -> None:
    is_deaf = tmp_path / "is deaf"
    supervisor.add("deaf", [sys.executable, "-c", DEAF, str(is_deaf)])
    supervisor.add("stopped", SLEEPER)
    watch_until(supervisor, lambda: supervisor.alive() == 2 and is_deaf.exists())
    stopped = supervisor.children["stopped"].process
    assert stopped
    stopped.send_signal(signal.SIGSTOP)
    started = time.monotonic()
    supervisor.stop()
    assert time.monotonic() - started < 5.0
    assert supervisor.alive() == 0
