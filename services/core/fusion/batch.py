"""Solutions of a whole log, whose samples and measurements are all available at the start."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from .aids.base import Measurement
from .inertial.imu_faults import FORCE_LIMIT, RATE_LIMIT, faults
from .inertial.propagation import samples_of
from .navigator import Navigator
from .solution import Solution
from .timeline.log import order

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def solve(
    navigator: Navigator,
    stamps_ns: IntArray,
    samples: FloatArray,
    measurements: Sequence[Measurement],
    *,
    every_ns: int,
) -> Iterator[Solution]:
    """Solutions of a log; the same as sample by sample with measurements in time.

    Parameters
    ----------
    navigator : Navigator
        A new one, possibly with a prior.
    stamps_ns : ndarray of int64, shape (n,)
        Ends of the samples; samples out of order are rejected and counted.
    samples : ndarray, shape (n, 6)
        [m/s², rad/s, body] Specific force and angular rate, as measured; implausible samples are rejected.
    measurements : sequence of Measurement
        In any order.
    every_ns : int
        Period of the solutions, each at the first sample of a period.

    Yields
    ------
    Solution
        From the start of the filter to the last sample. Plausibility limits of measurements are not tested.
    """
    usable = _usable(stamps_ns, samples)
    navigator.samples_used += int(usable.sum())
    navigator.samples_rejected += int((~usable).sum())
    stamps_ns, samples = stamps_ns[usable], samples[usable]
    log = samples_of(stamps_ns, samples, faults(stamps_ns, samples))
    due = sorted(measurements, key=order)
    begin = used = 0
    for end, is_period in _periods(stamps_ns, every_ns):
        until = bisect_right(due, int(stamps_ns[end - 1]), used, key=lambda m: m.time_ns)
        navigator.engine.process(log.part(begin, end), due[used:until])
        begin, used = end, until
        if is_period and (solution := navigator.solution()) is not None:
            yield solution


def _periods(stamps_ns: IntArray, every_ns: int) -> Iterator[tuple[int, bool]]:
    """Ends (exclusive) of the parts of a log, and whether a part ends with the first sample of a period."""
    ends = (np.flatnonzero(np.diff(stamps_ns // every_ns)) + 2).tolist()
    yield from ((end, True) for end in ends)
    if len(stamps_ns) > (ends[-1] if ends else 0):
        yield len(stamps_ns), False


def _usable(stamps_ns: IntArray, samples: FloatArray) -> npt.NDArray[np.bool_]:
    """Mask of the samples that a navigator uses sample by sample."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = samples * samples
        credible: npt.NDArray[np.bool_] = squares[:, :3].sum(axis=1) < FORCE_LIMIT**2
        credible &= squares[:, 3:].sum(axis=1) < RATE_LIMIT**2
    newest = np.maximum.accumulate(np.where(credible, stamps_ns, stamps_ns.min(initial=0)))
    credible[1:] &= stamps_ns[1:] > newest[:-1]
    return credible
