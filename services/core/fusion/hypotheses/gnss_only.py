"""Position without inertial sensors and without a filter: the newest fix, with what successive fixes tell of its error.

A fix is published at its own stamp. Its covariance is the stated one times the learned scale of position errors, never
below what is stated: without inertial sensors an error that lasts for minutes cannot be observed. The heading is the
course over ground while the vehicle moves, and afterwards that course, which becomes worse with the distance driven.
"""

from math import hypot

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import NavigationPhase

from ..aids.base import Measurement
from ..aids.gnss.correlated import position_errors_at_start, position_errors_of
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer.aid import WheelSpeed
from ..inertial.filter import ErrorStateFilter
from ..integrity.protection_levels import horizontal_level, vertical_level
from ..settings import Settings
from ..solution import Solution, upper
from ..start.course import STANDING_M_S, UNKNOWN_HEADING_VARIANCE, CourseFollower, course_of

FloatArray = npt.NDArray[np.float64]

VELOCITY_AGE_S = 0.5  # largest age of a velocity that belongs to a position
MAX_STEP_S = 10.0  # between two positions that are compared
ACCELERATION_SD = 2.0  # [m/s²] of a car between two fixes, as in a gap of the inertial samples
GATE = chi_square_limit(3, 1e-6)
REJECTIONS = 3  # positions in a row, after which the new place is taken and the old one is held in the covariance
JUMP_HELD_S = 60.0  # a reflection or another constellation in use lasts for about a minute
NO_TIME_NS = -(2**62)
TILT_SD = 0.1  # [rad] roll and pitch of a car on a road: grades and banks of 10 %
UNKNOWN_HEIGHT_SD = 100.0  # [m] of a position without a height


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
        self._heading = CourseFollower(settings)
        self._errors = position_errors_at_start(settings) if lost is None else position_errors_of(lost).at_start()
        if lost is not None:
            self._heading.course = course_of(lost)
        self._velocity: GnssVelocity | None = None
        self._before: GnssPosition | None = None  # newest position that was used
        self._before_velocity = np.zeros(3)
        self._way = np.zeros(3)  # [m, NED] integral of the velocity, from the first position on
        self._path = np.zeros(3)  # [m, NED] of positions from the first one on
        self._rejections = 0
        self._jump_n: FloatArray = np.zeros(3)
        self._jump_ns = NO_TIME_NS
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
        self._heading.use_velocity(fix)

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
        if before is None or fix.time_ns - before.time_ns > MAX_STEP_S * 1e9:
            unknown = self._settings.gnss.position_sd_ned_m
            return np.zeros(3), np.diag(np.square(unknown)) + np.eye(3) * 30.0**2
        step_s = (fix.time_ns - before.time_ns) * 1e-9
        way = np.array(ned_from_geodetic_difference(fix.position, before.position))
        way[2] = way[2] if fix.axes == before.axes == 3 else 0.0
        cov = (fix.cov + before.cov) / step_s**2 + np.eye(3) * (0.5 * ACCELERATION_SD * step_s) ** 2
        north, east, down = (way / step_s).tolist()
        self._heading.follow(fix.time_ns, (north, east, down), float(max(cov[0, 0], cov[1, 1])))
        return way / step_s, cov

    def _agrees(self, before: GnssPosition, fix: GnssPosition, velocity: FloatArray, velocity_cov: FloatArray) -> bool:
        """Compare a position with the one before and the velocities of both; after some rejections it is taken."""
        step_s = (fix.time_ns - before.time_ns) * 1e-9
        if step_s > MAX_STEP_S:
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

    def _solution(self, fix: GnssPosition, velocity: FloatArray, velocity_cov: FloatArray) -> Solution:
        course = self._heading.course
        yaw = 0.0 if course is None else course.yaw
        yaw_variance = UNKNOWN_HEADING_VARIANCE if course is None else course.variance
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
        position_cov, velocity_triangle, attitude = (
            upper(vector.tolist()) for vector in (cov, velocity_cov, attitude_cov)
        )
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
