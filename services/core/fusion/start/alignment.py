"""Initial alignment: levelling, heading and position from inertial samples and the first fixes, and the filter."""

from copy import copy
from math import cos, hypot, radians, sin

import numpy as np
import numpy.typing as npt

from shared.copies import shallow
from shared.inertial.strapdown import InertialState, rotate
from shared.maths.earth import STANDARD_GRAVITY, earth_rate_n, geodetic_from_ned_difference
from shared.maths.rotation import Quaternion, Vector, matrix_from_quaternion, quaternion_product
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import NavigationPhase

from ..aids.dual_antenna.aid import BaselineHeading
from ..aids.gnss.comparison import STANDSTILL_OFFSET_SD, Comparison
from ..aids.gnss.correlated import GNSS_ERROR, POSITION, position_errors_at_start, position_errors_of
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..codes import Code, HeadingMethod
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..inertial.propagation import ImuErrors
from ..inertial.standstill import STANDSTILL_RATE_SD
from ..settings import Settings
from ..states import LAYOUT
from .heading import (
    Heading,
    Motion,
    Prior,
    better_prior,
    drift_sd,
    forwards_or_backwards,
    heading_of_accelerations,
    heading_of_motion,
    parked_heading,
    saved_heading,
)
from .initial_position import FirstPlace, first_place
from .levelling import MOVING_M_S, Levelling, standstill_gyroscope_bias
from .track_matching import Point, moved_m_s, track

FloatArray = npt.NDArray[np.float64]

VERTICAL_BIAS_SD_LIMIT = radians(1.0)  # [rad/s] of the prior of a start on the move: with more, heading takes longer
TRACK_S = 5.0  # longest span of the positions that give a course
MOTION_AGE_S = 0.5  # largest age of a velocity that is used with a fix
STANDSTILL_VELOCITY_SD = 0.05  # [m/s]
ARM_RATE_SD = 0.05  # [rad/s] error of the rate that makes the lever-arm velocity
KEPT_SD_LIMIT = radians(30.0)  # largest standard deviation of a heading from before with which a filter starts
BASELINE_AGE_S = 2.0  # largest age of a two-antenna heading that is used with a fix


class Alignment:
    """Initial alignment: collects measurements until a filter can be started.

    Parameters
    ----------
    settings : Settings
        Settings of the filter to be started.
    lost : ErrorStateFilter, optional
        Filter before a reset; its biases and parameters are reused.
    kept : Heading, optional
        Correction of its heading, with the standard deviation; without it the attitude is not reused. If the correction
        is not zero, biases and parameters are not reused.
    tilt_variance : float
        [rad²] Of an attitude that is reused.
    first : bool
        Whether no filter ran before; `gnss.zero_error_at_start` holds for the first fix only.
    """

    def __init__(
        self,
        settings: Settings,
        lost: ErrorStateFilter | None = None,
        kept: Heading | None = None,
        *,
        tilt_variance: float = 1.0,
        first: bool = True,
    ) -> None:
        self.method: HeadingMethod | None = None  # of the heading that started the filter
        self.first_fix: GnssPosition | None = None
        self._settings = settings
        self._lost = None if kept and kept.turn else lost
        self._saved: Prior | None = None
        self._kept = kept
        self.levelling = (
            Levelling(settings, lost.inertial.quaternion, lost.imu.gyroscope_bias, tilt_variance)
            if lost and kept
            else Levelling(settings)
        )
        self.comparison = Comparison()
        self._from_zero = first and settings.gnss.zero_error_at_start
        self._zero_ns: int | None = None  # stamp of the fix without time-correlated error
        self._has_velocity = False
        self._motion: Motion | None = None
        self._course: Heading | None = None
        self._baseline: tuple[int, Heading] | None = None  # stamp and heading of two antennas
        self._track: tuple[Point, ...] = ()  # newest last
        self._standstill_fixes: tuple[GnssPosition, ...] = ()

    def copy(self) -> "Alignment":
        """Independent copy."""
        made = copy(self)
        made.levelling = copy(self.levelling)
        return made

    def carried(self, time_ns: int) -> ErrorStateFilter | None:
        """Filter that was lost, with its attitude at a time; None if none is kept."""
        if self._lost is None or self._kept is None:
            return None
        carried, drift = shallow(self._lost), drift_sd(self.levelling)
        quaternion = self.levelling.quaternion
        carried.inertial = self._lost.inertial._replace(time_ns=time_ns, quaternion=quaternion)
        carried.P = self._lost.P.copy()
        carried.P[em.ATTITUDE.stop - 1, em.ATTITUDE.stop - 1] = (self._kept.sd + drift) ** 2
        return carried

    def use_prior(self, prior: Prior) -> None:
        """Use a position and heading saved before the unit was switched off; the first, or that of a parked vehicle."""
        self._saved = better_prior(self._saved, prior)

    @property
    def phase(self) -> NavigationPhase:
        """Phase of the alignment."""
        if not self.levelling.ready:
            return NavigationPhase.LEVELLING
        return NavigationPhase.WAITING_FOR_GNSS if self.first_fix is None else NavigationPhase.WAITING_FOR_HEADING

    @property
    def why(self) -> Explanation:
        """Why it is in its phase."""
        match self.phase:
            case NavigationPhase.LEVELLING:
                return explain(Code.LEVELLING, levelling_s=self._settings.alignment.levelling_s)
            case NavigationPhase.WAITING_FOR_GNSS:
                return explain(Code.NO_POSITION_YET)
            case _:
                return explain(Code.NO_HEADING_YET, speed_m_s=self._settings.alignment.course_speed_m_s)

    def use_velocity(self, measurement: GnssVelocity) -> None:
        """Use a velocity for the heading and the initial velocity."""
        self._has_velocity = True
        self.levelling.use_speed(hypot(measurement.velocity[0], measurement.velocity[1]))
        north, east, down = np.sqrt(measurement.cov.diagonal()).tolist()
        sd = (north, east, down if measurement.axes == 3 else 1.0)
        arm_velocity = self._lever_arm_velocity(measurement.lever_arm)
        self._compare(measurement, arm_velocity)
        self._set_motion(Motion(measurement.time_ns, measurement.velocity, sd, arm_velocity))

    def use_heading(self, measurement: BaselineHeading, sd: float) -> None:
        """Use the heading of two antennas with its standard deviation [rad]."""
        turn = measurement.turn_from(self.levelling.quaternion)
        self._baseline = measurement.time_ns, Heading(turn, sd, HeadingMethod.TWO_ANTENNAS)

    def start_at(self, fix: GnssPosition) -> ErrorStateFilter | None:
        """Use a position; returns the filter if attitude and velocity are known, otherwise None."""
        if self._from_zero and self.first_fix is None:
            self._zero_ns = fix.time_ns
        self.first_fix = self.first_fix or fix
        self._add_to_track(fix)
        self._compare(fix, self._lever_arm_velocity(fix.lever_arm))
        self._standstill_fixes = (*self._standstill_fixes[-99:], fix) if self.levelling.is_stationary else ()
        if self._motion is None or abs(fix.time_ns - self._motion.time_ns) > MOTION_AGE_S * 1e9:
            self._set_motion_from_track(fix)
        if self._motion is None or not self.levelling.ready:
            return None
        heading = self._heading(fix)
        return self._start(fix, self._motion, heading) if heading else None

    def start_parked(self, time_ns: int) -> ErrorStateFilter | None:
        """Start at the saved position, if the vehicle was parked there and has not moved since; otherwise None."""
        saved, level = self._saved, self.levelling
        if saved is None or self.first_fix is not None or not level.ready:
            return None
        heading = parked_heading(saved, level)
        if heading is None:
            return None
        arm, half = self._settings.vehicle.gnss.lever_arm_body_m, 0.5 * heading.turn
        attitude = quaternion_product((cos(half), 0.0, 0.0, sin(half)), level.quaternion)
        place = GnssPosition(
            time_ns=time_ns, received_ns=time_ns, source="navigation/last_position",
            position=geodetic_from_ned_difference(rotate(attitude, arm), saved.position),
            cov=np.diag(np.square(saved.position_sd)), axes=3, lever_arm=arm, time_sd_s=0.0,
        )  # fmt: skip
        still = Motion(time_ns, (0.0, 0.0, 0.0), (STANDSTILL_VELOCITY_SD,) * 3, (0.0, 0.0, 0.0))
        return self._start(place, still, heading)

    def _heading(self, fix: GnssPosition) -> Heading | None:
        """Most accurate of all known headings, without those that the motion contradicts."""
        drift = drift_sd(self.levelling)
        kept = self._kept and self._kept._replace(sd=self._kept.sd + drift)
        saved = saved_heading(self._saved, self.levelling, fix) if self._saved else None
        kept = kept if kept and kept.sd < KEPT_SD_LIMIT else None
        known = [heading for heading in (kept, saved) if heading and not self.comparison.contradicts(heading.turn)]
        course = self._course and forwards_or_backwards(self._course, self.comparison)
        matched = heading_of_accelerations(self.comparison, self.levelling)
        found = (heading for heading in (*known, course, matched, self._two_antennas(fix)) if heading)
        return min(found, key=lambda heading: heading.sd, default=None)

    def _compare(self, measurement: GnssPosition | GnssVelocity, arm_velocity: Vector) -> None:
        """Compare GNSS with the velocity of the antenna by inertial sensors alone."""
        if self.levelling.standstill_quaternion is not None and self.comparison.offset_sd != STANDSTILL_OFFSET_SD:
            self.comparison = Comparison(offset_sd=STANDSTILL_OFFSET_SD)
        (north, east), (x, y) = self.levelling.velocity, self.levelling.velocity_before
        antenna = complex(north + x + arm_velocity[0], east + y + arm_velocity[1])
        self.comparison = self.comparison.after(measurement, antenna)

    def _two_antennas(self, fix: GnssPosition) -> Heading | None:
        recent = self._baseline is not None and abs(fix.time_ns - self._baseline[0]) <= BASELINE_AGE_S * 1e9
        return self._baseline[1] if self._baseline and recent else None

    def _add_to_track(self, fix: GnssPosition) -> None:
        """Add a position to the track; without GNSS velocities, levelling uses the speed of the track."""
        level, now_ns = self.levelling, fix.time_ns
        x, y, _ = rotate(level.quaternion, fix.lever_arm)
        recent = (point for point in self._track if now_ns - TRACK_S * 1e9 <= point.fix.time_ns < now_ns)
        self._track = (*tuple(recent)[-99:], Point(fix, level.heading_integral, level.displacement, complex(x, y)))
        if self._has_velocity:
            return
        level.use_speed(moved_m_s(self._track))
        recent_points = [point for point in self._track if now_ns - point.fix.time_ns <= level.standstill_s * 1e9]
        if level.is_stationary and moved_m_s(recent_points) > MOVING_M_S:
            level.discard_standstill()
            self.comparison = Comparison()

    def _set_motion(self, motion: Motion) -> None:
        self._motion, self._course = motion, heading_of_motion(motion, self.levelling, self._settings)

    def _lever_arm_velocity(self, arm: Vector) -> Vector:
        """Velocity of the antenna relative to the IMU [m/s, level frame]: C (w x l)."""
        x, y, z = np.cross(self.levelling.rate, arm).tolist()
        return rotate(self.levelling.quaternion, (x, y, z))

    def _set_motion_from_track(self, fix: GnssPosition) -> None:
        """Velocity without GNSS velocities: zero at standstill, otherwise from the track."""
        if self.levelling.is_stationary:
            self._set_motion(Motion(fix.time_ns, (0.0, 0.0, 0.0), (STANDSTILL_VELOCITY_SD,) * 3, (0.0, 0.0, 0.0)))
        else:
            self._motion, self._course = track(self._track, self.levelling, self._settings) or (None, None)

    def _start(self, fix: GnssPosition, motion: Motion, heading: Heading) -> ErrorStateFilter:
        """Filter at the instant of the fix."""
        self.method, self.comparison = heading.method, self.comparison.turned(heading.turn).interrupted()
        settings, arm = self._settings, fix.lever_arm
        north_from_level: Quaternion = (cos(0.5 * heading.turn), 0.0, 0.0, sin(0.5 * heading.turn))
        quaternion = quaternion_product(north_from_level, self.levelling.quaternion)
        arm_n = rotate(quaternion, arm)
        first = self._first_place(fix)
        (north, east, down), (x, y, z) = motion.velocity, rotate(north_from_level, motion.lever_arm_velocity)
        velocity = north - x, east - y, down - z
        position = geodetic_from_ned_difference((-arm_n[0], -arm_n[1], -arm_n[2]), first.position)
        bias, bias_cov = self._accelerometer_bias()
        drift, drift_cov = self._gyroscope_bias(north_from_level, position.latitude)
        tilt2 = self.levelling.tilt_sd**2 + float(bias_cov[0, 0]) / STANDARD_GRAVITY**2

        size = LAYOUT.size_by(settings)
        P = np.zeros((size, size))
        P[em.ATTITUDE, em.ATTITUDE] = np.diag([tilt2, tilt2, heading.sd**2])
        P[em.VELOCITY, em.VELOCITY] = np.diag(np.square(motion.sd)) + (ARM_RATE_SD * hypot(*arm)) ** 2 * np.eye(3)
        P[em.ACCELEROMETER_BIAS, em.ACCELEROMETER_BIAS] = bias_cov
        P[em.GYROSCOPE_BIAS, em.GYROSCOPE_BIAS] = drift_cov
        if self._lost is None:
            tilt = _tilt_by_bias_error(matrix_from_quaternion(quaternion))
            P[em.ATTITUDE, em.ACCELEROMETER_BIAS] = tilt @ bias_cov
            P[em.ACCELEROMETER_BIAS, em.ATTITUDE] = P[em.ATTITUDE, em.ACCELEROMETER_BIAS].T
        if self._lost is None and self.levelling.standstill_quaternion is None:
            level = np.diag([1.0, 1.0, 0.0]) @ matrix_from_quaternion(quaternion)
            P[em.ATTITUDE, em.GYROSCOPE_BIAS] = self.levelling.covariance.cross * level
            P[em.GYROSCOPE_BIAS, em.ATTITUDE] = P[em.ATTITUDE, em.GYROSCOPE_BIAS].T
        P[em.SCALES, em.SCALES] = self._scales_cov()
        P[em.PARAMETERS, em.PARAMETERS] = self._parameters_cov()
        P[em.POSITION, em.POSITION] = first.cov
        P[GNSS_ERROR, :] = P[:, GNSS_ERROR] = 0.0
        P[GNSS_ERROR, GNSS_ERROR] = first.error_cov
        P[em.POSITION, GNSS_ERROR] = first.cross_cov
        P[GNSS_ERROR, em.POSITION] = first.cross_cov.T
        inertial = InertialState(fix.time_ns, quaternion, velocity, position)
        known = self._lost.parameters if self._lost else (0.0,) * (size - em.DRIVING)
        begin, end = GNSS_ERROR.start - em.DRIVING, GNSS_ERROR.stop - em.DRIVING
        parameters = (*known[:begin], *first.error, *known[end:])
        imu = (self._lost.imu if self._lost else ImuErrors())._replace(accelerometer_bias=bias, gyroscope_bias=drift)
        errors = {**(self._lost.errors if self._lost else {}), POSITION: first.gnss_errors}
        made = ErrorStateFilter(settings, inertial, P, imu, parameters, errors)
        if self._lost is None:
            for block in LAYOUT.blocks_by(settings):
                if stated := block.known(settings, position):
                    for place in range(size)[LAYOUT.place(block.name)]:
                        made.set_parameter(place, *stated)
        return made

    def _first_place(self, fix: GnssPosition) -> FirstPlace:
        """Weighted mean of the fixes at standstill, or the newest fix on the move."""
        fixes = [
            standstill_fix
            for standstill_fix in self._standstill_fixes
            if (standstill_fix.axes, standstill_fix.time_correlated) == (fix.axes, fix.time_correlated)
        ]
        known = self._lost and position_errors_of(self._lost).at_start()
        gnss_errors = known or position_errors_at_start(self._settings)
        return first_place(fixes or [fix], gnss_errors, self._zero_ns)

    def _scales_cov(self) -> FloatArray:
        if self._lost is not None:
            return self._lost.P[em.SCALES, em.SCALES]
        sd = self._settings.imu.accelerometer_scale_sd, self._settings.imu.gyroscope_scale_sd
        return np.diag(np.repeat(np.square(sd), 3))

    def _parameters_cov(self) -> FloatArray:
        if self._lost is not None:
            return self._lost.P[em.PARAMETERS, em.PARAMETERS]
        sd = np.concatenate(
            [np.full(block.size, block.sd(self._settings)) for block in LAYOUT.blocks_by(self._settings)]
        )
        return np.diag(np.square(sd[em.PARAMETERS]))

    def _accelerometer_bias(self) -> tuple[Vector, FloatArray]:
        if self._lost is not None:
            return self._lost.imu.accelerometer_bias, self._lost.P[em.ACCELEROMETER_BIAS, em.ACCELEROMETER_BIAS]
        return (0.0, 0.0, 0.0), np.eye(3) * self._settings.imu.accelerometer_bias_sd_m_s2**2

    def _gyroscope_bias(self, north_from_level: Quaternion, latitude: float) -> tuple[Vector, FloatArray]:
        attitude = self.levelling.standstill_quaternion
        if attitude is not None:
            C = matrix_from_quaternion(quaternion_product(north_from_level, attitude))
            bias = standstill_gyroscope_bias(self.levelling.rate_bias, C, earth_rate_n(latitude))
            return bias, np.eye(3) * STANDSTILL_RATE_SD**2
        if self._lost is not None:
            return self._lost.imu.gyroscope_bias, self._lost.P[em.GYROSCOPE_BIAS, em.GYROSCOPE_BIAS]
        horizontal = self.levelling.covariance.bias
        C = matrix_from_quaternion(self.levelling.quaternion)
        vertical = min(self._settings.imu.gyroscope_bias_sd_rad_s, VERTICAL_BIAS_SD_LIMIT)
        cov = np.diag([horizontal, horizontal, vertical**2])
        return self.levelling.rate_bias, C.T @ cov @ C


def _tilt_by_bias_error(ned_from_body: FloatArray) -> FloatArray:
    """Matrix A [rad per m/s²] of psi = A db_a for an attitude from levelling, in which C f is vertical."""
    cross = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # e_N e_E^T - e_E e_N^T
    tilt: FloatArray = cross @ ned_from_body / STANDARD_GRAVITY
    return tilt
