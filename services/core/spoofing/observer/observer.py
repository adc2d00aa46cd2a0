"""Tilt, yaw and gyroscope bias of inertial samples and standing wheels alone.

Nothing here follows GNSS or a filter that uses it: what a slow attack teaches the filter, it does not teach this. It
needs no latitude: at standstill the gyroscopes measure their bias and the Earth's rate together, and the vertical part
of both stays the same where the vehicle drives on. The horizontal part turns with the heading and acts through the
tilt: 15 degrees an hour times 3 degrees of slope are 2e-4 deg/s.
"""

from collections import Counter
from collections.abc import Iterable
from math import exp, sqrt
from typing import NamedTuple

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import Vector

from ..gyroscope.track import Turn, dot, turn_at
from ..settings import Settings
from .standstill import Standstill, Standstills

SWAY_RAD = 2.5e-4  # a body sways on its springs by half a millimetre at the bumper, 2 m from its middle
LEVELLING_S = 60.0  # time constant with which the tilt follows the specific force while driving
LEVEL_M_S2 = 0.5  # excess of the specific force above which it shows an acceleration, and no tilt
LEVEL_RATE = 0.05  # [rad/s] likewise: a bend
MIN_NOISE = 0.25  # of the stated random walk, to which the scatter of few increments may fall
BIAS_JUMP_SDS = 5.0  # by which a bias jumps only where no vehicle stood: without wheels that say so
HISTORY_INCREMENTS = 30  # increments of the yaw
BRIDGED_NS = SECOND_NS  # gap of the samples over which the axis down is kept
CORRELATION_S = 200.0  # of the instability of a bias
EARTH_SD = 4e-6  # [rad/s] Earth's rate and the curvature of the way, through slopes and speed


class ObservedBias(NamedTuple):
    """Gyroscope bias, the Earth's rate included, by standstills."""

    time_ns: int  # end of the last standstill
    value: Vector  # [rad/s, body]
    variance: float  # [rad²/s²] of each axis at that time, without the instability of the run


class Observer:
    """Integrates increments; its bias comes from standstills, and between them its variance grows as the grade says."""

    def __init__(self, settings: Settings) -> None:
        self._long, self._grade = settings.long, settings.observer
        self.standstills = Standstills()
        self.bias: ObservedBias | None = None
        self.counts: Counter[str] = Counter()
        self._prior: ObservedBias | None = None  # before the present standstill
        self._begin_ns: int | None = None  # of it
        self.down: Vector | None = None  # [-, body]
        self._turns: list[Turn] = []
        self._end_ns: int | None = None  # of the newest increment

    def advance(self, increments: Iterable[Increment]) -> bool:
        """Integrate increments; gives whether the yaw has been continuous."""
        continuous = True
        for increment in increments:
            if increment.after_gap or (self._turns and self._turns[-1].time_ns != increment.start_ns):
                continuous = continuous and not self._turns
                bridged = self._end_ns is not None and increment.start_ns - self._end_ns <= BRIDGED_NS
                self._turns.clear()
                self.standstills.clear()
                if not bridged:  # within a second a vehicle hardly tilts: levelling takes up the rest
                    self.down = None
            self._end_ns = increment.end_ns
            standstill = self.standstills.add(increment)
            if standstill is not None:
                self._learn(standstill)
            self._turn(increment)
        return continuous

    def _learn(self, found: Standstill) -> None:
        """Combine a standstill with the bias from before it, and level by its specific force."""
        if found.begin_ns != self._begin_ns:
            self._begin_ns, self._prior = found.begin_ns, self.bias
        noise = max(found.noise, MIN_NOISE * self._long.angle_random_walk_rad_sqrt_s)
        variance = noise**2 / found.seconds + (SWAY_RAD / found.seconds) ** 2
        variance += self._grade.gyroscope_instability_rad_s**2
        value, prior = found.rate, self._prior
        if prior is not None:
            before = self._walked(prior, found.end_ns)
            limit = BIAS_JUMP_SDS * sqrt(before + variance)
            if not found.by_wheels and max(abs(a - b) for a, b in zip(value, prior.value, strict=True)) > limit:
                self.counts["standstill without wheels: turns"] += 1
                return
            gain = before / (before + variance)
            x, y, z = (b + gain * (a - b) for a, b in zip(value, prior.value, strict=True))
            value, variance = (x, y, z), (1.0 - gain) * before
        self.bias = ObservedBias(found.end_ns, value, variance)
        size = sqrt(dot(found.force, found.force))
        self.down = (-found.force[0] / size, -found.force[1] / size, -found.force[2] / size)

    def _walked(self, bias: ObservedBias, time_ns: int) -> float:
        """Variance of a bias [rad²/s²] at a later time, without the instability."""
        age_s = max(0, time_ns - bias.time_ns) / SECOND_NS
        return bias.variance + self._grade.gyroscope_bias_walk_rad_s_sqrt_s**2 * age_s

    def bias_variance(self, time_ns: int) -> float | None:
        """Variance of the bias [rad²/s²] of an axis at a time, None before the first standstill."""
        if self.bias is None:
            return None
        age_s = max(0, time_ns - self.bias.time_ns) / SECOND_NS
        unstable = self._grade.gyroscope_instability_rad_s**2 * (1.0 - exp(-2.0 * age_s / CORRELATION_S))
        moving = self._grade.gyroscope_moving_sd_rad_s**2
        return self._walked(self.bias, time_ns) + unstable + moving + EARTH_SD**2

    def _turn(self, one: Increment) -> None:
        """Integrate one increment about the axis down, and carry that axis."""
        down = self.down
        if down is None or self.bias is None:
            return
        fx, fy, fz, wx, wy, wz, duration_s = one.row
        if not self._turns:
            self._turns.append(Turn(one.start_ns, 0.0, (0.0, 0.0, 0.0), 0.0, down))
        bx, by, bz = self.bias.value
        ax, ay, az = (wx - bx) * duration_s, (wy - by) * duration_s, (wz - bz) * duration_s
        dx, dy, dz = down
        cx, cy, cz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax  # d' = d x w
        rate = dx * wx + dy * wy + dz * wz
        if abs(one.excess_force) < LEVEL_M_S2 and abs(rate) < LEVEL_RATE:
            share = duration_s / LEVELLING_S / STANDARD_GRAVITY
            cx, cy, cz = (
                cx - share * (fx + STANDARD_GRAVITY * dx),
                cy - share * (fy + STANDARD_GRAVITY * dy),
                cz - share * (fz + STANDARD_GRAVITY * dz),
            )
        dx, dy, dz = dx + cx, dy + cy, dz + cz
        size = sqrt(dx * dx + dy * dy + dz * dz)
        self.down = down = (dx / size, dy / size, dz / size)
        last = self._turns[-1]
        sx, sy, sz = last.axis_s
        moved = (sx + down[0] * duration_s, sy + down[1] * duration_s, sz + down[2] * duration_s)
        self._turns.append(Turn(one.end_ns, last.angle + rate * duration_s, moved, rate, down))
        if len(self._turns) > 2 * HISTORY_INCREMENTS:
            del self._turns[:-HISTORY_INCREMENTS]

    @property
    def newest_ns(self) -> int | None:
        """End of the yaw, None without one."""
        return self._turns[-1].time_ns if self._turns else None

    def at(self, time_ns: int) -> Turn | None:
        """Yaw at a time of the last seconds, bias not removed, by linear interpolation; None where it is unknown."""
        return turn_at(self._turns, time_ns)

    def outputs(self) -> tuple[float, ...]:
        """Everything that it says, as numbers: newest yaw [rad], bias [rad/s] and its standard deviation, axis down."""
        if self.bias is None or not self._turns:
            return ()
        variance = self.bias_variance(self._turns[-1].time_ns) or 0.0
        return (self._turns[-1].less(self.bias.value), *self.bias.value, sqrt(variance), *self._turns[-1].axis)
