"""The gyroscope's turn about the vertical, and the turns by other sources at the same times."""

from collections import deque
from collections.abc import Iterable, Sequence
from math import radians, sin
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import EARTH_RATE
from shared.maths.rotation import Vector, ned_from_body
from shared.messages.navigation import NavigationSolution

HISTORY_INCREMENTS = 350  # increments, 35 s: the longest window
STALE_AFTER_NS = 3 * SECOND_NS  # age of an attitude


class Turn(NamedTuple):
    """Heading by the gyroscope at a time, from an arbitrary zero; its bias is not removed."""

    time_ns: int
    angle: float  # [rad] integral of the rate about the vertical
    axis_s: Vector  # [s, body] integral of the axis down: times the bias, it is the angle by the bias
    rate: float  # [rad/s] about the vertical, mean of 100 ms
    axis: Vector  # [-, body] down

    def less(self, bias: Vector) -> float:
        """Angle [rad] without that of a bias [rad/s, body]."""
        return self.angle - dot(self.axis_s, bias)


def turn_at(turns: Sequence[Turn], time_ns: int) -> Turn | None:
    """Turn at a time within a track, by linear interpolation; its rate is the mean of the 100 ms around it."""
    if not turns or not turns[0].time_ns <= time_ns <= turns[-1].time_ns:
        return None
    after = turns[-1]
    for before in reversed(turns):
        if before.time_ns <= time_ns:
            break
        after = before
    span = after.time_ns - before.time_ns
    share = (time_ns - before.time_ns) / span if span else 0.0
    x, y, z = (a + share * (b - a) for a, b in zip(before.axis_s, after.axis_s, strict=True))
    angle = before.angle + share * (after.angle - before.angle)
    return Turn(time_ns, angle, (x, y, z), after.rate, after.axis)


class GyroscopeTrack:
    """Integrates increments of the angular rate about the axis down of fusion's attitude.

    Tilt errors of a degree change the rate by 2e-4 of itself and by 2 % of the rates of roll and pitch, whose mean over
    seconds is small. The Earth's rate is removed.
    """

    def __init__(self) -> None:
        self._turns: deque[Turn] = deque(maxlen=HISTORY_INCREMENTS)
        self._axis: Vector | None = None
        self._axis_ns = 0
        self._earth = 0.0

    def attitude(self, solution: NavigationSolution) -> None:
        """Use the tilt of a solution; its axes may be turned against those of the sensors."""
        matrix = ned_from_body(solution.roll_rad, solution.pitch_rad, 0.0)
        if solution.heading_turn_rad:
            matrix = matrix @ ned_from_body(0.0, 0.0, -solution.heading_turn_rad)
        x, y, z = matrix[2].tolist()
        self._axis, self._axis_ns = (x, y, z), solution.sampled_ns
        self._earth = EARTH_RATE * sin(radians(solution.latitude_deg))

    def add(self, increments: Iterable[Increment]) -> bool:
        """Integrate increments; gives whether the track has been continuous."""
        continuous = True
        for increment in increments:
            if self._axis is None or abs(increment.end_ns - self._axis_ns) > STALE_AFTER_NS:
                continuous = continuous and not self._turns
                self._turns.clear()
                continue
            if increment.after_gap or not self._turns or self._turns[-1].time_ns != increment.start_ns:
                continuous = continuous and not self._turns
                self._turns.clear()
                self._turns.append(Turn(increment.start_ns, 0.0, (0.0, 0.0, 0.0), 0.0, self._axis))
            last, duration_s, axis = self._turns[-1], increment.row[6], self._axis
            rate = dot(axis, (increment.row[3], increment.row[4], increment.row[5])) + self._earth
            sx, sy, sz = last.axis_s
            moved = (sx + axis[0] * duration_s, sy + axis[1] * duration_s, sz + axis[2] * duration_s)
            self._turns.append(Turn(increment.end_ns, last.angle + rate * duration_s, moved, rate, axis))
        return continuous

    @property
    def axis(self) -> Vector:
        """Down in body axes [-]."""
        return self._axis or (0.0, 0.0, 1.0)

    @property
    def earth(self) -> float:
        """Earth's rate about the vertical [rad/s], upwards positive."""
        return self._earth

    @property
    def newest_ns(self) -> int | None:
        """End of the track, None without one."""
        return self._turns[-1].time_ns if self._turns else None

    def at(self, time_ns: int) -> Turn | None:
        """Turn at a time within the track, by linear interpolation; its rate is the mean of the 100 ms around it."""
        return turn_at(self._turns, time_ns)


def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
