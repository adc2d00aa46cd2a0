"""Supervises a set of processes: starts them, restarts them when they end or hang, and stops them within a deadline."""

import logging
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from shared.errors import UserError
from shared.runtime.reports import VARIABLE, read_report
from shared.runtime.warm.client import Forked, WarmStart, end_with_this

from .signs_of_life import SignsOfLife

log = logging.getLogger(__name__)

BACK_OFF_S = (0.1, 0.5, 1.0, 2.0, 5.0)
SETTLING_TIME_S = 10.0  # run time after which earlier failures no longer lengthen the pause
STOP_S = 4.0
LAST_STOP_S = 0.5  # for those that end last
HUNG_S = 14.0  # without a sign of life, after which a child is killed; one that can ends itself before, and tells where
LISTEN_TIMEOUT_S = 20.0  # that the others wait for one that runs throughout
START_S = 90.0  # until the first sign of a process, which may be long on a machine that starts everything at once
UNATTENDED_S = 3.0  # between two calls of `watch`: the supervisor was stopped itself, perhaps with its children


@dataclass
class Child:
    """One supervised process: its command and its history."""

    name: str
    command: Sequence[str]
    log_file: Path | None
    throughout: bool = False
    start_limit_s: float | None = None  # None: a child that need not give signs of life
    report: Path | None = None  # file of what it tells beside its exit code
    signs: SignsOfLife = field(default_factory=SignsOfLife)
    seen: float | None = None  # when the last sign of this run came
    arguments: Sequence[str] = ()  # of `obu`, with which the warm parent starts it; () of another program
    process: subprocess.Popen[bytes] | Forked | None = None
    started: float = 0.0
    next_start: float = 0.0
    failures: int = 0
    restarts: int = 0
    misconfigured: bool = False
    exit_codes: list[int] = field(default_factory=list)


class Supervisor:
    """Starts each child, and restarts it with growing pauses when it ends by itself.

    A child that exits with `EX_CONFIG` is not restarted: it would end again; one that exits with `EX_TEMPFAIL` wants to
    be started again with other settings. One that has given signs of life and gives
    no more is killed, and restarted.
    """

    def __init__(
        self, environment: Mapping[str, str], log_folder: Path | None = None, *, warm: WarmStart | None = None
    ) -> None:
        """Start nothing yet; with `warm`, processes of the unit are forked from its parent."""
        self._environment = dict(environment)
        self._warm = warm
        self._log_folder = log_folder
        self._watched = time.monotonic()
        self.children: dict[str, Child] = {}

    def add(
        self, name: str, command: Sequence[str], *, throughout: bool = False, start_limit_s: float | None = None
    ) -> None:
        """Add a child, which `watch` starts.

        One that runs `throughout` is started before the others and stopped after them. With `start_limit_s` a child is
        killed unless it gives a sign of life within this time [s]; if it runs throughout, the others wait until it is
        connected to the broker, but not for long.
        """
        log_file = self._log_folder / f"{name}.log" if self._log_folder else None
        report = self._log_folder / f"{name}.report.json" if self._log_folder else None
        self.children[name] = Child(name, command, log_file, throughout, start_limit_s, report)

    def add_process(self, name: str, *, throughout: bool = False) -> None:
        """Add a process of the unit."""
        command = [sys.executable, "-m", "cli", "run", name]
        self.add(name, command, throughout=throughout, start_limit_s=START_S)
        self.children[name].arguments = ("run", name)

    def watch(self) -> None:
        """Start the children that are due, detect those that ended, kill those that hang; to be called often."""
        now = time.monotonic()
        late_s, self._watched = now - self._watched, now
        if self._warm is not None:
            self._warm.is_ready()  # a parent that has ended is replaced before it is needed
        for child in self.children.values():
            _listen(child, now)
            if late_s > UNATTENDED_S and child.seen is not None:
                child.seen = now
            if child.process is None:
                if now >= child.next_start and (child.throughout or not self._waits(now)):
                    self._start(child)
            elif (code := child.process.poll()) is not None:
                self._ended(child, code, now)
            elif hangs(child, now):
                log.warning("%s hangs and is killed", child.name)
                child.process.kill()

    def stop(self) -> None:
        """Stop every child: SIGTERM, and SIGKILL after four seconds."""
        deadline = time.monotonic() + STOP_S
        for throughout in (False, True):
            children = [child for child in self.children.values() if child.throughout is throughout]
            for child in children:
                if child.process is not None and child.process.poll() is None:
                    child.process.send_signal(signal.SIGTERM)
                    child.process.send_signal(signal.SIGCONT)  # a stopped child does not receive SIGTERM
            for child in children:
                _wait_for_end(child, deadline if not throughout else deadline + LAST_STOP_S)
        for child in self.children.values():
            child.signs.close()
        if self._warm is not None:
            self._warm.stop()

    def raise_rejected(self) -> None:
        """Raise `UserError` with the report of a child that exited with `EX_CONFIG`."""
        for child in self.children.values():
            if child.misconfigured and child.report is not None:
                error = read_report(child.report).error
                raise UserError(f"{child.name} does not start: {error or f'its log is {child.log_file}'}")

    @property
    def parent(self) -> int | None:
        """Process from which those of the unit are forked."""
        return self._warm.pid if self._warm is not None else None

    def alive(self) -> int:
        """Number of running children."""
        return sum(c.process is not None and c.process.poll() is None for c in self.children.values())

    def _waits(self, now: float) -> bool:
        """Whether one that runs throughout does not listen yet; one that has ended once is waited for no more."""
        return any(
            not child.signs.is_connected and (child.process is None or now - child.started < LISTEN_TIMEOUT_S)
            for child in self.children.values()
            if child.throughout and child.start_limit_s is not None and not child.exit_codes
        )

    def _start(self, child: Child) -> None:
        """Start a child; one that waits for the warm parent is started by a later call."""
        warm = self._warm if child.arguments else None
        if warm is not None and not warm.is_given_up and not warm.is_ready():
            return
        if child.report is not None:
            child.report.unlink(missing_ok=True)
        environment = {**self._environment, "NOTIFY_SOCKET": child.signs.address, VARIABLE: str(child.report or "")}
        with child.log_file.open("ab") if child.log_file else nullcontext() as output:
            if warm is None or warm.is_given_up:
                child.process = subprocess.Popen(
                    [*end_with_this(), *child.command],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT if output else None,
                )
            else:
                child.process = warm.start(child.arguments, environment, output.fileno() if output else None)
        child.started, child.seen = time.monotonic(), None

    def _ended(self, child: Child, code: int, now: float) -> None:
        child.process = None
        child.exit_codes = [*child.exit_codes[-9:], code]
        if code == os.EX_CONFIG:
            child.misconfigured, child.next_start = True, math.inf
            log.error("%s rejects its configuration; correct it and restart the unit", child.name)
            return
        if code == os.EX_TEMPFAIL:
            child.failures, child.next_start = 0, now
            log.info("%s starts again with other settings", child.name)
            return
        child.failures = 0 if now - child.started > SETTLING_TIME_S else child.failures + 1
        pause = BACK_OFF_S[min(max(child.failures - 1, 0), len(BACK_OFF_S) - 1)]
        child.next_start = now + pause
        child.restarts += 1
        log.warning("%s ended with %d, restart in %.1f s", child.name, code, pause)


def _listen(child: Child, now: float) -> None:
    if child.signs.heard():
        child.seen = now


def hangs(child: Child, now: float) -> bool:
    """Whether a running child has given no sign of life for too long."""
    if child.seen is not None:
        return now - child.seen > HUNG_S
    return child.start_limit_s is not None and now - child.started > child.start_limit_s


def _wait_for_end(child: Child, deadline: float) -> None:
    if child.process is None:
        return
    try:
        child.process.wait(max(0.0, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        log.warning("%s did not end in time and was killed", child.name)
        child.process.kill()
        child.process.wait()
