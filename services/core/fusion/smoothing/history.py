"""History of the filter for the smoother: every covariance step, every correction, and the state ten times a second.

Records are in the order of the stamps: where an out-of-sequence measurement rolls the engine back, those written since
are dropped. Process noise needs no record, for the smoother finds it in the covariance.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shared.maths.kalman import Correction

from ..filter import error_model as em

if TYPE_CHECKING:
    from ..filter.eskf import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]


class Start(NamedTuple):
    """A filter begins; nothing is known of its errors' way from the filter before."""

    time_ns: int


class Step(NamedTuple):
    """The errors propagated: x+ = Phi x + noise, with Phi = I + F t but for the time-correlated error of GNSS."""

    time_ns: int  # of its end
    Ft: FloatArray  # the part of F t that is not zero, shape (9, 21)
    gnss_decay: float  # on the diagonal of the error of GNSS

    @property
    def transition(self) -> FloatArray:
        """Matrix Phi, shape (31, 31)."""
        Phi = np.eye(em.SIZE)
        Phi[: em.MOVING, : em.DRIVING] += self.Ft
        Phi[em.GNSS_ERROR, em.GNSS_ERROR] *= self.gnss_decay
        return Phi


class Corrected(NamedTuple):
    """A measurement was used, and the errors that it showed were taken out of the state."""

    time_ns: int
    z: FloatArray  # measured - predicted, shape (m,)
    H: FloatArray  # shape (m, n)
    K: FloatArray  # the optimal gain, shape (n, m)
    S_inverse: FloatArray  # of the covariance of z, shape (m, m)


class Forgotten(NamedTuple):
    """An error became that of something else, of which what came before says nothing."""

    time_ns: int
    place: int


class Resized(NamedTuple):
    """The unit of some errors u was found to be another one, in which they are as large as before."""

    time_ns: int
    place: slice
    ratios: FloatArray  # new unit of each over the old one
    rows: FloatArray  # of u in P before, shape (u, n)


class Knot(NamedTuple):
    """The filter as it was; its covariance holds the errors of `known` only, all others are zero."""

    time_ns: int
    filter: "ErrorStateFilter"
    known: npt.NDArray[np.intp]


Record = Start | Step | Corrected | Forgotten | Resized | Knot


class Store(Protocol):
    """Where records go."""

    def push(self, record: Record) -> None:
        """Add one behind all others."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def cut(self, count: int) -> None:
        """Take records off the end until so many are left."""

    def newest_first(self) -> Iterator[Record]:
        """Give all back, from the end."""


class Trail:
    """Writes down what a filter does to its errors.

    Parameters
    ----------
    store : Store
        Where the records go.
    period_ns : int
        Between two knots, each at the first covariance step that ends in a new period.
    """

    def __init__(self, store: Store, period_ns: int) -> None:
        self._store = store
        self._period_ns = period_ns

    def follow(self, filter_: "ErrorStateFilter") -> None:
        """Note a new filter, and whatever it does from now on."""
        filter_.trail = self
        self._store.push(Start(filter_.inertial.time_ns))
        self._tie(filter_)

    def stepped(self, filter_: "ErrorStateFilter", F: FloatArray, step_s: float, gnss_decay: float) -> None:
        """Record a covariance step over a time, with the system matrix F [1/s] of that time."""
        time_ns = filter_.time_ns
        self._store.push(Step(time_ns, F[: em.MOVING, : em.DRIVING] * step_s, gnss_decay))
        before_ns = time_ns - round(step_s * 1e9)
        if time_ns // self._period_ns != before_ns // self._period_ns:
            self._tie(filter_)

    def corrected(self, time_ns: int, correction: Correction) -> None:
        """Note a correction that was accepted."""
        self._store.push(Corrected(time_ns, correction.z, correction.H, correction.K, correction.S_inverse))

    def forgot(self, time_ns: int, place: int) -> None:
        """Note that an error was made one of which nothing is known yet."""
        self._store.push(Forgotten(time_ns, place))

    def resized(self, time_ns: int, place: slice, ratios: FloatArray, rows: FloatArray) -> None:
        """Note that errors got another unit, before which P had these rows."""
        self._store.push(Resized(time_ns, place, ratios, rows))

    @property
    def written(self) -> int:
        """How much has been written, for a way back to now."""
        return len(self._store)

    def rewind(self, written: int) -> None:
        """Forget what was written since then: the engine has gone back."""
        self._store.cut(written)

    def _tie(self, filter_: "ErrorStateFilter") -> None:
        twin = filter_.fork()
        twin.trail = None
        known = np.flatnonzero(filter_.P.diagonal())
        twin.P = filter_.P[np.ix_(known, known)]
        self._store.push(Knot(filter_.inertial.time_ns, twin, known))
