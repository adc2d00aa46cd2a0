"""A field's values on a time grid; pure."""

from array import array
from math import isnan, nan

SECOND_NS = 1_000_000_000
FINE_NS, FINE_CELLS = 200_000_000, 300  # the last minute
COARSE_NS, COARSE_CELLS = SECOND_NS, 3600  # the last hour
BYTES_PER_FIELD = 8 * (FINE_CELLS + COARSE_CELLS)


class Ring:
    """The newest value of each period; a cell without value is NaN, which never leaves this class."""

    def __init__(self, period_ns: int, cells: int) -> None:
        self.period_ns = period_ns
        self._length = cells
        self._cells = array("d")  # allocated with the first value
        self._newest = 0  # number of the newest period, counted from time 0

    def put(self, time_ns: int, value: float, *, fill: bool = False) -> None:
        """Note a value; one that is older than the ring is dropped, and `fill` leaves what is there."""
        period, length = time_ns // self.period_ns, self._length
        if not self._cells:
            self._cells, self._newest = array("d", [nan]) * length, period
        if period > self._newest:
            for skipped in range(max(self._newest + 1, period - length + 1), period + 1):
                self._cells[skipped % length] = nan
            self._newest = period
        elif period <= self._newest - length:
            return
        if not fill or isnan(self._cells[period % length]):
            self._cells[period % length] = value

    def values(self, first: int, last: int) -> list[float | None]:
        """Give the values of the periods from `first` to `last`, None where there is none."""
        length = self._length
        oldest = self._newest - length
        return [
            None
            if not self._cells or not oldest < period <= self._newest or isnan(value := self._cells[period % length])
            else value
            for period in range(first, last + 1)
        ]
