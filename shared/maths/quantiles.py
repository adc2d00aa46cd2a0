"""Quantiles of the normal and chi-square distributions: limits of gates, and radii of protection levels.

All of them depend on configured probabilities only, and are computed once for each.
"""

from functools import cache, lru_cache
from math import hypot

import numpy as np
import numpy.typing as npt
from scipy.special import gammainccinv, ndtri

FloatArray = npt.NDArray[np.float64]

NODES = 64  # of the mean over a quarter turn
COSINES2 = np.cos((np.arange(NODES) + 0.5) * (np.pi / (2 * NODES))) ** 2
STEPS = 32  # of the table of factors, from a line to a circle
RATIOS = np.arange(STEPS + 1) / STEPS
ROUNDS = 8  # of Newton's method, which needs 4 to rounding


@cache
def chi_square_limit(dimension: int, false_alarm: float) -> float:
    """Limit of a gate: what a normalised innovation squared exceeds by chance with a given probability.

    Parameters
    ----------
    dimension : int
        [-] Number of components, at least 1.
    false_alarm : float
        [-] Probability, such as 0.001.

    Returns
    -------
    float
        [-] The limit of d², to be compared with d² and not with d.

    Notes
    -----
    A chi-square over two has a gamma distribution with half the degrees of freedom::

        P(d² > x) = Q(n/2, x/2),    Q the regularised upper incomplete gamma function
    """
    return 2.0 * float(gammainccinv(0.5 * dimension, false_alarm))


@lru_cache(maxsize=64)
def line_factor(risk: float) -> float:
    """Find the number of standard deviations that a normal number is off, on either side, with a probability."""
    return -float(ndtri(0.5 * risk)) if risk < 1.0 else 0.0


def principal_variances(nn: float, ne: float, ee: float) -> tuple[float, float]:
    """Larger and smaller eigenvalue of a horizontal covariance [m²: NN, NE, EE]; rounding may make it negative."""
    middle, spread = 0.5 * (nn + ee), hypot(0.5 * (nn - ee), ne)
    return middle + spread, middle - spread


def circle_factor(ratio: float, risk: float) -> float:
    """Find the radius outside which a normal pair lies with a probability, over its larger standard deviation.

    Parameters
    ----------
    ratio : float
        [-] Of the smaller standard deviation to the larger, 0 to 1.
    risk : float
        [-] The probability.

    Returns
    -------
    float
        [-] From `line_factor` for a line to sqrt(-2 ln risk) for a circle; interpolated, which is
        never too little, and too much by 0.003 at most.
    """
    return float(np.interp(ratio, RATIOS, _circle_factors(risk)))


@lru_cache(maxsize=64)
def _circle_factors(risk: float) -> FloatArray:
    """Radii, over the larger standard deviation, outside which a normal pair is with the risk, for each of `RATIOS` b.

    Notes
    -----
    With x = ρ cos φ and y = b ρ sin φ, ρ is Rayleigh's and φ even, so that the tail in each direction is closed::

        P(R) = 2/π ∫₀^{π/2} exp( -R² r(φ) ) dφ,    r = 1 / (2 (cos² φ + b² sin² φ))

    Midpoints give the integral of a smooth periodic function fast. ln P is a convex and falling function of R², as the
    logarithm of a sum of exponentials, so that Newton's method rises to its root from the radius of a line, which is
    too small for every ellipse, without passing it::

        R² <- R² + ln(P / risk) / (-d ln P / d R²)

    References
    ----------
    R. S. Hoyt, "Probability functions for the modulus of the angular vector", Bell System Technical Journal 26, 1947.
    """
    if risk >= 1.0:
        return np.zeros(STEPS + 1)
    line, circle, b2 = line_factor(risk), np.sqrt(-2.0 * np.log(risk)), RATIOS[1:-1, np.newaxis] ** 2
    rates = 0.5 / (b2 + (1.0 - b2) * COSINES2)
    squared = np.full(STEPS - 1, line**2)
    for _ in range(ROUNDS):
        tails = np.exp(-squared[:, np.newaxis] * rates)
        mean = tails.mean(axis=1)
        squared += np.log(mean / risk) * mean / (tails * rates).mean(axis=1)
    return np.array([line, *np.sqrt(squared), circle])
