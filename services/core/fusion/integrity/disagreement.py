"""What two solutions, or a solution and GNSS, differ by: the level holds it until evidence ends it, never by time.

A reset of the filter to rejected positions, a return after an outage, and a conflict that ended without a decision
leave a vector between the position in use and the one that was given up. Either of the two may be right. Three things
end it:

- closure: the position comes back by the same vector, within the spread of both;
- displacement, where the difference grew and did not step: since then the way driven by inertial sensors and by GNSS
  has agreed for `CONFIRMED_S`. A held offset agrees in displacement for ever, so that a step is not ended by it;
- for a first fix aside of the saved position, a drive of `DRIVEN_M`: a transmitter at the parking place stays behind.
"""

from dataclasses import dataclass, replace
from math import hypot

Pair = tuple[float, float]  # horizontal, vertical
Vector = tuple[float, float, float]
NONE: Pair = (0.0, 0.0)
STILL: Vector = (0.0, 0.0, 0.0)

CONFIRMED_S = 60.0  # of used positions without a rejection, which decide for GNSS where the difference grew
DRIVEN_M = 2000.0  # with positions that agree, after which the saved position is no longer held against them
CLOSURE_SDS = 3.0
GREW_RATIO = 9.0  # [-] largest test ratio of the first rejected position of a difference that grew: three gates


@dataclass(frozen=True)
class Disagreement:
    """A vector between two positions, of which each may be the true one; replaced and never changed in place."""

    vector_n: Vector = STILL  # [m, NED] position in use minus the one that was given up
    spread: Pair = NONE  # [m] standard deviation of the vector
    grew: bool = False  # without a step: displacement decides
    agreeing_ns: int | None = None  # since when positions have been used without a rejection
    at_start: bool = False  # between the saved position and the first fix
    driven_m: float = 0.0  # since then, while positions agreed

    @property
    def is_open(self) -> bool:
        """Whether there is anything to hold."""
        return self.vector_n != STILL

    @property
    def bound(self) -> Pair:
        """Length of the vector [m, horizontal and vertical]."""
        north, east, down = self.vector_n
        return hypot(north, east), abs(down)

    @property
    def reason(self) -> str:
        """What it is, and what would end it; empty without one."""
        if not self.is_open:
            return ""
        horizontal, vertical = self.bound
        size = f"{horizontal:.1f} m horizontal and {vertical:.1f} m vertical"
        if self.at_start:
            return (
                f"the first fix was {size} from the saved position of the parked vehicle; ends after {DRIVEN_M:.0f} m "
                f"driven in agreement ({self.driven_m:.0f} m so far), or by a step back"
            )
        if self.grew:
            return f"positions differed by {size} and were taken over; ends after {CONFIRMED_S:.0f} s of agreement"
        return f"positions differ by {size} and nothing decides which is right; ends by a step back by the same vector"

    def after(
        self, vector_n: Vector, spread: Pair, time_ns: int, *, grew: bool, at_start: bool = False
    ) -> "Disagreement":
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
        at_start : bool
            It is between a saved position and the first fix.
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
        first = not self.is_open
        return Disagreement(sum_n, spreads, grew and (self.grew or first), time_ns, at_start and first)

    def confirmed(self, time_ns: int, *, used: bool, moved_m: float) -> "Disagreement":
        """Use the outcome of a position: displacement ends a difference that grew, a drive that of a start.

        Parameters
        ----------
        time_ns : int
            Stamp.
        used : bool
            Whether the position was used.
        moved_m : float
            [m] Way since the position before.
        """
        if not self.is_open:
            return self
        if not used or self.agreeing_ns is None:
            return replace(self, agreeing_ns=time_ns)
        if self.grew and (time_ns - self.agreeing_ns) * 1e-9 >= CONFIRMED_S:
            return NOTHING
        if not self.at_start:
            return self
        driven_m = self.driven_m + moved_m
        return NOTHING if driven_m >= DRIVEN_M else replace(self, driven_m=driven_m)


NOTHING = Disagreement()
