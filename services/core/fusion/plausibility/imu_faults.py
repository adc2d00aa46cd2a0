"""Faults of inertial samples: a clipped gyroscope, an accelerometer without output."""

from operator import eq
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import Vector

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Readings = tuple[float, float, float, float, float, float]

STUCK_S = 0.5  # noise changes the last digit of any sensor that works sooner
FLAT_TOP_S = 0.03  # the largest value of a sensor, again and again
FLAT_TOP_RAD_S = 1.5  # below it no gyroscope clips
GYROSCOPE = (3, 4, 5)
AXES = (*GYROSCOPE, 0, 1, 2)  # in the order in which they are asked
LONGEST_NS = (int(STUCK_S * 1e9),) * 3 + (int(FLAT_TOP_S * 1e9),) * 3  # of a repetition
FAULTS = ("accelerometer stuck",) * 3 + ("gyroscope saturated",) * 3
ALL = (True,) * 6
FORCE_LIMIT = 1000.0  # [m/s²] no sensor of a car measures so much
RATE_LIMIT = 100.0  # [rad/s]


class Sample(NamedTuple):
    """Mean specific force and angular rate [m/s², rad/s; body] of the time that ends at the stamp."""

    time_ns: int
    force: Vector
    rate: Vector
    fault: str | None = None  # what is wrong with it, if it is used nevertheless


def credible(force: Vector, rate: Vector) -> bool:
    """Whether a sensor can have measured this; not if a reading is not a number."""
    fx, fy, fz = force
    wx, wy, wz = rate
    return fx * fx + fy * fy + fz * fz < FORCE_LIMIT**2 and wx * wx + wy * wy + wz * wz < RATE_LIMIT**2


def unremarkable(sample: Sample, last: Sample) -> bool:
    """Whether a sample is credible, and none of its readings is that of the sample before."""
    return True not in map(eq, (*sample.force, *sample.rate), (*last.force, *last.rate)) and credible(
        sample.force, sample.rate
    )


class Repeats:
    """Times for which each of six readings has been the same to the last bit, and the faults that follow.

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
        self._changed: tuple[bool, ...] = (False,) * 6  # whether it ever did: a constant reading is not measured at all

    def changed(self, time_ns: int, readings: Readings) -> None:
        """Add a sample that is known to differ from the previous one in every reading."""
        self._readings, self._since_ns, self._changed = readings, (time_ns,) * 6, ALL

    def fault(self, time_ns: int, readings: Readings) -> str | None:
        """Add the next sample; returns its fault, or None."""
        old, self._readings = self._readings, readings
        if True not in map(eq, readings, old):  # nearly always
            self._since_ns, self._changed = (time_ns,) * 6, ALL
            return None
        same = tuple(map(eq, readings, old))
        since = tuple(begin if equal else time_ns for begin, equal in zip(self._since_ns, same, strict=True))
        changed = tuple(ever or not equal for ever, equal in zip(self._changed, same, strict=True))
        self._since_ns, self._changed = since, changed
        for axis in AXES:
            if changed[axis] and time_ns - since[axis] >= LONGEST_NS[axis] and _tells(axis, readings[axis]):
                return FAULTS[axis]
        return None


def mean(first: Vector, second: Vector) -> Vector:
    """Mean of two vectors."""
    return 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), 0.5 * (first[2] + second[2])


def faults(stamps_ns: IntArray, samples: FloatArray) -> dict[int, str]:
    """Find the suspect samples of a whole log, and what is wrong with them, as `Repeats` does sample by sample."""
    found: dict[int, str] = {}
    for axis in AXES:
        readings = samples[:, axis]
        begins = np.flatnonzero(readings[1:] != readings[:-1]) + 1  # of runs, but for the first: it had not changed yet
        lasts = np.append(begins, len(readings))[1:] - 1
        for begin, last in np.column_stack([begins, lasts])[stamps_ns[lasts] - stamps_ns[begins] >= LONGEST_NS[axis]]:
            if _tells(axis, float(readings[begin])):
                late = np.searchsorted(stamps_ns[begin : last + 1], stamps_ns[begin] + LONGEST_NS[axis])
                for place in range(int(begin + late), int(last) + 1):
                    found.setdefault(place, FAULTS[axis])
    return found


def _tells(axis: int, reading: float) -> bool:
    """Whether a repetition of this reading is none by chance: a gyroscope at rest may well repeat itself."""
    return axis not in GYROSCOPE or abs(reading) > FLAT_TOP_RAD_S
