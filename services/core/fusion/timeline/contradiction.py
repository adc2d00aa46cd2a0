"""What the solution without GNSS has contradicted the one with it by since a conflict began, and what is left of it.

What both differ by within three standard deviations of their difference contradicts nothing. Beyond that the offset of
GNSS is what they differed by when this was the most standard deviations, with the spread of that time: a spread that
grows later is the drift of the solution without GNSS, and takes nothing back. What GNSS moves away after that is added,
as long as that solution decides.

Offset and growth are two things. Whether GNSS still moves is what displacement shows, and it ends with the conflict;
the offset stays, unless a solution that began before the suspect time now knows better.
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np
import numpy.typing as npt

from ..integrity.closure import horizontal_bound, vertical_bound
from ..integrity.disagreement import CLOSURE_SDS, NONE, ZERO_VECTOR, Pair, Vector
from ..integrity.separation import spreads, squared

FloatArray = npt.NDArray[np.float64]

GROWTH_S = 10.0  # over which the rate of a growing offset is measured
NOISE_M = 0.5  # of a difference within this time, beside the spread that has grown in it


def sizes(vector_n: Vector) -> Pair:
    """Length of a vector [m, NED] on the ground, and that of its vertical part."""
    north, east, down = vector_n
    return hypot(north, east), abs(down)


@dataclass(frozen=True)
class SolutionDifference:
    """Position with GNSS minus the one without it, at one time."""

    time_ns: int
    vector_n: Vector  # [m, NED]
    spread: Pair  # [m] largest standard deviation on the ground, and vertical
    ratio: Pair  # [-] length in standard deviations of the difference
    smaller_m: float  # smaller standard deviation on the ground

    @classmethod
    def of(cls, time_ns: int, vector_n: Vector, covariance: FloatArray) -> "SolutionDifference":
        """With the covariance of the difference [m², NED]."""
        spread, horizontal = spreads(covariance), sqrt(squared(vector_n, covariance) or 0.0)
        smaller_m = sqrt(max(0.0, float(np.linalg.det(covariance[:2, :2])))) / spread[0]
        return cls(time_ns, vector_n, spread, (horizontal, abs(vector_n[2]) / spread[1]), smaller_m)

    def bound(self, risk: float) -> Pair:
        """How far GNSS may be off [m] that came back to this difference."""
        size_h, size_v = sizes(self.vector_n)
        horizontal = horizontal_bound(size_h, (self.spread[0], self.smaller_m), self.ratio[0], risk)
        return horizontal, vertical_bound(size_v, self.spread[1], risk)


@dataclass(frozen=True)
class ResidualOffset:
    """What a conflict leaves: a vector [m, NED] with its standard deviation and the slack that the level adds [m]."""

    vector_n: Vector = ZERO_VECTOR
    spread: Pair = NONE
    slack: Pair = NONE


@dataclass(frozen=True)
class Contradiction:
    """The largest contradiction of a conflict; without one its ratios are 0."""

    vector_n: Vector = ZERO_VECTOR  # [m, NED]
    spread: Pair = NONE  # [m] of the difference when it was the most standard deviations
    ratio: Pair = NONE  # [-] which it was then
    earlier: tuple[SolutionDifference, ...] = ()  # of the last `GROWTH_S`
    growth_m_s: float = 0.0  # on the ground, as far as the solution without GNSS decided

    @property
    def is_any(self) -> bool:
        """Whether there has been a contradiction."""
        return self.ratio != NONE

    def after(self, now: SolutionDifference, *, decides: bool, stepped: bool = False) -> "Contradiction":
        """Add the difference of a second, in which the solution without GNSS was good enough to decide, or was not.

        One with GNSS that has `stepped` by a reset has not grown, and a wide solution without it shows no rate.
        """
        found = self
        for k, (size, known) in enumerate(zip(sizes(now.vector_n), sizes(self.vector_n), strict=True)):
            if decides and now.ratio[k] > CLOSURE_SDS and now.ratio[k] >= self.ratio[k]:
                found = found._with(k, now.vector_n, now.spread[k], now.ratio[k])
            elif decides and self.ratio[k] > 0.0 and size > known:
                found = found._with(k, now.vector_n, self.spread[k], self.ratio[k])
        recent = tuple(
            apart for apart in self.earlier if not stepped and (now.time_ns - apart.time_ns) * 1e-9 <= GROWTH_S
        )
        growth = _growth(recent[0], now) if recent and decides else self.growth_m_s
        return replace(found, earlier=(*recent, now), growth_m_s=growth)

    def left(self, now: SolutionDifference | None, sds: float, risk: float) -> ResidualOffset:
        """What is left of the offset by what the solution without GNSS, which began before it, says now, if anything.

        Its posterior of now takes the place of the one of then, `sds` standard deviations of which are held, where it
        is nearer: GNSS came back, or it knows better now.
        """
        north, east, down = self.vector_n
        spread, slack = [*self.spread], [sds * value for value in self.spread]
        bounds_m = NONE if now is None else now.bound(risk)
        for k, known in enumerate(sizes(self.vector_n)):
            if now is None or self.ratio[k] == 0.0 or bounds_m[k] >= known + slack[k]:
                continue
            size, closed = sizes(now.vector_n)[k], bounds_m[k] == 0.0
            spread[k], slack[k] = (0.0, 0.0) if closed else (now.spread[k], bounds_m[k] - size)
            if k == 0:
                north, east = (0.0, 0.0) if closed else now.vector_n[:2]
            else:
                down = 0.0 if closed else now.vector_n[2]
        return ResidualOffset((north, east, down), (spread[0], spread[1]), (slack[0], slack[1]))

    def _with(self, axis: int, vector_n: Vector, spread: float, ratio: float) -> "Contradiction":
        """The same with another value on the ground (0) or of the height (1)."""
        (north, east, _), (_, _, down) = (vector_n, self.vector_n) if axis == 0 else (self.vector_n, vector_n)
        spread_h, spread_v = (spread, self.spread[1]) if axis == 0 else (self.spread[0], spread)
        ratio_h, ratio_v = (ratio, self.ratio[1]) if axis == 0 else (self.ratio[0], ratio)
        return replace(self, vector_n=(north, east, down), spread=(spread_h, spread_v), ratio=(ratio_h, ratio_v))


def _growth(then: SolutionDifference, now: SolutionDifference) -> float:
    """Rate [m/s] at which a difference has grown between two times; 0 where its spread explains it."""
    span_s = (now.time_ns - then.time_ns) * 1e-9
    moved = hypot(now.vector_n[0] - then.vector_n[0], now.vector_n[1] - then.vector_n[1])
    sd = sqrt(max(0.0, now.spread[0] ** 2 - then.spread[0] ** 2) + NOISE_M**2)
    return moved / span_s if span_s >= 0.5 * GROWTH_S and moved > CLOSURE_SDS * sd else 0.0
