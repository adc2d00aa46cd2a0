"""Real pseudoranges tested against a prediction from virtual ones: the construction of the paper, corrected.

A virtual pseudorange is computed from the forward estimate x^- to a satellite that need not be received. It adds no
information: with q = (y_r - yhat_r^-) - Omega (y_v - yhat_v^-) and noise-free y_v, q is y_r - yhat_r(x^-) for any
choice of virtual satellites, which act through the covariance W alone. The corrections are listed in
docs/explanation/cooperative.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import cos, inf, sin, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.quantiles import chi_square_limit

from ..detection import local_threshold, noncentrality
from ..measurements import FloatArray

MAX_CHOICES = 5000  # sets of virtual satellites that are compared: all of 4 out of 20
BoolArray = npt.NDArray[np.bool_]


def design_row(elevation: float, azimuth: float) -> FloatArray:
    """Row of H for (north, east, down, c dt), shape (4,), towards angles [rad]."""
    return np.array([-cos(elevation) * cos(azimuth), -cos(elevation) * sin(azimuth), sin(elevation), 1.0])


def prediction_matrix(H_real: FloatArray, H_virtual: FloatArray) -> FloatArray:
    """Omega = H_r H_v^+, shape (n, u): what virtual pseudoranges predict of real ones.

    Raises
    ------
    ValueError
        The virtual satellites do not determine the state.
    """
    if np.linalg.matrix_rank(H_virtual) < H_virtual.shape[1]:
        raise ValueError(f"{len(H_virtual)} virtual satellites do not determine {H_virtual.shape[1]} unknowns")
    omega: FloatArray = H_real @ np.linalg.pinv(H_virtual)
    return omega


def residual_cov(omega: FloatArray, real_sd: FloatArray, virtual_sd: FloatArray) -> FloatArray:
    """W = Lambda_r + Omega Lambda_v Omega' [m²], shape (n, n); it contains the variances of both."""
    cov: FloatArray = np.diag(real_sd**2) + (omega * virtual_sd**2) @ omega.T
    return cov


@dataclass(frozen=True)
class ResidualTest:
    """Global and local tests of residuals q; the leading axes are those of q."""

    statistic: FloatArray  # T = q' W^-1 q
    threshold: float  # chi2inv(1 - P_FA, n)
    t: FloatArray  # |q_i|/sqrt(W_ii), shape (..., n)
    local: float  # two-sided, P_FA/n for each
    excluded: BoolArray  # shape (..., n)


def residual_test(q: FloatArray, W: FloatArray, false_alarm_rate: float) -> ResidualTest:
    """Exclude satellite i where T > T_H and t_i > D_H.

    Parameters
    ----------
    q : ndarray, shape (..., n)
        [m] Measured minus predicted pseudoranges; the reference contains no real satellite, so that a fault on i is
        in q_i alone and several may be excluded at once.
    W : ndarray, shape (n, n)
        [m²] Their covariance.
    false_alarm_rate : float
        [-] P_FA of the global test, and of all local tests together.

    Notes
    -----
    T is chi-square with n degrees of freedom, whatever the number of virtual satellites.
    """
    n = len(W)
    statistic = (q * np.linalg.solve(W, q[..., np.newaxis])[..., 0]).sum(axis=-1)
    threshold, local = chi_square_limit(n, false_alarm_rate), local_threshold(n, false_alarm_rate)
    t = np.abs(q) / np.sqrt(np.diag(W))
    return ResidualTest(statistic, threshold, t, local, (statistic > threshold)[..., np.newaxis] & (t > local))


def snooping_test(q: FloatArray, W: FloatArray, false_alarm_rate: float) -> ResidualTest:
    """Exclude one satellite after the other by Baarda's statistic, while T > T_H of those that are left.

    Parameters and statistics as in `residual_test`; `t` holds w_i of all satellites. The one with the largest w_i is
    excluded if w_i > D_H. A bias on one satellite raises the w_i of the others less than the t_i that are printed.
    """
    whole = residual_test(q, W, false_alarm_rate)
    excluded, shape = np.zeros((q[..., 0].size, len(W)), dtype=np.bool_), q.shape
    residuals = q.reshape(-1, len(W))
    for left in range(len(W), 0, -1):
        for pattern in np.unique(excluded, axis=0):
            if (~pattern).sum() != left:
                continue
            rows = np.flatnonzero((excluded == pattern).all(axis=1))
            used = np.flatnonzero(~pattern)
            W_used, q_used = W[np.ix_(used, used)], residuals[np.ix_(rows, used)]
            w = baarda_statistics(q_used, W_used)
            statistic = (q_used * np.linalg.solve(W_used, q_used[..., np.newaxis])[..., 0]).sum(axis=-1)
            found = (statistic > chi_square_limit(left, false_alarm_rate)) & (
                w.max(axis=1) > local_threshold(left, false_alarm_rate)
            )
            excluded[rows[found], used[w.argmax(axis=1)[found]]] = True
    return replace(whole, t=baarda_statistics(q, W), excluded=excluded.reshape(shape))


def local_biases(W: FloatArray, false_alarm_rate: float) -> FloatArray:
    """Bias [m] of each satellite at which its local test fires, shape (n,)."""
    biases: FloatArray = local_threshold(len(W), false_alarm_rate) * np.sqrt(np.diag(W))
    return biases


def baarda_statistics(q: FloatArray, W: FloatArray) -> FloatArray:
    """w_i = |(W^-1 q)_i|/sqrt((W^-1)_ii), shape (..., n) as q: the sharpest test of a bias on one satellite."""
    inverse = np.linalg.inv(W)
    w: FloatArray = np.abs(q @ inverse) / np.sqrt(np.diag(inverse))
    return w


def baarda_biases(W: FloatArray, false_alarm_rate: float) -> FloatArray:
    """Bias [m] of each satellite at which its w-test fires, shape (n,)."""
    biases: FloatArray = local_threshold(len(W), false_alarm_rate) / np.sqrt(np.diag(np.linalg.inv(W)))
    return biases


def hdop(H: FloatArray) -> float:
    """Horizontal dilution of precision: sqrt of the trace of the horizontal block of (H' H)^-1."""
    inverse = np.linalg.inv(H.T @ H)
    return sqrt(float(inverse[0, 0] + inverse[1, 1]))


def horizontal_slopes(H: FloatArray, real: Sequence[int]) -> FloatArray:
    """d_i = sqrt(HDOP_i² - HDOP²) of the rows `real`, shape (n,), HDOP_i without row i; infinite where it is undefined.

    Equal to the slope (A_1i² + A_2i²)/S_ii of parity-space RAIM.
    """
    inverse = np.linalg.inv(H.T @ H)
    gain = inverse @ H.T
    redundancy = 1.0 - (H * gain.T).sum(axis=1)
    with np.errstate(divide="ignore"):
        slopes: FloatArray = np.hypot(gain[0], gain[1]) / np.sqrt(np.maximum(redundancy, 0.0))
    return slopes[list(real)]


def horizontal_protection_level(
    H: FloatArray, real: Sequence[int], sd: float, *, false_alarm_rate: float, missed_detection_rate: float
) -> float:
    """HPL = sigma sqrt(lambda) max d_i [m]: a bound of the bias alone, valid for four virtual satellites."""
    lambda_ = noncentrality(len(real), false_alarm_rate, missed_detection_rate)
    return sd * sqrt(lambda_) * float(horizontal_slopes(H, real).max())


def choose_virtual(
    H_real: FloatArray,
    candidates: FloatArray,
    count: int = 4,
    *,
    level: Callable[[FloatArray], float] | None = None,
    limit: float = inf,
) -> tuple[int, ...] | None:
    """Choose virtual satellites so that the least sensitive test is as sensitive as can be: least max W_ii.

    Where the protection level with them exceeds the alert limit they are chosen anew: the next best set with a level
    within the limit, or the one with the least level where there is none.

    Parameters
    ----------
    H_real : ndarray, shape (n, m)
        Rows of the received satellites.
    candidates : ndarray, shape (k, m)
        Rows of satellites that may serve as virtual ones, the best first: `MAX_CHOICES` sets are compared.
    count : int
        How many to choose.
    level : callable or None
        Gives the protection level HPL [m] with virtual satellites of given rows, shape (count, m).
    limit : float
        [m] HAL.

    Returns
    -------
    tuple of int or None
        Rows of the candidates; None where no set determines the state.
    """
    sets: list[tuple[float, tuple[int, ...]]] = []
    for chosen in islice(combinations(range(len(candidates)), count), MAX_CHOICES):
        H_virtual = candidates[list(chosen)]
        if np.linalg.cond(H_virtual) <= 1e6:
            sets.append((float((prediction_matrix(H_real, H_virtual) ** 2).sum(axis=1).max()), chosen))
    if level is None or not sets:
        return min(sets)[1] if sets else None
    least: tuple[float, tuple[int, ...]] | None = None
    for _, chosen in sorted(sets):
        found = level(candidates[list(chosen)])
        if found <= limit:
            return chosen
        if least is None or found < least[0]:
            least = found, chosen
    return least[1] if least else None
