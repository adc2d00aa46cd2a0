"""The supervisor restarts children that end, and stops all of them."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.demo.supervisor import Supervisor
from shared.errors import UserError
from tests.support.patience import HANGS_S

SLEEPER = [sys.executable, "-c", "import time; time.sleep(60)"]
IGNORING = """
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


def watch_until(supervisor: Supervisor, condition: Callable[[], bool], limit_s: float = HANGS_S) -> float:
    """Poll until a condition holds; return the time before the last poll."""
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


def test_a_child_that_rejects_its_configuration_is_not_restarted(supervisor: Supervisor) -> None:
    supervisor.add("misconfigured", [sys.executable, "-c", "raise SystemExit(78)"])
    child = supervisor.children["misconfigured"]
    watch_until(supervisor, lambda: child.misconfigured)
    supervisor.watch()
    assert child.process is None and child.restarts == 0


def test_why_a_configuration_is_rejected_is_what_the_child_reports_and_not_what_it_logs(
    supervisor: Supervisor,
) -> None:
    script = "import os, sys; from shared.runtime.reports import begin, tell; begin(); tell(error='no such key')"
    supervisor.add("rejecting", [sys.executable, "-c", f"{script}; print('a line'); sys.exit(os.EX_CONFIG)"])
    child = supervisor.children["rejecting"]
    watch_until(supervisor, lambda: child.misconfigured)
    with pytest.raises(UserError, match=r"^rejecting does not start: no such key$"):
        supervisor.raise_rejected()


def test_the_output_of_a_child_is_logged(supervisor: Supervisor, tmp_path: Path) -> None:
    supervisor.add("printing", [sys.executable, "-c", "print('a line')"])
    watch_until(supervisor, lambda: supervisor.children["printing"].restarts >= 1)
    assert "a line" in (tmp_path / "printing.log").read_text()


def test_children_that_ignore_sigterm_or_are_stopped_end_all_the_same(supervisor: Supervisor, tmp_path: Path) -> None:
    ignores = tmp_path / "ignores"
    supervisor.add("ignoring", [sys.executable, "-c", IGNORING, str(ignores)])
    supervisor.add("stopped", SLEEPER)
    watch_until(supervisor, lambda: supervisor.alive() == 2 and ignores.exists())
    stopped = supervisor.children["stopped"].process
    assert stopped
    stopped.send_signal(signal.SIGSTOP)
    supervisor.stop()
    assert supervisor.alive() == 0
    ignoring = supervisor.children["ignoring"].process
    assert ignoring and (ignoring.returncode, stopped.returncode) == (-signal.SIGKILL, -signal.SIGTERM)


BEATING = """
import time
from shared.runtime.alive import LivenessSignal
alive = LivenessSignal()
while True:
    alive.beat(connected=True)
    time.sleep(0.05)
"""


CONNECTING = """
import time
from shared.runtime.alive import LivenessSignal
alive = LivenessSignal()
began = time.monotonic()
while True:
    alive.beat(connected=time.monotonic() - began > 0.3)
    time.sleep(0.05)
"""
RECORDER = [sys.executable, "-c", CONNECTING]


def test_the_others_start_when_one_that_runs_throughout_is_connected(supervisor: Supervisor) -> None:
    supervisor.add("other", SLEEPER)
    supervisor.add("recorder", RECORDER, throughout=True, start_limit_s=60.0)
    other, recorder = supervisor.children["other"], supervisor.children["recorder"]
    watch_until(supervisor, lambda: recorder.seen is not None)
    assert other.process is None
    watch_until(supervisor, lambda: other.process is not None)
    assert recorder.signs.is_connected
    assert recorder.process is not None
    recorder.process.kill()
    recorder.process.wait()
    supervisor.watch()
    assert other.process is not None
    other.process.kill()
    other.process.wait()
    watch_until(supervisor, lambda: other.restarts == 1 and other.process is not None)


@pytest.mark.parametrize("code", ["raise SystemExit(78)", "raise SystemExit(3)"])
def test_nobody_waits_for_one_that_has_ended(supervisor: Supervisor, code: str) -> None:
    supervisor.add("other", SLEEPER)
    supervisor.add("recorder", [sys.executable, "-c", code], throughout=True, start_limit_s=60.0)
    other = supervisor.children["other"]
    watch_until(supervisor, lambda: other.process is not None)
    assert supervisor.children["recorder"].exit_codes


def test_one_that_does_not_connect_is_waited_for_a_while_alone(
    supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cli.demo.supervisor.LISTEN_TIMEOUT_S", 0.5)
    supervisor.add("recorder", SLEEPER, throughout=True, start_limit_s=60.0)
    supervisor.add("other", SLEEPER)
    watch_until(supervisor, lambda: supervisor.alive() == 2)
    assert not supervisor.children["recorder"].signs.is_connected


@pytest.fixture
def impatient(supervisor: Supervisor, monkeypatch: pytest.MonkeyPatch) -> Supervisor:
    monkeypatch.setattr("cli.demo.supervisor.HUNG_S", 0.5)
    return supervisor


def test_a_child_that_is_stopped_is_killed_and_started_again(impatient: Supervisor) -> None:
    impatient.add("beating", [sys.executable, "-c", BEATING])
    child = impatient.children["beating"]
    watch_until(impatient, lambda: child.seen is not None)
    assert child.process
    child.process.send_signal(signal.SIGSTOP)
    watch_until(impatient, lambda: child.restarts == 1 and child.seen is not None)
    assert child.exit_codes == [-signal.SIGKILL]


def test_a_child_that_never_gives_a_sign_is_killed_if_it_should(impatient: Supervisor) -> None:
    impatient.add("mute", SLEEPER, start_limit_s=0.5)
    impatient.add("need not", SLEEPER)
    watch_until(impatient, lambda: impatient.children["mute"].restarts == 1)
    assert impatient.children["need not"].restarts == 0


def test_after_a_stop_of_the_supervisor_itself_nobody_is_killed(
    impatient: Supervisor, monkeypatch: pytest.MonkeyPatch
) -> None:
    impatient.add("beating", [sys.executable, "-c", BEATING])
    child = impatient.children["beating"]
    watch_until(impatient, lambda: child.seen is not None)
    assert child.process
    child.process.send_signal(signal.SIGSTOP)  # as Ctrl-Z does to all of them
    while child.signs.heard():
        impatient.watch()
    monkeypatch.setattr(time, "monotonic", lambda now=time.monotonic: now() + 100.0)
    impatient.watch()
    child.process.send_signal(signal.SIGCONT)
    watch_until(impatient, child.signs.heard)
    assert child.restarts == 0 and not child.exit_codes
