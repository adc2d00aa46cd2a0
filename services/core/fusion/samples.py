"""What may be wrong with an inertial sample: a clipped gyroscope, a dead accelerometer."""

from collections.abc import Sequence
from operator import eq
from typing import NamedTuple

from shared.maths.rotation import Vector

STUCK_S = 0.5  # noise changes the last digit of any sensor that works sooner
FLAT_TOP_S = 0.03  # the largest value of a sensor, again and again
FLAT_TOP_RAD_S = 1.5  # below it no gyroscope clips


class Sample(NamedTuple):
    """Mean specific force and angular rate [m/s², rad/s; body] of the time that ends at the stamp."""

    time_ns: int
    force: Vector
    rate: Vector
    doubt: str | None = None  # what is wrong with it, if it is used nevertheless


class Repeats(NamedTuple):
    """How long each of six readings has been the same to the last bit."""

    time_ns: int
    readings: tuple[float, ...]
    since_ns: tuple[int, ...]
    changed: tuple[bool, ...]  # whether it ever did: a reading that never changes is one that is not made

    def after(self, time_ns: int, readings: tuple[float, ...]) -> "Repeats":
        """Take in the next sample."""
        old, since, changed = self.readings, self.since_ns, self.changed
        same = tuple(map(eq, readings, old))
        if True not in same:
            return Repeats(time_ns, readings, (time_ns,) * 6, _ALL)
        return Repeats(
            time_ns,
            readings,
            tuple(begin if equal else time_ns for begin, equal in zip(since, same, strict=True)),
            tuple(ever or not equal for ever, equal in zip(changed, same, strict=True)),
        )

    def doubt(self) -> str | None:
        """What the repetition of readings says of the sensor."""
        oldest = min(self.since_ns)
        if self.time_ns - oldest < FLAT_TOP_S * 1e9:
            return None
        for axis in range(3, 6):
            flat = self.time_ns - self.since_ns[axis] >= FLAT_TOP_S * 1e9
            if flat and abs(self.readings[axis]) > FLAT_TOP_RAD_S and self.changed[axis]:
                return "gyroscope saturated"
        for axis in range(3):
            if self.changed[axis] and self.time_ns - self.since_ns[axis] >= STUCK_S * 1e9:
                return "accelerometer stuck"
        return None


_ALL = (True,) * 6


def begun(time_ns: int, readings: tuple[float, ...]) -> Repeats:
    """Begin with the first sample."""
    return Repeats(time_ns, readings, (time_ns,) * 6, (False,) * 6)


def mean(first: Vector, second: Vector) -> Vector:
    """Mean of two vectors."""
    return 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), 0.5 * (first[2] + second[2])


def doubts(stamps_ns: Sequence[int], rows: Sequence[Sequence[float]]) -> dict[int, str]:
    """Say of a whole log which samples are doubtful, and why: what `Repeats` says sample by sample."""
    found: dict[int, str] = {}
    repeats: Repeats | None = None
    for place, (time_ns, row) in enumerate(zip(stamps_ns, rows, strict=True)):
        readings = tuple(row)
        repeats = repeats.after(time_ns, readings) if repeats else begun(time_ns, readings)
        if doubt := repeats.doubt():
            found[place] = doubt
    return found
