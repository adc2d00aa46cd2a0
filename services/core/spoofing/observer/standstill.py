"""Standstills, found in the inertial samples and, where there are wheels, in wheels that stand: GNSS has no part in it.

Without wheels they last longer before they are believed, for a vehicle that rolls evenly on a smooth road is quiet too.
"""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.rotation import Vector

# Mean of half a second against that of the standstill: an idling engine shakes single samples by more. On a car in town
# no 4 s of driving stayed within both, and 70 % of those of standing did; over 2 s one in a hundred of driving does.
FORCE_LIMIT = 0.1  # [m/s²]
RATE_LIMIT = 0.004  # [rad/s]
MAX_RATE = 0.05  # [rad/s] bias at switch-on: 3 deg/s
MEAN_INCREMENTS = 5  # increments of such a mean
SETTLING = 1  # parts that begin a standstill, and are not used
MARGIN_MEANS = 2  # the last parts before a motion are not used: it begins before the wheels are seen to turn
WITH_WHEELS_S, WITHOUT_S = 2.0, 4.0  # least length
MAX_DURATION_S = 120.0  # after which another one begins: the bias walks on
WHEELS_SILENT_NS = 2 * SECOND_NS  # after which wheels say nothing any more
MOTION_MARGIN_NS = SECOND_NS  # before and after wheels that turn


class Standstill(NamedTuple):
    """Means over a standstill so far."""

    begin_ns: int
    end_ns: int
    seconds: float
    rate: Vector  # [rad/s, body] of the gyroscopes: their bias, and the Earth's rate
    force: Vector  # [m/s², body] of the accelerometers
    noise: float  # [rad/√s] of the gyroscopes, by the scatter of the increments
    by_wheels: bool  # the wheels are known to stand


class _Sums:
    """Sums over increments: of their rows times their durations, and of the squares of neighbours' differences."""

    def __init__(self) -> None:
        self.count, self.seconds, self.squares = 0, 0.0, 0.0
        self.row = [0.0] * 6

    def add(self, other: "_Sums") -> None:
        """Add another sum."""
        self.count, self.seconds = self.count + other.count, self.seconds + other.seconds
        self.squares += other.squares
        self.row = [a + b for a, b in zip(self.row, other.row, strict=True)]

    def mean(self) -> list[float]:
        """Mean row."""
        return [value / self.seconds for value in self.row]


class Standstills:
    """Finds standstills, increment by increment."""

    def __init__(self) -> None:
        self._wheels_ns: int | None = None  # newest stamp of wheels
        self._turned_ns: int | None = None  # newest one at which they turned
        self.clear()

    def clear(self) -> None:
        """Begin anew: the inertial samples have a gap, or the vehicle moves."""
        self._part, self._last = _Sums(), [0.0] * 6
        self._begin(0)

    def _begin(self, time_ns: int) -> None:
        """Begin what may be a standstill."""
        self._begin_ns, self._settling = time_ns, SETTLING
        self._whole = _Sums()  # all parts that are sure
        self._all = _Sums()  # those that wait, as well
        self._waiting: list[_Sums] = []

    def wheels(self, time_ns: int, *, turn: bool) -> None:
        """Use wheel speeds, or the speed of the odometer: whether the wheels turn."""
        self._wheels_ns = max(time_ns, self._wheels_ns or time_ns)
        if turn:
            self._turned_ns = max(time_ns, self._turned_ns or time_ns)

    def add(self, one: Increment) -> Standstill | None:
        """Use an increment; gives the standstill so far when another part of it is sure."""
        hears = self._wheels_ns is not None and one.end_ns - self._wheels_ns <= WHEELS_SILENT_NS
        if hears and self._turned_ns is not None and self._turned_ns > one.start_ns - MOTION_MARGIN_NS:
            self.clear()
            return None
        self._sum(one.row)
        if self._part.count < MEAN_INCREMENTS:
            return None
        part, self._part = self._part, _Sums()
        if not self._is_quiet(part):
            self._begin(one.end_ns)
        elif self._settling:
            self._settling -= 1
            self._begin_ns = one.end_ns
            return None
        self._all.add(part)
        self._waiting.append(part)
        if len(self._waiting) <= MARGIN_MEANS:
            return None
        self._whole.add(self._waiting.pop(0))
        if self._whole.seconds < (WITH_WHEELS_S if hears else WITHOUT_S):
            return None
        found = self._found(one.end_ns - SECOND_NS, by_wheels=hears)
        if self._whole.seconds >= MAX_DURATION_S:
            self._begin(one.end_ns)
        return found

    def _is_quiet(self, part: _Sums) -> bool:
        """Whether force and rate are those of the standstill so far."""
        if not self._all.count:
            return True
        new, mean = part.mean(), self._all.mean()
        apart = [(a - b) ** 2 for a, b in zip(new, mean, strict=True)]
        rate2 = sum(value**2 for value in mean[3:])
        return sum(apart[:3]) < FORCE_LIMIT**2 and sum(apart[3:]) < RATE_LIMIT**2 and rate2 < MAX_RATE**2

    def _sum(self, row: Sequence[float]) -> None:
        part, duration_s = self._part, row[6]
        # Of neighbours: a bias that walks, or a swaying body, is no noise.
        last, wx, wy, wz = self._last, row[3], row[4], row[5]
        if part.count:
            part.squares += duration_s * ((wx - last[3]) ** 2 + (wy - last[4]) ** 2 + (wz - last[5]) ** 2) / 6.0
        self._last = [*row[:6]]
        part.row = [total + value * duration_s for total, value in zip(part.row, row, strict=False)]
        part.count, part.seconds = part.count + 1, part.seconds + duration_s

    def _found(self, end_ns: int, *, by_wheels: bool) -> Standstill:
        whole = self._whole
        fx, fy, fz, wx, wy, wz = whole.mean()
        noise = sqrt(whole.squares * MEAN_INCREMENTS / (MEAN_INCREMENTS - 1) / whole.count)
        return Standstill(self._begin_ns, end_ns, whole.seconds, (wx, wy, wz), (fx, fy, fz), noise, by_wheels)
