"""Methods of initial heading: the rotation about the vertical from the level frame of `levelling` to NED."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, sin, sqrt
from typing import NamedTuple

from shared.maths.earth import Geodetic, ned_from_geodetic_difference, wrap_angle
from shared.maths.rotation import Vector

from ..aids.gnss.comparison import MEMORY_S, Comparison
from ..aids.gnss.fix import GnssPosition
from ..codes import HeadingMethod
from ..inertial.standstill import STANDSTILL_RATE_SD
from ..settings import Settings
from .levelling import Levelling

MATCH_S = 20.0  # longest time since a standstill after which the velocity gained is matched with that of GNSS
MATCH_ACCELERATION_SD = 0.05  # [m/s²] drift of that velocity, by tilt
SAVED_YAW_SD_FLOOR = radians(0.5)
SAVED_YAW_SD_LIMIT = radians(30.0)  # largest standard deviation of a saved heading that is used
MAX_PARKING_OFFSET_M = 20.0  # distance of the first fix from the saved position above which the vehicle was moved
MAX_SPEED_M_S = 60.0
ACCELERATIONS_SD = radians(2.0)  # smallest standard deviation of matched accelerations: tilt changes on the move
ACCELERATIONS_LIMIT = radians(10.0)  # largest standard deviation with which they start a filter
SENSE_LIMIT = radians(25.0)  # largest standard deviation with which they tell forward from backward motion


@dataclass(frozen=True)
class Prior:
    """Position and heading saved before the unit was switched off."""

    position: Geodetic
    position_sd: Vector
    yaw: float
    yaw_sd: float
    parked: bool = False  # saved at standstill
    level_m: float | None = None  # horizontal protection level of it


def better_prior(known: Prior | None, prior: Prior) -> Prior:
    """The first of two, unless only the second is of a parked vehicle.

    A broker that keeps its messages passes the position on before it is known to be of an earlier boot.
    """
    return prior if known is None or (prior.parked and not known.parked) else known


def parked_heading(saved: Prior, levelling: Levelling) -> "Heading | None":
    """Saved heading of a vehicle that was parked and has not moved since; None of another one."""
    if not saved.parked or not levelling.has_stood or levelling.yaw_at_start is None:
        return None
    if saved.yaw_sd > SAVED_YAW_SD_LIMIT:
        return None
    sd = max(saved.yaw_sd, SAVED_YAW_SD_FLOOR) + drift_sd(levelling)
    return Heading(wrap_angle(saved.yaw - levelling.yaw_at_start), sd, HeadingMethod.SAVED_POSITION)


class Heading(NamedTuple):
    """Turn [rad] about the vertical from the level frame to NED, its standard deviation, and the method."""

    turn: float
    sd: float
    method: HeadingMethod


class Motion(NamedTuple):
    """Velocity of the antenna [m/s, NED], its standard deviations, and its part w x l by the lever arm l."""

    time_ns: int
    velocity: Vector
    sd: Vector
    lever_arm_velocity: Vector  # [m/s, level frame]


def drift_sd(levelling: Levelling) -> float:
    """Standard deviation of the level frame's azimuth [rad], from the rate integrated since the last standstill."""
    return STANDSTILL_RATE_SD * levelling.moving_s


def saved_heading(saved: Prior, levelling: Levelling, fix: GnssPosition) -> Heading | None:
    """Saved heading, if the vehicle was at standstill at the start and the first fix is at the saved position."""
    if levelling.yaw_at_start is None or saved.yaw_sd > SAVED_YAW_SD_LIMIT:
        return None
    distance = hypot(*ned_from_geodetic_difference(fix.position, saved.position)[:2])
    variance = float(fix.cov[0, 0] + fix.cov[1, 1]) + saved.position_sd[0] ** 2 + saved.position_sd[1] ** 2
    if distance > MAX_PARKING_OFFSET_M + 3.0 * sqrt(variance) + MAX_SPEED_M_S * levelling.moving_s:
        return None
    sd = max(saved.yaw_sd, SAVED_YAW_SD_FLOOR) + drift_sd(levelling)
    return Heading(wrap_angle(saved.yaw - levelling.yaw_at_start), sd, HeadingMethod.SAVED)


def heading_of_motion(motion: Motion, levelling: Levelling, settings: Settings) -> Heading | None:
    """Match the velocity gained since a standstill with that of GNSS, or take the course as the heading.

    The first tells forward from backward motion and does not depend on the mounting; the second assumes forward motion
    along the IMU's x axis. None below `alignment.course_speed_m_s`.
    """
    north, east, _ = motion.velocity
    speed, course = hypot(north, east), atan2(east, north)
    if speed < settings.alignment.course_speed_m_s:
        return None
    noise = max(motion.sd[0], motion.sd[1]) / speed
    (x, y), (arm_x, arm_y, _) = levelling.velocity, motion.lever_arm_velocity
    gained_x, gained_y = x + arm_x, y + arm_y
    fresh = levelling.standstill_quaternion is not None and levelling.moving_s < MATCH_S
    if fresh and hypot(gained_x, gained_y) > 0.5 * speed:
        sd = hypot(noise, MATCH_ACCELERATION_SD * levelling.moving_s / speed)
        return Heading(wrap_angle(course - atan2(gained_y, gained_x)), sd, HeadingMethod.VELOCITY)
    yaw = levelling.yaw
    sideways = arm_y * cos(yaw) - arm_x * sin(yaw)
    turn = wrap_angle(course - atan2(sideways, speed) - yaw)
    return Heading(turn, hypot(noise, settings.alignment.course_yaw_sd_rad), HeadingMethod.COURSE)


def heading_of_accelerations(comparison: Comparison, levelling: Levelling) -> Heading | None:
    """Match the accelerations of the last half minute: needs manoeuvres, but neither standstill nor known mounting.

    An unmeasured gyroscope bias turns the level frame meanwhile, on average by half of the total.
    """
    turn, sd = comparison.precise()
    if sd >= ACCELERATIONS_LIMIT:
        return None
    sd = hypot(max(sd, ACCELERATIONS_SD), 0.5 * levelling.yaw_drift_sd(MEMORY_S))
    return Heading(turn, sd, HeadingMethod.ACCELERATIONS)


def forwards_or_backwards(course: Heading, comparison: Comparison) -> Heading:
    """Turn a course by 180 degrees if matched accelerations show that the vehicle reverses."""
    turn, sd = comparison.result()
    if (
        course.method is not HeadingMethod.COURSE
        or sd > SENSE_LIMIT
        or abs(wrap_angle(turn - course.turn)) < pi - 3.0 * SENSE_LIMIT
    ):
        return course
    return Heading(wrap_angle(course.turn + pi), course.sd, HeadingMethod.COURSE_BACKWARDS)
