"""Successive samples that are all there, and how an engine gets through them: together where they are ordinary."""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence

import numpy as np

from ..filter.propagation import Rows, Stamps
from ..filter.runner import Runner
from ..measurements.base import Measurement, Outcome
from ..plausibility.imu_faults import Sample
from ..update.engine import Engine


class Stretch:
    """Samples one after the other; an engine that has taken one of them can go on from there.

    Parameters
    ----------
    stamps_ns : list of int, or ndarray
        Ends of the samples, the first being that of the sample before them.
    rows : list of list of float, or ndarray
        [m/s², rad/s, body] Specific force and angular rate that end at the second stamp, the third, and so on.
    due : sequence of Measurement
        In order; what was true on the way is used.
    runner : Runner
        What gets through ordinary ones.
    doubts : mapping
        What is wrong with samples, by their row.
    """

    def __init__(
        self,
        stamps_ns: Stamps,
        rows: Rows,
        due: Sequence[Measurement],
        runner: Runner,
        doubts: Mapping[int, str] | None = None,
    ) -> None:
        self._stamps_ns: Sequence[int] = stamps_ns.tolist() if isinstance(stamps_ns, np.ndarray) else stamps_ns
        self._rows = rows
        self._due, self._due_ns = due, [measurement.time_ns for measurement in due]
        self._doubts = doubts or {}
        self._doubtful = sorted(self._doubts)
        self._run = runner
        self._given: tuple[Stamps, Rows] = stamps_ns, rows
        if runner.wants_arrays:
            self._given = np.ascontiguousarray(stamps_ns, np.int64), np.ascontiguousarray(rows, np.float64)

    def through(self, engine: Engine, here: int, stop: int) -> list[Outcome]:
        """Take the samples from one place up to another, with the measurements that were true on the way."""
        outcomes: list[Outcome] = []
        next_ = bisect_right(self._due_ns, self._stamps_ns[here])
        while here < stop:
            free = stop
            if next_ < len(self._due_ns):
                free = min(stop, bisect_left(self._stamps_ns, self._due_ns[next_], here + 1) - 1)
            if self._doubtful:
                free = min([free, *self._doubtful[(k := bisect_left(self._doubtful, here)) : k + 1]])
            if free > here:
                taken = self._stride(engine, here, free)
                here += taken
                if taken and here == free:
                    continue
            stamp_ns, (fx, fy, fz, wx, wy, wz) = self._stamps_ns[here + 1], map(float, self._rows[here])
            used = bisect_right(self._due_ns, stamp_ns, next_)
            doubt = self._doubts.get(here)
            self._run.serve(engine)
            outcomes += engine.step(Sample(stamp_ns, (fx, fy, fz), (wx, wy, wz), doubt), self._due[next_:used])
            here, next_ = here + 1, used
        return outcomes

    def _stride(self, engine: Engine, here: int, stop: int) -> int:
        """Take samples as long as they are ordinary, and say how many; none is due a measurement but the last."""
        departure = engine.departure()
        if departure is None:
            return 0
        start, until_ns = departure
        times_ns, rows = self._given
        stop = min(stop, bisect_right(self._stamps_ns, until_ns, here, stop + 1) - 1)
        if stop <= here:
            return 0
        taken, moment, P = self._run(start, times_ns[here : stop + 1], rows[here:stop])
        if taken:
            engine.resume(moment, P, Sample(self._stamps_ns[here + taken], *moment[3]))
        return taken
