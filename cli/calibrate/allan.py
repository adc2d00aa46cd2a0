"""Overlapping Allan deviation of inertial sensors, and the noise parameters that follow from it.

References
----------
IEEE Std 952-1997, annex C: Allan variance of the errors of a gyroscope.
W. Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, section 5.2.4: the overlapping estimate.
"""

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

MIN_CLUSTERS = 9  # of the longest cluster time, at which the deviation is known to 25 %
PER_DECADE = 10  # cluster times
FLICKER = sqrt(2.0 * log(2.0) / pi)  # 0.664: Allan deviation of flicker noise over its bias instability
VISIBLE_RATIO = 2.0  # Allan variance over that of the white noise alone, from which the bias is seen
RISE_SDS = 2.0  # standard deviations by which a deviation rises behind its minimum
TIMES = 60  # correlation times that are tried


@dataclass(frozen=True)
class Allan:
    """Allan deviation of one axis.

    Attributes
    ----------
    times_s, deviation : ndarray, shape (m,)
        [s] Cluster times and [rad/s or m/s²] the deviation at each.
    relative_sd : ndarray, shape (m,)
        [-] Its standard deviation over its value.
    """

    times_s: FloatArray
    deviation: FloatArray
    relative_sd: FloatArray


@dataclass(frozen=True)
class Noise:
    """Noise parameters of one axis, in rad/s or m/s² and the unit of time second.

    Attributes
    ----------
    random_walk : float
        [unit sqrt(s)] Root of the PSD of the white noise.
    instability : float
        [unit] First minimum of the Allan deviation over 0.664: bias instability; an upper limit where `minimum_seen` is
        false.
    instability_time_s : float
        [s] Cluster time of that minimum.
    minimum_seen : bool
        Whether the deviation rises again behind its minimum.
    bias_sd : float or None
        [unit] Standard deviation of the first-order Gauss-Markov bias; None where it is not seen.
    correlation_s : float or None
        [s] Its correlation time, at most the longest cluster time.
    """

    random_walk: float
    instability: float
    instability_time_s: float
    minimum_seen: bool
    bias_sd: float | None
    correlation_s: float | None

    @property
    def bias_psd(self) -> float | None:
        """PSD [unit²/s] of the white noise that drives the bias: 2 sd² / T."""
        if self.bias_sd is None or self.correlation_s is None:
            return None
        return 2.0 * self.bias_sd**2 / self.correlation_s


def cluster_counts(samples: int) -> Counts:
    """Samples of a cluster, evenly on a logarithmic scale, up to a ninth of all samples."""
    longest = samples // MIN_CLUSTERS
    if longest < 1:
        return np.zeros(0, dtype=np.int64)
    steps = max(round(PER_DECADE * np.log10(longest)), 1)
    return np.unique(np.round(np.logspace(0.0, np.log10(longest), steps + 1)).astype(np.int64))


def allan_deviation(values: FloatArray, step_s: float, counts: Counts) -> Allan:
    """Overlapping Allan deviation of one axis.

    Parameters
    ----------
    values : ndarray, shape (n,)
        [rad/s or m/s²] Samples at even steps.
    step_s : float
        [s] Time between two samples.
    counts : ndarray of int, shape (m,)
        Samples of a cluster, at most n / 2.

    Returns
    -------
    Allan
        Deviations at ``counts * step_s``.

    Raises
    ------
    ValueError
        A cluster is longer than half of the samples.

    Notes
    -----
    With the integral a_k of the samples and clusters of m samples, t = m step::

        s²(t) = 1 / (2 t² (N + 1 - 2m)) · Σ (a_{k+2m} - 2 a_{k+m} + a_k)²

    The relative standard deviation of s is that of white noise, 1 / sqrt(2 (n/m - 1)).
    """
    if len(counts) and 2 * int(counts.max()) > len(values):
        raise ValueError(f"clusters of {int(counts.max())} samples need twice as many, and there are {len(values)}")
    # Without the mean, the sum over hours of samples keeps its digits.
    integral = np.concatenate([[0.0], np.cumsum(values - values.mean())]) * step_s
    deviations = np.empty(len(counts))
    for place, count in enumerate(counts.tolist()):
        second = integral[2 * count :] - 2.0 * integral[count:-count] + integral[: -2 * count]
        deviations[place] = sqrt(float(second @ second) / (2.0 * (count * step_s) ** 2 * len(second)))
    clusters = len(values) / counts.astype(np.float64)
    relative_sd: FloatArray = 1.0 / np.sqrt(2.0 * (clusters - 1.0))
    times_s: FloatArray = counts.astype(np.float64) * step_s
    return Allan(times_s, deviations, relative_sd)


def gauss_markov_variance(times_s: FloatArray, correlation_s: float) -> FloatArray:
    """Allan variance [-] of a first-order Gauss-Markov process of variance one.

    Notes
    -----
    ::

        s²(t) = 2 T/t (1 - T/(2t) (3 - 4 exp(-t/T) + exp(-2t/T)))
    """
    ratio = times_s / correlation_s
    bracket = 3.0 - 4.0 * np.exp(-ratio) + np.exp(-2.0 * ratio)
    # For short times the difference loses its digits: the series is 2t / (3T).
    exact = 2.0 / ratio * (1.0 - bracket / (2.0 * ratio))
    variance: FloatArray = np.where(ratio < 1e-3, 2.0 * ratio / 3.0, exact)
    return variance


def noise_of(allan: Allan) -> Noise:
    """Fit white noise and a Gauss-Markov bias to an Allan deviation.

    Parameters
    ----------
    allan : Allan
        Of one axis.

    Returns
    -------
    Noise
        The parameters; those of the bias are None where the deviation at the longest times is that of white noise.

    Notes
    -----
    For each of many correlation times T, the two variances are found by non-negative least squares of relative
    residuals, each cluster time weighted by the number of independent clusters; the T of the least residual is taken::

        s²(t) = N²/t + B² g(t, T)
    """
    from scipy.optimize import nnls

    variance = allan.deviation**2
    usable = variance > 0.0
    place, rises = _minimum(allan)
    instability, instability_s = float(allan.deviation[place]) / FLICKER, float(allan.times_s[place])
    if usable.sum() < 3:
        return Noise(float(allan.deviation[0] * sqrt(allan.times_s[0])), instability, instability_s, rises, None, None)
    times, weights = allan.times_s[usable], 1.0 / allan.relative_sd[usable]
    known = variance[usable]
    best: tuple[float, float, float, float] | None = None
    for correlation in np.geomspace(times[0] * 3.0, times[-1], TIMES).tolist():
        columns = np.column_stack([1.0 / times, gauss_markov_variance(times, correlation)])
        scaled = columns / known[:, None] * weights[:, None]
        size = np.linalg.norm(scaled, axis=0)
        found, residual = nnls(scaled / size, weights)
        white, bias = (found / size).tolist()
        if best is None or residual < best[0]:
            best = float(residual), white, bias, correlation
    if best is None:  # there is at least one correlation time
        raise ValueError("no cluster times")
    _, white, bias, correlation = best
    seen = bias > 0.0 and bool(np.any(known > VISIBLE_RATIO * white / times))
    return Noise(
        sqrt(white), instability, instability_s, rises, sqrt(bias) if seen else None, correlation if seen else None
    )


def _minimum(allan: Allan) -> tuple[int, bool]:
    """Index of the first minimum behind which the deviation rises clearly, and True; else of the least, and False.

    Behind its hump the deviation of a Gauss-Markov bias falls again, below that minimum.
    """
    deviation = allan.deviation
    for place, least in enumerate(deviation.tolist()):
        later = np.flatnonzero(deviation[place + 1 :] < least)
        end = place + 1 + int(later[0]) if len(later) else len(deviation)
        risen = deviation[place + 1 : end] > least * (1.0 + RISE_SDS * allan.relative_sd[place + 1 : end])
        if risen.any():
            return place, True
    return int(np.argmin(deviation)), False
