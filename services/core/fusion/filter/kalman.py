"""What this filter's covariance needs beside `shared.maths.kalman`."""

from math import isfinite

import numpy as np
import numpy.typing as npt

from shared.maths import kalman

FloatArray = npt.NDArray[np.float64]


def predict(P: FloatArray, Phi: FloatArray, added: FloatArray) -> FloatArray:
    """Covariance after a step: Phi P Phi^T + diag(added).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    Phi : ndarray, shape (n, n)
        Transition matrix.
    added : ndarray, shape (n,)
        [unit²] Variances that the step adds.

    Returns
    -------
    ndarray, shape (n, n)
        Exactly symmetric.
    """
    return kalman.predict(P, Phi, np.diag(added))


def variances(P: FloatArray, count: int) -> tuple[float, float]:
    """Sum of all variances, and the least of the first ones: how a covariance is seen to be sound."""
    diagonal = P.diagonal().tolist()
    return sum(diagonal), min(diagonal[:count])


def resized(P: FloatArray, first: int, end: int, ratios: FloatArray) -> FloatArray:
    """Covariance after the unit of some errors was found to be another one, in which they are as large as before.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    first, end : int
        Place of these errors u, the end not included; all of them have variance.
    ratios : ndarray, shape (end - first,)
        [-] New unit of each over the old one.

    Returns
    -------
    ndarray, shape (n, n)
        What of the other errors x stems from u is as much larger; all else stays, as if the unit had been known from
        the beginning.

    Notes
    -----
    With P_xu, P_uu the blocks of P and D = diag(ratios)::

        A = P_xu P_uu^-1,  x = A u + rest  ->  A D u + rest,  P+ = (I + W) P (I + W)^T  with  W = A (D - I)
    """
    stems = P[:, first:end].dot(np.linalg.inv(P[first:end, first:end]))
    stems[first:end] = 0.0
    W = stems * (ratios - 1.0)
    half = P + W.dot(P[first:end])
    after = half + half[:, first:end].dot(W.T)
    symmetric: FloatArray = after + after.T
    symmetric *= 0.5
    return symmetric


def inverse_elements(
    s11: float, s21: float, s22: float, s31: float, s32: float, s33: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Whether a symmetric matrix is positive definite and finite, and its inverse, by their lower halves."""
    d1 = s11
    l21, l31 = (s21 / d1, s31 / d1) if d1 > 0.0 else (0.0, 0.0)
    d2 = s22 - l21 * s21
    l32 = (s32 - l31 * s21) / d2 if d2 > 0.0 else 0.0
    d3 = s33 - l31 * s31 - l32 * l32 * d2
    if not (d1 > 0.0 and d2 > 0.0 and d3 > 0.0 and isfinite(d1 + d2 + d3)):
        return False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    w31 = l21 * l32 - l31
    v31, v32 = w31 / d3, -l32 / d3
    v21, v22 = -l21 / d2 + w31 * v32, 1.0 / d2 - l32 * v32
    return True, 1.0 / d1 + l21 * l21 / d2 + w31 * v31, v21, v22, v31, v32, 1.0 / d3
