"""The fixed-interval smoother: what the filter would have said, had it known the whole drive.

Backwards over the filter's trail goes what all later measurements say about the errors: lambda, and its covariance
Lambda. At any instant, with P of the filter, whose own estimate of the errors is zero because it feeds them back::

    smoothed errors = -P lambda,    smoothed covariance = P - P Lambda P
"""

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from shared.errors import FilterDiverged

from ..filter import error_model as em
from ..filter.eskf import ErrorStateFilter
from .history import Corrected, Forgotten, Knot, Record, Resized, Start, Step

FloatArray = npt.NDArray[np.float64]
LEAST_SHARE = 1e-12  # of a variance, that rounding may leave of it


class Backwards:
    """What the measurements after an instant say about the errors at that instant.

    Parameters
    ----------
    size : int
        [-] Number of errors n.

    Notes
    -----
    The adjoint form of the Rauch-Tung-Striebel smoother. Both give the same numbers, but this one divides by no
    covariance: errors without variance, and noise from whatever source, need no special case. Backwards over a step
    x+ = Phi x + noise, and over a measurement z = H x + noise with gain K and innovation covariance S::

        lambda = Phi^T lambda,                          Lambda = Phi^T Lambda Phi
        lambda = (I - K H)^T lambda - H^T S^-1 z,       Lambda = (I - K H)^T Lambda (I - K H) + H^T S^-1 H

    The filter takes the estimate x = K z out of its state at once. The state moves by it and so does what is called
    its error, so that neither the innovations, which are measured from the moved state, nor lambda change by it.

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
        """Go back over a covariance step."""
        self.adjoint = Phi.T @ self.adjoint
        information = Phi.T @ self.information @ Phi
        self.information = 0.5 * (information + information.T)

    def correction(self, z: FloatArray, H: FloatArray, K: FloatArray, S_inverse: FloatArray) -> None:
        """Go back over a measurement that was used."""
        told = self.information @ K
        self.adjoint = self.adjoint - H.T @ (K.T @ self.adjoint + S_inverse @ z)
        cross = told @ H
        information = self.information - cross - cross.T + H.T @ (K.T @ told + S_inverse) @ H
        self.information = 0.5 * (information + information.T)

    def forget(self, place: int) -> None:
        """Go back over the beginning of an error, of which nothing is known before."""
        self.adjoint, self.information = self.adjoint.copy(), self.information.copy()
        self.adjoint[place] = 0.0
        self.information[place] = self.information[:, place] = 0.0

    def resize(self, place: slice, ratios: FloatArray, rows: FloatArray) -> None:
        """Go back over a new unit of some errors u, across which all errors are the same in their old units.

        Notes
        -----
        With D = diag(ratios), E the columns of the unit matrix at u, N = P_uu^-1 and N P_u. = N E^T P from `rows`::

            lambda = B D^-1 lambda,    Lambda = B D^-1 Lambda D^-1 B^T + E (N - N D P_uu D N) E^T
            B = (I + E N (D - I) P_u.) (I + E (D - I) N P_u.)

        for then P lambda, and P - P Lambda P, have the values that they have behind it.
        """
        own = rows[:, place]
        inverse = np.linalg.inv(own)
        own_change, change = np.eye(rows.shape[1]), np.eye(rows.shape[1])
        more = np.diag(ratios - 1.0)
        own_change[place] += inverse @ more @ rows
        change[place] += more @ inverse @ rows
        change = own_change @ change
        change[:, place] /= ratios
        self.adjoint = change @ self.adjoint
        information = change @ self.information @ change.T
        information[place, place] += inverse - inverse @ (ratios[:, np.newaxis] * own * ratios) @ inverse
        self.information = 0.5 * (information + information.T)

    def smoothed(self, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Smoothed errors, shape (n,), and their covariance, shape (n, n), where the filter has P."""
        told = P @ self.information @ P
        covariance = P - 0.5 * (told + told.T)
        # Subtraction leaves rounding errors of the size of P: a variance never falls below them.
        np.fill_diagonal(covariance, np.maximum(covariance.diagonal(), LEAST_SHARE * P.diagonal()))
        return -P @ self.adjoint, covariance


def smoothed_filters(newest_first: Iterable[Record]) -> Iterator[ErrorStateFilter]:
    """Smooth every knot of a trail, each stretch from a start to the next one by itself.

    Parameters
    ----------
    newest_first : iterable of Record
        The whole trail, from its end.

    Returns
    -------
    iterator of ErrorStateFilter
        State and covariance of each knot as all measurements of its stretch have them, from the newest to the oldest;
        none for knots of a filter that had lost its way so far that no meaning is left.
    """
    back = Backwards(em.SIZE)
    for record in newest_first:
        match record:
            case Step():
                back.step(record.transition)
            case Corrected():
                back.correction(record.z, record.H, record.K, record.S_inverse)
            case Forgotten():
                back.forget(record.place)
            case Resized():
                back.resize(record.place, record.ratios, record.rows)
            case Start():
                back = Backwards(em.SIZE)
            case Knot():
                state = _smoothed(record, back)
                if state is not None:
                    yield state


def _smoothed(knot: Knot, back: Backwards) -> ErrorStateFilter | None:
    """Move a filter by the errors that were found behind it, in the way in which it moves by its own."""
    P = np.zeros((em.SIZE, em.SIZE))
    P[np.ix_(knot.known, knot.known)] = knot.filter.P
    errors, covariance = back.smoothed(P)
    moved = knot.filter.fork()
    try:
        moved.take_out(errors, covariance)
    except FilterDiverged:
        return None
    return moved
