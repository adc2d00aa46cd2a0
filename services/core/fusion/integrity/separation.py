"""How far two solutions may be apart although neither is wrong: the covariance of their difference.

Of two filters of one model and one past, of which one uses all measurements of the other and further ones, the error of
the better informed one is orthogonal to everything that both have measured, and so to their difference::

    Cov(x_sub - x) = P_sub - P

The sum of both covariances counts the shared past twice: on clean drives it makes the square of a difference after 20 s
look a third of what it is. Time-correlated errors of GNSS that are a state of the filter are part of both covariances,
and the identity holds with them. Those that no state stands for have another value at the anchor, where the solution
without GNSS keeps it, than they have now: twice their variance is added.

References
----------
M. Brenner, "Integrated GPS/inertial fault detection availability", Navigation 43(2), 1996 (solution separation).
"""

from math import isfinite, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.quantiles import principal_variances
from shared.maths.rotation import Vector

from .disagreement import Pair
from .error_monitor import ErrorMonitor

FloatArray = npt.NDArray[np.float64]

MIN_SD_M = 0.1  # of a difference: two filters do not propagate their covariances at the same instants


def difference_covariance(of_sub: FloatArray, of_full: FloatArray, monitor: ErrorMonitor) -> FloatArray:
    """Covariance of the position of one solution minus that of another one, which uses more.

    Parameters
    ----------
    of_sub : ndarray, shape (3, 3)
        [m², NED] Covariance of the position of the solution that leaves measurements out.
    of_full : ndarray, shape (3, 3)
        [m², NED] That of the solution that uses them.
    monitor : ErrorMonitor
        Of the solution that uses them: what it knows of time-correlated errors of GNSS.

    Returns
    -------
    ndarray, shape (3, 3)
        [m², NED] Positive definite. Where the second one is not the better informed along an eigenvector, because its
        error model has grown since the anchor, the sum of both bounds the variance.
    """
    values, axes = np.linalg.eigh(of_sub - of_full)
    sums = np.einsum("ik,ij,jk->k", axes, of_sub + of_full, axes)
    values = np.where(values < -(MIN_SD_M**2), sums, values)
    horizontal, vertical = 2.0 * monitor.correlated_variance_horizontal, 2.0 * monitor.correlated_variance_vertical
    S: FloatArray = (axes * np.maximum(values, 0.0)) @ axes.T
    return S + np.diag([horizontal, horizontal, vertical]) + MIN_SD_M**2 * np.eye(3)


def squared(apart_n: Vector, covariance: FloatArray) -> float | None:
    """Horizontal difference squared over its covariance [m²]; None of a covariance that is none."""
    S = covariance[:2, :2]
    determinant = float(S[0, 0] * S[1, 1] - S[0, 1] ** 2)
    if not determinant > 0.0:
        return None
    north, east, _ = apart_n
    value = (north**2 * S[1, 1] - 2.0 * north * east * S[0, 1] + east**2 * S[0, 0]) / determinant
    return float(value) if isfinite(value) else None


def spreads(covariance: FloatArray) -> Pair:
    """Largest horizontal and the vertical standard deviation [m] of a covariance [m², NED]."""
    (nn, ne, _), (_, ee, _), (_, _, dd) = covariance.tolist()
    return sqrt(principal_variances(nn, ne, ee)[0]), sqrt(dd)
