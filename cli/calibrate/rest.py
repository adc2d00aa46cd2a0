"""Finds the longest time at rest in a series of inertial samples."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

WINDOW_S = 1.0
QUIET_QUANTILE = 0.1  # of the windows' standard deviations: the noise of the sensor itself
LOUD = 4.0  # times that noise: somebody moves, or the engine runs
TURN_RAD_S = 0.01  # mean rate of a window, less the median: a slow turn on a smooth table
LONGEST_STEP = 1.5  # of the median interval: a sample is missing


@dataclass(frozen=True)
class Rest:
    """Samples at rest, at even steps.

    Attributes
    ----------
    step_s : float
        [s] Time between two samples.
    forces, rates : ndarray, shape (n, 3)
        [m/s², body] and [rad/s, body].
    first_s : float
        [s] Begin after the first sample.
    """

    step_s: float
    forces: FloatArray
    rates: FloatArray
    first_s: float

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return len(self.forces) * self.step_s


def longest_rest(stamps_s: FloatArray, forces: FloatArray, rates: FloatArray) -> Rest | None:
    """Find the longest run of samples without motion and without a gap.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        [s] Increasing.
    forces, rates : ndarray, shape (n, 3)
        [m/s², body] and [rad/s, body].

    Returns
    -------
    Rest or None
        None with fewer samples than two windows of one second hold.
    """
    if len(stamps_s) < 3:
        return None
    steps = np.diff(stamps_s)
    step_s = float(np.median(steps))
    width = max(round(WINDOW_S / step_s), 2) if step_s > 0.0 else len(stamps_s)
    best = (0, 0)
    cuts = [0, *(np.flatnonzero(steps > LONGEST_STEP * step_s) + 1).tolist(), len(stamps_s)]
    pieces = [(a, b) for a, b in pairwise(cuts) if b - a >= 2 * width]
    if not pieces:
        return None
    windows = [
        (start, *_window(forces, rates, start, width)) for a, b in pieces for start in range(a, b - width + 1, width)
    ]
    spreads = np.array([spread for _, spread, _ in windows])
    means = np.array([mean for _, _, mean in windows])
    noise = np.quantile(spreads, QUIET_QUANTILE, axis=0)
    turning = np.abs(means - np.median(means, axis=0)).max(axis=1) > TURN_RAD_S
    quiet = (spreads <= LOUD * np.maximum(noise, 1e-12)).all(axis=1) & ~turning
    starts = {first for first, _ in pieces}
    start = stop = -1
    for (at, _, _), still in zip(windows, quiet.tolist(), strict=True):
        if not still:
            start = stop = -1
            continue
        start = at if at != stop or at in starts else start  # a gap ends the run
        stop = at + width
        best = max(best, (start, stop), key=lambda run: run[1] - run[0])
    if best[1] == best[0]:
        return None
    first, last = best
    # The mean interval, since each stamp may be late by itself.
    even_s = float(stamps_s[last - 1] - stamps_s[first]) / (last - 1 - first)
    return Rest(even_s, forces[first:last], rates[first:last], float(stamps_s[first] - stamps_s[0]))


def _window(forces: FloatArray, rates: FloatArray, start: int, width: int) -> tuple[FloatArray, FloatArray]:
    part = slice(start, start + width)
    spread: FloatArray = np.concatenate([forces[part].std(axis=0), rates[part].std(axis=0)])
    mean: FloatArray = rates[part].mean(axis=0)
    return spread, mean
