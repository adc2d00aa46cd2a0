"""Fixed-interval smoother: state and covariance given all measurements of the drive.

The adjoint lambda and its information matrix Lambda are propagated backwards over the recorded history. The filter
feeds its error estimate back, so its own estimate of the errors is zero; with its covariance P::

    smoothed errors = -P lambda,    smoothed covariance = P - P Lambda P
"""

from collections.abc import Iterable, Iterator
from copy import copy

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged

from ..inertial.filter import ErrorStateFilter
from .history import CorrectionRecord, Knot, ParameterReset, Record, Start, Step, UnitChange

FloatArray = npt.NDArray[np.float64]
MIN_SHARE = 1e-12  # lower limit of a smoothed variance, relative to the filtered one


class BackwardRecursion:
    """Backward recursion: information on the errors at an instant from all later measurements.

    Parameters
    ----------
    size : int
        [-] Number of errors n.

    Notes
    -----
    The adjoint form of the Rauch-Tung-Striebel smoother. Both give the same numbers, but this one needs no
    inverse of a covariance: errors without variance and process noise of any form need no special case. Over a step
    x+ = Phi x + noise, and over a measurement z = H x + noise with gain K and innovation covariance S::

        lambda = Phi^T lambda,                          Lambda = Phi^T Lambda Phi
        lambda = (I - K H)^T lambda - H^T S^-1 z,       Lambda = (I - K H)^T Lambda (I - K H) + H^T S^-1 H

    The filter feeds the estimate x = K z back at once. State and error change by the same amount, so that neither the
    later innovations nor lambda depend on it.

    References
    ----------
    G. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18(1), 1973;
    A. Bryson, M. Frazier, "Smoothing for linear and nonlinear dynamic systems", 1963;
    H. Rauch, F. Tung, C. Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3(8), 1965.
    """

    def __init__(self, size: int) -> None:
        self.adjoint: FloatArray = np.zeros(size)  # lambda
        self.information: FloatArray = np.zeros((size, size))  # Lambda

    def step(self, Phi: FloatArray) -> None:
        """Propagate backwards over a covariance step."""
        self.adjoint = Phi.T @ self.adjoint
        information = Phi.T @ self.information @ Phi
        self.information = 0.5 * (information + information.T)

    def correction(self, z: FloatArray, H: FloatArray, K: FloatArray, S_inverse: FloatArray) -> None:
        """Propagate backwards over a correction by a measurement."""
        information_K = self.information @ K
        self.adjoint = self.adjoint - H.T @ (K.T @ self.adjoint + S_inverse @ z)
        cross = information_K @ H
        information = self.information - cross - cross.T + H.T @ (K.T @ information_K + S_inverse) @ H
        self.information = 0.5 * (information + information.T)

    def reset_parameter(self, place: int) -> None:
        """Propagate backwards over the replacement of a parameter."""
        if not len(self.adjoint):
            return
        self.adjoint, self.information = self.adjoint.copy(), self.information.copy()
        self.adjoint[place] = 0.0
        self.information[place] = self.information[:, place] = 0.0

    def rescale(self, place: slice, ratios: FloatArray, rows: FloatArray) -> None:
        """Propagate backwards over a change of unit of some errors u.

        Notes
        -----
        With D = diag(ratios), E the columns of the unit matrix at u, N = P_uu^-1 and N P_u. = N E^T P from `rows`::

            lambda = B D^-1 lambda,    Lambda = B D^-1 Lambda D^-1 B^T + E (N - N D P_uu D N) E^T
            B = (I + E N (D - I) P_u.) (I + E (D - I) N P_u.)

        so that P lambda and P - P Lambda P do not change.
        """
        P_uu = rows[:, place]
        N = np.linalg.inv(P_uu)
        left, right = np.eye(rows.shape[1]), np.eye(rows.shape[1])
        increase = np.diag(ratios - 1.0)
        left[place] += N @ increase @ rows
        right[place] += increase @ N @ rows
        B = left @ right
        B[:, place] /= ratios  # B D^-1
        self.adjoint = B @ self.adjoint
        information = B @ self.information @ B.T
        information[place, place] += N - N @ (ratios[:, np.newaxis] * P_uu * ratios) @ N
        self.information = 0.5 * (information + information.T)

    def smoothed(self, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Smoothed errors, shape (n,), and their covariance, shape (n, n), from the filter's covariance P."""
        reduction = P @ self.information @ P
        covariance = P - 0.5 * (reduction + reduction.T)
        # The difference has rounding errors of the order of eps * P: variances are kept above them.
        np.fill_diagonal(covariance, np.maximum(covariance.diagonal(), MIN_SHARE * P.diagonal()))
        return -P @ self.adjoint, covariance


def smoothed_filters(newest_first: Iterable[Record]) -> Iterator[ErrorStateFilter]:
    """Smooth every knot of a history; each filter is smoothed independently of the others.

    Parameters
    ----------
    newest_first : iterable of Record
        The whole history, newest first; all its filters have the same states.

    Returns
    -------
    iterator of ErrorStateFilter
        Smoothed state and covariance of each knot, newest first; knots at which the correction of a diverged filter
        is beyond its limits are left out.
    """
    back = BackwardRecursion(0)
    for record in newest_first:
        if not len(back.adjoint):  # nothing is known yet: what is zero, stays so
            back = BackwardRecursion(_size_of(record))
        match record:
            case Step():
                back.step(record.transition)
            case CorrectionRecord():
                back.correction(record.z, record.H, record.K, record.S_inverse)
            case ParameterReset():
                back.reset_parameter(record.place)
            case UnitChange():
                back.rescale(record.place, record.ratios, record.rows)
            case Start():
                back = BackwardRecursion(0)
            case Knot():
                state = _smoothed(record, back)
                if state is not None:
                    yield state


def _size_of(record: Record) -> int:
    """Number of states of the filter of a record, or zero where the record does not show it."""
    match record:
        case Step():
            return len(record.decay)
        case CorrectionRecord():
            return len(record.K)
        case UnitChange():
            return len(record.rows.T)
        case Knot():
            return record.filter.size
        case _:
            return 0


def _smoothed(knot: Knot, back: BackwardRecursion) -> ErrorStateFilter | None:
    """Subtract the smoothed errors from the state of a knot."""
    P = np.zeros_like(back.information)
    P[np.ix_(knot.known, knot.known)] = knot.filter.P
    errors, covariance = back.smoothed(P)
    smoothed = copy(knot.filter)
    try:
        smoothed.subtract_errors(errors, covariance)
    except FilterDiverged:
        return None
    return smoothed
