"""Bias of the gyroscope from before the windows, so that an error that fusion has learned meanwhile is still seen."""

from collections import deque
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS
from shared.maths.rotation import Vector

AGE_NS = 60 * SECOND_NS  # twice the longest window: an error of half the smallest detectable size is not followed
HISTORY_SECONDS = 130  # one a second
DEFAULT_SD = 2e-3  # [rad/s] of a recording without the standard deviation: 0.1 deg/s, at switch-on


class Bias(NamedTuple):
    """Estimate of fusion."""

    time_ns: int
    value: Vector  # [rad/s, body]
    sd: Vector


class ReferenceBias:
    """The estimate of a minute ago, or the oldest there is; while something is suspected, that of before."""

    def __init__(self) -> None:
        self._known: deque[Bias] = deque(maxlen=HISTORY_SECONDS)
        self._used: Bias | None = None

    def add(self, time_ns: int, value: Vector, sd: Vector | None) -> None:
        """Keep an estimate of fusion, one a second."""
        if self._known and time_ns < self._known[-1].time_ns:
            self.clear()
        if not self._known or time_ns - self._known[-1].time_ns >= SECOND_NS:
            self._known.append(Bias(time_ns, value, sd or (DEFAULT_SD,) * 3))

    def clear(self) -> None:
        """Forget all: the filter has started again."""
        self._known.clear()
        self._used = None

    def advance(self, time_ns: int, *, suspected: bool) -> Bias | None:
        """Choose the reference at a time."""
        if suspected and self._used is not None:
            return self._used
        old = [bias for bias in self._known if bias.time_ns <= time_ns - AGE_NS]
        self._used = old[-1] if old else self._known[0] if self._known else None
        return self._used

    @property
    def newest(self) -> Bias | None:
        """Newest estimate."""
        return self._known[-1] if self._known else None

    def adopt(self) -> None:
        """Take the newest estimate in place of all before it."""
        if self._known:
            newest = self._known[-1]
            self._known.clear()
            self._known.append(newest)
            self._used = None
