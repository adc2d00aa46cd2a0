"""Heading from the course over ground alone, while no inertial sample measures how the vehicle turns."""

from math import atan2, hypot, pi
from typing import NamedTuple

from shared.maths.earth import wrap_angle
from shared.maths.rotation import Vector

from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer.aid import WheelSpeed
from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..settings import Settings

UNKNOWN_HEADING_VARIANCE = pi**2 / 3.0  # [rad²] of a uniform distribution over the circle
TURNING_RADIUS_M = 5.0  # of a car: a metre driven unobserved turns it by at most 0.2 rad
STEADY_SPEED_S = 2.0  # within which a car's speed changes evenly; over longer times the larger of both is taken
STANDING_M_S = 0.3  # speed below which the vehicle stands, three times the noise of a receiver's velocity
FASTEST_REVERSE_M_S = 8.0  # a course against the heading at more than this is not that of a reversing car
SENSE_VARIANCE = 0.6  # [rad²] of a heading that tells forward from backward motion (44 degrees)
COURSE_OVER_SD = 3.0  # speed over its standard deviation from which the course is used


class Course(NamedTuple):
    """Heading of the vehicle at an instant, and its speed since."""

    time_ns: int
    yaw: float  # [rad]
    variance: float  # [rad²]
    speed: float  # [m/s]

    def after(self, time_ns: int, speed: float) -> "Course":
        """Heading at a later time, at which the vehicle has a speed [m/s]: worse by the way driven meanwhile."""
        span_s = max(0.0, (time_ns - self.time_ns) * 1e-9)
        fastest = max(speed, self.speed)
        mean = 0.5 * (speed + self.speed) if span_s <= STEADY_SPEED_S else fastest
        moved_m = mean * span_s if fastest > STANDING_M_S else 0.0
        sd = self.variance**0.5 + moved_m / TURNING_RADIUS_M
        return Course(time_ns, self.yaw, min(sd**2, UNKNOWN_HEADING_VARIANCE), speed)


def course_of(navigation: ErrorStateFilter) -> Course:
    """Heading of a filter, its variance and its speed."""
    C = navigation.ned_from_body
    variance = float(navigation.P[em.ATTITUDE, em.ATTITUDE][2, 2])
    return Course(navigation.time_ns, atan2(C[1, 0], C[0, 0]), variance, hypot(*navigation.velocity[:2]))


class CourseFollower:
    """Follows the course over ground of velocities.

    Parameters
    ----------
    settings : Settings
        Lowest speed of a course, and its standard deviation against the heading.
    known : Course, optional
        Heading before.
    """

    def __init__(self, settings: Settings, known: Course | None = None) -> None:
        self._settings = settings
        self.course = known
        self.velocity: Vector = (0.0, 0.0, 0.0)  # [m/s, NED] newest

    def use_position(self, fix: GnssPosition) -> None:
        """A position has no course."""

    def use_speed(self, wheels: WheelSpeed) -> None:
        """A speed has no course."""

    def use_velocity(self, fix: GnssVelocity) -> None:
        """Use a velocity of the antenna."""
        self.follow(fix.time_ns, fix.velocity, float(max(fix.cov[0, 0], fix.cov[1, 1])))

    def follow(self, time_ns: int, velocity: Vector, variance: float) -> None:
        """Use a velocity [m/s, NED] with its variance on the ground [m²/s²]."""
        speed = hypot(velocity[0], velocity[1])
        self.velocity = velocity
        known = self.course and self.course.after(time_ns, speed)
        self.course = known
        if speed < self._settings.alignment.course_speed_m_s or speed < COURSE_OVER_SD * variance**0.5:
            return
        yaw = atan2(velocity[1], velocity[0])
        if known is not None and known.variance < SENSE_VARIANCE and speed < FASTEST_REVERSE_M_S:
            is_reverse = abs(wrap_angle(yaw - known.yaw)) > 0.5 * pi
            yaw = wrap_angle(yaw + pi) if is_reverse else yaw
        found = variance / speed**2 + self._settings.alignment.course_yaw_sd_rad**2
        self.course = Course(time_ns, yaw, found, speed)
