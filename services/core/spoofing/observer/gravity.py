"""A unit that was knocked: gravity turns in its axes, and its gyroscopes have not seen it turn.

The inertial sensors contradict themselves here, which neither GNSS nor an odometer that is falsified like it explains:
only the accelerations of the wheels are removed from the specific force, and what an attack may do to them is in the
spread. A road that climbs turns both.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from math import degrees, hypot, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import STANDARD_GRAVITY
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector, matrix_from_quaternion, quaternion_from_rotation_vector
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.accused import IMU
from shared.trust.result import Test, judged

from ..codes import Code
from ..inertial.tracks import Series
from ..settings import Settings

FloatArray = npt.NDArray[np.float64]

NAME = "gravity"
SIDE, GAP = 10, 2  # [s] of the means before and after, and between them
MIN_ANGLE_DEG = 1.0
ODOMETER_GAP_S = 2.5
MAX_PENDING_SECONDS = 5  # seconds for which speeds may be late
RETENTION_S = 120  # for which a knock is stated: until the mounting can have been found again
ALONG_SD = 0.3  # [m/s²] of the acceleration along: a drag that GNSS and odometer share is no knock
ACROSS_SD, ACROSS_SHARE = 0.1, 0.1  # [m/s²] likewise, and as a share of speed times yaw rate: sideslip, lever arms


class _PendingSecond(NamedTuple):
    """One second that the speeds have not reached yet."""

    end_ns: int
    force: FloatArray  # shape (3,) [m/s², body]
    frame: FloatArray  # shape (3, 3) common frame from body, in the middle
    angle: FloatArray  # shape (3,) [rad, body]
    duration_s: float


class _Second(NamedTuple):
    """One second in a frame that the gyroscopes carry."""

    time_ns: int
    force: FloatArray  # shape (3,) [m/s²] less the acceleration by wheels
    across: float  # [m/s²] speed times yaw rate
    turn: float  # [rad] size of the rotation


class Gravity:
    """Gravity before and after a gap of two seconds, in axes that the gyroscopes carry."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._seconds: deque[_Second] = deque(maxlen=2 * SIDE + GAP)
        self._frame: FloatArray = np.eye(3)  # of the present body axes
        self._open: list[Increment] = []
        self._end_ns: int | None = None  # of the newest increment
        self._waiting: deque[_PendingSecond] = deque(maxlen=MAX_PENDING_SECONDS)
        self._speeds = Series(500, ODOMETER_GAP_S)
        self._before: float | None = None  # speed at the end of the last second
        self._knock: Test | None = None
        self._knock_ns = 0

    def speed(self, time_ns: int, speed_m_s: float) -> None:
        """Use the speed of the wheels."""
        if self._speeds.newest_ns is None or time_ns > self._speeds.newest_ns:
            self._speeds.add(time_ns, speed_m_s)

    def clear(self) -> None:
        """Begin anew: the inertial samples have a gap."""
        self._seconds.clear()
        self._open.clear()
        self._waiting.clear()
        self._before = None

    def advance(self, increments: Iterable[Increment], bias: Vector) -> None:
        """Use increments, whose gyroscopes have a bias [rad/s]."""
        for increment in increments:
            if increment.after_gap or increment.start_ns != self._end_ns:
                self.clear()
            self._end_ns = increment.end_ns
            self._open.append(increment)
            if increment.end_ns // SECOND_NS != increment.start_ns // SECOND_NS:
                self._close(np.array(bias))
                self._open.clear()

    def _close(self, bias: FloatArray) -> None:
        """Put a second into the common frame."""
        rows, end_ns = np.array([increment.row for increment in self._open]), self._open[-1].end_ns
        step = rows[:, 6]
        duration = float(step.sum())
        angle = ((rows[:, 3:6] - bias) * step[:, None]).sum(axis=0)
        force = (rows[:, :3] * step[:, None]).sum(axis=0) / duration
        self._waiting.append(_PendingSecond(end_ns, force, self._frame @ _rotation(0.5 * angle), angle, duration))
        self._frame = self._frame @ _rotation(angle)
        reached_ns = self._speeds.newest_ns or 0
        while self._waiting and self._waiting[0].end_ns <= reached_ns:
            self._take(self._waiting.popleft())

    def _take(self, one: _PendingSecond) -> None:
        """Remove the acceleration of the wheels from a second that the speeds have reached."""
        speed, before = self._speeds.at(one.end_ns), self._before
        self._before = speed
        if speed is None or before is None:
            self._seconds.clear()
            return
        across = 0.5 * (speed + before) * float(one.angle[2]) / one.duration_s
        force = one.force - np.array([(speed - before) / one.duration_s, across, 0.0])
        turn = float(np.linalg.norm(one.angle))
        self._seconds.append(_Second(one.end_ns, one.frame @ force, across, turn))

    def verdict(self, bias_variance: float, false_alarm_rate: float) -> Test:
        """Test the newest two sides; a knock is stated for two minutes."""
        base = Test(
            Outcome.NOT_EVALUATED, explain(Code.NO_GRAVITY), false_alarm_rate=false_alarm_rate,
            window_s=float(SIDE), accused=(IMU,),
        )  # fmt: skip
        if len(self._seconds) < 2 * SIDE + GAP:
            return base if self._knock is None else self._stated(self._knock, base)
        now_ns, limit = self._seconds[-1].time_ns, chi_square_limit(2, false_alarm_rate)
        statistic, angle_deg = self._turned(bias_variance)
        why = explain(Code.GRAVITY, turned_deg=angle_deg)
        base = replace(base, why=why, suspect_since_ns=now_ns - (SIDE + GAP) * SECOND_NS)
        found = judged(base, statistic, limit)
        if found.accuses and self._knock is None:
            self._knock, self._knock_ns = found, now_ns
        return found if self._knock is None else self._stated(self._knock, found)

    def _stated(self, knock: Test, present: Test) -> Test:
        """The knock, or what is found now when it was long ago."""
        newest_ns = self._seconds[-1].time_ns if self._seconds else self._knock_ns
        if newest_ns - self._knock_ns <= RETENTION_S * SECOND_NS:
            return knock
        self._knock = None
        return present

    def _turned(self, bias_variance: float) -> tuple[float, float]:
        """Least chi-square of the two halves of the later side, and the angle [deg] between both sides."""
        seconds = list(self._seconds)
        forces = np.array([second.force for second in seconds])
        first = forces[:SIDE].mean(axis=0)
        sides = [forces[-SIDE:], forces[-SIDE : -SIDE // 2], forces[-SIDE // 2 :]]
        apart = [self._frame.T @ (side.mean(axis=0) - first) for side in sides]
        turn = sum(second.turn for second in seconds)
        across = max(abs(second.across) for second in seconds)
        carried = sqrt(bias_variance) * (SIDE + GAP) + self._settings.long.gyroscope_scale_sd * turn
        drift = STANDARD_GRAVITY * carried
        sd = hypot(ALONG_SD, drift), hypot(ACROSS_SD, ACROSS_SHARE * across, drift)
        statistics = [(item[0] / sd[0]) ** 2 + (item[1] / sd[1]) ** 2 for item in apart]
        angles = [degrees(hypot(item[0], item[1]) / STANDARD_GRAVITY) for item in apart]
        kept = min(angles) > MIN_ANGLE_DEG and float(apart[1][:2] @ apart[2][:2]) > 0.0
        return (min(statistics) if kept else 0.0), angles[0]


def _rotation(angle: FloatArray) -> FloatArray:
    """Matrix of a rotation vector [rad]."""
    x, y, z = angle.tolist()
    return np.asarray(matrix_from_quaternion(quaternion_from_rotation_vector((x, y, z))))
