"""A road as a chain of stretches that closes on itself: where it turns, where it climbs, where one has to stop.

Curvature rises linearly along the first part of a stretch, stays, and falls linearly along the last (clothoid,
arc, clothoid), so that heading has a continuous derivative; the slope changes in the same manner.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

EDGE = 0.25  # [-] part of a bend along which its curvature rises, and again falls
_KNOTS = np.array([EDGE, 1.0 - 2.0 * EDGE, EDGE])
_PEAK = 1.0 / (1.0 - EDGE)  # [-] largest over mean curvature


@dataclass(frozen=True)
class Stretch:
    """A piece of road with one speed; ranges are drawn from anew on every lap."""

    length_m: float
    speed_m_s: tuple[float, float]
    turn_deg: float = 0.0  # to the right
    rise_deg: float = 0.0  # change of the slope from its begin to its end
    stop_s: tuple[float, float] | None = None  # how long one stands at its end
    stop_probability: float = 1.0
    covered: bool = False  # no sky


def bend(
    turn_deg: float, radius_m: float, speed_m_s: tuple[float, float], stop_s: tuple[float, float] | None = None
) -> Stretch:
    """Make a bend whose tightest part has the given radius."""
    return Stretch(abs(turn_deg) * pi / 180.0 * radius_m * _PEAK, speed_m_s, turn_deg, stop_s=stop_s)


@dataclass(frozen=True)
class Course:
    """A loop: where its last stretch ends its first begins again, after a stop."""

    stretches: tuple[Stretch, ...]
    heading_deg: float = 0.0
    slope_deg: float = 0.0

    def __post_init__(self) -> None:
        last = self.stretches[-1]
        if last.stop_s is None or last.stop_probability < 1.0:
            raise ValueError("the last stretch of a course must end in a stop")


class Road:
    """Heading and slope of a course at any distance from its start."""

    def __init__(self, course: Course) -> None:
        lengths = np.array([s.length_m for s in course.stretches])
        self.length = float(lengths.sum())
        self._ends = np.cumsum(lengths)
        self._covered = np.array([s.covered for s in course.stretches])
        self._knots = np.concatenate([[0.0], np.cumsum(np.outer(lengths, _KNOTS))])
        turns = np.radians([s.turn_deg for s in course.stretches])
        rises = np.radians([s.rise_deg for s in course.stretches])
        self._heading = _Bends(self._knots, turns / lengths, np.radians(course.heading_deg))
        self._slope = _Bends(self._knots, rises / lengths, np.radians(course.slope_deg))

    def at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Heading, slope and curvature of the road.

        Parameters
        ----------
        distance : ndarray, shape (n,)
            [m] From the start, of any number of laps.

        Returns
        -------
        tuple of ndarray, each of shape (n,)
            [rad] Heading, clockwise from north, growing from lap to lap; [rad] slope, upwards positive;
            [rad/m] derivative of the heading.
        """
        laps, along = np.divmod(distance, self.length)
        index = np.clip(np.searchsorted(self._knots, along, side="right") - 1, 0, len(self._knots) - 2)
        beyond = along - self._knots[index]
        heading, curvature = self._heading.at(index, beyond)
        slope, _ = self._slope.at(index, beyond)
        return heading + laps * self._heading.total, slope + laps * self._slope.total, curvature

    def covered(self, distance: FloatArray) -> BoolArray:
        """Whether there is no sky above: ndarray, shape (n,)."""
        index = np.searchsorted(self._ends, np.mod(distance, self.length), side="right")
        covered: BoolArray = self._covered[np.minimum(index, len(self._ends) - 1)]
        return covered


class _Bends:
    """An angle along the road, from the mean of its derivative in each stretch."""

    def __init__(self, knots: FloatArray, means: FloatArray, start: float) -> None:
        lengths = np.diff(knots)
        self._rates = np.zeros((len(means), 3))  # where a stretch begins, and at both ends of its arc
        self._rates[:, 1:] = _PEAK * means[:, np.newaxis]
        begins = self._rates.ravel()
        ends = np.roll(begins, -1)
        self._begins, self._slopes = begins, (ends - begins) / lengths
        angles = np.concatenate([[0.0], np.cumsum(0.5 * (begins + ends) * lengths)])
        self._angles, self.total = start + angles, float(angles[-1])

    def at(self, index: npt.NDArray[np.intp], beyond: FloatArray) -> tuple[FloatArray, FloatArray]:
        rate, slope = self._begins[index], self._slopes[index]
        return self._angles[index] + beyond * (rate + 0.5 * slope * beyond), rate + slope * beyond
