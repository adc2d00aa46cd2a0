"""The log of the timeline: inertial samples as arrays, and measurements and events, in the order of their stamps."""

from bisect import bisect_right, insort
from collections.abc import Callable
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from ..aids.base import Measurement
from ..inertial.imu_faults import Sample
from ..inertial.propagation import Samples, samples_of

IntArray = npt.NDArray[np.int64]

STAMP = attrgetter("time_ns")
FIRST_CAPACITY = 1024  # samples
Key = tuple[int, str, type]


def key_of(measurement: Measurement) -> Key:
    """Key that a measurement shares with its repetition."""
    return measurement.time_ns, measurement.source, type(measurement)


def order(measurement: Measurement) -> tuple[int, int, str]:
    """Key by which measurements are used."""
    return measurement.time_ns, measurement.received_ns, measurement.source


class Log:
    """Samples in order, and entries (measurements and events) in any order up to a time back."""

    def __init__(self) -> None:
        self.newest: Sample | None = None
        self._times_ns: IntArray = np.empty(FIRST_CAPACITY, np.int64)
        self._rows = np.empty((FIRST_CAPACITY, 6))  # [m/s², rad/s, body] specific force and angular rate
        self._begin = self._end = 0  # of the samples that are kept, in the arrays
        self._faults: dict[int, str] = {}  # of suspect samples, by stamp
        self._entries: list[Measurement] = []

    def add(self, sample: Sample) -> None:
        """Append a sample, newer than all before."""
        if self._end == len(self._times_ns):
            self._make_room()
        self._times_ns[self._end] = sample.time_ns
        self._rows[self._end] = (*sample.force, *sample.rate)
        self._end += 1
        if sample.fault is not None:
            self._faults[sample.time_ns] = sample.fault
        self.newest = sample

    @property
    def size(self) -> int:
        """Number of samples."""
        return self._end - self._begin

    def samples(self, after_ns: int, until_ns: int, most: int) -> Samples:
        """Samples with stamps after one time and up to another, at most so many; the oldest first."""
        times_ns = self._times_ns[self._begin : self._end]
        first = int(times_ns.searchsorted(after_ns, side="right"))
        last = min(int(times_ns.searchsorted(until_ns, side="right")), first + most)
        times_ns = times_ns[first:last]
        rows = self._rows[self._begin + first : self._begin + last]
        faults = self._faults and {k: self._faults[t] for k, t in enumerate(times_ns.tolist()) if t in self._faults}
        return samples_of(times_ns, rows, faults)

    def is_known(self, sample: Sample, oldest_ns: int) -> bool:
        """Whether a sample of the past was used before, or falls into a bridged gap."""
        times_ns = self._times_ns[self._begin : self._end]
        if len(times_ns) > 1 and int(times_ns[-2]) < sample.time_ns:
            return True
        place = int(times_ns.searchsorted(sample.time_ns))
        if sample.time_ns <= oldest_ns or place == len(times_ns) or int(times_ns[place]) != sample.time_ns:
            return False
        return tuple(self._rows[self._begin + place].tolist()) == (*sample.force, *sample.rate)

    def insert(self, entry: Measurement) -> bool:
        """Insert an entry at its stamp; returns whether it is the first with its key."""
        is_first = not self._repetitions(entry)
        insort(self._entries, entry, key=order)
        return is_first

    def supersedes(self, entry: Measurement) -> bool:
        """Whether the fault-free fix of an entry's epoch is known; an entry that is one removes the receiver's own."""
        if not entry.epoch:
            return False
        same = self._repetitions(entry)
        if not entry.left_out:
            return any(measurement.left_out for measurement in same)
        removed = set(map(id, same))
        self._entries = [entry for entry in self._entries if id(entry) not in removed]
        return False

    def entries(self, after_ns: int, until_ns: int) -> list[Measurement]:
        """Entries with stamps after one time and up to another."""
        first = bisect_right(self._entries, after_ns, key=STAMP)
        return self._entries[first : bisect_right(self._entries, until_ns, first, key=STAMP)]

    def change(self, after_ns: int, change: Callable[[Measurement], Measurement]) -> None:
        """Change the entries after a time, and drop those that are before it then."""
        first = bisect_right(self._entries, after_ns, key=STAMP)
        moved = [change(entry) for entry in self._entries[first:]]
        self._entries[first:] = sorted(
            (measurement for measurement in moved if measurement.time_ns > after_ns), key=order
        )

    def drop(self, until_ns: int) -> None:
        """Drop samples and entries up to a time."""
        self._begin += int(self._times_ns[self._begin : self._end].searchsorted(until_ns, side="right"))
        del self._entries[: bisect_right(self._entries, until_ns, key=STAMP)]
        if self._faults:
            self._faults = {time_ns: fault for time_ns, fault in self._faults.items() if time_ns > until_ns}

    def _repetitions(self, entry: Measurement) -> list[Measurement]:
        """Entries with the key of another one."""
        return [
            measurement
            for measurement in self.entries(entry.time_ns - 1, entry.time_ns)
            if key_of(measurement) == key_of(entry)
        ]

    def _make_room(self) -> None:
        """Move the kept samples to the begin of arrays that are at least twice as large as they need."""
        kept = slice(self._begin, self._end)
        count = self._end - self._begin
        times_ns, rows = self._times_ns[kept], self._rows[kept]
        if 2 * count > len(self._times_ns):
            self._times_ns, self._rows = np.empty(4 * count, np.int64), np.empty((4 * count, 6))
        self._times_ns[:count], self._rows[:count] = times_ns.copy(), rows.copy()
        self._begin, self._end = 0, count
