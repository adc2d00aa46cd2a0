"""The OBU time line: the monotonic clock of the host, offset once a boot to UTC, in nanoseconds."""

import ctypes
import os
import time
from pathlib import Path
from uuid import uuid4

from ..errors import UserError
from ..maths.dates import plausible_host_ns

FAILED, UNSYNCHRONISED = -1, 5  # answers of ntp_gettime(3)


def boot_id() -> str:
    """Identifier of this boot of the host."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text().strip() if path.exists() else "unknown"


def fixed_offset_ns(state_dir: Path) -> int:
    """Agree with every other process of this boot on the offset of the monotonic clock to UTC.

    The first process to ask writes it down; a clock that is set later does not move the time line. A clock that shows
    an impossible date begins the line at the earliest date that is possible: every stamp is from 1980 to 2100.
    """
    path = state_dir / f"clock-{boot_id()}"
    if path.exists():
        return int(path.read_text())
    proposal = plausible_host_ns(time.time_ns()) - time.monotonic_ns()
    draft = state_dir / f"clock-draft-{uuid4().hex}"  # containers share the folder, and in each the process is number 1
    try:
        draft.write_text(str(proposal))
        os.link(draft, path)  # fails where another process was first: atomic, and never half written
    except FileExistsError:
        return int(path.read_text())
    except OSError as error:
        raise UserError(f"cannot write into the state folder {state_dir}: {error.strerror}; set OBU_STATE") from error
    finally:
        draft.unlink(missing_ok=True)
    for old in state_dir.glob("clock-*"):
        if old != path and not old.name.startswith("clock-draft-"):
            old.unlink(missing_ok=True)
    return proposal


class _NtpTime(ctypes.Structure):
    """The C library's struct ntptimeval."""

    _fields_ = (
        ("seconds", ctypes.c_long), ("microseconds", ctypes.c_long), ("maximum_error_us", ctypes.c_long),
        ("estimated_error_us", ctypes.c_long), ("tai", ctypes.c_long), ("unused", ctypes.c_long * 4),
    )  # fmt: skip


def maximum_error_s() -> float | None:
    """Largest error [s] of the host's clock as the kernel states it; None while nothing synchronises it.

    The kernel is told by whatever holds the clock: chrony, ntpd or systemd-timesyncd.
    """
    ask = getattr(ctypes.CDLL(None), "ntp_gettime", None)
    found = _NtpTime()
    if ask is None or ask(ctypes.byref(found)) in (FAILED, UNSYNCHRONISED):
        return None
    return float(found.maximum_error_us) / 1e6


class Clock:
    """The OBU time line of this boot."""

    def __init__(self, state_dir: Path) -> None:
        self.offset_ns = fixed_offset_ns(state_dir)

    def now_ns(self) -> int:
        """Read the time line."""
        return time.monotonic_ns() + self.offset_ns
