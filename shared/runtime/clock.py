"""The OBU time line: the monotonic clock of the host, offset once a boot to UTC, in nanoseconds."""

import ctypes
import errno
import logging
import os
import time
from pathlib import Path
from uuid import uuid4

from ..errors import UserError
from ..maths.dates import plausible_host_ns

log = logging.getLogger(__name__)

SHARED_MEMORY = Path("/dev/shm")  # where processes of a host agree while the disk takes nothing
DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)
FAILED, UNSYNCHRONISED = -1, 5  # answers of ntp_gettime(3)


def boot_id() -> str:
    """Identifier of this boot of the host."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text().strip() if path.exists() else "unknown"


def fixed_offset_ns(state_dir: Path) -> int:
    """Agree with every other process of this boot on the offset of the monotonic clock to UTC.

    The first process to ask writes it down; a clock that is set later does not move the time line. A clock that shows
    an impossible date begins the line at the earliest date that is possible: every stamp is from 1980 to 2100.

    Raises
    ------
    UserError
        The state folder is missing or may not be written to. On a full or failing disk the processes agree in memory,
        also where the disk had no room to make the folder.
    """
    return _agreed_offset_ns(state_dir)[0]


def _agreed_offset_ns(state_dir: Path) -> tuple[int, str | None]:
    """The offset, and why it is not on the state disk; None where it is."""
    path = state_dir / f"clock-{boot_id()}"
    if (known := _read(path)) is not None:
        return known, None
    in_memory = SHARED_MEMORY / f"obu-{path.name}"
    proposal = _read(in_memory)
    if proposal is None:
        proposal = plausible_host_ns(time.time_ns()) - time.monotonic_ns()
    try:
        agreed = _propose(path, proposal)
    except OSError as error:
        reason = f"cannot write into the state folder {state_dir}: {error.strerror}"
        if error.errno not in DISK_FAULTS and not is_full(state_dir):
            raise UserError(f"{reason}; set OBU_STATE") from error
        log.warning("%s; the time line is kept in memory", reason)
        return _propose_in_memory(in_memory, proposal), reason
    for old in state_dir.glob("clock-*"):
        if old != path and not old.name.startswith("clock-draft-"):
            old.unlink(missing_ok=True)
    return agreed, None


def is_full(path: Path) -> bool:
    """Whether the disk of a path, which need not exist, has no room for a file."""
    there = next((item for item in (path, *path.resolve().parents) if item.exists()), None)
    if there is None:
        return False
    disk = os.statvfs(there)
    return disk.f_bavail == 0 or (disk.f_files > 0 and disk.f_favail == 0)


def _propose(path: Path, proposal: int) -> int:
    """Write an offset down unless another process was first; return what is written then."""
    draft = path.with_name(f"clock-draft-{uuid4().hex}")  # containers share it, and in each the process is number 1
    try:
        draft.write_text(str(proposal))
        try:
            os.link(draft, path)  # fails where another process was first: atomic, and never half written
        except FileExistsError:
            if (known := _read(path)) is not None:
                return known
            draft.replace(path)  # it held no offset, as after a power cut
        return proposal
    finally:
        draft.unlink(missing_ok=True)


def _propose_in_memory(path: Path, proposal: int) -> int:
    """Agree by the host's shared memory; without one, as in containers, each process keeps its own proposal."""
    try:
        return _propose(path, proposal)
    except OSError as error:
        log.warning("each process has a time line of its own: %s", error.strerror)
        return proposal


def _read(path: Path) -> int | None:
    """The offset in a file; None without one, or where it holds none."""
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


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
        self.offset_ns, self.not_stored = _agreed_offset_ns(state_dir)  # why it is not on the state disk

    def now_ns(self) -> int:
        """Read the time line."""
        return time.monotonic_ns() + self.offset_ns
