"""History of the filter for the smoother: every covariance step, every correction, and the state ten times a second.

Records are in the order of the stamps: where an out-of-sequence measurement rolls the engine back, newer records are
removed. Process noise is not recorded, because it is contained in the covariance.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shared.maths.kalman import Correction

from ..inertial import error_model as em

if TYPE_CHECKING:
    from ..inertial.filter import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]


class Start(NamedTuple):
    """Start of a filter; its errors are independent of those of the filter before."""

    time_ns: int


class Step(NamedTuple):
    """Covariance step x+ = Phi x + noise, with Phi = I + F t except for time-correlated errors."""

    time_ns: int  # end of the step
    Ft: FloatArray  # nonzero block of F t, shape (9, 21)
    decay: FloatArray  # diagonal of Phi but for that block, shape (n,)

    @property
    def transition(self) -> FloatArray:
        """Matrix Phi, shape (n, n)."""
        return em.transition_matrix(self.Ft, self.decay)


class CorrectionRecord(NamedTuple):
    """Correction by a measurement: the estimated errors were subtracted from the state."""

    time_ns: int
    z: FloatArray  # measured - predicted, shape (m,)
    H: FloatArray  # shape (m, n)
    K: FloatArray  # the optimal gain, shape (n, m)
    S_inverse: FloatArray  # inverse of the covariance of z, shape (m, m)


class ParameterReset(NamedTuple):
    """Replacement of a parameter, such as the scale of another odometer: its error is independent of the one before."""

    time_ns: int
    place: int


class UnitChange(NamedTuple):
    """Change of unit of some errors u; their numerical values are kept."""

    time_ns: int
    place: slice
    ratios: FloatArray  # new unit of each over the old one
    rows: FloatArray  # rows of u in P before the change, shape (u, n)


class Knot(NamedTuple):
    """State and covariance of the filter; P is stored for the states `known`, and zero for all others."""

    time_ns: int
    filter: "ErrorStateFilter"
    known: npt.NDArray[np.intp]


Record = Start | Step | CorrectionRecord | ParameterReset | UnitChange | Knot


class Store(Protocol):
    """Storage of the records."""

    def push(self, record: Record) -> None:
        """Append a record."""

    def __len__(self) -> int:
        """Number of records."""
        ...

    def cut(self, count: int) -> None:
        """Remove the newest records until `count` are left."""

    def newest_first(self) -> Iterator[Record]:
        """Yield all records, newest first."""


class HistoryRecorder:
    """Records every operation of a filter on its errors.

    Parameters
    ----------
    store : Store
        Storage of the records.
    period_ns : int
        [ns] Interval of the knots, each at the first covariance step that ends in a new period.
    """

    def __init__(self, store: Store, period_ns: int) -> None:
        self._store = store
        self._period_ns = period_ns

    def start(self, filter_: "ErrorStateFilter") -> None:
        """Record the start of a filter, and its operations from now on."""
        filter_.recorder = self
        self._store.push(Start(filter_.inertial.time_ns))
        self._add_knot(filter_)

    def record_step(self, filter_: "ErrorStateFilter", Ft: FloatArray, step_s: float, decay: FloatArray) -> None:
        """Record a covariance step of `step_s` with the block F t and the decays of its transition."""
        time_ns = filter_.time_ns
        self._store.push(Step(time_ns, Ft, decay))
        before_ns = time_ns - round(step_s * 1e9)
        if time_ns // self._period_ns != before_ns // self._period_ns:
            self._add_knot(filter_)

    def record_correction(self, time_ns: int, correction: Correction) -> None:
        """Record a correction."""
        self._store.push(CorrectionRecord(time_ns, correction.z, correction.H, correction.K, correction.S_inverse))

    def record_reset(self, time_ns: int, place: int) -> None:
        """Record the replacement of a parameter by one with an independent error."""
        self._store.push(ParameterReset(time_ns, place))

    def record_rescaling(self, time_ns: int, place: slice, ratios: FloatArray, rows: FloatArray) -> None:
        """Record a change of unit, with the rows of P before it."""
        self._store.push(UnitChange(time_ns, place, ratios, rows))

    @property
    def size(self) -> int:
        """Number of records, for `truncate`."""
        return len(self._store)

    def truncate(self, size: int) -> None:
        """Remove the newest records until `size` are left, after a roll-back of the engine."""
        self._store.cut(size)

    def _add_knot(self, filter_: "ErrorStateFilter") -> None:
        knot = filter_.unrecorded()
        known = np.flatnonzero(filter_.P.diagonal())
        knot.P = filter_.P[np.ix_(known, known)]
        self._store.push(Knot(filter_.inertial.time_ns, knot, known))
