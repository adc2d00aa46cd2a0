"""Faults of inertial samples: saturated gyroscope, stuck accelerometer, implausible values."""

from operator import eq
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import Vector

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Readings = tuple[float, float, float, float, float, float]

MAX_REPETITION_S = 0.5  # repetition of an accelerometer reading that noise excludes
SATURATED_S = 0.03  # repetition of a gyroscope reading at the end of its range
SATURATED_RAD_S = 1.5  # lowest end of a range
GYROSCOPE = (3, 4, 5)
AXES = (*GYROSCOPE, 0, 1, 2)  # in the order of the test: the first fault is reported
MAX_DURATION_NS = (int(MAX_REPETITION_S * 1e9),) * 3 + (int(SATURATED_S * 1e9),) * 3  # plausible repetition, by axis
FAULTS = ("accelerometer stuck",) * 3 + ("gyroscope saturated",) * 3
FORCE_LIMIT = 1000.0  # [m/s²] plausible specific force
RATE_LIMIT = 100.0  # [rad/s] plausible angular rate


class Sample(NamedTuple):
    """Mean specific force and angular rate [m/s², rad/s; body] of the time that ends at the stamp."""

    time_ns: int
    force: Vector
    rate: Vector
    fault: str | None = None  # of a suspect sample, which is used with an inflated covariance


def credible(force: Vector, rate: Vector) -> bool:
    """Whether specific force and angular rate are plausible, and no reading is NaN."""
    fx, fy, fz = force
    wx, wy, wz = rate
    return fx * fx + fy * fy + fz * fz < FORCE_LIMIT**2 and wx * wx + wy * wy + wz * wz < RATE_LIMIT**2


class Repeats:
    """Finds faults by the times for which each of the six readings has repeated to the last bit.

    Parameters
    ----------
    time_ns : int
        Stamp of the first sample.
    readings : tuple of float
        Its specific force [m/s², body] and angular rate [rad/s, body].
    """

    def __init__(self, time_ns: int, readings: Readings) -> None:
        self._readings = readings
        self._since_ns: tuple[int, ...] = (time_ns,) * 6
        self._changed: tuple[bool, ...] = (False,) * 6  # whether a reading ever changed; if not, it is not measured

    def fault(self, time_ns: int, readings: Readings) -> str | None:
        """Add the next sample; returns its fault, or None."""
        old, self._readings = self._readings, readings
        if True not in map(eq, readings, old):  # the ordinary case
            self._since_ns, self._changed = (time_ns,) * 6, (True,) * 6
            return None
        same = tuple(map(eq, readings, old))
        since = tuple(begin if equal else time_ns for begin, equal in zip(self._since_ns, same, strict=True))
        changed = tuple(ever or not equal for ever, equal in zip(self._changed, same, strict=True))
        self._since_ns, self._changed = since, changed
        for axis in AXES:
            if changed[axis] and time_ns - since[axis] >= MAX_DURATION_NS[axis] and _is_fault(axis, readings[axis]):
                return FAULTS[axis]
        return None


def mean(first: Vector, second: Vector) -> Vector:
    """Mean of two vectors."""
    return 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), 0.5 * (first[2] + second[2])


def faults(stamps_ns: IntArray, samples: FloatArray) -> dict[int, str]:
    """Faults of the samples of a whole log, by row; the same as `Repeats` sample by sample."""
    found: dict[int, str] = {}
    for axis in AXES:
        readings = samples[:, axis]
        begins = (
            np.flatnonzero(readings[1:] != readings[:-1]) + 1
        )  # of repetitions, without the first, before which nothing has changed
        lasts = np.append(begins, len(readings))[1:] - 1
        for begin, last in np.column_stack([begins, lasts])[
            stamps_ns[lasts] - stamps_ns[begins] >= MAX_DURATION_NS[axis]
        ]:
            if _is_fault(axis, float(readings[begin])):
                late = np.searchsorted(stamps_ns[begin : last + 1], stamps_ns[begin] + MAX_DURATION_NS[axis])
                for place in range(int(begin + late), int(last) + 1):
                    found.setdefault(place, FAULTS[axis])
    return found


def _is_fault(axis: int, reading: float) -> bool:
    """Whether a repetition of this reading is a fault: a gyroscope at standstill may repeat its readings."""
    return axis not in GYROSCOPE or abs(reading) > SATURATED_RAD_S
