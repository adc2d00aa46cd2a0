"""Normalised innovations of GNSS as means over seconds, in axes of the Earth and of the vehicle."""

from collections import Counter, deque
from math import cos, isfinite, sin
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS
from shared.messages.navigation import AidingKind, AidingUpdate

HISTORY_SECONDS = 330  # seconds: the longest window, and what is learned after it
# Standard deviations by which one innovation counts at most: a second of multipath is no drift.
CLIP = 4.0
KINDS = (AidingKind.GNSS_VELOCITY, AidingKind.GNSS_POSITION)
AXES = ("north", "east", "down", "along", "across")
Axes = tuple[float, float, float, float, float]
NO_SUM: Axes = (0.0, 0.0, 0.0, 0.0, 0.0)


class Second(NamedTuple):
    """Mean of the normalised innovations of a second, and the sum of the means up to it."""

    number: int
    mean: Axes
    total: Axes


def plus(a: Axes, b: Axes, sign: float = 1.0) -> Axes:
    """Sum a + b of each axis, or a - b with the sign -1."""
    return (
        a[0] + sign * b[0], a[1] + sign * b[1], a[2] + sign * b[2], a[3] + sign * b[3], a[4] + sign * b[4],
    )  # fmt: skip


def sums_over(first: Second, last: Second) -> Axes:
    """Sum of each axis from one second to another, both included."""
    return plus(plus(last.total, first.total, -1.0), first.mean)


class InnovationSeconds:
    """Innovations over their standard deviations, one mean a second; newest last."""

    def __init__(self, rejected: Counter[str]) -> None:
        self.seconds: deque[Second] = deque(maxlen=HISTORY_SECONDS)
        self._rejected = rejected
        self._number = 0
        self._sum = [0.0] * 5
        self._count = self._heights = 0

    def clear(self) -> None:
        """Forget all: the filter has started again."""
        self.seconds.clear()
        self._count, self._heights, self._sum = 0, 0, [0.0] * 5

    def keep(self, number: int) -> None:
        """Forget all but the newest seconds."""
        while len(self.seconds) > number:
            self.seconds.popleft()

    def add(self, update: AidingUpdate, heading: float) -> None:
        """Use an innovation of two or three axes [NED], with the vehicle's heading [rad]."""
        size = len(update.innovation)
        if size not in (2, 3) or len(update.innovation_sd) != size:
            self._rejected["aiding: innovation of another layout"] += 1
            return
        if not all(isfinite(z) and sd > 0.0 for z, sd in zip(update.innovation, update.innovation_sd, strict=True)):
            self._rejected["aiding: innovation without a standard deviation"] += 1
            return
        number = update.sampled_ns // SECOND_NS
        if number < self._number:
            self._rejected["aiding: stamp is before that of the second before"] += 1
            return
        self.complete(number)
        self._number = number
        ratios = [max(-CLIP, min(CLIP, z / sd)) for z, sd in zip(update.innovation, update.innovation_sd, strict=True)]
        north, east = ratios[:2]
        c, s = cos(heading), sin(heading)
        parts = (north, east, ratios[2] if size == 3 else 0.0, c * north + s * east, c * east - s * north)
        self._sum = [a + b for a, b in zip(self._sum, parts, strict=True)]
        self._count += 1
        self._heights += size == 3

    def complete(self, number: int) -> None:
        """End the open second, if it is before this one."""
        if not self._count or self._number >= number:
            return
        north, east, down, along, across = (value / self._count for value in self._sum)
        if self._heights:
            down *= self._count / self._heights
        mean = north, east, down, along, across
        total = self.seconds[-1].total if self.seconds else NO_SUM
        self.seconds.append(Second(self._number, mean, plus(total, mean)))
        self._count, self._heights, self._sum = 0, 0, [0.0] * 5
