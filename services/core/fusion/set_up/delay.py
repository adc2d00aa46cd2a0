"""Delay of GNSS beyond the settings, by the lag at which changes of speed and course fit the inertial sensors best.

The likelihood of a lag is that of the residuals of two regressions, change of speed on mean force and change of course
on mean rate; mounting and biases are in the coefficients.
"""

import numpy as np
import numpy.typing as npt

from shared.messages.explanation import explain

from ..codes import Code
from .findings import Check, Verdict
from .motion import Changes, Motion, Velocities

FloatArray = npt.NDArray[np.float64]

MAX_DURATION_S = 1.6
COARSE_GRID_S: FloatArray = np.arange(-8, 9, dtype=np.float64) * 0.2
FINE_GRID_S: FloatArray = np.arange(-5, 6, dtype=np.float64) * 0.05  # about the best of them
PEAK_WIDTH_S = 0.25
LEAST_SD_S, LARGEST_SD_S = 0.02, 0.08
MIN_INTERVALS = 30
INDEPENDENT = 1e-12  # eigenvalue of xᵀ x over the largest, below which a regressor follows from the others
EXPLAINED = 0.5  # share of the variance of the course rate that the best lag explains
CLEAR = 12.0  # logarithm of the likelihood over that of no lag
REPEATED = 3.0  # residuals in a row that count as one
POSITION_SPACING_S = 1.9  # between positions without velocity
REPEATED_APART = 4.0  # as `REPEATED`, of two series that share their noise in part
MAX_DELAY_S = 0.15


def check_delay(name: str, what: str, found: tuple[float, float, float] | None, setting: tuple[str, float]) -> Check:
    """Put the lag of GNSS against the inertial sensors into a finding.

    Parameters
    ----------
    name, what : str
        Of the check, and "position" or "velocity": what is late.
    found : tuple of float or None
        By `lag_of` or `lag_of_positions`.
    setting : tuple of str and float
        Key of the delay, and its present value [s].
    """
    if found is None:
        return Check(name)
    lag_s, sd_s, gain = found
    values = lag_s, sd_s, 0.0, MAX_DELAY_S, "s"
    if abs(lag_s) < MAX_DELAY_S:
        why = explain(Code.DELAY_AGREES, what=what, lag_s=lag_s, sd_s=sd_s)
        return Check(name, Verdict.AGREES, why, *values)
    if abs(lag_s) < MAX_DELAY_S + 2.0 * sd_s or gain < CLEAR:
        return Check(name)
    key, present_s = setting
    code = Code.OLDER_THAN_STATED if lag_s > 0.0 else Code.NEWER_THAN_STATED
    why = explain(code, what=what, lag_s=abs(lag_s), sd_s=sd_s)
    return Check(name, Verdict.CONTRADICTS, why, *values, f"{key} = {present_s + lag_s:.2f}")


def lag_of(motion: Motion, velocities: Velocities) -> tuple[float, float, float] | None:
    """Lag and its standard deviation [s], and the log-likelihood over that of no lag; None while not known."""
    return _lag_of(motion, [Changes.of(velocities)], REPEATED)


def lag_of_positions(motion: Motion) -> tuple[float, float, float] | None:
    """Lag of the positions of a receiver that measures no velocity, as `lag_of`.

    Errors of metres hide the changes of speed between positions a second apart. Over twice the time they are a quarter
    as large, and positions between those of one series make another.
    """
    found = lag_of(motion, motion.of_positions())
    if found is not None:
        return found
    series = [
        Changes.of(motion.of_positions(POSITION_SPACING_S, after_s), POSITION_SPACING_S)
        for after_s in (0.0, 0.5 * POSITION_SPACING_S)
    ]
    return _lag_of(motion, series, REPEATED_APART)


def _lag_of(motion: Motion, series: list[Changes], repeated: float) -> tuple[float, float, float] | None:
    series = [changes.within(motion, MAX_DURATION_S + PEAK_WIDTH_S) for changes in series]
    if any(np.isfinite(changes.course_rate).sum() < MIN_INTERVALS for changes in series):
        return None

    def log_likelihoods(lags_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = [_log_likelihoods(motion, changes, lags_s) for changes in series]
        return np.sum([part for part, _ in parts], axis=0) / repeated, np.min([share for _, share in parts], axis=0)

    coarse, _ = log_likelihoods(COARSE_GRID_S)
    lags = COARSE_GRID_S[int(coarse.argmax())] + FINE_GRID_S
    total, explained = log_likelihoods(lags)
    if explained.max() < EXPLAINED:
        return None
    weight = np.exp(total - total.max())
    weight /= weight.sum()
    lag = float(weight @ lags)
    sd = float(np.hypot(np.sqrt(weight @ (lags - lag) ** 2), LEAST_SD_S))
    unmoved = float(coarse[len(COARSE_GRID_S) // 2])
    return (lag, sd, float(total.max()) - unmoved) if sd < LARGEST_SD_S else None


def _log_likelihoods(motion: Motion, changes: Changes, lags_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithms of the likelihood of one series at lags, and the shares of the course rate that they explain."""
    turning, inertial = np.isfinite(changes.course_rate), changes.inertial(motion, lags_s)
    by_force, _ = _fit(inertial[:3], changes.acceleration)
    by_rate, explained = _fit(inertial[3:, :, turning], changes.course_rate[turning])
    return by_force + by_rate, explained


def _fit(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithm of the likelihood of y = x b + b0, large residuals counted less, and the share of y's variance.

    Parameters
    ----------
    x : ndarray, shape (3, l, n)
        Regressors at each lag.
    y : ndarray, shape (n,)
        Observations.

    Returns
    -------
    tuple of ndarray, shape (l,)
        Logarithms, and shares.

    Notes
    -----
    Without their means, which b0 takes up, b = (xᵀ x)⁺ xᵀ y.
    """
    y = y - y.mean()
    x = (x - x.mean(axis=2, keepdims=True)).transpose(1, 0, 2)  # each lag's regressors as rows
    b = np.linalg.pinv(x @ x.transpose(0, 2, 1), rcond=INDEPENDENT, hermitian=True) @ (x @ y)[..., np.newaxis]
    size = np.abs(y - (b.transpose(0, 2, 1) @ x)[:, 0])
    left = np.minimum(size, 4.0 * np.median(size, axis=1, keepdims=True))
    variance = float(y @ y) + 1e-12
    residual = np.maximum((left * left).sum(axis=1), 1e-9 * variance)
    return -0.5 * len(y) * np.log(residual / variance), 1.0 - residual / variance
