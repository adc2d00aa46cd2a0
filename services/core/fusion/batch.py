"""A whole log at once: all samples and measurements are there, and each is used when it was true."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from .aiding import Measurement
from .delayed import order
from .engine import Sample
from .navigator import FORCE_LIMIT, RATE_LIMIT, Navigator, Solution
from .ordinary import Rows, Run, Stamps, run

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def solve(
    navigator: Navigator,
    stamps_ns: IntArray,
    samples: FloatArray,
    measurements: Sequence[Measurement],
    *,
    every_ns: int,
    compiled: Run | None = None,
) -> Iterator[Solution]:
    """Navigate through a log; the result is that of samples and measurements one by one, with nothing late.

    Parameters
    ----------
    navigator : Navigator
        Fresh, or told of a saved position.
    stamps_ns : ndarray of int64, shape (n,)
        Ends of the samples; what does not ascend is left out and counted.
    samples : ndarray, shape (n, 6)
        [m/s², rad/s, body] Specific force and angular rate, as measured; what no sensor measures is left out as well.
    measurements : sequence of Measurement
        In any order.
    every_ns : int
        A solution is given at the first sample of each such period.
    compiled : callable, optional
        What a compiler has made of `ordinary.run`: see `fast`.

    Yields
    ------
    Solution
        As soon as there are any, until the last sample.
    """
    usable = _usable(stamps_ns, samples)
    navigator.samples_used += int(usable.sum())
    navigator.samples_rejected += int((~usable).sum())
    stamps_ns, samples = np.ascontiguousarray(stamps_ns[usable]), np.ascontiguousarray(samples[usable])
    stamps, rows = stamps_ns.tolist(), samples.tolist()
    pending = sorted(measurements, key=order)
    due_ns = [measurement.time_ns for measurement in pending]
    engine = navigator.engine
    here = used = 0
    while here < len(stamps):
        period_end_ns = (stamps[max(here - 1, 0)] // every_ns + 1) * every_ns
        stop = min(bisect_left(stamps, period_end_ns, here) + 1, len(stamps))
        if used < len(due_ns):
            stop = min(stop, bisect_left(stamps, due_ns[used], here))
        taken = 0
        if here and stop > here:
            times: Stamps = stamps_ns[here - 1 : stop] if compiled else stamps[here - 1 : stop]
            block: Rows = samples[here:stop] if compiled else rows[here:stop]
            taken = engine.stride(compiled or run, times, block)
            here += taken
        if here < stop or not taken:
            fx, fy, fz, wx, wy, wz = rows[here]
            first, used = used, bisect_right(due_ns, stamps[here], used)
            engine.step(Sample(stamps[here], (fx, fy, fz), (wx, wy, wz)), pending[first:used])
            here += 1
        if stamps[here - 1] >= period_end_ns and (solution := navigator.solution()) is not None:
            yield solution


def _usable(stamps_ns: IntArray, samples: FloatArray) -> npt.NDArray[np.bool_]:
    """Which samples a navigator would take, one by one."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = samples * samples
        credible: npt.NDArray[np.bool_] = size[:, :3].sum(axis=1) < FORCE_LIMIT**2
        credible &= size[:, 3:].sum(axis=1) < RATE_LIMIT**2
    newest = np.maximum.accumulate(np.where(credible, stamps_ns, stamps_ns.min(initial=0)))
    credible[1:] &= stamps_ns[1:] > newest[:-1]
    return credible
