"""Programs that end with the process that has started them, even where that is killed."""

import pwd
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from shared.runtime.warm.client import Forked

from .logs import BoundedLog

END_S = 20.0  # in which a program must end by itself


class Child:
    """A program that runs from `_run` until `stop`."""

    def __init__(self, log: Path, ends_by: signal.Signals = signal.SIGTERM, user: str | None = None) -> None:
        self.log = BoundedLog(log)
        self._ends_by, self._user = ends_by, user
        self._process: subprocess.Popen[bytes] | Forked | None = None

    @property
    def pid(self) -> int | None:
        """Its process, while it runs."""
        return None if self._process is None else self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether its process is there."""
        return self._process is not None and self._process.poll() is None

    def stop(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.send_signal(self._ends_by)
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = None

    def cause(self) -> str:
        """Why it has ended: by its log, unless it had no time to say so."""
        code = None if self._process is None else self._process.poll()
        if code == -signal.SIGKILL:
            return "it was killed"
        return f"{self.log.cause()} ({how_ended(code)})"

    def _run(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Start it with its output in its log; Ctrl-C is for the parent, which ends it."""
        with self.log.output() as output:
            self._process = subprocess.Popen(
                bound_to_parent(command, self._ends_by.name.removeprefix("SIG"), self._user),
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, cwd="/" if self._user else None,
                env=environment, start_new_session=True,
            )  # fmt: skip


def bound_to_parent(command: Sequence[str], ends_by: str, user: str | None = None) -> list[str]:
    """Give the command that runs a program as a user, and sends it a signal when its parent is gone.

    The program takes the place of the command: its process is the one that is started. Without util-linux the server
    outlives a parent that is killed; another user needs it.
    """
    if shutil.which("setpriv") is None and user is None:
        return list(command)
    words = ["setpriv", "--pdeathsig", ends_by]
    if user is not None:
        entry = pwd.getpwnam(user)
        words += ["--reuid", str(entry.pw_uid), "--regid", str(entry.pw_gid), "--clear-groups"]
    return [*words, "--", *command]


def how_ended(code: int | None) -> str:
    """Say how a process has ended."""
    return f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
