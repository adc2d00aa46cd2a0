"""Successive samples that are all there, and how an engine gets through them: together where they are ordinary."""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence

import numpy as np

from .aiding import Measurement, Outcome
from .engine import Engine
from .ordinary import Rows, Run, Stamps, run
from .samples import Sample


class Stretch:
    """Samples one after the other; an engine that has taken one of them can go on from there.

    Parameters
    ----------
    stamps_ns : list of int
        Ends of the samples, the first being that of the sample before them.
    rows : list of list of float
        [m/s², rad/s, body] Specific force and angular rate that end at the second stamp, the third, and so on.
    compiled : callable, optional
        What a compiler has made of `ordinary.run`: see `fast`.
    doubts : mapping
        What is wrong with samples, by their row.
    """

    def __init__(
        self,
        stamps_ns: list[int],
        rows: list[list[float]],
        compiled: Run | None,
        doubts: Mapping[int, str] | None = None,
    ) -> None:
        self._stamps_ns = stamps_ns
        self._doubts = doubts or {}
        self._doubtful = sorted(self._doubts)
        self._rows = rows
        self._run = compiled or run
        # A compiler wants arrays; Python is faster with lists.
        self._given: tuple[Stamps, Rows] = (np.array(stamps_ns), np.array(rows)) if compiled else (stamps_ns, rows)

    def through(self, engine: Engine, here: int, stop: int, due: Sequence[Measurement]) -> list[Outcome]:
        """Take the samples from one place up to another, with the measurements, sorted, that were true on the way."""
        outcomes: list[Outcome] = []
        times_ns, rows = self._given
        while here < stop:
            next_ = bisect_right(due, self._stamps_ns[here], key=_time_ns)
            free = (
                stop if next_ == len(due) else min(stop, bisect_left(self._stamps_ns, due[next_].time_ns, here + 1) - 1)
            )
            free = min([free, *self._doubtful[(k := bisect_left(self._doubtful, here)) : k + 1]])
            if free > here:
                taken = engine.stride(self._run, times_ns[here : free + 1], rows[here:free])
                here += taken
                if taken and here == free:
                    continue
            stamp_ns, (fx, fy, fz, wx, wy, wz) = self._stamps_ns[here + 1], self._rows[here]
            used = bisect_right(due, stamp_ns, next_, key=_time_ns)
            outcomes += engine.step(
                Sample(stamp_ns, (fx, fy, fz), (wx, wy, wz), self._doubts.get(here)), due[next_:used]
            )
            here += 1
        return outcomes


def _time_ns(measurement: Measurement) -> int:
    return measurement.time_ns
