"""The Kalman filter's prediction and correction, for one filter or for a stack of filters of one size.

All arrays may have the same leading axes, as in NumPy's linear algebra: a covariance is then of shape (..., n, n).
The state is the caller's: a correction estimates the state's errors, which the caller adds to it.
"""

from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..errors import FilterDiverged
from .compiled import compilable, compiled, inlined

FloatArray = npt.NDArray[np.float64]


class Correction(NamedTuple):
    """What one measurement says about the errors, with everything that a gate and a smoother need."""

    x: FloatArray  # shape (..., n), estimate of the errors
    P: FloatArray  # shape (..., n, n), covariance after
    distance2: FloatArray | float  # shape (...), normalised innovation squared, d²: see `quantiles.chi_square_limit`
    z: FloatArray  # shape (..., m), innovation
    H: FloatArray  # shape (..., m, n)
    K: FloatArray  # shape (..., n, m), gain
    S: FloatArray  # shape (..., m, m), covariance of z
    S_inverse: FloatArray  # shape (..., m, m)

    @property
    def innovation_sd(self) -> FloatArray:
        """Standard deviations of z, shape (..., m)."""
        return np.sqrt(np.diagonal(self.S, axis1=-2, axis2=-1))


def predict(P: FloatArray, Phi: FloatArray, Q: FloatArray) -> FloatArray:
    """Covariance after a step: Phi P Phi^T + Q.

    Parameters
    ----------
    P : ndarray, shape (..., n, n)
        Covariance before.
    Phi : ndarray, shape (..., n, n)
        Transition matrix.
    Q : ndarray, shape (..., n, n)
        Covariance of the noise that the step adds.

    Returns
    -------
    ndarray, shape (..., n, n)
        Exactly symmetric.
    """
    return _symmetric(Phi @ P @ Phi.mT + Q)


def correct(P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
    """Estimate the errors from one measurement.

    Parameters
    ----------
    P : ndarray, shape (..., n, n)
        Covariance before.
    z : ndarray, shape (..., m)
        Measured minus predicted.
    H : ndarray, shape (..., m, n)
        z = H x + noise.
    R : ndarray, shape (..., m, m)
        Covariance of that noise.

    Returns
    -------
    Correction
        Computed whether or not the innovation is credible; the caller compares `distance2` with its limit.

    Raises
    ------
    FilterDiverged
        The innovation's covariance, one of those of a stack, is not positive definite or not finite.

    Notes
    -----
    Joseph's form keeps P symmetric and positive::

        S = H P H^T + R,  K = P H^T S^-1,  x = K z,  P+ = (I - K H) P (I - K H)^T + K R K^T

    Its products are taken as A = P - K (H P) and A - (A H^T - K R) K^T, which are m columns wide.

    References
    ----------
    R. Bucy, P. Joseph, Filtering for Stochastic Processes with Applications to Guidance, 1968, ch. 16.
    """
    if P.ndim == 2:  # of one filter; compiled products want whole arrays, no views
        whole = np.ascontiguousarray(z), np.ascontiguousarray(H), np.ascontiguousarray(R)
        valid, x, after, distance2, K, S, S_inverse = correct_one(P, *whole)
        found = Correction(x, after, distance2, z, H, K, S, S_inverse)
    else:
        valid, found = _correct_stack(P, z, H, R)
    if not valid:
        raise FilterDiverged("the covariance of an innovation is not positive definite")
    if not np.isfinite(found.distance2).all():
        raise FilterDiverged("an innovation is not finite")
    return found


def consider(P: FloatArray, found: Correction, R: FloatArray, states: slice) -> Correction:
    """Leave some states out of a correction, and their uncertainty in: they keep their values and their covariance.

    Parameters
    ----------
    P, R : ndarray, shape (..., n, n) and (..., m, m)
        As given to `correct`.
    found : Correction
        What that has computed.
    states : slice
        Those that are considered and not estimated.

    Notes
    -----
    The rows of the gain that belong to them are zero, and Joseph's form holds for any gain::

        x = K z,  P+ = (I - K H) P (I - K H)^T + K R K^T

    References
    ----------
    S. Schmidt, "Application of State-Space Methods to Navigation Problems", Advances in Control Systems 3, 1966.
    """
    K = found.K.copy()
    K[..., states, :] = 0.0
    A = np.eye(P.shape[-1]) - K @ found.H
    after = A @ P @ A.mT + K @ R @ K.mT
    return found._replace(x=np.matvec(K, found.z), P=0.5 * (after + after.mT), K=K)


@compiled
def correct_one(
    P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[bool, FloatArray, FloatArray, float, FloatArray, FloatArray, FloatArray]:
    """Whether S is positive definite, then x, covariance after, d², K, S and its inverse: see `correct`."""
    PHt = P @ H.mT
    S = H @ PHt + R
    valid, S_inverse = inverse_of(S)
    K = PHt @ S_inverse
    return valid, K @ z, _joseph(P, H, R, K, PHt), float(z @ (S_inverse @ z)), K, S, S_inverse


@compilable
def inverse_of(S: FloatArray) -> tuple[bool, FloatArray]:
    """Whether a small symmetric matrix is positive definite and finite, and its inverse; zero if it is not.

    Notes
    -----
    By Cholesky's root without its square roots, S = L D L^T, in plain floats: S^-1 = L^-T D^-1 L^-1.
    """
    m = len(S)
    root, inverse = np.eye(m), np.zeros((m, m))
    for j in range(m):
        pivot = float(S[j, j])
        for k in range(j):
            pivot -= float(root[j, k]) ** 2 * float(inverse[k, k])
        if not 0.0 < pivot < inf:
            return False, np.zeros((m, m))
        inverse[j, j] = pivot
        for i in range(j + 1, m):
            value = float(S[i, j])
            for k in range(j):
                value -= float(root[i, k]) * float(root[j, k]) * float(inverse[k, k])
            root[i, j] = value / pivot
    for j in range(m):  # L^-1, in place
        for i in range(j + 1, m):
            value = 0.0
            for k in range(j, i):
                value -= float(root[i, k]) * float(root[k, j])
            root[i, j] = value
    for j in range(m):
        inverse[j, j] = 1.0 / inverse[j, j]
    scaled = inverse @ root
    return True, root.T @ scaled


def _correct_stack(P: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray) -> tuple[bool, Correction]:
    """Whether S of each filter of a stack is positive definite, and the correction."""
    PHt = P @ H.mT
    S = H @ PHt + R
    valid = bool(np.isfinite(S).all())
    try:
        np.linalg.cholesky(S)  # fails for one that is not positive definite
        S_inverse: FloatArray = np.asarray(np.linalg.inv(S), np.float64)
    except np.linalg.LinAlgError:
        valid, S_inverse = False, np.zeros_like(S)
    K: FloatArray = PHt @ S_inverse
    distance2: FloatArray = np.vecdot(z, np.matvec(S_inverse, z))
    return valid, Correction(np.matvec(K, z), _joseph(P, H, R, K, PHt), distance2, z, H, K, S, S_inverse)


@inlined
def _joseph(P: FloatArray, H: FloatArray, R: FloatArray, K: FloatArray, PHt: FloatArray) -> FloatArray:
    """Covariance after a correction by the gain K: see `correct`."""
    A = P - K @ PHt.mT
    half = 0.5 * (A - (A @ H.mT - K @ R) @ K.mT)
    return half + half.mT


def root_of(cov: FloatArray, what: str) -> FloatArray:
    """Cholesky's root L, L L^T = cov, of the covariance of what an error message names, shape (..., m, m).

    Raises
    ------
    FilterDiverged
        It is not positive definite, or not finite.
    """
    problem = FilterDiverged(f"the covariance of {what} is not positive definite")
    try:
        root: FloatArray = np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise problem from None
    if not np.isfinite(root).all():
        raise problem
    return root


def _symmetric(A: FloatArray) -> FloatArray:
    half: FloatArray = 0.5 * A
    return half + half.mT
