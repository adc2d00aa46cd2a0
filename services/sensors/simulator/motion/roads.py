"""Closed road of consecutive segments with curvature, slope, speed range and stops.

Curvature rises linearly along the first part of a segment, is constant, and falls linearly along the last part
(clothoid, arc, clothoid), so that the heading has a continuous derivative; the slope changes in the same manner.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

EDGE = 0.25  # [-] fraction of a bend that each of its two clothoids takes
_KNOTS = np.array([EDGE, 1.0 - 2.0 * EDGE, EDGE])
_PEAK = 1.0 / (1.0 - EDGE)  # [-] ratio of maximum to mean curvature


@dataclass(frozen=True)
class RoadSegment:
    """A road segment with one speed; speed and stop duration are drawn from their ranges on every lap."""

    length_m: float
    speed_m_s: tuple[float, float]
    turn_deg: float = 0.0  # change of heading, positive to the right
    rise_deg: float = 0.0  # change of slope from start to end
    stop_s: tuple[float, float] | None = None  # duration of the stop at the end
    stop_probability: float = 1.0
    covered: bool = False  # tunnel: no GNSS signals


def bend(
    turn_deg: float, radius_m: float, speed_m_s: tuple[float, float], stop_s: tuple[float, float] | None = None
) -> RoadSegment:
    """Create a bend whose minimum radius is `radius_m`."""
    return RoadSegment(abs(turn_deg) * pi / 180.0 * radius_m * _PEAK, speed_m_s, turn_deg, stop_s=stop_s)


@dataclass(frozen=True)
class Course:
    """A closed course: after a stop at the end of the last segment, the first begins again."""

    segments: tuple[RoadSegment, ...]
    heading_deg: float = 0.0
    slope_deg: float = 0.0

    def __post_init__(self) -> None:
        last = self.segments[-1]
        if last.stop_s is None or last.stop_probability < 1.0:
            raise ValueError("the last segment of a course must end in a stop")


class Road:
    """Heading and slope of a course at any distance from its start."""

    def __init__(self, course: Course) -> None:
        lengths = np.array([s.length_m for s in course.segments])
        self.length = float(lengths.sum())
        self._ends = np.cumsum(lengths)
        self._covered = np.array([s.covered for s in course.segments])
        self._knots = np.concatenate([[0.0], np.cumsum(np.outer(lengths, _KNOTS))])
        turns = np.radians([s.turn_deg for s in course.segments])
        rises = np.radians([s.rise_deg for s in course.segments])
        self._heading = _Bends(self._knots, turns / lengths, np.radians(course.heading_deg))
        self._slope = _Bends(self._knots, rises / lengths, np.radians(course.slope_deg))

    def at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Heading, slope and curvature of the road.

        Parameters
        ----------
        distance : ndarray, shape (n,)
            [m] Distance from the start, over any number of laps.

        Returns
        -------
        tuple of ndarray, each of shape (n,)
            [rad] Heading, clockwise from north, continuous over laps; [rad] slope, positive upwards;
            [rad/m] curvature, the derivative of the heading.
        """
        laps, along = np.divmod(distance, self.length)
        index = np.clip(np.searchsorted(self._knots, along, side="right") - 1, 0, len(self._knots) - 2)
        beyond = along - self._knots[index]
        heading, curvature = self._heading.at(index, beyond)
        slope, _ = self._slope.at(index, beyond)
        return heading + laps * self._heading.total, slope + laps * self._slope.total, curvature

    def covered(self, distance: FloatArray) -> BoolArray:
        """Whether GNSS signals are blocked: ndarray, shape (n,)."""
        index = np.searchsorted(self._ends, np.mod(distance, self.length), side="right")
        covered: BoolArray = self._covered[np.minimum(index, len(self._ends) - 1)]
        return covered


class _Bends:
    """An angle along the road, computed from its mean derivative in each segment."""

    def __init__(self, knots: FloatArray, means: FloatArray, start: float) -> None:
        lengths = np.diff(knots)
        self._rates = np.zeros((len(means), 3))  # at the start of a segment, and at both ends of its arc
        self._rates[:, 1:] = _PEAK * means[:, np.newaxis]
        begins = self._rates.ravel()
        ends = np.roll(begins, -1)
        self._begins, self._slopes = begins, (ends - begins) / lengths
        angles = np.concatenate([[0.0], np.cumsum(0.5 * (begins + ends) * lengths)])
        self._angles, self.total = start + angles, float(angles[-1])

    def at(self, index: npt.NDArray[np.intp], beyond: FloatArray) -> tuple[FloatArray, FloatArray]:
        rate, slope = self._begins[index], self._slopes[index]
        return self._angles[index] + beyond * (rate + 0.5 * slope * beyond), rate + slope * beyond
