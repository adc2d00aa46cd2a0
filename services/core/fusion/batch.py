"""A whole log at once: all samples and measurements are there, and each is used when it was true."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from .filter.imu_step import FORCE_LIMIT, RATE_LIMIT
from .filter.runner import Runner
from .measurements.base import Measurement
from .navigator import Navigator
from .plausibility.imu_faults import Sample, doubts
from .solution import Solution
from .timing.imu_batch import Stretch
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
    runner: Runner | None = None,
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
    runner : Runner, optional
        What gets through ordinary samples: a compiled one, if `fast` has one.

    Raises
    ------
    ValueError
        Delays shall be estimated: measurements are used at their stamps, and all of them are believed to be possible.

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
    stamps: list[int] = stamps_ns.tolist()
    if not stamps:
        return
    runner = runner or Runner()
    rows = samples[1:] if runner.wants_arrays else samples[1:].tolist()
    doubtful = {place - 1: doubt for place, doubt in doubts(stamps_ns, samples).items()}
    stretch = Stretch(
        stamps_ns if runner.wants_arrays else stamps, rows, sorted(measurements, key=order), runner, doubtful
    )
    engine, here = navigator.engine, 0
    fx, fy, fz, wx, wy, wz = samples[0].tolist()
    engine.step(Sample(stamps[0], (fx, fy, fz), (wx, wy, wz)), [])
    while here + 1 < len(stamps):
        next_period_ns = (stamps[here] // every_ns + 1) * every_ns
        stop = min(bisect_left(stamps, next_period_ns, here + 1), len(stamps) - 1)
        stretch.through(engine, here, stop)
        here = stop
        if stamps[here] >= next_period_ns and (solution := navigator.solution()) is not None:
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
