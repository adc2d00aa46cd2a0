"""What a filter keeps over a gap of its inertial samples that is too long to be integrated over."""

from collections.abc import Sequence
from math import atan2, cos, sin
from typing import NamedTuple

import numpy as np

from shared.copies import shallow
from shared.maths.earth import wrap_angle
from shared.maths.rotation import Quaternion, quaternion_product

from ..aids.base import Measurement
from ..codes import HeadingMethod
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..settings import Settings
from .course import CourseFollower, course_of
from .heading import Heading

MAX_DURATION_S = 25.0  # of a gap over which attitude and biases are kept: a restart of a device, and a margin
RECENT_WINDOW_S = (
    0.3  # age of a fix at the end of a gap from which the filter starts: an unmeasured turn errs by 5 degrees
)
TILT_SD = 0.05  # [rad] by which the grade of a road changes meanwhile


class GapCarryOver(NamedTuple):
    """Filter with the attitude and biases at the end of a gap, its heading, and the variance of its tilt [rad²]."""

    filter: ErrorStateFilter
    heading: Heading
    tilt_variance: float


def kept_over_gap(
    settings: Settings, lost: ErrorStateFilter, end_ns: int, measurements: Sequence[Measurement]
) -> GapCarryOver:
    """Carry heading and biases over a gap, with the covariance that they have after it.

    The heading follows the course over ground of GNSS velocities in the gap; where the vehicle moved before it, the
    difference of heading and course is kept, so that a sensor that is mounted askew, or a car that reverses, keeps its
    own. Without a velocity the heading becomes worse with the distance driven, as if the vehicle turned on the spot.

    Parameters
    ----------
    settings : Settings
        For the course and the random walk of the biases.
    lost : ErrorStateFilter
        At the last sample before the gap; unchanged.
    end_ns : int
        Stamp of the first sample after it.
    measurements : sequence of Measurement
        In the gap, in the order of their stamps.
    """
    before = course_of(lost)
    north, east, _ = lost.velocity
    is_moving = before.speed >= settings.alignment.course_speed_m_s
    offset = wrap_angle(before.yaw - atan2(east, north)) if is_moving else 0.0
    follower = CourseFollower(settings, before._replace(yaw=wrap_angle(before.yaw - offset)))
    follower.velocity = lost.velocity
    for measurement in measurements:
        measurement.tell(follower)
    assert follower.course is not None
    course = follower.course.after(end_ns, follower.course.speed)
    turn = wrap_angle(course.yaw + offset - before.yaw)
    half: Quaternion = (cos(0.5 * turn), 0.0, 0.0, sin(0.5 * turn))
    gap_s = (end_ns - lost.time_ns) * 1e-9
    kept = shallow(lost)
    quaternion = quaternion_product(half, lost.inertial.quaternion)
    kept.inertial = lost.inertial._replace(time_ns=end_ns, quaternion=quaternion, velocity=follower.velocity)
    P = lost.P.copy()
    P[em.ACCELEROMETER_BIAS, em.ACCELEROMETER_BIAS] += np.eye(3) * settings.imu.accelerometer_bias_psd_m2_s5 * gap_s
    P[em.GYROSCOPE_BIAS, em.GYROSCOPE_BIAS] += np.eye(3) * settings.imu.gyroscope_bias_psd_rad2_s3 * gap_s
    kept.P = P
    P[em.ATTITUDE, em.ATTITUDE] += np.diag([TILT_SD**2, TILT_SD**2, 0.0])
    P[em.ATTITUDE.stop - 1, em.ATTITUDE.stop - 1] = course.variance
    tilt = max(float(P[em.ATTITUDE, em.ATTITUDE][k, k]) for k in (0, 1))
    return GapCarryOver(kept, Heading(0.0, course.variance**0.5, HeadingMethod.KEPT_OVER_GAP), tilt)
