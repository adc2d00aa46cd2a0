"""A folder of recordings, one of them in progress."""

import logging
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from errno import EINVAL, ENOENT, ENOTSUP
from pathlib import Path
from stat import S_ISREG

from ..bus.envelope import Envelope
from ..evidence import EvidenceError, Signer
from ..library.order import in_order, read_order, write_order
from ..library.summary import KEEP_SUFFIX
from ..library.summary import RECORDING_SUFFIX as SUFFIX
from ..library.summary import SUFFIX as SUMMARY_SUFFIX
from .seals import Sealer
from .writer import Opener, RecordingWriter, open_new

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StoredRecording:
    """A recording in the folder, and its place in the order in which they were made.

    It is `kept` if a file of its name and `.keep` lies beside it, or if it could not be deleted.
    """

    name: str
    size_bytes: int
    kept: bool = False
    place: int = 0


class RecordingFolder:
    """Recordings as files; failures of the disk raise `OSError`.

    With a signer each file is signed, and names the last seal of the one before. Without a usable key it is recorded
    all the same, and `unsigned` says why it is not signed.
    """

    def __init__(self, path: Path, opener: Opener = open_new, signer: Callable[[], Signer] | None = None) -> None:
        self.path = path
        self.unsigned: str | None = None
        self._signer = signer
        self._sealer: Sealer | None = None  # of the file in progress, or of the one before
        self.free_bytes = 0  # free space at the last call of `stored`; 0 without a disk
        self._opener = opener
        self._writer: RecordingWriter | None = None
        self._order: list[str] = []  # of making, also where there is no room to store it
        self._undeletable: set[str] = set()
        self._received = self._closed_messages = self._closed_bytes = 0
        self._syncing: Future[None] | None = None
        self._new = False  # whether the folder's entry of the recording in progress may not be on the disk
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

    def stored(self) -> list[StoredRecording]:
        """List the recordings in the order in which they were made, and determine the free space.

        The folder is made if it is missing. What it lies in is not: where that is missing, a disk is not mounted.
        What is no file, such as a link that leads nowhere, is none of the recordings.

        Raises
        ------
        OSError
            The disk cannot be used, or the recording in progress is no longer in the folder.
        """
        self.free_bytes = 0
        self.path.mkdir(exist_ok=True)
        self.free_bytes = shutil.disk_usage(self.path).free
        entries = {entry.name: entry for entry in os.scandir(self.path)}
        if self._writer and not self._is_in(entries):
            raise FileNotFoundError(ENOENT, "the recording in progress has vanished")
        sizes = {name: size for name in entries if (size := self._size(name)) is not None}
        kept = {name for name in sizes if name + KEEP_SUFFIX in entries} | self._undeletable
        order = self._ordered(sizes)
        return [StoredRecording(name, sizes[name], name in kept, place) for place, name in enumerate(order)]

    def _is_in(self, entries: Mapping[str, os.DirEntry[str]]) -> bool:
        """Whether the recording in progress is in the folder, and no other file of its name."""
        if self._writer is None or (entry := entries.get(self._writer.path.name)) is None:
            return False
        return entry.stat().st_ino == os.fstat(self._writer.fileno()).st_ino

    def _size(self, name: str) -> int | None:
        """Size of a recording, None of what is none."""
        try:
            status = (self.path / name).stat() if name.endswith(SUFFIX) else None
        except OSError:
            return None
        return status.st_size if status is not None and S_ISREG(status.st_mode) else None

    def _ordered(self, names: Iterable[str]) -> list[str]:
        """Bring names into the order of making, and store it where it has changed."""
        stored = read_order(self.path)
        self._order = in_order(names, list(dict.fromkeys((*stored, *self._order))))
        if self._order != (stored or in_order(self._order, ())):
            self._store_order()
        return self._order

    def _store_order(self) -> None:
        try:
            write_order(self.path, self._order)
        except OSError as error:  # it is stored when there is room, and known here until then
            log.debug("could not store the order of the recordings: %s", error.strerror)

    def delete(self, names: Iterable[str]) -> None:
        """Remove recordings; one that cannot be removed counts as kept from now on."""
        for name in names:
            log.info("deleting %s", name)
            try:
                (self.path / name).unlink(missing_ok=True)
                (self.path / (name + SUMMARY_SUFFIX)).unlink(missing_ok=True)
            except OSError as error:
                log.warning("could not delete %s: %s", name, error.strerror)
                self._undeletable.add(name)

    def open(self, name: str, *, vehicle: str, vehicle_toml: str, chunk_bytes: int, now_ns: int = 0) -> None:
        """Begin a recording; a name that is taken gets a number."""
        path, attempt = self.path / f"{name}{SUFFIX}", 1
        while os.path.lexists(path):  # a link that leads nowhere takes a name, too
            attempt += 1
            path = self.path / f"{name}_{attempt}{SUFFIX}"
        sealer = self._new_sealer(vehicle, now_ns)
        self._writer = RecordingWriter(
            path, vehicle=vehicle, vehicle_toml=vehicle_toml, chunk_bytes=chunk_bytes, opener=self._opener,
            sealer=sealer,
        )  # fmt: skip
        self._sealer, self._new = sealer, True
        self._order = [*self._order, path.name]
        self._store_order()

    def _new_sealer(self, vehicle: str, now_ns: int) -> Sealer | None:
        """Make what signs a file; None without a key."""
        if self._signer is None:
            return None
        try:
            signer = self._signer()
        except EvidenceError as error:
            if str(error) != self.unsigned:
                log.warning("recording without signatures: %s", error)
            self.unsigned = str(error)
            return None
        self.unsigned = None
        follows = self._sealer.digest if self._sealer is not None else ""
        return Sealer(signer, vehicle=vehicle, started_ns=now_ns, follows=follows)

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
        """Synchronise the file, and the folder that lists it, with the disk in a thread: a card may take a second."""
        if self._syncing and self._syncing.done() and (error := self._syncing.exception()):
            self._syncing = None
            raise error
        if self._writer and (self._syncing is None or self._syncing.done()):
            self._syncing = self._sync_thread.submit(_sync, self._writer.fileno(), self.path if self._new else None)
            self._new = False

    def close_on_disk(self) -> None:
        """Finish the recording in progress and wait until the disk has it: the power may end at any time."""
        path = self._writer.path if self._writer else None
        self.close()
        if path is None or not path.exists():
            return
        for item in (path, path.parent):
            _sync_path(item)

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


def _sync(descriptor: int, folder: Path | None) -> None:
    """Write a file's bytes to the disk, and the entry of a new one: without it a power cut may lose the whole file."""
    os.fdatasync(descriptor)
    if folder is not None:
        try:
            _sync_path(folder)
        except OSError as error:
            if error.errno not in (EINVAL, ENOTSUP):  # file systems that write entries by themselves
                raise


def _sync_path(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
