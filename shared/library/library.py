"""The recordings of a unit with their summaries, which are computed one at a time beside them."""

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG

from .order import in_order, read_order
from .summary import KEEP_SUFFIX, RECORDING_SUFFIX, RecordingSummary, SummaryWorker, read_summary
from .summary import SUFFIX as SUMMARY_SUFFIX

MAX_LISTED = 200  # recordings that are listed, the newest
SETTLING_TIME_S = 5.0  # without a change: a recorder writes twice a second
READ_AT_ONCE = 10  # summaries: the caller has other work


@dataclass(frozen=True)
class Entry:
    """One recording; the summary is None while it is being recorded, until it is computed, and if that has failed."""

    name: str
    size_bytes: int
    modified_s: float  # since 1970
    kept: bool
    summary: RecordingSummary | None
    failed: bool = False  # no summary can be computed of it


class Library:
    """Recordings in a folder, newest first. `look` is called now and then and does nothing that takes long."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.free_bytes: int | None = None
        self.entries: Mapping[str, Entry] = {}
        self._worker: SummaryWorker | None = None
        self._tried: set[tuple[str, int]] = set()
        self._trying: tuple[str, int] | None = None  # what the worker computes
        self._reads = READ_AT_ONCE

    def look(self, open_name: str | None) -> None:
        """List the folder, and begin the next summary if none is being computed; not of the recording in progress."""
        try:
            self.free_bytes = shutil.disk_usage(self.folder).free
            names = [path.name for path in self.folder.glob(f"*{RECORDING_SUFFIX}")]
        except OSError:  # the folder is not there, or no longer
            self.entries, self.free_bytes = {}, None
            return
        if self._worker is not None and not self._worker.running:
            self._worker = self._trying = None
        self._reads = READ_AT_ONCE
        entries: dict[str, Entry] = {}
        for name in reversed(in_order(names, read_order(self.folder))):
            if len(entries) < MAX_LISTED and (entry := self._entry(self.folder / name)) is not None:
                entries[name] = entry
        self.entries = entries
        if self._reads <= 0 or self._worker is not None:
            return
        for entry in self.entries.values():
            key = entry.name, entry.size_bytes
            settled = (
                entry.name != open_name and abs(time.time() - entry.modified_s) > SETTLING_TIME_S
            )  # the clock may be set back
            if entry.summary is None and settled and key not in self._tried:
                self._tried.add(key)
                self._trying = key
                self._worker = SummaryWorker(self.folder / entry.name, self.folder)
                return

    def keep(self, name: str, *, keep: bool) -> None:
        """Mark a recording so that the recorder never deletes it, or remove the mark."""
        mark = self.folder / (name + KEEP_SUFFIX)
        if keep:
            mark.touch()
        else:
            mark.unlink(missing_ok=True)

    def delete(self, name: str) -> None:
        """Delete a recording with its mark and its summary."""
        for path in (name, name + KEEP_SUFFIX, name + SUMMARY_SUFFIX):
            (self.folder / path).unlink(missing_ok=True)

    def stop(self) -> None:
        """End what is being computed."""
        if self._worker is not None:
            self._worker.stop()

    def _entry(self, path: Path) -> Entry | None:
        try:
            status = path.stat()
        except OSError:  # deleted since it was listed, or a link that leads nowhere
            return None
        if not S_ISREG(status.st_mode):
            return None
        size, modified_s = status.st_size, status.st_mtime
        known = self.entries.get(path.name)
        kept = path.with_name(path.name + KEEP_SUFFIX).exists()
        if known is not None and known.size_bytes == size and known.summary is not None:
            return Entry(path.name, size, modified_s, kept, known.summary)
        stored = path.with_name(path.name + SUMMARY_SUFFIX)
        if self._reads <= 0 or not stored.exists():
            failed = (path.name, size) in self._tried and (path.name, size) != self._trying
            return Entry(path.name, size, modified_s, kept, None, failed)
        self._reads -= 1
        return Entry(path.name, size, modified_s, kept, read_summary(stored, size))
