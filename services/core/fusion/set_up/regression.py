"""Least squares with standard errors, without the rows that contradict all others."""

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

CORRELATED_ROWS = 2.0  # residuals in a row that count as one
OUTLIER = 4.0  # times the median residual
SIGNED_PERMUTATIONS = tuple(
    np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
)
SIGNED_PERMUTATIONS_2 = tuple(
    np.diag(signs)[list(order)] for order in permutations(range(2)) for signs in product((1.0, -1.0), repeat=2)
)


class Fit(NamedTuple):
    """Coefficients of y = x @ coefficients, their standard deviations, shape (p, q), and the rows that were used."""

    coefficients: FloatArray
    sd: FloatArray
    rows: int
    residual: FloatArray  # standard deviation of each column of y, shape (q,)


def least_squares(x: FloatArray, y: FloatArray) -> Fit | None:
    """Fit y = x @ c by least squares, again without outliers; None where the rows do not determine c.

    Parameters
    ----------
    x : ndarray, shape (n, p)
        Regressors.
    y : ndarray, shape (n, q)
        Observations.
    """
    fit = _fit(x, y)
    if fit is None:
        return None
    size = np.linalg.norm((y - x @ fit.coefficients) / np.maximum(fit.residual, 1e-12), axis=1)
    sound = size <= OUTLIER * float(np.median(size)) + 1e-9
    return _fit(x[sound], y[sound])


def _fit(x: FloatArray, y: FloatArray) -> Fit | None:
    n, p = x.shape
    if n < 2 * p + 2 or np.linalg.matrix_rank(x) < p:
        return None
    inverse = np.linalg.inv(x.T @ x)
    coefficients: FloatArray = inverse @ (x.T @ y)
    variance = ((y - x @ coefficients) ** 2).sum(axis=0) / (n - p)
    sd = np.sqrt(CORRELATED_ROWS * np.outer(inverse.diagonal(), variance))
    return Fit(coefficients, sd, n, np.sqrt(variance))


def nearest_permutation(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Signed permutation P that maximises tr(Pᵀ M), and by how much it exceeds that of the identity."""
    choices = SIGNED_PERMUTATIONS if len(matrix) == 3 else SIGNED_PERMUTATIONS_2
    best = max(choices, key=lambda choice: float((choice * matrix).sum()))
    return best, float((best * matrix).sum() - np.trace(matrix))
