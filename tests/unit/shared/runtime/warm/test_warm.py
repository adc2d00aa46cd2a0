"""Processes that one parent has forked: what is their own, what they share, and what the supervisor learns of them."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from shared.processes import PROCESSES
from shared.runtime.warm.client import FAILURES, Forked, WarmStart
from shared.runtime.warm.rights import Rights, Start
from tests.support.data import REPOSITORY
from tests.support.patience import HANGS_S

ENTRY = "tests.support.forked:main"
SECRET = "a-secret-of-this-test-alone"


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.01)


@pytest.fixture
def warm(monkeypatch: pytest.MonkeyPatch) -> Iterator[WarmStart]:
    monkeypatch.chdir(REPOSITORY)
    made = WarmStart((), ENTRY)
    yield made
    made.stop()


class Children:
    """Starts children with a log each, and ends them."""

    def __init__(self, warm: WarmStart, folder: Path) -> None:
        self.warm, self._folder, self._started = warm, folder, list[Forked]()

    def start(self, *arguments: str, rights: Rights | None = None, **environment: str) -> tuple[Forked, Path]:
        until(self.warm.is_ready)
        log = self._folder / f"{len(self._started)}.log"
        with log.open("ab") as output:
            child = self.warm.start(arguments, environment, output.fileno(), rights)
        assert child is not None
        self._started.append(child)
        return child, log

    def state(self, *arguments: str, rights: Rights | None = None, **environment: str) -> dict[str, Any]:
        """What a child says of itself that ends at once."""
        child, log = self.start(*(arguments or ("exit", "0")), rights=rights, **environment)
        assert child.wait(HANGS_S) == (int(arguments[1]) if arguments else 0), log.read_text()
        state: dict[str, Any] = json.loads(log.read_text().splitlines()[0])
        return state

    def end(self) -> None:
        for child in self._started:
            child.kill()
            child.wait(HANGS_S)


@pytest.fixture
def children(warm: WarmStart, tmp_path: Path) -> Iterator[Children]:
    made = Children(warm, tmp_path)
    yield made
    made.end()


def test_exit_codes_and_signals_are_seen_as_those_of_any_child(children: Children) -> None:
    codes = {code: children.start("exit", str(code))[0].wait(HANGS_S) for code in (0, 3, os.EX_CONFIG)}
    assert codes == {code: code for code in codes}
    failing, log = children.start("fail")
    assert failing.wait(HANGS_S) == 1
    assert "RuntimeError: a bug" in log.read_text()
    sleeping, log = children.start("sleep")
    until(lambda: bool(log.read_text()))
    assert sleeping.poll() is None
    sleeping.terminate()
    assert sleeping.wait(HANGS_S) == -signal.SIGTERM
    stubborn, _ = children.start("sleep")
    with pytest.raises(subprocess.TimeoutExpired):
        stubborn.wait(0.05)


def test_a_child_is_a_process_of_its_own(children: Children) -> None:
    state = children.state("exit", "0", ONE="1")
    assert state["arguments"] == ["obu", "exit", "0"]
    assert state["session"] and state["interrupt"] and state["terminate"] and not state["blocked"]
    assert state["no_new_privileges"] and state["too_large_is_an_error"]
    assert state["collects"] and state["frozen"]
    assert len(state["descriptors"]) == 3, "standard input, output and errors, and no descriptor of the parent"
    assert state["descriptors"][0] == "/dev/null"


def test_neither_environment_nor_secret_of_one_child_reaches_another_or_the_parent(children: Children) -> None:
    first = children.state("exit", "0", OBU_BROKER=f"mqtt://user:{SECRET}@host", TZ="UTC")
    assert SECRET in first["environment"]["OBU_BROKER"]
    second = children.state("exit", "0", OTHER="2")
    assert second["environment"] == {"OTHER": "2"}
    parent = children.warm.pid
    assert parent is not None
    assert SECRET not in Path(f"/proc/{parent}/environ").read_text(encoding="utf-8", errors="replace")
    assert not holds(parent, SECRET.encode())
    assert holds(parent, b"tests.support.forked"), "the search finds what is there"


def holds(pid: int, text: bytes) -> bool:
    """Whether the memory of a process that it may write holds a text."""
    areas = [line.split() for line in Path(f"/proc/{pid}/maps").read_text().splitlines()]
    with Path(f"/proc/{pid}/mem").open("rb", buffering=0) as memory:
        for place, rights, *_ in areas:
            begin, end = (int(number, 16) for number in place.split("-"))
            if rights.startswith("rw"):
                with contextlib.suppress(OSError):
                    memory.seek(begin)
                    if text in memory.read(end - begin):
                        return True
    return False


def test_the_parent_inherits_nothing_but_what_an_interpreter_needs(
    children: Children, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OBU_BROKER", f"mqtt://user:{SECRET}@host")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", "/somewhere")
    children.state()
    assert children.warm.pid is not None
    inherited = psutil.Process(children.warm.pid).environ()
    assert not [name for name in inherited if name.startswith(("OBU_", "CREDENTIALS"))]
    assert (inherited["OPENBLAS_NUM_THREADS"], inherited["OMP_NUM_THREADS"]) == ("1", "1")


def test_no_two_children_draw_the_same_random_numbers(children: Children) -> None:
    drawn = [number for _ in range(3) for number in children.state()["random"]]
    assert len(set(drawn)) == 9


def test_limits_of_a_child_are_its_own(children: Children) -> None:
    limited = children.state("exit", "0", rights=Rights(memory_bytes=4_000_000_000, files=64))
    assert limited["limits"] == [4_000_000_000, 64]
    free = children.state("exit", "0")
    assert free["limits"] != limited["limits"]
    beyond, log = children.start("sleep", rights=Rights(files=2**40))
    assert beyond.wait(HANGS_S) == 1 and not log.read_text(), "it ends before it does anything"


@pytest.mark.skipif(os.getuid() != 0, reason="only root may become another user")
def test_a_child_of_another_user_has_no_way_back(children: Children) -> None:
    state = children.state("exit", "0", rights=Rights(user=10_101, group=10_101, groups=(10_100,)))
    assert state["user"] == [10_101, 10_101, 10_101, [10_100]]


def test_what_is_asked_for_survives_the_way_to_the_parent() -> None:
    start = Start(("run", "core.fusion"), 7, Rights(1, 2, (3, 4), 5, 6, 7))
    assert Start.parse(json.loads(json.dumps(start.to_json()))) == start
    with pytest.raises(TypeError, match="no start"):
        Start.parse({"arguments": "run", "supervisor": 7, "rights": {}})


def test_a_child_is_shown_by_its_own_name(children: Children) -> None:
    child, log = children.start("sleep", "run", "core.fusion", "--folder")
    until(lambda: bool(log.read_text()))
    shown = psutil.Process(child.pid)
    assert " ".join(shown.cmdline()).strip() == "python -m cli sleep run core.fusion --folder"
    assert shown.name() == "core.fusion"
    assert shown.ppid() == os.getpid()


def test_children_go_on_when_their_parent_is_killed_and_another_one_takes_its_place(children: Children) -> None:
    child, log = children.start("sleep")
    until(lambda: bool(log.read_text()))
    before = children.warm.pid
    assert before is not None
    os.kill(before, signal.SIGKILL)
    until(lambda: children.warm.is_ready() and children.warm.pid != before)
    assert child.poll() is None
    children.state("exit", "0")
    child.kill()
    assert child.wait(HANGS_S) == -signal.SIGKILL


def test_a_parent_that_does_not_answer_is_replaced(children: Children, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shared.runtime.warm.client.ANSWER_S", 0.2)
    children.state()
    stopped = children.warm.pid
    assert stopped is not None
    os.kill(stopped, signal.SIGSTOP)
    assert children.warm.start(("exit", "0"), {}) is None
    assert not psutil.pid_exists(stopped)
    monkeypatch.undo()
    children.state()


def test_a_process_whose_number_the_supervisor_does_not_learn_ends_before_it_does_anything(
    children: Children, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    children.state()
    monkeypatch.setattr("shared.runtime.warm.client.ANSWER_S", 0.0)  # a millisecond: less than two forks take
    log = tmp_path / "unknown.log"
    with log.open("ab") as output:
        assert children.warm.start(("sleep", "unknown"), {}, output.fileno()) is None
    until(lambda: not [child for child in psutil.Process().children() if "unknown" in " ".join(shown(child))])
    assert not log.read_text()
    for child in psutil.Process().children():  # it was adopted for the moment of the fork
        if child.status() == psutil.STATUS_ZOMBIE:
            os.waitpid(child.pid, 0)


def shown(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:  # it has ended
        return []


def test_a_user_without_its_groups_is_no_right() -> None:
    with pytest.raises(ValueError, match="would keep those of the parent"):
        Rights(user=10_101)


def test_a_parent_of_files_that_have_changed_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "replaced.py"
    module.write_text("import sys\ndef main(): sys.exit(3)\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{REPOSITORY}")
    warm = WarmStart((), "replaced:main")
    try:
        until(warm.is_ready)
        old = warm.start(("x",), {})
        assert old is not None and old.wait(HANGS_S) == 3
        module.write_text("import sys\ndef main(): sys.exit(44)\n")
        assert warm.start(("x",), {}) is None
        until(warm.is_ready)
        new = warm.start(("x",), {})
        assert new is not None and new.wait(HANGS_S) == 44
    finally:
        warm.stop()


def test_a_parent_with_a_second_thread_refuses_and_is_given_up_after_some_attempts(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(REPOSITORY)
    warm = WarmStart(("tests.support.threaded",), ENTRY)
    try:
        for _ in range(FAILURES):
            until(warm.is_ready)
            assert warm.start(("exit", "0"), {}) is None
        assert warm.is_given_up and not warm.is_ready() and warm.pid is None
        monkeypatch.setattr(warm, "_retry_s", 0.0)
        assert not warm.is_given_up
        until(warm.is_ready)  # a while later another parent is tried
    finally:
        warm.stop()
    assert "has 2 threads" in caplog.text


def test_what_a_child_leaves_behind_is_no_child_of_the_supervisor(children: Children) -> None:
    child, log = children.start("orphan")
    assert child.wait(HANGS_S) == 0, log.read_text()
    assert all(os.getpgid(other.pid) != child.pid for other in psutil.Process().children())


IMPORT_ALL = """
import builtins, collections.abc, json, os, sys
from pathlib import Path

LIBRARY = ("/os.py", "/_collections_abc.py", "/posixpath.py", "/pathlib.py")
read = []
class Watched(dict):
    def _note(self, name):
        frame = sys._getframe(2)
        while frame.f_code.co_filename.startswith("<frozen") or frame.f_code.co_filename.endswith(LIBRARY):
            frame = frame.f_back
        read.append((os.path.relpath(frame.f_code.co_filename, {root!r}), name))
    def __getitem__(self, name):
        self._note(name)
        return super().__getitem__(name)
    def get(self, name, default=None):
        self._note(name)
        return super().get(name, default)
    def __contains__(self, name):
        self._note(name)
        return super().__contains__(name)

os.environ = Watched(os.environ)
os.getenv = os.environ.get
from shared.runtime.warm.kernel import threads
from shared.runtime.warm.parent import prepare
opened = set(os.listdir("/proc/self/fd"))
prepare({modules!r})
print(json.dumps({{
    "read": [(file, name) for file, name in read if not file.startswith(("..", ".venv"))],
    "threads": threads(), "opened": len(set(os.listdir("/proc/self/fd")) - opened),
    "numba": "numba" in sys.modules,
}}))
"""


def test_what_all_processes_import_reads_no_environment_opens_no_file_and_starts_no_thread() -> None:
    processes = [f"services.{row.name}.process" for row in PROCESSES]
    modules = ["cli.__main__", "shared.runtime.live", *sorted(processes)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL.format(root=str(REPOSITORY), modules=modules)],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    # Whether Numba compiles is decided at import: the parent sets it itself, and it is the same for every child.
    assert {tuple(row) for row in found["read"]} <= {("shared/maths/compiled.py", "NUMBA_DISABLE_JIT")}
    assert (found["threads"], found["opened"], found["numba"]) == (1, 0, False)
