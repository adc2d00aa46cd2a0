"""What two solutions, or a solution and GNSS, differ by: the level holds it until evidence ends it, never by time.

A reset of the filter to rejected positions, a return after an outage, and a conflict that ended without a decision
leave a vector between the position in use and the one that was given up. Either of the two may be right. Three things
end it:

- closure: the position comes back by the same vector, within the spread of both;
- displacement, where the difference grew and did not step: since then the way driven by inertial sensors and by GNSS
  has agreed for `CONFIRMED_S`. A held offset agrees in displacement for ever, so that a step is not ended by it;
- a decision of core.trust for one of the two.
"""

from dataclasses import dataclass, replace
from math import hypot

Pair = tuple[float, float]  # horizontal, vertical
Vector = tuple[float, float, float]
NONE: Pair = (0.0, 0.0)
STILL: Vector = (0.0, 0.0, 0.0)

CONFIRMED_S = 60.0  # of used positions without a rejection, which decide for GNSS where the difference grew
CLOSURE_SDS = 3.0
GREW_RATIO = 9.0  # [-] largest test ratio of the first rejected position of a difference that grew: three gates


@dataclass(frozen=True)
class Disagreement:
    """A vector between two positions, of which each may be the true one; replaced and never changed in place."""

    vector_n: Vector = STILL  # [m, NED] position in use minus the one that was given up
    spread: Pair = NONE  # [m] standard deviation of the vector
    grew: bool = False  # without a step: displacement decides
    agreeing_ns: int | None = None  # since when positions have been used without a rejection

    @property
    def is_open(self) -> bool:
        """Whether there is anything to hold."""
        return self.vector_n != STILL

    @property
    def bound(self) -> Pair:
        """Length of the vector [m, horizontal and vertical]."""
        north, east, down = self.vector_n
        return hypot(north, east), abs(down)

    def after(self, vector_n: Vector, spread: Pair, time_ns: int, *, grew: bool) -> "Disagreement":
        """Add a further vector; the sum is closed on an axis where it is within its spread.

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
        """
        (n, e, d), (dn, de, dd) = self.vector_n, vector_n
        sum_n, spreads = (n + dn, e + de, d + dd), (hypot(self.spread[0], spread[0]), hypot(self.spread[1], spread[1]))
        if self.is_open:
            if hypot(sum_n[0], sum_n[1]) <= CLOSURE_SDS * spreads[0]:
                sum_n = (0.0, 0.0, sum_n[2])
            if abs(sum_n[2]) <= CLOSURE_SDS * spreads[1]:
                sum_n = (sum_n[0], sum_n[1], 0.0)
        if sum_n == STILL:
            return NOTHING
        return Disagreement(sum_n, spreads, grew and (self.grew or not self.is_open), time_ns)

    def confirmed(self, time_ns: int, *, used: bool) -> "Disagreement":
        """Use the outcome of a position: displacement ends a difference that grew."""
        if not self.is_open:
            return self
        if not used or self.agreeing_ns is None:
            return replace(self, agreeing_ns=time_ns)
        if self.grew and (time_ns - self.agreeing_ns) * 1e-9 >= CONFIRMED_S:
            return NOTHING
        return self


NOTHING = Disagreement()
