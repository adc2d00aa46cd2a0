"""Largest error that accepted GNSS measurements may have caused, where no state from before them is left."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import AidingKind

from ..aids.base import Outcome
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]

SHIFTED = em.ACCELEROMETER_SCALE.start  # states: attitude, velocity, position and biases
UNKNOWN_LIMIT = 16.3  # [-] chi-square, 3 degrees of freedom, 1e-3
MOTION = frozenset((AidingKind.GNSS_VELOCITY, AidingKind.CARRIER_DISPLACEMENT))  # one may stand in for the other
BREAK_S = 10.0  # longest interval between two fixes of one series


@dataclass(frozen=True)
class FixShift:
    """Largest change of each state by one measurement within the gate, shape (15,), and the time between two."""

    time_ns: int
    interval_s: float
    change: FloatArray


@dataclass(frozen=True)
class UndetectedShift:
    """Largest undetected shift by the newest measurement of each kind of GNSS measurement; immutable."""

    kinds: Mapping[AidingKind, FixShift] = field(default_factory=dict)

    def after(
        self, outcome: Outcome, before: FloatArray, now: FloatArray, gate: tuple[float, float]
    ) -> "UndetectedShift":
        """Add a measurement that was used.

        Parameters
        ----------
        outcome : Outcome
            Of the measurement.
        before, now : ndarray, shape (n, n)
            Covariance of the filter before and after it.
        gate : tuple of float
            False-alarm probability of the gate, and the multiple of its limit up to which a measurement is used.

        Notes
        -----
        The change K z with z' S^-1 z <= T is largest for state i where it is sqrt(T (P- - P+)_ii), because
        K S K' = P- - P+. A velocity that displacements have replaced for `BREAK_S` is dropped, and the reverse.
        """
        limit = gate[1] * chi_square_limit(len(outcome.innovation), gate[0])
        taken = np.maximum(before.diagonal()[:SHIFTED] - now.diagonal()[:SHIFTED], 0.0)
        last = self.kinds.get(outcome.kind)
        interval_s = 0.0 if last is None else (outcome.time_ns - last.time_ns) * 1e-9
        if not 0.0 < interval_s <= BREAK_S:
            interval_s = last.interval_s if last is not None else 1.0
        stale = MOTION - {outcome.kind} if outcome.kind in MOTION else frozenset()
        kept = {
            kind: shift
            for kind, shift in self.kinds.items()
            if kind not in stale or abs(outcome.time_ns - shift.time_ns) <= BREAK_S * 1e9
        }
        return UndetectedShift({**kept, outcome.kind: FixShift(outcome.time_ns, interval_s, np.sqrt(limit * taken))})

    def inflate(self, navigation: ErrorStateFilter, span_s: float) -> None:
        """Add to the covariance what fixes over a time may have done, as standard deviations.

        Notes
        -----
        Over a time D with fixes every T seconds, each of which changes state i by at most c_i::

            s_i = D/T c_i,    and for the position also + D/2 s_v of the velocity

        Of a filter whose fixes are not known, as after a warm start, T = 1 s and c_i = sqrt(chi2 P_ii), which no
        measurement within the gate exceeds. A protection level is at least three standard deviations; so it grows by
        more than this largest shift.
        """
        navigation.propagate_covariance()
        P = navigation.P.copy()
        sd = np.zeros(SHIFTED) if self.kinds else span_s * np.sqrt(UNKNOWN_LIMIT * P.diagonal()[:SHIFTED])
        for fix in self.kinds.values():
            sd += max(1.0, span_s / fix.interval_s) * fix.change
        sd[em.POSITION] += 0.5 * span_s * sd[em.VELOCITY]
        np.einsum("ii->i", P)[:SHIFTED] += sd**2
        navigation.P = P
