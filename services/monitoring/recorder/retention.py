"""Which recordings go when room gets short, and when to stop instead: the disk is never filled."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from shared.library.order import natural
from shared.messages.explanation import Explanation, explain
from shared.recording.folder import StoredRecording

from .codes import Code


@dataclass(frozen=True)
class Limits:
    """How much all recordings may take, and how much of the disk must stay free."""

    maximum_total_bytes: int
    minimum_free_bytes: int


@dataclass(frozen=True)
class Verdict:
    """What to delete, oldest first; or, where that would not help, why not to record."""

    delete: tuple[str, ...] = ()
    refusal: Explanation | None = None


def decide(
    stored: Iterable[StoredRecording], free_bytes: int, limits: Limits, *, open_name: str | None = None
) -> Verdict:
    """Choose the recordings that must go, so that both limits hold.

    Parameters
    ----------
    stored : iterable of Stored
        Recordings in the folder, in any sequence; each has its place in the order in which they were made.
    free_bytes : int
        Room that the disk has left.
    limits : Limits
        Quota of all recordings together, and the floor of free room.
    open_name : str, optional
        The recording in progress, which counts but never goes.

    Returns
    -------
    Verdict
        Nothing is deleted where even deleting everything that may go would not be enough.
    """
    files = sorted(stored, key=lambda file: (file.place, natural(file.name)))
    over_quota = sum(file.size_bytes for file in files) - limits.maximum_total_bytes
    below_floor = limits.minimum_free_bytes - free_bytes
    missing = max(over_quota, below_floor)
    chosen = []
    for file in files:
        if missing <= 0:
            break
        if not file.kept and file.name != open_name:
            chosen.append(file.name)
            missing -= file.size_bytes
    if missing <= 0:
        return Verdict(tuple(chosen))
    if over_quota > below_floor:
        return Verdict(refusal=explain(Code.OVER_QUOTA, maximum_total_bytes=limits.maximum_total_bytes))
    return Verdict(refusal=explain(Code.DISK_FULL, free_bytes=free_bytes, minimum_free_bytes=limits.minimum_free_bytes))


def file_name(started_ns: int, vehicle: str) -> str:
    """Name a recording by its start in UTC, as the host's clock shows it, and its vehicle."""
    start = datetime.fromtimestamp(started_ns // 1_000_000_000, UTC)
    return f"{start:%Y%m%dT%H%M%SZ}_{re.sub(r'[^A-Za-z0-9-]', '-', vehicle)[:32]}"
