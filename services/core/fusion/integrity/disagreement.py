"""What two solutions, or a solution and GNSS, differ by: the level holds it until evidence ends it, never by time.

A reset of the filter to rejected positions, a return after an outage, and a conflict that ended without a decision
leave a vector between the position in use and the one that was given up. Either of the two may be right. It ends
by:

- closure: the position comes back by the same vector, within the spread of both;
- displacement, where the difference grew and did not step: since then the way driven by inertial sensors and by GNSS
  has agreed for `CONFIRMATION_S`. A held offset agrees in displacement for ever, so that a step is not ended by it;
- a place that is known from an earlier drive, and the operator, who confirms the position;
- for a first fix aside of the saved position, a drive of `DRIVEN_M`: a transmitter at the parking place stays behind.
"""

from dataclasses import dataclass, replace
from math import hypot

from shared.messages.explanation import Explanation, explain

from ..codes import Code
from .closure import horizontal_bound, vertical_bound

Pair = tuple[float, float]  # horizontal, vertical
Vector = tuple[float, float, float]
NONE: Pair = (0.0, 0.0)
ZERO_VECTOR: Vector = (0.0, 0.0, 0.0)

CONFIRMATION_S = 60.0  # of used positions without a rejection, which decide for GNSS where the difference grew
DRIVEN_M = 2000.0  # with positions that agree, after which the saved position is no longer held against them
MAX_DURATION_S = 3.0  # between two positions of one agreement
CLOSURE_SDS = 3.0
CLOSURE_RISK = 1e-3  # that an offset is larger than what a step back leaves of it
GREW_RATIO = 9.0  # [-] largest test ratio of the first rejected position of a difference that grew: three gates


@dataclass(frozen=True)
class Disagreement:
    """A vector between two positions, of which each may be the true one; replaced and never changed in place."""

    vector_n: Vector = ZERO_VECTOR  # [m, NED] position in use minus the one that was given up
    spread: Pair = NONE  # [m] standard deviation of the vector
    grew: bool = False  # without a step: displacement decides
    slack: Pair = NONE  # [m] by which a solution that was given up may itself have been off
    agreeing_ns: int | None = None  # since when positions have been used without a rejection
    at_start: bool = False  # between the saved position and the first fix
    driven_m: float = 0.0  # since then, while positions agreed
    # at which it may still grow, until displacement agrees: positions in use have contradicted what was given up
    growth_m_s: float = 0.0
    since_ns: int = 0  # since when the vector, or a part of it, may have been there

    @property
    def is_open(self) -> bool:
        """Whether there is anything to hold."""
        return self.vector_n != ZERO_VECTOR or self.slack != NONE

    @property
    def bound(self) -> Pair:
        """Length of the vector, with the slack [m, horizontal and vertical]."""
        north, east, down = self.vector_n
        return hypot(north, east) + self.slack[0], abs(down) + self.slack[1]

    @property
    def why(self) -> Explanation | None:
        """What it is; None without one."""
        if not self.is_open:
            return None
        code = Code.HELD_AT_START if self.at_start else Code.HELD_GREW if self.grew else Code.HELD_STEP
        return explain(code, horizontal_m=self.bound[0], vertical_m=self.bound[1])

    def ends(self, place_m: float | None) -> tuple[Explanation, ...]:
        """What would end it; `place_m` is the distance to where the vehicle was parked before this drive, if known."""
        if not self.is_open:
            return ()
        ways = [explain(Code.ENDS_BY_STEP_BACK)]
        if self.at_start:
            ways.append(explain(Code.ENDS_BY_DRIVE, needed_m=DRIVEN_M, driven_m=self.driven_m))
        elif self.grew:
            ways.append(explain(Code.ENDS_BY_AGREEMENT, needed_s=CONFIRMATION_S))
        if place_m is not None:
            ways.append(explain(Code.ENDS_AT_PLACE, distance_m=place_m))
        return (*ways, explain(Code.ENDS_BY_OPERATOR))

    def after(
        self, vector_n: Vector, spread: Pair, time_ns: int, *, grew: bool, at_start: bool = False, slack: Pair = NONE,
        since_ns: int | None = None,
    ) -> "Disagreement":  # fmt: skip
        """Add a further vector; an axis is closed where it comes back: the sum is within its spread and half as long.

        Parameters
        ----------
        vector_n : tuple of float
            [m, NED] New position in use minus the one before.
        spread : tuple of float
            [m] Standard deviation of the vector, horizontal and vertical.
        time_ns : int
            Stamp.
        grew : bool
            The difference grew and did not step.
        at_start : bool
            It is between a saved position and the first fix.
        slack : tuple of float
            [m] By which a solution that was given up may have been off.
        since_ns : int, optional
            Since when the vector may have been there; `time_ns` if not given.
        """
        (n, e, d), (dn, de, dd) = self.vector_n, vector_n
        sum_n, spreads = (n + dn, e + de, d + dd), (hypot(self.spread[0], spread[0]), hypot(self.spread[1], spread[1]))
        slacks = self.slack[0] + slack[0], self.slack[1] + slack[1]
        before_m, after_m = (hypot(n, e), abs(d)), (hypot(*sum_n[:2]), abs(sum_n[2]))
        moved = (dn, de) != (0.0, 0.0), dd != 0.0
        # A step back leaves what its spread cannot tell from another offset; what a reset had left has no slack.
        returned = [moved[k] and after_m[k] <= min(CLOSURE_SDS * spreads[k], 0.5 * before_m[k]) for k in (0, 1)]
        ratio = after_m[0] / spreads[0] if spreads[0] > 0.0 else 0.0
        left_m = (
            horizontal_bound(after_m[0], (spreads[0], spreads[0]), ratio, CLOSURE_RISK),
            vertical_bound(after_m[1], spreads[1], CLOSURE_RISK),
        )
        closed = [returned[k] and (left_m[k] == 0.0 or slacks[k] == 0.0) for k in (0, 1)]
        slack_h, slack_v = (
            max(0.0, min(before_m[k] + self.slack[k], left_m[k]) - after_m[k])
            if returned[k] and not closed[k]
            else slacks[k]
            for k in (0, 1)
        )
        slacks = slack_h, slack_v
        # Beside an axis that closes, the noise of the step on an axis where nothing was held is nothing to hold.
        noise = [before_m[k] == 0.0 and after_m[k] <= CLOSURE_SDS * spread[k] and returned[1 - k] for k in (0, 1)]
        if closed[0] or noise[0]:
            sum_n, slacks = (0.0, 0.0, sum_n[2]), (0.0, slacks[1])
        if closed[1] or noise[1]:
            sum_n, slacks = (sum_n[0], sum_n[1], 0.0), (slacks[0], 0.0)
        if sum_n == ZERO_VECTOR and slacks == NONE:
            return NO_DISAGREEMENT
        first = not self.is_open
        begun_ns = time_ns if since_ns is None else since_ns
        return Disagreement(
            sum_n, spreads, grew and (self.grew or first), slacks, time_ns, at_start and first,
            growth_m_s=self.growth_m_s, since_ns=begun_ns if first else min(begun_ns, self.since_ns),
        )  # fmt: skip

    def confirmed(self, time_ns: int, *, used: bool, since_s: float, speed: float) -> "Disagreement":
        """Use the outcome of a position: displacement ends a difference that grew, a drive that of a start.

        Parameters
        ----------
        time_ns : int
            Stamp.
        used : bool
            Whether the position was used.
        since_s : float
            [s] Since the position before; an outage begins the agreement anew, for nothing has agreed in it.
        speed : float
            [m/s] Of the vehicle.
        """
        if not self.is_open:
            return self
        if self.growth_m_s > 0.0:
            grown = self.slack[0] + self.growth_m_s * since_s, self.slack[1]
            return replace(self, slack=grown, agreeing_ns=time_ns)
        if not used or self.agreeing_ns is None or since_s > MAX_DURATION_S:
            return replace(self, agreeing_ns=time_ns)
        if self.grew and (time_ns - self.agreeing_ns) * 1e-9 >= CONFIRMATION_S:
            return NO_DISAGREEMENT
        if not self.at_start:
            return self
        driven_m = self.driven_m + speed * since_s
        return NO_DISAGREEMENT if driven_m >= DRIVEN_M else replace(self, driven_m=driven_m)


NO_DISAGREEMENT = Disagreement()
