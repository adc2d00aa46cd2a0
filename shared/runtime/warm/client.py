"""The side of the supervisor: it keeps a parent ready, asks it for processes, and waits for them."""

import array
import json
import logging
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack

from .kernel import adopt_orphans
from .parent import GO_AHEAD
from .rights import Rights, Start

log = logging.getLogger(__name__)

ANSWER_S = 5.0  # for which the supervisor waits; a fork takes some milliseconds
READY_S = 90.0  # in which a parent must have imported its modules
FAILURES = 3  # of parents in a row that were never ready: processes start by themselves for a while
RETRY_S = 60.0  # after so many failures, until another parent is tried: an update may have been under way
POLL_S = 0.02
# Of the environment, what an interpreter needs: the rest is of the children, and may hold secrets.
KEPT = ("PATH", "HOME", "LANG", "LANGUAGE", "TZ", "VIRTUAL_ENV", "XDG_CACHE_HOME")
KEPT_PREFIXES = ("LC_", "LD_", "PYTHON", "MALLOC_", "GLIBC_", "OPENBLAS_", "NPY_")  # read at start or at import alone
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_DISABLE_JIT": "1"}


def end_with_this() -> list[str]:
    """Prefix of a command with which the kernel sends it SIGTERM when this process is killed (requires util-linux)."""
    return ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []


class Forked:
    """A process that the parent has forked: a child of this process, with what `subprocess.Popen` offers."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Its exit code, or None while it runs."""
        if self.returncode is None:
            try:
                pid, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # SIGCHLD is ignored here: its exit code is lost, as for `subprocess.Popen`
                pid, status = self.pid, 0
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; raises `subprocess.TimeoutExpired`."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if timeout is not None and deadline is not None and time.monotonic() >= deadline:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(POLL_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


class WarmStart:
    """Keeps one parent, and replaces it when it ends, hangs or no longer is of the files on the disk."""

    def __init__(self, modules: Sequence[str], entry: str) -> None:
        """Make no parent yet; it imports `modules`, and its children call `entry`, written as module:function."""
        self._modules, self._entry = tuple(modules), entry
        self._parent: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._since = 0.0
        self._ready = False
        self._failures = 0
        self._retry_s = 0.0 if sys.platform == "linux" else math.inf  # until then no parent is made

    @property
    def pid(self) -> int | None:
        """Process of the parent."""
        return self._parent.pid if self._parent is not None else None

    @property
    def is_given_up(self) -> bool:
        """Whether no parent can be made now; processes then start by themselves."""
        return time.monotonic() < self._retry_s

    def is_ready(self) -> bool:
        """Whether a process can be started now; makes a parent where there is none."""
        if self.is_given_up:
            return False
        if self._parent is None:
            self._begin()
        elif self._parent.poll() is not None:
            self._drop("has ended", failed=not self._ready)
        elif not self._ready:
            self._ready = self._answer(0.0) is not None
            if not self._ready and time.monotonic() - self._since > READY_S:
                self._drop("was not ready in time")
        return self._ready

    def start(
        self,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        output: int | None = None,
        rights: Rights | None = None,
    ) -> Forked | None:
        """Start a process with arguments of `obu`; None if the parent did not, which is replaced.

        `output` is the descriptor of its log; without one it writes where this process does. Orphans are adopted for
        the moment of the fork alone, so that this process is the parent of what it asked for, and of nothing else.
        """
        if self._connection is None:
            return None
        try:
            adopt_orphans()
        except OSError as error:  # a kernel or a container without it
            self._failures = FAILURES
            self._drop(f"cannot give its processes to this one: {error}")
            return None
        try:
            return self._start(arguments, environment, output, rights or Rights())
        finally:
            adopt_orphans(adopt=False)

    def stop(self) -> None:
        """End the parent; its children go on."""
        self._close()

    def _start(
        self, arguments: Sequence[str], environment: Mapping[str, str], output: int | None, rights: Rights
    ) -> Forked | None:
        assert self._connection is not None
        request = json.dumps(Start(tuple(arguments), os.getpid(), rights).to_json()).encode()
        with ExitStack() as opened:
            try:
                variables = os.memfd_create("environment", os.MFD_CLOEXEC)
                opened.callback(os.close, variables)
                os.write(variables, json.dumps(dict(environment)).encode())
                waits, go_ahead = os.pipe()
                opened.callback(os.close, go_ahead)
                try:
                    written = (1, 2) if output is None else (output, output)
                    descriptors = array.array("i", (*written, variables, waits))
                    self._connection.sendmsg([request], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, descriptors)])
                finally:
                    os.close(waits)
            except OSError as error:
                self._drop(f"does not listen: {error}")
                return None
            answer = self._answer(ANSWER_S)
            pid = answer.get("pid") if answer is not None else None
            if isinstance(pid, int):
                self._failures = 0
                os.write(go_ahead, GO_AHEAD)  # without it the process ends: it is not started twice
                return Forked(pid)
        if answer is None:
            self._drop("does not answer")
            return None
        self._drop(str(answer.get("refused")), failed=not answer.get("stale"))
        return None

    def _begin(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        kept = {k: v for k, v in os.environ.items() if k in KEPT or k.startswith(KEPT_PREFIXES)}
        with theirs:
            self._parent = subprocess.Popen(
                [
                    *end_with_this(), sys.executable, "-m", __package__, str(theirs.fileno()), self._entry,
                    *self._modules,
                ],
                env=kept | ONE_THREAD, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], start_new_session=True,
            )  # fmt: skip
        self._connection, self._since, self._ready = ours, time.monotonic(), False

    def _answer(self, seconds: float) -> dict[str, object] | None:
        assert self._connection is not None
        self._connection.settimeout(seconds or 1e-3)
        try:
            text = self._connection.recv(4096)
            answer = json.loads(text) if text else None
        except (OSError, ValueError):
            return None
        return answer if isinstance(answer, dict) else None

    def _drop(self, reason: str, *, failed: bool = True) -> None:
        """Give up a parent, so that the next one is made."""
        self._failures += failed
        then = "another one takes its place"
        if self._failures >= FAILURES:
            self._retry_s = time.monotonic() + RETRY_S
            then = f"processes start by themselves, and another one is tried in {RETRY_S:.0f} s"
        log.warning("the parent of the processes %s; %s", reason, then)
        self._close()

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        if self._parent is not None:
            self._parent.kill()
            self._parent.wait()
        self._parent, self._connection, self._ready = None, None, False
