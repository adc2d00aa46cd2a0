"""The supervisor starts processes of the unit through a warm parent, and treats them as any other child."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from cli.demo.supervisor import Supervisor
from shared.runtime.warm.client import Forked, WarmStart
from tests.support.data import REPOSITORY
from tests.support.patience import HANGS_S


@pytest.fixture
def supervisor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Supervisor]:
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr("shared.runtime.warm.client.ANSWER_S", HANGS_S)  # a busy machine replaces no parent here
    made = Supervisor(os.environ, tmp_path, warm=WarmStart((), "tests.support.forked:main"))
    yield made
    made.stop()


def add(supervisor: Supervisor, *arguments: str) -> str:
    name = " ".join(arguments)
    supervisor.add(name, [sys.executable, "-c", "raise SystemExit(9)"])
    supervisor.children[name].arguments = arguments
    return name


def watch_until(supervisor: Supervisor, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        supervisor.watch()
        time.sleep(0.02)


def forked(supervisor: Supervisor, name: str) -> Forked:
    process = supervisor.children[name].process
    assert isinstance(process, Forked)
    return process


def warm_parent(supervisor: Supervisor) -> psutil.Process:
    assert supervisor.parent is not None
    return psutil.Process(supervisor.parent)


def test_a_killed_process_is_forked_again_by_the_same_parent(supervisor: Supervisor, tmp_path: Path) -> None:
    name = add(supervisor, "sleep")
    log = tmp_path / "sleep.log"
    watch_until(supervisor, lambda: log.exists() and log.read_text().count("\n") == 1)
    first = forked(supervisor, name)
    parent = warm_parent(supervisor)
    first.kill()
    watch_until(supervisor, lambda: supervisor.children[name].restarts == 1 and supervisor.alive() == 1)
    assert supervisor.children[name].exit_codes == [-signal.SIGKILL]
    assert warm_parent(supervisor) == parent
    second = forked(supervisor, name)
    assert second.pid != first.pid
    watch_until(supervisor, lambda: log.read_text().count("\n") == 2)
    supervisor.stop()
    assert second.returncode == -signal.SIGTERM
    assert not parent.is_running()


def test_one_that_rejects_its_configuration_is_not_started_again(supervisor: Supervisor) -> None:
    name = add(supervisor, "exit", str(os.EX_CONFIG))
    child = supervisor.children[name]
    watch_until(supervisor, lambda: child.misconfigured)
    supervisor.watch()
    assert child.process is None and child.exit_codes == [os.EX_CONFIG]


def test_a_killed_parent_is_replaced_and_its_children_go_on(supervisor: Supervisor) -> None:
    name, ending = add(supervisor, "sleep"), add(supervisor, "exit", "3")
    watch_until(supervisor, lambda: supervisor.children[ending].restarts > 0)
    sleeping = forked(supervisor, name)
    parent = warm_parent(supervisor)
    parent.kill()
    before = supervisor.children[ending].restarts
    watch_until(supervisor, lambda: supervisor.children[ending].restarts > before + 1)
    assert not parent.is_running()
    assert sleeping.poll() is None
    assert set(supervisor.children[ending].exit_codes) == {3}, "by a parent, and not by its command"


def test_where_no_parent_can_be_made_processes_start_by_themselves(tmp_path: Path) -> None:
    supervisor = Supervisor(os.environ, tmp_path, warm=WarmStart(("no.such.module",), "tests.support.forked:main"))
    try:
        name = add(supervisor, "sleep")
        watch_until(supervisor, lambda: supervisor.children[name].exit_codes == [9])
    finally:
        supervisor.stop()


def test_no_child_outlives_a_supervisor_that_is_killed(tmp_path: Path) -> None:
    program = f"""
import os, time
from pathlib import Path
from cli.demo.supervisor import Supervisor
from shared.runtime.warm.client import WarmStart
supervisor = Supervisor(os.environ, Path({str(tmp_path)!r}), warm=WarmStart((), "tests.support.forked:main"))
supervisor.add("sleep", ["false"])
supervisor.children["sleep"].arguments = ("sleep",)
while True:
    supervisor.watch()
    time.sleep(0.02)
"""
    with psutil.Popen([sys.executable, "-c", program], cwd=REPOSITORY) as running:
        log, deadline = tmp_path / "sleep.log", time.monotonic() + HANGS_S
        while not (log.exists() and log.read_text()):
            assert time.monotonic() < deadline, "it did not happen in time"
            time.sleep(0.02)
        started = running.children(recursive=True)
        assert len(started) == 2
        running.kill()
        running.wait(HANGS_S)
    gone, _ = psutil.wait_procs(started, HANGS_S)
    assert len(gone) == 2
