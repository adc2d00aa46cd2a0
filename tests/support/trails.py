"""A trail in memory, for tests of the smoother."""

from collections.abc import Iterator

from services.core.fusion.trail import Record


class Records:
    """All records, in a list."""

    def __init__(self) -> None:
        self.all: list[Record] = []

    def push(self, record: Record) -> None:
        """Add one behind all others."""
        self.all.append(record)

    def forget_after(self, time_ns: int) -> None:
        """Take records off the end for as long as they are of a later time."""
        while self.all and self.all[-1].time_ns > time_ns:
            self.all.pop()

    def newest_first(self) -> Iterator[Record]:
        """Give all back, from the end."""
        yield from reversed(self.all)
