"""The 5 s window: changes of GNSS velocity, course and height against those of the inertial sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot, sqrt

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS, Increment
from shared.maths.earth import STANDARD_GRAVITY, wrap_angle
from shared.maths.rotation import skew
from shared.messages.explanation import Explanation, explain
from shared.trust.inputs import Input

from ..codes import Code
from ..inertial.anchors import Anchor
from ..inertial.propagation import MOTION, QUATERNION, RATE, VELOCITY, carried, matrices, table_of
from ..inertial.tracks import VelocityFix
from .metrics import WINDOW_S, Metric, acceleration_differences

FloatArray = npt.NDArray[np.float64]

MAX_DURATION_S = 6.0  # of a window: epochs at 1 Hz may be 0.9 s off
GAP_S = 1.6  # between two fixes of a window
MIN_SPEED = 1.0  # [m/s] of the heading rate
MOVING_SPEED = 3.0  # [m/s] by inertial sensors, at which a GNSS that stands has no course that could turn


@dataclass(frozen=True)
class Window:
    """One evaluation: signed differences GNSS minus inertial, and the dynamics that thresholds depend on."""

    start_ns: int
    end_ns: int
    difference: dict[Metric, float]
    # standard deviation from the velocity's stated accuracy, and from attitude and gyroscope biases of the anchor
    noise: dict[Metric, float] = field(default_factory=dict)
    speed_m_s: tuple[float, float] = (0.0, 0.0)  # least and largest
    force_m_s2: float = 0.0  # largest | |f| - g |
    missing: dict[Metric, Explanation] = field(default_factory=dict)  # why a metric was not evaluated
    speed_change_m_s: tuple[float, float] = (0.0, 0.0)  # of the horizontal speed over the window: GNSS, inertial


def window_of_fixes(fixes: Sequence[VelocityFix]) -> list[VelocityFix] | Explanation:
    """Fixes of the 5 s before the newest one, it included; or why there is no such window."""
    if not fixes:
        return explain(Code.NO_INPUT, input=Input.GNSS_VELOCITY)
    limit_ns = fixes[-1].time_ns - round((WINDOW_S - 0.1) * SECOND_NS)
    chosen: list[VelocityFix] = []
    for fix in reversed(fixes):
        chosen.append(fix)
        if fix.time_ns <= limit_ns:
            break
    chosen.reverse()
    if chosen[0].time_ns > limit_ns or chosen[-1].time_ns - chosen[0].time_ns > MAX_DURATION_S * SECOND_NS:
        return explain(Code.FEW_VELOCITIES)
    if any(b.time_ns - a.time_ns > GAP_S * SECOND_NS for a, b in pairwise(chosen)):
        return explain(Code.VELOCITY_GAP, limit_s=GAP_S)
    return chosen


def compare(
    fixes: Sequence[VelocityFix],
    increments: Sequence[Increment],
    anchor: Anchor,
    *,
    lever_arm_b: FloatArray,
    height_rate: Callable[[int, int], float | None],
) -> Window:
    """Compare the changes over a window.

    Parameters
    ----------
    fixes : sequence of VelocityFix
        Of `window_of_fixes`.
    increments : sequence of Increment
        From the anchor to the newest fix or later, contiguous.
    anchor : Anchor
        Attitude, velocity and biases from before the window: GNSS of the window has no part in them.
    lever_arm_b : ndarray, shape (3,)
        [m, body] From the IMU to the antenna.
    height_rate : callable
        [m/s] Mean rate of the barometric height between two times, None if it is not known.

    Returns
    -------
    Window
        Without the metrics that could not be evaluated, which are in `missing`.

    Notes
    -----
    The mean over a window of a differenced series is its change divided by the length W of the window, so that both
    sides are filtered equally::

        a_gnss = (v_k - v_0) / W,    a_inertial = (v_free(t_k) - v_free(t_0)) / W

    v_free is the strapdown velocity of the antenna: gravity is removed with the gyroscopes' attitude.
    """
    times, velocity, yaw = _propagated(increments, anchor, lever_arm_b)
    start_ns, end_ns = fixes[0].time_ns, fixes[-1].time_ns
    duration = (end_ns - start_ns) / SECOND_NS
    ends = np.array([start_ns - anchor.time_ns, end_ns - anchor.time_ns]) / SECOND_NS
    free = np.column_stack([np.interp(ends, times, velocity[:, axis]) for axis in range(3)])
    gnss_change = fixes[-1].velocity_n - fixes[0].velocity_n
    difference = acceleration_differences(gnss_change / duration, (free[1] - free[0]) / duration)
    sd = np.hypot(fixes[0].sd, fixes[-1].sd) / duration
    horizontal = float(max(sd[0], sd[1]))
    noise = {
        Metric.ACCELERATION_NORTH: float(sd[0]),
        Metric.ACCELERATION_EAST: float(sd[1]),
        Metric.ACCELERATION_UP: float(sd[2]),
        Metric.ACCELERATION: horizontal,
    }
    missing: dict[Metric, Explanation] = {}
    slowest = min(fix.speed for fix in fixes)
    inertial_speeds = np.hypot(free[:, 0], free[:, 1]).tolist()
    inertial_speed = min(inertial_speeds)
    if slowest > MIN_SPEED or inertial_speed > MOVING_SPEED:
        turned = float(np.interp(ends[1], times, yaw) - np.interp(ends[0], times, yaw))
        difference[Metric.HEADING_RATE] = (_course_change(fixes) - turned) / duration
        noise[Metric.HEADING_RATE] = horizontal / max(slowest, MIN_SPEED)  # of two courses, over the window
    else:
        missing[Metric.HEADING_RATE] = explain(Code.TOO_SLOW, limit_m_s=MIN_SPEED)
    rate = height_rate(start_ns, end_ns)
    if rate is None:
        missing[Metric.ALTITUDE_RATE] = explain(Code.NO_BAROMETER)
    else:
        difference[Metric.ALTITUDE_RATE] = _climb_rate(fixes) - rate
        noise[Metric.ALTITUDE_RATE] = float(max(fix.sd[2] for fix in fixes)) / sqrt(len(fixes))
    inside = [increment for increment in increments if increment.end_ns > start_ns]
    force = max(abs(increment.excess_force) for increment in inside)
    speeds = (min(slowest, inertial_speed), max(fix.speed for fix in fixes))
    C = matrices(anchor.state[QUATERNION])
    tilted = _attitude_part(anchor, C, (free[1] - free[0]) / duration, float(ends.mean()))
    north, east, up = tilted.tolist()
    turn_sd = float(np.sqrt(C[2] ** 2 @ anchor.gyroscope_bias_sd**2))
    of_anchor = {
        Metric.ACCELERATION_NORTH: north,
        Metric.ACCELERATION_EAST: east,
        Metric.ACCELERATION_UP: up,
        Metric.ACCELERATION: max(north, east),
        Metric.HEADING_RATE: turn_sd,
    }
    noise = {metric: hypot(sd, of_anchor.get(metric, 0.0)) for metric, sd in noise.items()}
    change = fixes[-1].speed - fixes[0].speed, inertial_speeds[1] - inertial_speeds[0]
    return Window(start_ns, end_ns, difference, noise, speeds, force, missing, change)


def _attitude_part(anchor: Anchor, C: FloatArray, acceleration_n: FloatArray, middle_s: float) -> FloatArray:
    """Standard deviation [m/s², NED] of the inertial acceleration from the anchor's attitude and gyroscope biases.

    Notes
    -----
    An attitude error psi turns the specific force f; with b the gyroscope bias, t the time from the anchor to the
    middle of the window::

        da = -sk(f) (psi + C b t),    f = a - g
    """
    force = skew(acceleration_n - [0.0, 0.0, STANDARD_GRAVITY])
    P = anchor.attitude_cov + middle_s**2 * (C * anchor.gyroscope_bias_sd**2) @ C.T
    sd: FloatArray = np.sqrt((force @ P @ force.T).diagonal())
    return sd


def _propagated(
    increments: Sequence[Increment], anchor: Anchor, lever_arm_b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times since the anchor [s], velocity of the antenna [m/s, NED] and continuous yaw [rad] after each increment."""
    table = table_of(increments)
    lever_velocity_b = table[:, RATE] @ skew(lever_arm_b)  # w x l
    motion = np.concatenate([anchor.state[None, MOTION], carried(anchor.state[None], table)[0, :, MOTION]])
    C = matrices(motion[:, QUATERNION])
    velocity = motion[:, VELOCITY] + np.matvec(C, np.concatenate([lever_velocity_b[:1], lever_velocity_b]))
    times_ns = np.array([anchor.time_ns] + [increment.end_ns for increment in increments])
    return (times_ns - anchor.time_ns) / SECOND_NS, velocity, np.unwrap(np.arctan2(C[:, 1, 0], C[:, 0, 0]))


def _course_change(fixes: Sequence[VelocityFix]) -> float:
    """Change of course [rad], turn by turn; 0 while GNSS stands, where its course is noise."""
    change = 0.0
    for before, after in pairwise(fixes):
        if min(before.speed, after.speed) > MIN_SPEED:
            courses = [float(np.arctan2(fix.velocity_n[1], fix.velocity_n[0])) for fix in (before, after)]
            change += wrap_angle(courses[1] - courses[0])
    return change


def _climb_rate(fixes: Sequence[VelocityFix]) -> float:
    """Mean upward velocity [m/s], by the trapezoidal rule."""
    times = np.array([(fix.time_ns - fixes[0].time_ns) / SECOND_NS for fix in fixes])
    up = -np.array([fix.velocity_n[2] for fix in fixes])
    return float(np.trapezoid(up, times) / times[-1])
