"""The filter's history on disk, for smoothing; only its newest part is in memory."""

import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from services.core.fusion.smoothing.history import Record
from shared.errors import UserError

CHUNK = 4096  # records: 2.5 minutes, 10 MB


class HistoryFile:
    """A stack of records in a temporary file, which is removed on close or at the end of the program."""

    def __init__(self, folder: Path) -> None:
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed by __exit__
        except OSError as error:
            raise UserError(_disk_error(error)) from error
        self._recent: list[Record] = []
        self._chunks: list[int] = []  # file offset of each
        self._end = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return len(self._chunks) * CHUNK + len(self._recent)

    def push(self, record: Record) -> None:
        """Append a record."""
        self._recent.append(record)
        if len(self._recent) >= 2 * CHUNK:
            self._write_chunk()

    def cut(self, count: int) -> None:
        """Remove records from the end until `count` remain."""
        while len(self) > count:
            if not self._recent:
                self._recent = self._load(self._chunks[-1])
                self._end = self._chunks.pop()
            del self._recent[-min(len(self) - count, len(self._recent)) :]

    def newest_first(self) -> Iterator[Record]:
        """Yield all records, newest first."""
        yield from reversed(self._recent)
        for start in reversed(self._chunks):
            yield from reversed(self._load(start))

    def _write_chunk(self) -> None:
        try:
            self._file.seek(self._end)
            pickle.dump(self._recent[:CHUNK], self._file, protocol=5)
            self._chunks.append(self._end)
            self._end = self._file.tell()
        except OSError as error:
            raise UserError(_disk_error(error)) from error
        del self._recent[:CHUNK]

    def _load(self, start: int) -> list[Record]:
        self._file.seek(start)
        records: list[Record] = pickle.load(self._file)  # safe: an unnamed file of this process
        return records


def _disk_error(error: OSError) -> str:
    return f"cannot store the history for smoothing: {error.strerror}; choose another folder with --out"
