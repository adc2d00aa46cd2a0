"""How a driver takes a course: accelerating, holding, braking and standing, with a continuous acceleration.

A change of speed from v0 to v1 within T seconds is, with x = t/T and dv = v1 - v0::

    v = v0 + dv (3 x² - 2 x³),    s = T (v0 x + dv (x³ - x⁴/2))
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np
import numpy.typing as npt

from .roads import Course, Stretch

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Move:
    """A smooth change from one speed to another."""

    duration: float  # [s]
    begin: float  # [m/s]
    end: float  # [m/s]

    @property
    def distance(self) -> float:
        """How far the vehicle gets [m]."""
        return 0.5 * (self.begin + self.end) * self.duration


def plan_lap(course: Course, acceleration: float, rng: np.random.Generator) -> list[Move]:
    """Plan one lap from rest to rest.

    Parameters
    ----------
    course : Course
        The road, with its speeds and stops.
    acceleration : float
        [m/s²] Mean of every change of speed; its peak is half as much again.
    rng : Generator
        Draws speeds, which stops are made, and how long they last: three numbers a stretch.

    Returns
    -------
    list of Move
        They cover the length of the course exactly.
    """
    draws = rng.random((len(course.stretches), 3))
    chosen = list(zip(course.stretches, draws.tolist(), strict=True))
    limits = [s.speed_m_s[0] + share * (s.speed_m_s[1] - s.speed_m_s[0]) for s, (share, _, _) in chosen]
    stands = [_stand(s, chance, share) for s, (_, chance, share) in chosen]
    joints = [0.0, *(min(pair) for pair in pairwise(limits)), 0.0]
    for i, stand in enumerate(stands):
        joints[i + 1] *= stand == 0.0
    lengths = [stretch.length_m for stretch in course.stretches]
    for i, length in reversed(list(enumerate(lengths))):
        joints[i] = min(joints[i], sqrt(joints[i + 1] ** 2 + 2.0 * acceleration * length))
    for i, length in enumerate(lengths):
        joints[i + 1] = min(joints[i + 1], sqrt(joints[i] ** 2 + 2.0 * acceleration * length))
    moves: list[Move] = []
    for i, length in enumerate(lengths):
        moves += _pass(length, joints[i], joints[i + 1], limits[i], acceleration)
        moves.append(Move(stands[i], 0.0, 0.0))
    return [move for move in moves if move.duration > 1e-9]


def _stand(stretch: Stretch, chance: float, share: float) -> float:
    if stretch.stop_s is None or chance >= stretch.stop_probability:
        return 0.0
    return float(stretch.stop_s[0] + share * (stretch.stop_s[1] - stretch.stop_s[0]))


def _pass(length: float, begin: float, end: float, limit: float, acceleration: float) -> Iterator[Move]:
    """Take one stretch: up to the limit or as near to it as its length allows, and down again."""
    top = max(begin, end, min(limit, sqrt(0.5 * (begin**2 + end**2) + acceleration * length)))
    up, down = Move((top - begin) / acceleration, begin, top), Move((top - end) / acceleration, top, end)
    yield up
    yield Move(max(0.0, length - up.distance - down.distance) / top, top, top)
    yield down


class Timetable:
    """Distance and speed at any time, planned lap by lap for ever; what lies behind is forgotten."""

    def __init__(self, course: Course, stand: float, acceleration: float, rng: np.random.Generator) -> None:
        self._course, self._acceleration, self._rng = course, acceleration, rng
        self._table = np.zeros((0, 5))  # time and distance at its begin, duration, speeds at begin and end
        self._time = self._distance = 0.0
        self._append([Move(stand, 0.0, 0.0)])

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance and speed of the vehicle along the road.

        Parameters
        ----------
        time : ndarray, shape (n,)
            [s] Since the start, increasing, and never before the begin of the last call.

        Returns
        -------
        tuple of ndarray, each of shape (n,)
            [m], [m/s]
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

    def _append(self, moves: list[Move]) -> None:
        rows = []
        for move in moves:
            rows.append((self._time, self._distance, move.duration, move.begin, move.end))
            self._time += move.duration
            self._distance += move.distance
        self._table = np.concatenate([self._table, rows])
