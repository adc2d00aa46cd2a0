"""Speed profile of a course: acceleration, constant speed, braking and standstill, with continuous acceleration.

A change of speed from v0 to v1 within T seconds is, with x = t/T and dv = v1 - v0::

    v = v0 + dv (3 x² - 2 x³),    s = T (v0 x + dv (x³ - x⁴/2))
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np
import numpy.typing as npt

from .roads import Course, RoadSegment

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SpeedChange:
    """A smooth change from one speed to another."""

    duration: float  # [s]
    begin: float  # [m/s]
    end: float  # [m/s]

    @property
    def distance(self) -> float:
        """Distance covered [m]."""
        return 0.5 * (self.begin + self.end) * self.duration


def plan_lap(course: Course, acceleration: float, rng: np.random.Generator) -> list[SpeedChange]:
    """Plan one lap from standstill to standstill.

    Parameters
    ----------
    course : Course
        The road, with its speeds and stops.
    acceleration : float
        [m/s²] Mean acceleration of every change of speed; the peak is 1.5 times the mean.
    rng : Generator
        Source of the random speeds, stops and stop durations: three numbers per segment.

    Returns
    -------
    list of Move
        Their total distance is exactly the length of the course.
    """
    draws = rng.random((len(course.segments), 3))
    chosen = list(zip(course.segments, draws.tolist(), strict=True))
    limits = [s.speed_m_s[0] + share * (s.speed_m_s[1] - s.speed_m_s[0]) for s, (share, _, _) in chosen]
    stops = [_stop_duration(s, chance, share) for s, (_, chance, share) in chosen]
    joints = [0.0, *(min(pair) for pair in pairwise(limits)), 0.0]  # speeds at the ends of the segments
    for i, stop in enumerate(stops):
        joints[i + 1] *= stop == 0.0
    lengths = [segment.length_m for segment in course.segments]
    for i, length in reversed(list(enumerate(lengths))):
        joints[i] = min(joints[i], sqrt(joints[i + 1] ** 2 + 2.0 * acceleration * length))
    for i, length in enumerate(lengths):
        joints[i + 1] = min(joints[i + 1], sqrt(joints[i] ** 2 + 2.0 * acceleration * length))
    moves: list[SpeedChange] = []
    for i, length in enumerate(lengths):
        moves += _segment_moves(length, joints[i], joints[i + 1], limits[i], acceleration)
        moves.append(SpeedChange(stops[i], 0.0, 0.0))
    return [move for move in moves if move.duration > 1e-9]


def _stop_duration(segment: RoadSegment, chance: float, share: float) -> float:
    if segment.stop_s is None or chance >= segment.stop_probability:
        return 0.0
    return float(segment.stop_s[0] + share * (segment.stop_s[1] - segment.stop_s[0]))


def _segment_moves(length: float, begin: float, end: float, limit: float, acceleration: float) -> Iterator[SpeedChange]:
    """Accelerate to the speed limit, or to the highest speed that the length allows, and brake to the end speed."""
    top = max(begin, end, min(limit, sqrt(0.5 * (begin**2 + end**2) + acceleration * length)))
    up, down = SpeedChange((top - begin) / acceleration, begin, top), SpeedChange((top - end) / acceleration, top, end)
    yield up
    yield SpeedChange(max(0.0, length - up.distance - down.distance) / top, top, top)
    yield down


class SpeedProfile:
    """Distance and speed over time, planned lap by lap without end; past moves are discarded."""

    def __init__(self, course: Course, standstill: float, acceleration: float, rng: np.random.Generator) -> None:
        self._course, self._acceleration, self._rng = course, acceleration, rng
        self._table = np.zeros((0, 5))  # start time, start distance, duration, start speed, end speed
        self._time = self._distance = 0.0
        self._append([SpeedChange(standstill, 0.0, 0.0)])

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance and speed of the vehicle along the road.

        Parameters
        ----------
        time : ndarray, shape (n,)
            [s] Time since the start, increasing; not before the first time of the previous call.

        Returns
        -------
        tuple of ndarray, each of shape (n,)
            [m] Distance; [m/s] speed.
        """
        while self._time <= time[-1]:
            self._append(plan_lap(self._course, self._acceleration, self._rng))
        index = np.searchsorted(self._table[:, 0], time, side="right") - 1
        begin, distance, duration, v0, v1 = self._table[np.maximum(index, 0)].T
        x, change = np.maximum(time - begin, 0.0) / duration, v1 - v0
        result = (
            distance + duration * x * (v0 + change * x**2 * (1.0 - 0.5 * x)),
            v0 + change * x**2 * (3.0 - 2.0 * x),
        )
        self._table = self._table[max(0, index[0]) :]
        return result

    def _append(self, moves: list[SpeedChange]) -> None:
        rows = []
        for move in moves:
            rows.append((self._time, self._distance, move.duration, move.begin, move.end))
            self._time += move.duration
            self._distance += move.distance
        self._table = np.concatenate([self._table, rows])
