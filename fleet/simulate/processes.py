"""The processes of a centre on this machine: found by their command lines, measured by the kernel's counters."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
NATS, INGEST, POSTGRES, ADMISSION = "nats-server", "ingest", "postgres", "admission"
PARTS = (NATS, INGEST, POSTGRES, ADMISSION)


class Usage(NamedTuple):
    """What a part of the centre has used, its children included."""

    cpu_s: float  # since its start
    memory_mb: float  # resident now; shared pages of PostgreSQL count once a process


def pids_of(folder: Path, part: str) -> list[int]:
    """Processes of a part of the centre in this folder; none while it is being started again."""
    if part == POSTGRES:
        try:
            pid = int((folder / "postgres" / "data" / "postmaster.pid").read_text(encoding="utf-8").split("\n")[0])
        except (OSError, ValueError):
            return []
        return [pid] if b"postgres" in _words(pid)[0] else []
    return [pid for pid in _all() if _is_of(_words(pid), folder, part)]


def kill(folder: Path, part: str) -> int | None:
    """End a part with SIGKILL; give its process, None if there is none now."""
    for pid in pids_of(folder, part):
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
        return pid
    return None


def usage(folder: Path) -> dict[str, Usage]:
    """Processor time and memory of each part."""
    children: dict[int, list[int]] = {}
    for pid in _all():
        if (fields := _stat(pid)) is not None:
            children.setdefault(int(fields[1]), []).append(pid)
    return {part: _summed(pids_of(folder, part), children) for part in PARTS}


class Meter:
    """Sums what each part uses, of processes that were killed and started again as well, as far as it was sampled."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.cpu_s = dict.fromkeys(PARTS, 0.0)
        self.memory_mb = dict.fromkeys(PARTS, 0.0)  # the most of each
        self._last = {part: item.cpu_s for part, item in usage(folder).items()}

    def sample(self) -> None:
        """Read the counters of the kernel."""
        for part, now in usage(self._folder).items():
            last = self._last[part]
            self.cpu_s[part] += now.cpu_s - last if now.cpu_s >= last else now.cpu_s
            self.memory_mb[part] = max(self.memory_mb[part], now.memory_mb)
            self._last[part] = now.cpu_s


def _summed(pids: list[int], children: dict[int, list[int]]) -> Usage:
    cpu_s = memory_mb = 0.0
    todo = list(pids)
    while todo:
        pid = todo.pop()
        if (fields := _stat(pid)) is None:
            continue
        # utime, stime, and those of children that were waited for
        cpu_s += sum(int(fields[number]) for number in (11, 12, 13, 14)) * TICK_S
        memory_mb += int(fields[21]) * PAGE_BYTES / 1e6
        todo += children.get(pid, [])
    return Usage(cpu_s, memory_mb)


def _is_of(words: list[bytes], folder: Path, part: str) -> bool:
    if part == NATS:
        return bytes(folder / "nats" / "nats.conf") in words and b"nats-server" in words[0]
    command = b" ".join((b"centre run", part.encode(), b"--folder", bytes(folder)))  # forked: one word with spaces
    return b" ".join(words).endswith(b" " + command)


def _all() -> Iterator[int]:
    return (int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal())


def _words(pid: int) -> list[bytes]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    except OSError:
        return [b""]


def _stat(pid: int) -> list[str] | None:
    """Fields of /proc/<pid>/stat after the name: state, parent, ..."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return text[text.rindex(")") + 2 :].split()
