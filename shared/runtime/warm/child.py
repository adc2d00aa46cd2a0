"""The steps by which a forked process becomes its own: they are in an order, and each is taken once."""

import json
import os
import random
import signal
import ssl
import sys
import time
from pathlib import Path

from .kernel import end_with_parent, show_as
from .parent import GO_AHEAD, Born


def become(born: Born) -> None:
    """Turn a fork of the parent into a process with the rights, environment, log and seeds that are its own."""
    start = born.start
    _close_others({born.output, born.errors, born.environment, born.go_ahead})
    os.setsid()
    show_as(" ".join(("python", "-m", "cli", *start.arguments)), start.name)
    _reset_signals()
    _await_supervisor(born.go_ahead)
    start.rights.take()
    end_with_parent(signal.SIGTERM)  # after the rights: a change of the user cancels it
    if os.getppid() != start.supervisor:
        os._exit(128 + signal.SIGTERM)
    _take_environment(born.environment)
    _take_output(born.output, born.errors)
    _seed()
    sys.argv = ["obu", *start.arguments]


def _close_others(kept: set[int]) -> None:
    """Close every descriptor that the parent had open, its connection to the supervisor above all."""
    for number in [int(path.name) for path in Path("/proc/self/fd").iterdir()]:
        if number > 2 and number not in kept:
            try:
                os.close(number)
            except OSError:
                continue  # that of the list itself


def _reset_signals() -> None:
    """Handle signals as a program of Python does that was just started."""
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        if isinstance(number, signal.Signals):
            signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):  # as Python does: a write fails, and does not end the process
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def _await_supervisor(go_ahead: int) -> None:
    """Wait until the supervisor knows this process; one that it does not know of ends, and is started again."""
    known = os.read(go_ahead, 1) == GO_AHEAD
    os.close(go_ahead)
    if not known:
        os._exit(128 + signal.SIGTERM)


def _take_environment(descriptor: int) -> None:
    with os.fdopen(descriptor, encoding="utf-8") as file:
        file.seek(0)
        given = json.load(file)
    os.environ.clear()
    os.environ.update(given)
    time.tzset()


def _take_output(output: int, errors: int) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number, taken in enumerate((nothing, output, errors)):
        os.dup2(taken, number)
    for number in {nothing, output, errors} - {0, 1, 2}:
        os.close(number)


def _seed() -> None:
    """Seed every generator of random numbers: forks of one process would draw the same."""
    random.seed()
    if "numpy.random" in sys.modules:
        sys.modules["numpy.random"].seed()  # its legacy generator, which a library may use
    ssl.RAND_add(os.urandom(32), 32.0)
