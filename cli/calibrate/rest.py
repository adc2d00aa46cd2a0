"""Finds the longest time at rest in a series of inertial samples."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

WINDOW_S = 1.0
QUIET_QUANTILE = 0.1  # of the windows' standard deviations: the noise of the sensor itself
NOISE_RATIO = 4.0  # times that noise: somebody moves, or the engine runs
MAX_RATE_RAD_S = 0.01  # mean rate of a window, less the median: a slow turn on a smooth table
DELAY_STEP_PERIODS = 0.5  # [periods] by which the least delay of stamps grows for good where a sample is missing
PERIOD_SAMPLES = 1000  # over which the period is measured, so that stamps in whole milliseconds tell it


@dataclass(frozen=True)
class StandstillSamples:
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


def longest_rest(stamps_s: FloatArray, forces: FloatArray, rates: FloatArray) -> StandstillSamples | None:
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
    width = _width(stamps_s)
    best = (0, 0)
    cuts = [0, *gaps(stamps_s).tolist(), len(stamps_s)]
    pieces = [(a, b) for a, b in pairwise(cuts) if b - a >= 2 * width]
    if not pieces:
        return None
    windows = [
        (start, *_window(forces, rates, start, width)) for a, b in pieces for start in range(a, b - width + 1, width)
    ]
    spreads = np.array([spread for _, spread, _ in windows])
    means = np.array([mean for _, _, mean in windows])
    noise = np.quantile(spreads, QUIET_QUANTILE, axis=0)
    turning = np.abs(means - np.median(means, axis=0)).max(axis=1) > MAX_RATE_RAD_S
    quiet = (spreads <= NOISE_RATIO * np.maximum(noise, 1e-12)).all(axis=1) & ~turning
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
    # By least squares, since each stamp may be late by itself, the first and the last one too.
    places = np.arange(last - first) - (last - first - 1) / 2.0
    even_s = float(places @ (stamps_s[first:last] - stamps_s[first]) / (places @ places))
    return StandstillSamples(even_s, forces[first:last], rates[first:last], float(stamps_s[first] - stamps_s[0]))


def gaps(stamps_s: FloatArray) -> Indices:
    """Find where samples are missing: not where stamps are late, or rounded.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        [s] Increasing; each may be late by itself, as of samples that arrive together.

    Returns
    -------
    ndarray of int, shape (m,)
        First sample behind each gap, and the first one half a second later, from which the stamps are known to be even
        again.

    Notes
    -----
    With the period p, the delay of stamp k is t_k - k p. Its least value over half a second stays the same where
    stamps are late, and grows by p for good with each sample that is missing.
    """
    from scipy.ndimage import minimum_filter1d

    if len(stamps_s) < 3:
        return np.zeros(0, dtype=np.int64)
    period_s, half = _period(stamps_s), max(_width(stamps_s) // 4, 1)
    delay = stamps_s - period_s * np.arange(len(stamps_s))
    least = minimum_filter1d(delay, 2 * half + 1, mode="nearest")
    last = len(stamps_s) - 1
    before = least[np.maximum(np.arange(last) - half, 0)]
    behind = least[np.minimum(np.arange(last) + 1 + half, last)]
    missing = np.concatenate([[False], behind - before > DELAY_STEP_PERIODS * period_s, [False]])
    found: Indices = np.flatnonzero(np.diff(missing)) + 1
    return found


def _period(stamps_s: FloatArray) -> float:
    """Period of the samples [s], although some are missing and stamps are uneven."""
    count = min(PERIOD_SAMPLES, len(stamps_s) - 1)
    return float(np.median(stamps_s[count:] - stamps_s[:-count])) / count


def _width(stamps_s: FloatArray) -> int:
    """Samples of a window."""
    return max(round(WINDOW_S / _period(stamps_s)), 2)


def _window(forces: FloatArray, rates: FloatArray, start: int, width: int) -> tuple[FloatArray, FloatArray]:
    part = slice(start, start + width)
    spread: FloatArray = np.concatenate([forces[part].std(axis=0), rates[part].std(axis=0)])
    mean: FloatArray = rates[part].mean(axis=0)
    return spread, mean
