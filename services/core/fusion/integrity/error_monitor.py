"""What protection levels use beside the covariance: innovation statistics, largest shifts, rejected positions."""

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


@dataclass(frozen=True)
class Watch:
    """Statistics of positions and velocities, and the effect of the last position; immutable."""

    position: InnovationStatistics = field(default_factory=InnovationStatistics)
    velocity: InnovationStatistics = field(default_factory=InnovationStatistics)
    estimated: bool = False  # the time-correlated error of positions is a state of the filter
    used_ns: int = 0  # stamp of the last position that was used
    anchored: Block = NO_BLOCK  # covariance after it
    pulled: tuple[float, float] = (0.0, 0.0)  # [m] largest shift by an undetected error of it, horizontal and vertical
    contested: tuple[float, float] = (0.0, 0.0)  # [m] innovation of a rejected position or height, until one is used
    followed: tuple[float, float] = (0.0, 0.0)  # [m²] variance of errors of positions that the filter follows
    yielded: tuple[float, float] = (0.0, 0.0)  # [m] `contested` when the filter was reset to the position; it decays
    late_s: float = 0.0  # suspected delay of positions that no setting corrects

    def begun(self, time_ns: int, started: ErrorStateFilter) -> "Watch":
        """Begin with a new filter; statistics of the receiver are kept.

        If the filter before rejected positions until it was reset, either of the two may have been wrong.
        """
        (level, upright), (more, higher) = self.yielded, self.contested
        if more > 0.0:
            more += hypot(*started.velocity) * (time_ns - self.position.time_ns) * 1e-9  # it went on since
        given_up = (level + more, upright + higher)
        anchored = block(started)
        return Watch(
            self.position, self.velocity, self.estimated, time_ns, anchored,
            followed=self.followed, yielded=given_up, late_s=self.late_s,
        )  # fmt: skip

    def after(
        self, outcome: Outcome, before: Block, navigation: ErrorStateFilter, false_alarm: float, *, estimated: bool
    ) -> "Watch":
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
        Watch

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
            seen = self.velocity.after(outcome.time_ns, outcome.innovation, outcome.innovation_sd)
            return replace(self, velocity=seen)
        if outcome.kind is not AidingKind.GNSS_POSITION:
            return self
        z, height = outcome.innovation, outcome.height
        known = self.position
        if not known.time_ns or (self.estimated and not estimated):  # statistics of another error model
            known = ESTIMATED if estimated else UNKNOWN
        sd = outcome.innovation_sd
        if height is not None:
            z, sd = (*z, height.innovation), (*sd, height.innovation_sd)
        seen = known.after(outcome.time_ns, z, sd)
        upright = self.contested[1] if len(z) < 3 else abs(z[2])  # of a height that is not used
        given_way = 0.0
        if height is not None and height.taken_over:
            given_way, upright = upright, 0.0
        if not outcome.used:
            contested, yielded = (hypot(z[0], z[1]), upright), (self.yielded[0], self.yielded[1] + given_way)
            return replace(self, position=seen, contested=contested, yielded=yielded, estimated=estimated)
        now, limit = block(navigation), chi_square_limit(len(outcome.innovation), false_alarm)
        nn, ne, ee, dd = (old - new for old, new in zip(before, now, strict=True))
        taken = max(0.0, 0.5 * (nn + ee) + hypot(0.5 * (nn - ee), ne))
        pulled = (sqrt(limit * taken), sqrt(limit * max(0.0, dd)))
        fading = exp(-max(0, outcome.time_ns - self.used_ns) * 1e-9 / MEMORY_S)
        yielded = fading * self.yielded[0], fading * self.yielded[1] + given_way
        contested = 0.0, 0.0 if len(outcome.innovation) == 3 else upright
        return Watch(
            seen, self.velocity, estimated, outcome.time_ns, now, pulled, contested, self.followed, yielded,
            late_s=self.late_s,
        )  # fmt: skip

    @cached_property
    def disputed(self) -> tuple[float, float]:
        """Largest error [m, horizontal and vertical] if the rejected positions were right, or were wrong."""
        return self.contested[0] + self.yielded[0], self.contested[1] + self.yielded[1]

    @cached_property
    def overstatement(self) -> float:
        """Factor by which time-correlated errors make the filter too certain; followed ones are modelled."""
        of_positions = 1.0 if self.followed[0] > 0.0 else self.position.overstatement
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
            return max(self.anchored[0], self.anchored[2])
        return max(self.position.correlated_variance(0), self.position.correlated_variance(1), self.followed[0])

    @cached_property
    def correlated_variance_vertical(self) -> float:
        """The same of the height."""
        if not self.position.time_ns:
            return self.anchored[3]
        return max(self.position.correlated_variance(2), self.followed[1])


def block(navigation: ErrorStateFilter) -> Block:
    """Take out of the covariance of now what the levels are made of."""
    navigation.propagate_covariance()
    rows: Sequence[Sequence[float]] = navigation.P[em.POSITION, em.POSITION].tolist()
    return rows[0][0], rows[0][1], rows[1][1], rows[2][2]
