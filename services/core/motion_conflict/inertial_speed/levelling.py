"""Levels inertial increments by the gyroscope: horizontal accelerations and the yaw rate about the vertical.

The direction of gravity in body axes is measured at standstill and propagated by the gyroscope. On straights the
lateral specific force is due to tilt alone, and corrects it slowly. No solution of the navigation filter is used: its
roll follows the GNSS velocity, and would hide a false scale of it.
"""

from collections import deque
from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from shared.inertial.increments import Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.rotation import Vector, cross

STANDSTILL_SPEED_M_S = 0.3  # speed that may be standstill: the noise of a GNSS speed
STILL_INCREMENTS = 20  # in a row, 2 s
STILL_RATE = 0.02  # [rad/s] largest range of each axis at standstill; an idling engine stays below it in means of 0.1 s
STILL_FORCE = 0.5  # [m/s²] the same of specific force; that of an idling diesel is 0.3
MAX_BIAS = 0.2  # [rad/s] of the gyroscope: three times that of an uncalibrated telephone, 0.07
BIAS_GAIN = 0.3  # of each further standstill of 2 s
STRAIGHT_M_S2 = 0.15  # yaw rate times speed of a straight; a tenth of it, should the speed be false, is 0.1 deg of tilt
STRAIGHT_M_S = 3.0
LATERAL_S = 5.0  # time constant of the correction across; a bend is left within a few of them
STEEPEST = 0.7  # [-] sine of the forward axis' slope, 45 degrees: beyond it the readings are not those of a vehicle
FORWARD_S = 20.0  # along: the change of speed is known less well


class LevelIncrement(NamedTuple):
    """One increment in level axes, the forward axis of the IMU made horizontal."""

    start_ns: int
    end_ns: int
    forward: float  # [m/s²] horizontal acceleration
    lateral: float  # [m/s²] to the right
    yaw_rate: float  # [rad/s] about the vertical, clockwise from above
    after_gap: bool


class Levelling:
    """Direction of gravity in body axes, and the gyroscope's bias."""

    def __init__(self) -> None:
        self._down: Vector | None = None  # unit vector, body
        self._bias: Vector | None = None  # [rad/s, body]
        self._still: deque[tuple[float, ...]] = deque(maxlen=STILL_INCREMENTS)  # force and rate

    @property
    def ready(self) -> bool:
        """Whether there has been a standstill, from which tilt and bias are known."""
        return self._bias is not None

    def step(self, increment: Increment, speed: float | None, acceleration: float | None) -> LevelIncrement | None:
        """Propagate over one increment.

        Parameters
        ----------
        increment : Increment
            Means of specific force [m/s²] and angular rate [rad/s] in body axes.
        speed, acceleration : float, optional
            [m/s, m/s²] Of GNSS or odometer. The speed tells standstill and straights; the acceleration corrects the
            pitch slowly, to which the lateral acceleration is not sensitive.

        Returns
        -------
        Levelled or None
            None before the first standstill.

        Notes
        -----
        With d the unit vector downwards, w the rate less its bias, f the specific force and x the forward axis::

            d' = d x w,   a = f + g d,   lateral = a · (d x x)/|d x x|,   yaw rate = w · d
        """
        row = increment.row
        force, duration = (row[0], row[1], row[2]), row[6]
        if increment.after_gap:
            self._still.clear()
        self._use_standstill(row, speed)
        if self._down is None or self._bias is None:
            return None
        bias = self._bias
        rate = (row[3] - bias[0], row[4] - bias[1], row[5] - bias[2])
        down = _unit(_sum(self._down, cross(self._down, rate), duration))
        if abs(down[0]) > STEEPEST:
            self._down = None
            return None
        right = _unit((0.0, down[2], -down[1]))
        ahead = cross(right, down)
        total = _sum(force, down, STANDARD_GRAVITY)
        forward, lateral, yaw_rate = _dot(total, ahead), _dot(total, right), _dot(rate, down)
        if speed is not None and speed > STRAIGHT_M_S and abs(yaw_rate * speed) < STRAIGHT_M_S2:
            down = _sum(down, right, -(lateral - yaw_rate * speed) / STANDARD_GRAVITY * duration / LATERAL_S)
            if acceleration is not None:
                down = _sum(down, ahead, -(forward - acceleration) / STANDARD_GRAVITY * duration / FORWARD_S)
            down = _unit(down)
        self._down = down
        return LevelIncrement(increment.start_ns, increment.end_ns, forward, lateral, yaw_rate, increment.after_gap)

    def _use_standstill(self, row: Sequence[float], speed: float | None) -> None:
        """Measure gravity and bias over 2 s in which speed is zero and the readings do not change."""
        if speed is None or speed > STANDSTILL_SPEED_M_S:
            self._still.clear()
            return
        self._still.append(tuple(row[:6]))
        if len(self._still) < STILL_INCREMENTS:
            return
        readings = np.array(self._still)
        spread, mean = np.ptp(readings, axis=0), readings.mean(axis=0)
        self._still.clear()
        if spread[:3].max() > STILL_FORCE or spread[3:].max() > STILL_RATE or abs(mean[3:]).max() > MAX_BIAS:
            return
        fx, fy, fz, wx, wy, wz = mean.tolist()
        self._down = _unit((-fx, -fy, -fz))
        old, gain = (self._bias, BIAS_GAIN) if self._bias is not None else ((0.0, 0.0, 0.0), 1.0)
        self._bias = _sum(old, (wx - old[0], wy - old[1], wz - old[2]), gain)


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sum(a: Vector, b: Vector, factor: float) -> Vector:
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


def _unit(a: Vector) -> Vector:
    length = sqrt(_dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length)
