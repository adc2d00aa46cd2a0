"""A trail in memory, for tests of the smoother."""

from collections.abc import Iterator

from services.core.fusion.smoothing.history import Record


class Records:
    """All records, in a list."""

    def __init__(self) -> None:
        self.all: list[Record] = []

    def push(self, record: Record) -> None:
        """Add one behind all others."""
        self.all.append(record)

    def __len__(self) -> int:
        return len(self.all)

    def cut(self, count: int) -> None:
        """Take records off the end until so many are left."""
        del self.all[count:]

    def newest_first(self) -> Iterator[Record]:
        """Give all back, from the end."""
        yield from reversed(self.all)
