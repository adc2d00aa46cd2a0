"""The Kalman filter's two steps, and the gate between them."""

from functools import cache
from math import erfc, exp, inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged

FloatArray = npt.NDArray[np.float64]


@cache
def chi_square_limit(dimension: int, false_alarm: float) -> float:
    """Size that a normalised innovation squared exceeds by chance with a given probability.

    Parameters
    ----------
    dimension : int
        [-] Number of components, 1 to 3.
    false_alarm : float
        [-] Probability, such as 0.001.

    Returns
    -------
    float
        [-] The limit of d², to be compared with d² and not with d.

    Notes
    -----
    The survival functions are closed: erfc(s) with s = sqrt(x/2) for one dimension, exp(-x/2) for two, and
    erfc(s) + 2 s exp(-s²)/sqrt(pi) for three; their inverse is found by halving.
    """
    low, high = 0.0, 26.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _survival(dimension, middle) > false_alarm else (low, middle)
    return 2.0 * low * low


def _survival(dimension: int, s: float) -> float:
    """Probability that chi-square exceeds 2 s²."""
    if dimension == 1:
        return erfc(s)
    if dimension == 2:
        return exp(-s * s)
    if dimension == 3:
        return erfc(s) + 2.0 * s * exp(-s * s) / sqrt(pi)
    raise ValueError(f"a chi-square of dimension {dimension}")


def predict(P: FloatArray, Phi: FloatArray, added: FloatArray) -> FloatArray:
    """Covariance after a step: Phi P Phi^T + diag(added).

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    Phi : ndarray, shape (n, n)
        Transition matrix. Most of it is zero, but calls of NumPy on its blocks would take longer than the whole.
    added : ndarray, shape (n,)
        [unit²] Variances that the step adds.

    Returns
    -------
    ndarray, shape (n, n)
        Exactly symmetric.
    """
    half = Phi.dot(P).dot(Phi.T)
    after: FloatArray = half + half.T
    after *= 0.5
    diagonal = after.reshape(-1)[:: len(P) + 1]
    diagonal += added
    return after


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
    stems = P[:, first:end].dot(inverse_of(P[first:end, first:end]))
    stems[first:end] = 0.0
    W = stems * (ratios - 1.0)
    half = P + W.dot(P[first:end])
    after = half + half[:, first:end].dot(W.T)
    symmetric: FloatArray = after + after.T
    symmetric *= 0.5
    return symmetric


class Correction(NamedTuple):
    """What a measurement says about the errors: the estimate, its covariance, and how surprising it was."""

    x: FloatArray
    P: FloatArray
    distance2: float  # normalised innovation squared, d²
    z: FloatArray
    H: FloatArray
    K: FloatArray
    S: FloatArray  # covariance of z
    S_inverse: FloatArray

    @property
    def innovation_sd(self) -> tuple[float, ...]:
        """Standard deviations of z."""
        return tuple(map(sqrt, self.S.diagonal().tolist()))


def correct(P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
    """Estimate the errors from one measurement.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    z : ndarray, shape (m,)
        Measured minus predicted.
    H : ndarray, shape (m, n)
        z = H x + noise.
    R : ndarray, shape (m, m)
        Covariance of that noise.

    Returns
    -------
    Correction
        Computed whether or not the innovation is credible; the caller compares `distance2` with its limit.

    Raises
    ------
    FilterDiverged
        The innovation's covariance is not positive definite or not finite.

    Notes
    -----
    Joseph's form keeps P symmetric and positive::

        S = H P H^T + R,  K = P H^T S^-1,  x = K z,  P+ = (I - K H) P (I - K H)^T + K R K^T

    Its products are taken as A = P - K (H P) and A - (A H^T - K R) K^T, which are three columns wide.
    """
    PHt = P.dot(H.T)
    S = H.dot(PHt)
    S += R
    inverse = inverse_of(S)
    K = PHt.dot(inverse)
    x = K.dot(z)
    distance2 = float(z.dot(inverse).dot(z))
    if not isfinite(distance2):
        raise FilterDiverged("an innovation is not finite")
    half = P - K.dot(PHt.T)
    P_after = half - (half.dot(H.T) - K.dot(R)).dot(K.T)
    P_after = P_after + P_after.T
    P_after *= 0.5
    return Correction(x, P_after, distance2, z, H, K, S, inverse)


def inverse_of(S: FloatArray) -> FloatArray:
    """Inverse of a covariance, shape (m, m) with m <= 3, in plain floats: NumPy would take five times as long.

    Raises
    ------
    FilterDiverged
        It is not positive definite, or not finite.

    Notes
    -----
    With S = L D L^T, L having ones on its diagonal, and W = L^-1: S^-1 = W^T D^-1 W. A smaller one is filled up by
    ones on the diagonal.
    """
    size, rows = len(S), S.tolist()
    s11, s21, s22, s31, s32, s33 = rows[0][0], 0.0, 1.0, 0.0, 0.0, 1.0
    if size > 1:
        s21, s22 = rows[1][:2]
    if size > 2:
        s31, s32, s33 = rows[2]
    fine, i11, i21, i22, i31, i32, i33 = inverse_elements(s11, s21, s22, s31, s32, s33)
    if not fine:
        raise FilterDiverged("the covariance of an innovation is not positive definite")
    full = (i11, i21, i31), (i21, i22, i32), (i31, i32, i33)
    return np.array(full if size == 3 else [row[:size] for row in full[:size]])


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


def root_of(cov: FloatArray) -> FloatArray:
    """Cholesky's root L, L L^T = cov, of a covariance of shape (3, 3), in plain floats as well.

    Raises
    ------
    FilterDiverged
        It is not positive definite, or not finite.
    """
    (v11, _, _), (v21, v22, _), (v31, v32, v33) = cov.tolist()
    if v11 > 0.0:
        l11 = sqrt(v11)
        l21, l31 = v21 / l11, v31 / l11
        d2 = v22 - l21 * l21
        if d2 > 0.0:
            l22 = sqrt(d2)
            l32 = (v32 - l31 * l21) / l22
            d3 = v33 - l31 * l31 - l32 * l32
            if 0.0 < d3 < inf:
                return np.array([[l11, 0.0, 0.0], [l21, l22, 0.0], [l31, l32, sqrt(d3)]])
    raise FilterDiverged("the covariance of a measurement is not positive definite")
