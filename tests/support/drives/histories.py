"""A history in memory, for tests of the smoother."""

from collections.abc import Iterator

from services.core.fusion.smoothing.history import Record


class Records:
    """All records, in a list."""

    def __init__(self) -> None:
        self.all: list[Record] = []

    def push(self, record: Record) -> None:
        """Append a record."""
        self.all.append(record)

    def __len__(self) -> int:
        return len(self.all)

    def cut(self, count: int) -> None:
        """Remove the newest records until `count` are left."""
        del self.all[count:]

    def newest_first(self) -> Iterator[Record]:
        """Yield all records, newest first."""
        yield from reversed(self.all)
