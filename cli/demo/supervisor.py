"""Supervises a set of processes: starts them, restarts them when they end, and stops them within a deadline."""

import logging
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from shared.errors import UserError

log = logging.getLogger(__name__)

BACK_OFF_S = (0.1, 0.5, 1.0, 2.0, 5.0)
SETTLED_S = 10.0  # run time after which earlier failures no longer lengthen the pause
STOP_S = 4.0
LAST_STOP_S = 0.5  # for those that end last


@dataclass
class Child:
    """One supervised process: its command and its history."""

    name: str
    command: Sequence[str]
    log_file: Path | None
    last: bool = False
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    next_start: float = 0.0
    failures: int = 0
    restarts: int = 0
    misconfigured: bool = False
    exit_codes: list[int] = field(default_factory=list)


class Supervisor:
    """Starts each child, and restarts it with growing pauses when it ends by itself.

    A child that exits with `EX_CONFIG` is not restarted: it would end again.
    """

    def __init__(self, environment: Mapping[str, str], log_folder: Path | None = None) -> None:
        self._environment = dict(environment)
        self._log_folder = log_folder
        self.children: dict[str, Child] = {}

    def add(self, name: str, command: Sequence[str], *, last: bool = False) -> None:
        """Add a child, which `watch` starts; with `last` it is stopped after the others."""
        log_file = self._log_folder / f"{name}.log" if self._log_folder else None
        self.children[name] = Child(name, command, log_file, last)

    def add_process(self, name: str, *, last: bool = False) -> None:
        """Add a process of the unit."""
        self.add(name, [sys.executable, "-m", "cli", "run", name], last=last)

    def watch(self) -> None:
        """Start the children that are due and detect those that ended; called a few times a second."""
        now = time.monotonic()
        for child in self.children.values():
            if child.process is None:
                if now >= child.next_start:
                    self._start(child)
            elif (code := child.process.poll()) is not None:
                self._ended(child, code, now)

    def stop(self) -> None:
        """Stop every child: SIGTERM, and SIGKILL after four seconds."""
        deadline = time.monotonic() + STOP_S
        for last in (False, True):
            children = [child for child in self.children.values() if child.last is last]
            for child in children:
                if child.process is not None and child.process.poll() is None:
                    child.process.send_signal(signal.SIGTERM)
                    child.process.send_signal(signal.SIGCONT)  # a stopped child does not receive SIGTERM
            for child in children:
                _wait_for_end(child, deadline if not last else deadline + LAST_STOP_S)

    def raise_rejected(self) -> None:
        """Raise `UserError` with the last line of the log of a child that exited with `EX_CONFIG`."""
        for child in self.children.values():
            if child.misconfigured and child.log_file:
                lines = child.log_file.read_text(encoding="utf-8", errors="replace").splitlines()
                raise UserError(
                    f"{child.name} does not start: {lines[-1].removeprefix('obu: ') if lines else 'no reason'}"
                )

    def alive(self) -> int:
        """Number of running children."""
        return sum(c.process is not None and c.process.poll() is None for c in self.children.values())

    def _start(self, child: Child) -> None:
        output = child.log_file.open("ab") if child.log_file else None
        try:
            child.process = subprocess.Popen(
                [*_end_with_parent(), *child.command],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT if output else None,
            )
        finally:
            if output:
                output.close()
        child.started = time.monotonic()

    def _ended(self, child: Child, code: int, now: float) -> None:
        child.process = None
        child.exit_codes = [*child.exit_codes[-9:], code]
        if code == os.EX_CONFIG:
            child.misconfigured, child.next_start = True, math.inf
            log.error("%s rejects its configuration; correct it and restart the unit", child.name)
            return
        child.failures = 0 if now - child.started > SETTLED_S else child.failures + 1
        pause = BACK_OFF_S[min(max(child.failures - 1, 0), len(BACK_OFF_S) - 1)]
        child.next_start = now + pause
        child.restarts += 1
        log.warning("%s ended with %d, restart in %.1f s", child.name, code, pause)


def _wait_for_end(child: Child, deadline: float) -> None:
    if child.process is None:
        return
    try:
        child.process.wait(max(0.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        log.warning("%s did not end in time and was killed", child.name)
        child.process.kill()
        child.process.wait()


def _end_with_parent() -> list[str]:
    """Prefix with which the kernel sends SIGTERM to a child when the supervisor is killed (requires util-linux)."""
    return ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
