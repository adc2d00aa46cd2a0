"""Verdicts, outages, fixes and tracks in the sky, as JSON lines in bounded files that outlive this process."""

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic_core import to_json

from shared.bounded import SizeExceeded, read_bytes

log = logging.getLogger(__name__)

FILE_BYTES = 2_000_000  # about two hours at one verdict and one fix a second; the file before it is kept as well
Record = Mapping[str, object]


class HistoryFile:
    """Appends records, and reads those of earlier incarnations; what cannot be read or written is logged."""

    def __init__(self, path: Path) -> None:
        self._path, self._before = path, path.with_suffix(".before.jsonl")
        self._failed = False

    def read(self) -> Iterator[bytes]:
        """Lines of earlier incarnations, oldest first."""
        for path in (self._before, self._path):
            try:
                yield from read_bytes(path, 4 * FILE_BYTES).splitlines() if path.exists() else []
            except (OSError, SizeExceeded) as error:
                log.warning("cannot read %s: %s", path, error)

    def append(self, records: list[Record]) -> None:
        """Write records; each survives the end of this process from then on."""
        if not records:
            return
        try:
            if self._path.exists() and self._path.stat().st_size >= FILE_BYTES:
                self._path.replace(self._before)
            with self._path.open("ab") as file:
                file.write(b"".join(to_json(record) + b"\n" for record in records))
            self._failed = False
        except OSError as error:
            if not self._failed:
                log.warning("the history does not outlive a restart: cannot write %s: %s", self._path, error.strerror)
            self._failed = True
