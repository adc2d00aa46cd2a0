"""What a forked process of the tests does: says what it is, and then what its arguments ask for."""

import contextlib
import gc
import json
import os
import random
import resource
import signal
import ssl
import sys
import time
from pathlib import Path

from numpy import random as numpy_random


def main() -> None:
    """Print one line of JSON, and do what the first argument says."""
    sys.stdout.write(f"{json.dumps(_state())}\n")
    sys.stdout.flush()
    what, *rest = sys.argv[1:]
    if what == "exit":
        sys.exit(int(rest[0]))
    if what == "fail":
        raise RuntimeError("a bug")
    if what == "orphan" and os.fork():
        return  # and leaves a child behind
    time.sleep(0.2 if what == "orphan" else 60.0)


def _state() -> dict[str, object]:
    status = dict(line.split(":\t", 1) for line in Path("/proc/self/status").read_text().splitlines() if ":\t" in line)
    return {
        "arguments": sys.argv,
        "environment": dict(os.environ),
        "descriptors": _open(),
        "session": os.getsid(0) == os.getpid(),
        "blocked": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ())),
        "interrupt": signal.getsignal(signal.SIGINT) is signal.default_int_handler,
        "terminate": signal.getsignal(signal.SIGTERM) == signal.SIG_DFL,
        "random": [random.random(), float(numpy_random.random()), ssl.RAND_bytes(8).hex()],  # noqa: NPY002
        "limits": [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_NOFILE)],
        "user": [os.getuid(), os.geteuid(), os.getgid(), os.getgroups()],
        "no_new_privileges": status["NoNewPrivs"].strip() == "1",
        "collects": gc.isenabled(),
        "too_large_is_an_error": signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN,
        "frozen": gc.get_freeze_count() > 1000,
    }


def _open() -> list[str]:
    found = list[str]()
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # that of the list itself
            found.append(str(path.readlink()))
    return sorted(found)
