"""What protection levels use beside the covariance: innovation statistics, undetected shifts, rejected positions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp, hypot, sqrt

from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import AidingKind

from ..filter import error_model as em
from ..filter.eskf import ErrorStateFilter
from ..measurements.base import Outcome
from .innovation_statistics import ESTIMATED, MEMORY_S, UNKNOWN, InnovationStatistics

Block = tuple[float, float, float, float]  # [m²] NN, NE, EE, DD of a position's covariance
NO_BLOCK: Block = (0.0, 0.0, 0.0, 0.0)
Pair = tuple[float, float]  # horizontal, vertical
NONE: Pair = (0.0, 0.0)


@dataclass(frozen=True)
class ErrorMonitor:
    """Innovation statistics of positions and velocities, and the effect of the last position; immutable."""

    position: InnovationStatistics = field(default_factory=InnovationStatistics)
    velocity: InnovationStatistics = field(default_factory=InnovationStatistics)
    estimated: bool = False  # the time-correlated error of positions is a state of the filter
    used_ns: int = 0  # stamp of the last position that was used
    cov_after_fix: Block = NO_BLOCK  # covariance after it
    fault_shift: Pair = NONE  # [m] largest shift by an undetected error of it
    rejected_shift: Pair = NONE  # [m] innovation of a rejected position or height, until one is used
    unestimated: Pair = NONE  # [m²] variance of position errors that are time-correlated and no state of the filter
    reset_shift: Pair = NONE  # [m] `rejected_shift` when the filter was reset to the position; it decays
    delay_s: float = 0.0  # suspected delay of positions that no setting corrects

    def restarted(self, time_ns: int, started: ErrorStateFilter) -> "ErrorMonitor":
        """Begin with a new filter; statistics of the receiver are kept.

        If the filter before rejected positions until it was reset, either of the two may have been wrong.
        """
        horizontal, vertical = self.rejected_shift
        if horizontal > 0.0:  # the vehicle has moved since
            horizontal += hypot(*started.velocity) * (time_ns - self.position.time_ns) * 1e-9
        reset_shift = self.reset_shift[0] + horizontal, self.reset_shift[1] + vertical
        return replace(
            self, used_ns=time_ns, cov_after_fix=block(started), fault_shift=NONE, rejected_shift=NONE,
            reset_shift=reset_shift,
        )  # fmt: skip

    def after(
        self, outcome: Outcome, before: Block, navigation: ErrorStateFilter, false_alarm: float, *, estimated: bool
    ) -> "ErrorMonitor":
        """Add the outcome of a measurement.

        Parameters
        ----------
        outcome : Outcome
            Of the measurement.
        before : Block
            [m²] Covariance of the position before it; used for a position only.
        navigation : ErrorStateFilter
            After it.
        false_alarm : float
            [-] Probability of the gate that it has passed.
        estimated : bool
            Whether the filter has a state for the time-correlated part of its error.

        Returns
        -------
        ErrorMonitor

        Notes
        -----
        A fix that passes the gate has moved the solution by K z with zᵀ S⁻¹ z <= T. As K S Kᵀ is the covariance
        that it took away, the farthest of these moves is √(T λ), λ being the largest eigenvalue of P⁻ - P⁺.

        References
        ----------
        The slope of RAIM (R. G. Brown, "A baseline GPS RAIM scheme and a note on the equivalence of three RAIM
        methods", Navigation 39(3), 1992), for the innovation of a Kalman filter in place of a residual.
        """
        if outcome.kind is AidingKind.GNSS_VELOCITY:
            velocity = self.velocity.after(outcome.time_ns, outcome.innovation, outcome.innovation_sd)
            return replace(self, velocity=velocity)
        if outcome.kind is not AidingKind.GNSS_POSITION:
            return self
        z, height = outcome.innovation, outcome.height
        statistics = self.position
        if not statistics.time_ns or (self.estimated and not estimated):  # they are of another error model
            statistics = ESTIMATED if estimated else UNKNOWN
        sd = outcome.innovation_sd
        if height is not None:
            z, sd = (*z, height.innovation), (*sd, height.innovation_sd)
        statistics = statistics.after(outcome.time_ns, z, sd)
        rejected_height = self.rejected_shift[1] if len(z) < 3 else abs(z[2])
        reset_height = 0.0
        if height is not None and height.taken_over:
            reset_height, rejected_height = rejected_height, 0.0
        known = replace(self, position=statistics, estimated=estimated)
        reset_h, reset_v = self.reset_shift
        if not outcome.used:
            rejected_shift = hypot(z[0], z[1]), rejected_height
            return replace(known, rejected_shift=rejected_shift, reset_shift=(reset_h, reset_v + reset_height))
        now, limit = block(navigation), chi_square_limit(len(outcome.innovation), false_alarm)
        nn, ne, ee, dd = (old - new for old, new in zip(before, now, strict=True))
        largest = max(0.0, 0.5 * (nn + ee) + hypot(0.5 * (nn - ee), ne))  # eigenvalue
        decay = exp(-max(0, outcome.time_ns - self.used_ns) * 1e-9 / MEMORY_S)
        return replace(
            known,
            used_ns=outcome.time_ns,
            cov_after_fix=now,
            fault_shift=(sqrt(limit * largest), sqrt(limit * max(0.0, dd))),
            rejected_shift=(0.0, 0.0 if len(outcome.innovation) == 3 else rejected_height),
            reset_shift=(decay * reset_h, decay * reset_v + reset_height),
        )

    @cached_property
    def rejection_bound(self) -> Pair:
        """Largest error [m, horizontal and vertical] if the rejected positions were right, or were wrong."""
        return self.rejected_shift[0] + self.reset_shift[0], self.rejected_shift[1] + self.reset_shift[1]

    @cached_property
    def overstatement(self) -> float:
        """Factor by which time-correlated errors make the filter too certain; unestimated ones are modelled."""
        of_positions = 1.0 if self.unestimated[0] > 0.0 else self.position.overstatement
        return max(of_positions, self.velocity.overstatement)

    @cached_property
    def scale_horizontal(self) -> float:
        """Factor by which squared horizontal innovations exceed their variance; at least 1."""
        return max(self.position.scale_horizontal, self.velocity.scale_horizontal)

    @cached_property
    def scale_vertical(self) -> float:
        """The same of vertical ones."""
        return max(self.position.scale_vertical, self.velocity.scale_vertical)

    @cached_property
    def correlated_variance_horizontal(self) -> float:
        """Variance [m²] of a correlated error of GNSS along the worse axis; the start's until there is evidence."""
        if not self.position.time_ns:
            return max(self.cov_after_fix[0], self.cov_after_fix[2])
        return max(self.position.correlated_variance(0), self.position.correlated_variance(1), self.unestimated[0])

    @cached_property
    def correlated_variance_vertical(self) -> float:
        """The same of the height."""
        if not self.position.time_ns:
            return self.cov_after_fix[3]
        return max(self.position.correlated_variance(2), self.unestimated[1])


def block(navigation: ErrorStateFilter) -> Block:
    """Take out of the covariance of now what the levels are made of."""
    navigation.propagate_covariance()
    rows: Sequence[Sequence[float]] = navigation.P[em.POSITION, em.POSITION].tolist()
    return rows[0][0], rows[0][1], rows[1][1], rows[2][2]
