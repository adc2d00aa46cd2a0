"""Chi-square global test, Baarda's w-test, minimal detectable bias and slope protection level of a least-squares fit.

References
----------
W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission 2(5), 1968;
R. G. Brown, G. Y. Chin, "GPS RAIM: calculation of thresholds and protection radius", Navigation 5, 1998.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import inf, sqrt

import numpy as np
from scipy.special import chndtrinc, ndtri

from shared.maths.quantiles import chi_square_limit

from .measurements import FloatArray

MIN_REDUNDANCY = 1e-6  # [-] below it, a satellite alone determines a parameter and cannot be tested


@lru_cache(maxsize=256)
def local_threshold(tests: float, false_alarm_rate: float) -> float:
    """D_H = Phi^-1(1 - P_FA/(2 n)), two-sided for each of n tests, to be compared with |w| and not with its square."""
    return float(-ndtri(false_alarm_rate / (2 * tests)))


@lru_cache(maxsize=256)
def noncentrality(dof: int, false_alarm_rate: float, missed_detection_rate: float) -> float:
    """Find lambda with P(chi2(dof, lambda) < T_H) = P_MD: what a fault must add to T to be detected."""
    return float(chndtrinc(chi_square_limit(dof, false_alarm_rate), dof, missed_detection_rate))


@dataclass(frozen=True)
class Fit:
    """A weighted least-squares fit of n measurements and m parameters, with what its residuals can show."""

    parameters: FloatArray  # shape (m,)
    cov: FloatArray  # shape (m, m)
    residuals: FloatArray  # shape (n,) [unit of the measurements]
    redundancy: FloatArray  # shape (n,) diagonal of S, 0 to 1: the part of an error that its own residual shows
    gain: FloatArray  # shape (m, n) parameters per unit of a measurement
    sd: FloatArray  # shape (n,)
    hat: FloatArray  # shape (n, n) I - S, of measurements over their sd
    statistic: float  # T
    dof: int

    @property
    def w(self) -> FloatArray:
        """|residual| over its standard deviation, shape (n,); 0 where a measurement cannot be tested."""
        testable = self.redundancy > MIN_REDUNDANCY
        sd = np.sqrt(np.where(testable, self.redundancy, 1.0)) * self.sd
        w: FloatArray = np.where(testable, np.abs(self.residuals) / sd, 0.0)
        return w


def weighted_fit(H: FloatArray, y: FloatArray, sd: FloatArray) -> Fit | None:
    """Fit y = H x + v by weighted least squares.

    Parameters
    ----------
    H : ndarray, shape (n, m)
        Design matrix, n >= m.
    y, sd : ndarray, shape (n,)
        Measurements and their standard deviations, uncorrelated.

    Returns
    -------
    Fit or None
        None where the geometry does not determine all parameters.

    Notes
    -----
    With A = H/sd and e = (y - H x)/sd::

        x = (A' A)^-1 A' y/sd,   T = e' e ~ chi2(n - m),   S = I - A (A' A)^-1 A',   w_i = |e_i|/sqrt(S_ii)
    """
    A = H / sd[:, np.newaxis]
    if len(A) < A.shape[1]:
        return None
    Q, R = np.linalg.qr(A)
    diagonal = np.abs(np.diag(R))
    if diagonal.min() <= 1e-9 * diagonal.max():
        return None
    inverse = np.linalg.inv(R)
    parameters = inverse @ (Q.T @ (y / sd))
    residuals = y - H @ parameters
    redundancy = 1.0 - (Q * Q).sum(axis=1)
    statistic = float(((residuals / sd) ** 2).sum())
    gain, cov, dof = inverse @ Q.T / sd, inverse @ inverse.T, len(A) - A.shape[1]
    return Fit(parameters, cov, residuals, redundancy, gain, sd, Q @ Q.T, statistic, dof)


def largest_correlations(fit: Fit) -> FloatArray:
    """Largest |correlation| of each w with another one, shape (n,): 1 where two faults cannot be separated."""
    S = np.eye(len(fit.sd)) - fit.hat
    sd = np.sqrt(np.maximum(fit.redundancy, MIN_REDUNDANCY))
    correlation = np.abs(S / np.outer(sd, sd))
    np.fill_diagonal(correlation, 0.0)
    largest: FloatArray = np.minimum(correlation.max(axis=1), 1.0)
    return largest


def minimal_identifiable_biases(fit: Fit, lambda_: float, missed_detection_rate: float) -> FloatArray:
    """Bias of each measurement that is detected, and attributed to it and not to another one, but for P_MD.

    Parameters
    ----------
    fit : Fit
        With dof >= 1.
    lambda_ : float
        `noncentrality` of its dof.
    missed_detection_rate : float
        [-] P_MD, of either mistake.

    Returns
    -------
    ndarray, shape (n,)
        [unit of the measurements] Infinite where no bias can be attributed, as everywhere with dof = 1.

    Notes
    -----
    A bias of d standard deviations of w_i moves w_j by rho_ij d, so that w_i - w_j has the mean (1 - rho) d and the
    variance 2 (1 - rho)::

        MIB_i = sd_i/sqrt(S_ii) max( sqrt(lambda), k sqrt(2/(1 - rho_i)) ),   k = Phi^-1(1 - P_MD/(n - 1))

    References
    ----------
    J. Wang, N. L. Knight, "New outlier separability test and its application in GNSS positioning", J. Global
    Positioning Systems 11(1), 2012.
    """
    detectable = minimal_detectable_biases(fit, lambda_)
    k = -float(ndtri(missed_detection_rate / max(len(fit.sd) - 1, 1)))
    apart = 1.0 - largest_correlations(fit)
    separable = apart > MIN_REDUNDANCY
    factor = np.where(separable, k * np.sqrt(2.0 / np.where(separable, apart, 1.0) / lambda_), inf)
    return detectable * np.maximum(1.0, factor)


def minimal_detectable_biases(fit: Fit, lambda_: float) -> FloatArray:
    """Bias of each measurement that the global test misses with probability P_MD: sd sqrt(lambda/S_ii).

    Parameters
    ----------
    fit : Fit
        With dof >= 1.
    lambda_ : float
        `noncentrality` of its dof.

    Returns
    -------
    ndarray, shape (n,)
        [unit of the measurements] Infinite where a measurement cannot be tested.
    """
    testable = fit.redundancy > MIN_REDUNDANCY
    biases: FloatArray = np.where(testable, fit.sd * np.sqrt(lambda_ / np.where(testable, fit.redundancy, 1.0)), inf)
    return biases


def horizontal_levels(fit: Fit, lambda_: float) -> FloatArray:
    """Horizontal error that each measurement's minimal detectable bias causes: sqrt(lambda) times its slope.

    Parameters 0 and 1 of the fit are north and east. It bounds the bias alone, without noise.

    Returns
    -------
    ndarray, shape (n,)
        [m] Infinite where a measurement cannot be tested.
    """
    slope = np.hypot(fit.gain[0], fit.gain[1])
    biases = minimal_detectable_biases(fit, lambda_)
    levels: FloatArray = np.where(np.isfinite(biases), slope * np.where(np.isfinite(biases), biases, 0.0), inf)
    return levels


def innovation_test(h: FloatArray, y: float, sd: float, fit: Fit) -> tuple[float, float]:
    """Test a measurement that a fit has not used: its innovation y - h x, and that over its standard deviation."""
    innovation = y - float(h @ fit.parameters)
    return innovation, abs(innovation) / sqrt(sd**2 + float(h @ fit.cov @ h))
