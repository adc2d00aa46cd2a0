"""Position without inertial sensors and without a filter: the newest fix, with what successive fixes tell of its error.

A fix is published at its own stamp. Its covariance is the stated one times the learned scale of position errors, never
below what is stated: without inertial sensors an error that lasts for minutes cannot be observed. The heading is the
course over ground while the vehicle moves, and afterwards that course, which becomes worse with the distance driven.
"""

from dataclasses import dataclass
from math import atan2, hypot, pi

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference, wrap_angle
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import Vector
from shared.messages.navigation import NavigationPhase

from ..aids.base import Measurement
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer import WheelSpeed
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..integrity.protection_levels import horizontal_level, vertical_level
from ..settings import Settings
from ..solution import Solution, upper
from ..start.alignment import gnss_error_model

FloatArray = npt.NDArray[np.float64]

VELOCITY_AGE_S = 0.5  # largest age of a velocity that belongs to a position
LONGEST_STEP_S = 10.0  # between two positions that are compared
ACCELERATION_SD = 2.0  # [m/s²] of a car between two fixes, as in a gap of the inertial samples
GATE = chi_square_limit(3, 1e-6)
REJECTIONS = 3  # positions in a row, after which the new place is taken and the old one is held in the covariance
JUMP_HELD_S = 60.0  # a reflection or another constellation in use lasts for about a minute
NEVER_NS = -(2**62)
TILT_SD = 0.1  # [rad] roll and pitch of a car on a road: grades and banks of 10 %
UNKNOWN_HEADING_VARIANCE = pi**2 / 3.0  # [rad²] of a uniform distribution over the circle
UNKNOWN_HEIGHT_SD = 100.0  # [m] of a position without a height
TURNING_RADIUS_M = 5.0  # of a car: a metre driven unobserved turns it by at most 0.2 rad
STANDING_M_S = 0.3  # speed below which the vehicle stands, three times the noise of a receiver's velocity
FASTEST_REVERSE_M_S = 8.0  # a course against the heading at more than this is not that of a reversing car
SENSE_VARIANCE = 0.6  # [rad²] of a heading that tells forward from backward motion (44 degrees)
COURSE_OVER_SD = 3.0  # speed over its standard deviation from which the course is used


@dataclass(frozen=True)
class Course:
    """Heading of the vehicle at an instant."""

    time_ns: int
    yaw: float  # [rad]
    variance: float  # [rad²]


class GnssOnly:
    """Solutions of single fixes.

    Parameters
    ----------
    settings : Settings
        Lever arm, course speed, and the integrity risk of the protection levels.
    lost : ErrorStateFilter, optional
        Filter that ran until the inertial samples were missing: its heading and its model of GNSS errors are used.
    """

    def __init__(self, settings: Settings, lost: ErrorStateFilter | None = None) -> None:
        self._settings = settings
        self.course: Course | None = None
        self._errors = gnss_error_model(settings) if lost is None else lost.gnss_errors.at_start()
        if lost is not None:
            yaw = atan2(lost.ned_from_body[1, 0], lost.ned_from_body[0, 0])
            self.course = Course(lost.time_ns, yaw, float(lost.P[em.ATTITUDE, em.ATTITUDE][2, 2]))
        self._velocity: GnssVelocity | None = None
        self._before: GnssPosition | None = None  # newest position that was used
        self._before_velocity = np.zeros(3)
        self._way = np.zeros(3)  # [m, NED] integral of the velocity, from the first position on
        self._path = np.zeros(3)  # [m, NED] of positions from the first one on
        self._rejections = 0
        self._jump_n: FloatArray = np.zeros(3)
        self._jump_ns = NEVER_NS
        self._newest: Solution | None = None
        self.rejected = 0  # positions that contradict those before

    def use(self, measurement: Measurement) -> None:
        """Use a measurement if it is a position or a velocity."""
        measurement.tell(self)

    def take(self) -> Solution | None:
        """Solution of the position used last; None if it was taken before, or rejected."""
        newest, self._newest = self._newest, None
        return newest

    def use_speed(self, wheels: WheelSpeed) -> None:
        """A speed without inertial sensors adds nothing to that of GNSS."""

    def use_velocity(self, fix: GnssVelocity) -> None:
        """Use a velocity of the antenna, and its direction."""
        if self._velocity is not None and fix.time_ns <= self._velocity.time_ns:
            return
        self._velocity = fix
        self._follow(fix.time_ns, fix.velocity, float(max(fix.cov[0, 0], fix.cov[1, 1])))

    def use_position(self, fix: GnssPosition) -> None:
        """Use a position of the antenna, unless it contradicts those before."""
        before = self._before
        if before is not None and fix.time_ns <= before.time_ns:
            return
        velocity, velocity_cov = self._motion(fix)
        if before is not None and not self._agrees(before, fix, velocity, velocity_cov):
            self.rejected += 1
            return
        self._learn(fix, velocity, velocity_cov)
        self._before, self._before_velocity = fix, velocity
        self._newest = self._solution(fix, velocity, velocity_cov)

    def _motion(self, fix: GnssPosition) -> tuple[FloatArray, FloatArray]:
        """Velocity at a position: that of the receiver, or the way since the last one over the time."""
        newest = self._velocity
        if newest is not None and abs(fix.time_ns - newest.time_ns) <= VELOCITY_AGE_S * 1e9:
            cov = newest.cov if newest.axes == 3 else newest.cov + np.diag([0.0, 0.0, 1.0])
            return np.array(newest.velocity), cov
        before = self._before
        if before is None or fix.time_ns - before.time_ns > LONGEST_STEP_S * 1e9:
            unknown = self._settings.gnss.position_sd_ned_m
            return np.zeros(3), np.diag(np.square(unknown)) + np.eye(3) * 30.0**2
        step_s = (fix.time_ns - before.time_ns) * 1e-9
        way = np.array(ned_from_geodetic_difference(fix.position, before.position))
        way[2] = way[2] if fix.axes == before.axes == 3 else 0.0
        cov = (fix.cov + before.cov) / step_s**2 + np.eye(3) * (0.5 * ACCELERATION_SD * step_s) ** 2
        north, east, down = (way / step_s).tolist()
        self._follow(fix.time_ns, (north, east, down), float(max(cov[0, 0], cov[1, 1])))
        return way / step_s, cov

    def _agrees(self, before: GnssPosition, fix: GnssPosition, velocity: FloatArray, velocity_cov: FloatArray) -> bool:
        """Compare a position with the one before and the velocities of both; after some rejections it is taken."""
        step_s = (fix.time_ns - before.time_ns) * 1e-9
        if step_s > LONGEST_STEP_S:
            self._rejections = 0
            return True
        z = np.array(ned_from_geodetic_difference(fix.position, before.position))
        z -= 0.5 * step_s * (self._before_velocity + velocity)
        S = 2.0 * self._cov_of(fix) + velocity_cov * step_s**2 + np.eye(3) * (0.5 * ACCELERATION_SD * step_s**2) ** 2
        n = min(fix.axes, before.axes)
        if float(z[:n] @ np.linalg.solve(S[:n, :n], z[:n])) <= GATE:
            self._rejections = 0
            return True
        self._rejections += 1
        if self._rejections < REJECTIONS:
            return False
        self._rejections, self._jump_ns = 0, fix.time_ns
        self._jump_n = np.where(np.arange(3) < n, z, 0.0)
        return True

    def _learn(self, fix: GnssPosition, velocity: FloatArray, velocity_cov: FloatArray) -> None:
        """Learn how large errors are from positions against the integral of the receiver's velocities."""
        before = self._before
        if before is None:
            return
        step_s = (fix.time_ns - before.time_ns) * 1e-9
        self._way += 0.5 * step_s * (self._before_velocity + velocity)
        self._path += ned_from_geodetic_difference(fix.position, before.position)
        if fix.time_correlated and fix.axes == 3 and self._velocity is not None:
            sd = np.sqrt(fix.cov.diagonal())
            self._errors = self._errors.after(fix.time_ns, self._path - self._way, sd, velocity_cov.diagonal().copy())

    def _cov_of(self, fix: GnssPosition) -> FloatArray:
        """Covariance of a position [m²], as stated or larger where errors have been so."""
        scale = np.maximum(self._errors.scale, 1.0) if fix.time_correlated else np.ones(3)
        cov: FloatArray = fix.cov * np.outer(scale, scale)
        return cov if fix.axes == 3 else cov + np.diag([0.0, 0.0, UNKNOWN_HEIGHT_SD**2])

    def _follow(self, time_ns: int, velocity: Vector, variance: float) -> None:
        """Follow the heading by a velocity [m/s, NED] with its variance on the ground [m²/s²]."""
        speed, known = hypot(velocity[0], velocity[1]), self.course
        if known is not None:
            span_s = max(0.0, (time_ns - known.time_ns) * 1e-9)
            moved_m = speed * span_s if speed > STANDING_M_S else 0.0
            sd = known.variance**0.5 + moved_m / TURNING_RADIUS_M
            known = Course(time_ns, known.yaw, min(sd**2, UNKNOWN_HEADING_VARIANCE))
        self.course = known
        if speed < self._settings.alignment.course_speed_m_s or speed < COURSE_OVER_SD * variance**0.5:
            return
        yaw = atan2(velocity[1], velocity[0])
        if known is not None and known.variance < SENSE_VARIANCE and speed < FASTEST_REVERSE_M_S:
            is_reverse = abs(wrap_angle(yaw - known.yaw)) > 0.5 * pi
            yaw = wrap_angle(yaw + pi) if is_reverse else yaw
        found = variance / speed**2 + self._settings.alignment.course_yaw_sd_rad**2
        self.course = Course(time_ns, yaw, found)

    def _solution(self, fix: GnssPosition, velocity: FloatArray, velocity_cov: FloatArray) -> Solution:
        yaw = 0.0 if self.course is None else self.course.yaw
        yaw_variance = UNKNOWN_HEADING_VARIANCE if self.course is None else self.course.variance
        ahead, right, down = fix.lever_arm
        c, s = np.cos(yaw), np.sin(yaw)
        arm_n = (float(ahead * c - right * s), float(ahead * s + right * c), down)
        position = geodetic_from_ned_difference((-arm_n[0], -arm_n[1], -arm_n[2]), fix.position)
        cov = self._cov_of(fix) + np.diag(_arm_variances(ahead, right, yaw_variance))
        late = fix.time_sd_s * velocity
        cov += np.outer(late, late)
        if fix.time_ns - self._jump_ns <= JUMP_HELD_S * 1e9:
            cov += np.outer(self._jump_n, self._jump_n)
        attitude_cov = np.diag([TILT_SD**2, TILT_SD**2, yaw_variance])
        (nn, ne, _), (_, ee, _), (_, _, dd) = cov.tolist()
        risk = self._settings.integrity.risk
        north, east, climb = velocity.tolist()
        zero = (0.0, 0.0, 0.0)
        position_cov, velocity_triangle, attitude = (upper(one.tolist()) for one in (cov, velocity_cov, attitude_cov))
        return Solution(
            time_ns=fix.time_ns,
            phase=NavigationPhase.GNSS_ONLY,
            position=Geodetic(*position),
            velocity=(north, east, climb),
            roll=0.0,
            pitch=0.0,
            yaw=yaw,
            position_cov=cov,
            velocity_cov=velocity_cov,
            attitude_cov=attitude_cov,
            rate=zero,
            accelerometer_bias=zero,
            gyroscope_bias=zero,
            stationary=hypot(north, east) < STANDING_M_S,
            gnss_age_s=0.0,
            protection_level_horizontal=horizontal_level(nn, ne, ee, risk),
            protection_level_vertical=vertical_level(dd, risk),
            integrity_risk=risk,
            triangles=(position_cov, velocity_triangle, attitude),
            gyroscope_bias_sd=(self._settings.imu.gyroscope_bias_sd_rad_s,) * 3,
            gnss_excluded_since_ns=None,
        )


def _arm_variances(ahead: float, right: float, yaw_variance: float) -> tuple[float, float, float]:
    """Variances [m², NED] of the lever arm by an error of the heading, and by a tilt that is not known.

    The horizontal arm errs by at most its own length across, whatever the heading.
    """
    length = hypot(ahead, right)
    across = length**2 * min(yaw_variance, 2.0)
    return across, across, (length * TILT_SD) ** 2
