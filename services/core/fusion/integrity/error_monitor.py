"""What protection levels use beside the covariance: innovation statistics, undetected shifts, rejected positions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot, sqrt

from shared.maths.quantiles import chi_square_limit, principal_variances
from shared.messages.navigation import AidingKind

from ..aids.base import Outcome
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from .after_loss import NO_LOSS, ReturnSpread
from .disagreement import CLOSURE_SDS, GREW_RATIO, NO_DISAGREEMENT, NONE, ZERO_VECTOR, Disagreement, Pair, Vector
from .innovation_statistics import ESTIMATED, NO_STATISTICS, InnovationStatistics

Block = tuple[float, float, float, float]  # [m²] NN, NE, EE, DD of a position's covariance
NO_BLOCK: Block = (0.0, 0.0, 0.0, 0.0)
OUTAGE_S = 3.0  # without a used position, after which a position is a return


@dataclass(frozen=True)
class ErrorMonitor:
    """Statistics of innovations of positions, velocities and displacements; effect of the last position; immutable."""

    position: InnovationStatistics = field(default_factory=InnovationStatistics)
    velocity: InnovationStatistics = field(default_factory=InnovationStatistics)
    displacement: InnovationStatistics = field(default_factory=InnovationStatistics)  # by carrier phases
    estimated: bool = False  # the time-correlated error of positions is a state of the filter
    used_ns: int = 0  # stamp of the last position that was used
    cov_after_fix: Block = NO_BLOCK  # covariance after it
    fault_shift: Pair = NONE  # [m] largest shift by an undetected error of it
    rejected_n: Vector = ZERO_VECTOR  # [m, NED] innovation of a rejected position or height, until one is used
    rejected_sd: Pair = NONE  # [m] of that innovation
    rejected_grew: bool = False  # the first of these was hardly beyond the gate
    unestimated: Pair = NONE  # [m²] variance of position errors that are time-correlated and no state of the filter
    held: Disagreement = NO_DISAGREEMENT  # what a reset to rejected positions, a return or a conflict has left open
    loss: ReturnSpread = NO_LOSS  # what the return after an outage may be off by
    delay_s: float = 0.0  # suspected delay of positions that no setting corrects

    def restarted(self, time_ns: int, started: ErrorStateFilter) -> "ErrorMonitor":
        """Begin with a new filter; statistics of the receiver are kept.

        If the filter before rejected positions until it was reset, either of the two may have been wrong.
        """
        held = self.held
        if self.rejected_n != ZERO_VECTOR:
            moved_m = hypot(*started.velocity) * (time_ns - self.position.time_ns) * 1e-9  # by the vehicle since
            north, east, down = self.rejected_n
            away = 1.0 + moved_m / max(hypot(north, east), 1e-3) if hypot(north, east) > 0.0 else 1.0
            spread = self.rejected_sd[0] + moved_m / CLOSURE_SDS, self.rejected_sd[1]
            held = held.after((away * north, away * east, down), spread, time_ns, grew=self.rejected_grew)
        return replace(
            self, used_ns=time_ns, cov_after_fix=block(started), fault_shift=NONE, rejected_n=ZERO_VECTOR, held=held
        )

    def after(
        self, outcome: Outcome, before: Block, navigation: ErrorStateFilter, false_alarm: float, *, estimated: bool,
        limits_m: Pair,
    ) -> "ErrorMonitor":  # fmt: skip
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
        limits_m : tuple of float
            [m] Alert limits, horizontal and vertical: a return after an outage that is farther off is held.

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
        if outcome.kind is AidingKind.CARRIER_DISPLACEMENT:
            displacement = self.displacement.after(outcome.time_ns, outcome.innovation, outcome.innovation_sd)
            return replace(self, displacement=displacement)
        if outcome.kind is not AidingKind.GNSS_POSITION:
            return self
        z, height = outcome.innovation, outcome.height
        statistics = self.position
        if not statistics.time_ns or (self.estimated and not estimated):  # they are of another error model
            statistics = ESTIMATED if estimated else NO_STATISTICS
        sd = outcome.innovation_sd
        if height is not None:
            z, sd = (*z, height.innovation), (*sd, height.innovation_sd)
        statistics = statistics.after(outcome.time_ns, z, sd)
        known = replace(self, position=statistics, estimated=estimated)
        down = self.rejected_n[2] if len(z) < 3 else z[2]
        sd_down = self.rejected_sd[1] if len(sd) < 3 else sd[2]
        sds = hypot(sd[0], sd[1]), sd_down
        since_s = max(0.0, (outcome.time_ns - self.position.time_ns) * 1e-9) if self.position.time_ns else 0.0
        speed = hypot(*navigation.velocity[:2])
        held = self.held.confirmed(outcome.time_ns, used=outcome.used, since_s=since_s, speed=speed)
        loss = self.loss.confirmed(used=outcome.used, since_s=since_s, speed=speed)
        known = replace(known, loss=loss)
        if height is not None and height.taken_over:
            held = held.after((0.0, 0.0, down), (0.0, sd_down), outcome.time_ns, grew=False)
            down = 0.0
        if not outcome.used:
            first = self.rejected_n[:2] == ZERO_VECTOR[:2]
            grew = outcome.test_ratio <= GREW_RATIO if first else self.rejected_grew
            return replace(known, rejected_n=(z[0], z[1], down), rejected_sd=sds, rejected_grew=grew, held=held)
        left_out = 0.0 if len(outcome.innovation) == 3 else down
        age_s = (outcome.time_ns - self.used_ns) * 1e-9
        far = hypot(z[0], z[1]) > limits_m[0], len(z) > 2 and left_out == 0.0 and abs(z[2]) > limits_m[1]
        if self.used_ns and min(age_s, since_s) > OUTAGE_S:  # positions were missing, and not only rejected
            known = replace(known, loss=loss.returned(outcome.time_ns, before))
        if self.used_ns and age_s > OUTAGE_S and any(far):
            returned = (z[0], z[1]) if far[0] else (0.0, 0.0)
            held = held.after((*returned, z[2] if far[1] else 0.0), sds, outcome.time_ns, grew=True)
        now, limit = block(navigation), chi_square_limit(len(outcome.innovation), false_alarm)
        nn, ne, ee, dd = (old - new for old, new in zip(before, now, strict=True))
        largest = max(0.0, principal_variances(nn, ne, ee)[0])
        return replace(
            known,
            used_ns=outcome.time_ns,
            cov_after_fix=now,
            fault_shift=(sqrt(limit * largest), sqrt(limit * max(0.0, dd))),
            rejected_n=(0.0, 0.0, left_out),
            rejected_sd=(0.0, sd_down if left_out else 0.0),
            held=held,
        )

    @cached_property
    def rejection_bound(self) -> Pair:
        """Largest error [m, horizontal and vertical] if the rejected positions were right, or were wrong."""
        (north, east, down), (held_h, held_v) = self.rejected_n, self.held.bound
        return hypot(north, east) + held_h + self.loss.bound[0], abs(down) + held_v + self.loss.bound[1]

    def after_interference(self) -> "ErrorMonitor":
        """Hold what the last return may be off by as an offset, which displacement does not end."""
        if self.loss.returned_ns is None:
            return self
        bound_h, bound_v = self.loss.bound
        spread = bound_h / CLOSURE_SDS, bound_v / CLOSURE_SDS
        held = self.held.after(ZERO_VECTOR, spread, self.used_ns, grew=False, slack=self.loss.bound)
        return replace(self, held=held, loss=NO_LOSS)

    @cached_property
    def overstatement(self) -> float:
        """Factor by which time-correlated errors make the filter too certain; unestimated ones are modelled."""
        of_positions = 1.0 if self.unestimated[0] > 0.0 else self.position.overstatement
        return max(of_positions, self.velocity.overstatement, self.displacement.overstatement)

    @cached_property
    def scale_horizontal(self) -> float:
        """Factor by which squared horizontal innovations exceed their variance; at least 1."""
        return max(self.position.scale_horizontal, self.velocity.scale_horizontal, self.displacement.scale_horizontal)

    @cached_property
    def scale_vertical(self) -> float:
        """The same of vertical ones."""
        return max(self.position.scale_vertical, self.velocity.scale_vertical, self.displacement.scale_vertical)

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
