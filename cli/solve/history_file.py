"""The filter's trail on disk: only its newest part is in memory, however long the drive."""

import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from services.core.fusion.smoothing.history import Record
from shared.errors import UserError

CHUNK = 4096  # records: two and a half minutes, 10 MB


class Spool:
    """Records in a temporary file of a folder, which is gone when the spool is closed or the program ends."""

    def __init__(self, folder: Path) -> None:
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  # closed by __exit__
        except OSError as error:
            raise UserError(_no_room(error)) from error
        self._recent: list[Record] = []
        self._chunks: list[int] = []  # where each begins
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
        """Add one behind all others."""
        self._recent.append(record)
        if len(self._recent) >= 2 * CHUNK:
            self._spill()

    def cut(self, count: int) -> None:
        """Take records off the end until so many are left."""
        while len(self) > count:
            if not self._recent:
                self._recent = self._load(self._chunks[-1])
                self._end = self._chunks.pop()
            del self._recent[-min(len(self) - count, len(self._recent)) :]

    def newest_first(self) -> Iterator[Record]:
        """Give all back, from the end."""
        yield from reversed(self._recent)
        for start in reversed(self._chunks):
            yield from reversed(self._load(start))

    def _spill(self) -> None:
        try:
            self._file.seek(self._end)
            pickle.dump(self._recent[:CHUNK], self._file, protocol=5)
            self._chunks.append(self._end)
            self._end = self._file.tell()
        except OSError as error:
            raise UserError(_no_room(error)) from error
        del self._recent[:CHUNK]

    def _load(self, start: int) -> list[Record]:
        self._file.seek(start)
        records: list[Record] = pickle.load(self._file)  # a file that nobody else can open
        return records


def _no_room(error: OSError) -> str:
    return f"no room for what the smoother must remember: {error.strerror}; choose another folder with --out"
