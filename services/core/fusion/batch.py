"""A whole log at once: all samples and measurements are there, and each is used when it was true."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from .filter.propagation import samples_of
from .measurements.base import Measurement
from .navigator import Navigator
from .plausibility.imu_faults import FORCE_LIMIT, RATE_LIMIT, faults
from .solution import Solution
from .timing.out_of_sequence import order

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
    """Navigate through a log; the result is that of samples and measurements one by one, with nothing late.

    Parameters
    ----------
    navigator : Navigator
        New, or with a saved position.
    stamps_ns : ndarray of int64, shape (n,)
        Ends of the samples; what does not ascend is left out and counted.
    samples : ndarray, shape (n, 6)
        [m/s², rad/s, body] Specific force and angular rate, as measured; what no sensor measures is left out as well.
    measurements : sequence of Measurement
        In any order.
    every_ns : int
        A solution is given at the first sample of each such period.

    Raises
    ------
    ValueError
        Delays shall be estimated: measurements are used at their stamps, and all of them pass the plausibility limits.

    Yields
    ------
    Solution
        As soon as there are any, until the last sample.
    """
    if navigator.settings.estimate_delays:
        raise ValueError("delays are estimated by a navigator that is given samples and measurements one by one")
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
    """Ends, not included, of the parts of a log that end with the first sample of a period; and the rest, if any."""
    ends = (np.flatnonzero(np.diff(stamps_ns // every_ns)) + 2).tolist()
    yield from ((end, True) for end in ends)
    if len(stamps_ns) > (ends[-1] if ends else 0):
        yield len(stamps_ns), False


def _usable(stamps_ns: IntArray, samples: FloatArray) -> npt.NDArray[np.bool_]:
    """Which samples a navigator would take, one by one."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = samples * samples
        credible: npt.NDArray[np.bool_] = size[:, :3].sum(axis=1) < FORCE_LIMIT**2
        credible &= size[:, 3:].sum(axis=1) < RATE_LIMIT**2
    newest = np.maximum.accumulate(np.where(credible, stamps_ns, stamps_ns.min(initial=0)))
    credible[1:] &= stamps_ns[1:] > newest[:-1]
    return credible
