"""A return of GNSS after an outage: the level holds the free run's spread until displacement has agreed over 500 m."""

from dataclasses import dataclass, replace
from math import sqrt

from shared.maths.quantiles import principal_variances
from shared.messages.explanation import Explanation, explain

from ..codes import Code
from .disagreement import CLOSURE_SDS, MAX_DURATION_S, NONE, Pair

DRIVEN_M = 500.0  # [m] with positions that agree
Block = tuple[float, float, float, float]  # [m²] NN, NE, EE, DD of a position's covariance


@dataclass(frozen=True)
class ReturnSpread:
    """What a return may be off by, as it is within the spread of the solution without GNSS; replaced, not changed."""

    bound: Pair = NONE  # [m] three standard deviations of that solution at the return, horizontal and vertical
    returned_ns: int | None = None
    driven_m: float = 0.0  # since then, while positions agreed

    @property
    def why(self) -> Explanation | None:
        """What it is, and what would end it; None without one."""
        if self.returned_ns is None:
            return None
        return explain(
            Code.HELD_AFTER_LOSS, horizontal_m=self.bound[0], vertical_m=self.bound[1], needed_m=DRIVEN_M,
            driven_m=self.driven_m,
        )  # fmt: skip

    def returned(self, time_ns: int, before: Block) -> "ReturnSpread":
        """Hold the spread of the solution before the first position; an earlier one that is larger stays."""
        nn, ne, ee, dd = before
        largest, _ = principal_variances(nn, ne, ee)
        horizontal, vertical = CLOSURE_SDS * sqrt(max(0.0, largest)), CLOSURE_SDS * sqrt(max(0.0, dd))
        return ReturnSpread((max(self.bound[0], horizontal), max(self.bound[1], vertical)), time_ns)

    def confirmed(self, *, used: bool, since_s: float, speed: float) -> "ReturnSpread":
        """Use the outcome of a position [s since the one before, m/s]: a way of 500 m in agreement ends it."""
        if self.returned_ns is None:
            return self
        if not used or since_s > MAX_DURATION_S:
            return replace(self, driven_m=0.0)
        driven_m = self.driven_m + speed * since_s
        return NO_LOSS if driven_m >= DRIVEN_M else replace(self, driven_m=driven_m)


NO_LOSS = ReturnSpread()
