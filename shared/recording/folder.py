"""A folder of recordings, one of them in progress."""

import logging
import os
import shutil
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..bus.envelope import Envelope
from ..library.summary import KEEP_SUFFIX
from ..library.summary import RECORDING_SUFFIX as SUFFIX
from ..library.summary import SUFFIX as SUMMARY_SUFFIX
from .writer import Opener, RecordingWriter, open_new

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Stored:
    """A recording in the folder; `kept` if a file of its name and `.keep` lies beside it."""

    name: str
    size_bytes: int
    kept: bool = False


class RecordingFolder:
    """Recordings as files; failures of the disk raise `OSError`."""

    def __init__(self, path: Path, opener: Opener = open_new) -> None:
        self.path = path
        self.free_bytes = 0  # free space at the last call of `stored`; 0 without a disk
        self._opener = opener
        self._writer: RecordingWriter | None = None
        self._received = self._closed_messages = self._closed_bytes = 0
        self._syncing: Future[None] | None = None
        self._sync_thread = ThreadPoolExecutor(1, "sync")

    @property
    def open_name(self) -> str | None:
        """Name of the recording in progress."""
        return self._writer.path.name if self._writer else None

    @property
    def open_bytes(self) -> int:
        """Size of the recording in progress."""
        return self._writer.bytes_written if self._writer else 0

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return self._closed_messages + (self._writer.messages if self._writer else 0)

    @property
    def bytes_written(self) -> int:
        """Bytes of all files that were written here."""
        return self._closed_bytes + self.open_bytes

    @property
    def lost(self) -> int:
        """Number of messages that could not be written."""
        return self._received - self.messages - (self._writer.pending if self._writer else 0)

    def stored(self) -> list[Stored]:
        """List the recordings in the folder, which is made if it is missing, and determine the free space.

        What the folder lies in is not made: where it is missing, a disk is not mounted.
        """
        self.free_bytes = 0
        self.path.mkdir(exist_ok=True)
        self.free_bytes = shutil.disk_usage(self.path).free
        entries = {entry.name: entry for entry in os.scandir(self.path)}
        return [
            Stored(name, entry.stat().st_size, name + KEEP_SUFFIX in entries)
            for name, entry in entries.items()
            if name.endswith(SUFFIX)
        ]

    def delete(self, names: Iterable[str]) -> None:
        """Remove recordings."""
        for name in names:
            log.info("deleting %s", name)
            (self.path / name).unlink(missing_ok=True)
            (self.path / (name + SUMMARY_SUFFIX)).unlink(missing_ok=True)

    def open(self, name: str, *, vehicle: str, vehicle_toml: str, chunk_bytes: int) -> None:
        """Begin a recording; a name that is taken gets a number."""
        path, attempt = self.path / f"{name}{SUFFIX}", 1
        while path.exists():
            attempt += 1
            path = self.path / f"{name}_{attempt}{SUFFIX}"
        self._writer = RecordingWriter(
            path, vehicle=vehicle, vehicle_toml=vehicle_toml, chunk_bytes=chunk_bytes, opener=self._opener
        )

    def write(self, envelopes: Sequence[Envelope]) -> None:
        """Add messages to the recording in progress; without one they are lost, as are those behind a failure."""
        self._received += len(envelopes)
        if self._writer:
            for envelope in envelopes:
                self._writer.write(envelope)

    def flush(self) -> None:
        """Pass the buffered data to the operating system."""
        if self._writer:
            self._writer.flush()

    def sync(self) -> None:
        """Synchronise the file with the disk in a thread: a memory card may take a second."""
        if self._syncing and self._syncing.done() and (error := self._syncing.exception()):
            self._syncing = None
            raise error
        if self._writer and (self._syncing is None or self._syncing.done()):
            self._syncing = self._sync_thread.submit(os.fdatasync, self._writer.fileno())

    def close(self) -> None:
        """Finish the recording in progress; a file without a message is removed."""
        if (writer := self._writer) is None:
            return
        self._writer = None
        if self._syncing:
            self._syncing.exception()  # waits: the descriptor of a closed file may be reused
        try:
            writer.close()
        finally:
            self._closed_messages += writer.messages
            if writer.messages:
                self._closed_bytes += writer.bytes_written
            else:
                writer.path.unlink(missing_ok=True)
