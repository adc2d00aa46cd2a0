"""Methods of finding the heading of the level frame of `levelling`, before the filter runs."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, sin, sqrt
from typing import NamedTuple

from shared.maths.earth import Geodetic, ned_from_geodetic_difference, wrap_angle
from shared.maths.rotation import Vector

from ..measurements.gnss import GnssPosition
from ..settings import Settings
from .levelling import Levelling
from .velocity_matching import MEMORY_S, Comparison

MATCH_S = 20.0  # how long the velocity gained since a rest is good enough to be matched with that of GNSS
MATCH_ACCELERATION_SD = 0.05  # [m/s²] by which it drifts: tilt
REST_RATE_SD = 2e-4  # [rad/s] of the mean rate over a rest of a few seconds
SAVED_YAW_SD_FLOOR = radians(0.5)
SAVED_YAW_SD_LIMIT = radians(30.0)  # beyond it nothing was known
MOVED_M = 20.0  # distance of the first fix from the saved position above which the vehicle was moved
FASTEST_M_S = 60.0
ACCELERATIONS_SD = radians(2.0)  # tilt changes while nobody levels
ACCELERATIONS_LIMIT = radians(10.0)
SENSE_LIMIT = radians(25.0)  # to distinguish forward from backward motion
COURSE = "course over ground"


@dataclass(frozen=True)
class Prior:
    """Position and heading that were saved before the power went."""

    position: Geodetic
    position_sd: Vector
    yaw: float
    yaw_sd: float


class Heading(NamedTuple):
    """Turn [rad] from the level frame to NED, its standard deviation, and how it was found."""

    turn: float
    sd: float
    how: str


class Motion(NamedTuple):
    """Velocity of the antenna [m/s, NED], its standard deviations, and what of it is swing of the lever arm."""

    time_ns: int
    velocity: Vector
    sd: Vector
    swing: Vector  # [m/s, level frame]


def drift_sd(levelling: Levelling) -> float:
    """How far the level frame may have turned since the last rest [rad]."""
    return REST_RATE_SD * levelling.moving_s


def saved_heading(saved: Prior, levelling: Levelling, fix: GnssPosition) -> Heading | None:
    """Use the saved heading if the vehicle stood still at first and the first fix is at the saved position."""
    if levelling.yaw_at_start is None or saved.yaw_sd > SAVED_YAW_SD_LIMIT:
        return None
    away = hypot(*ned_from_geodetic_difference(fix.position, saved.position)[:2])
    blur = 3.0 * sqrt(float(fix.cov[0, 0] + fix.cov[1, 1]) + saved.position_sd[0] ** 2 + saved.position_sd[1] ** 2)
    if away > MOVED_M + blur + FASTEST_M_S * levelling.moving_s:
        return None
    sd = max(saved.yaw_sd, SAVED_YAW_SD_FLOOR) + drift_sd(levelling)
    return Heading(wrap_angle(saved.yaw - levelling.yaw_at_start), sd, "saved heading")


def heading_of_motion(motion: Motion, levelling: Levelling, settings: Settings) -> Heading | None:
    """Match the velocity gained since a rest, or else assume that the vehicle moves along its longitudinal axis.

    Only the first distinguishes forward from backward, and it needs no alignment of the
    mount. Neither works at walking pace.
    """
    north, east, _ = motion.velocity
    speed, course = hypot(north, east), atan2(east, north)
    if speed < settings.alignment.course_speed_m_s:
        return None
    noise = max(motion.sd[0], motion.sd[1]) / speed
    gained_x, gained_y = levelling.velocity[0] + motion.swing[0], levelling.velocity[1] + motion.swing[1]
    fresh = levelling.quaternion_at_rest is not None and levelling.moving_s < MATCH_S
    if fresh and hypot(gained_x, gained_y) > 0.5 * speed:
        sd = hypot(noise, MATCH_ACCELERATION_SD * levelling.moving_s / speed)
        return Heading(wrap_angle(course - atan2(gained_y, gained_x)), sd, "matched velocity")
    yaw = levelling.yaw
    sideways = motion.swing[1] * cos(yaw) - motion.swing[0] * sin(yaw)
    turn = wrap_angle(course - atan2(sideways, speed) - yaw)
    return Heading(turn, hypot(noise, settings.alignment.course_yaw_sd_rad), COURSE)


def heading_of_accelerations(comparison: Comparison, levelling: Levelling) -> Heading | None:
    """Match the accelerations of the last half minute; it needs neither rest nor straight mount, but manoeuvres.

    A gyroscope bias that no rest has measured turns the level frame meanwhile, on average by half of the whole.
    """
    turn, sd = comparison.precise()
    if sd >= ACCELERATIONS_LIMIT:
        return None
    return Heading(turn, hypot(max(sd, ACCELERATIONS_SD), 0.5 * levelling.turn_sd(MEMORY_S)), "matched accelerations")


def forwards_or_backwards(course: Heading, comparison: Comparison) -> Heading:
    """Turn a course round if the accelerations so far say that the vehicle reverses."""
    turn, sd = comparison.result()
    if course.how != COURSE or sd > SENSE_LIMIT or abs(wrap_angle(turn - course.turn)) < pi - 3.0 * SENSE_LIMIT:
        return course
    return Heading(wrap_angle(course.turn + pi), course.sd, f"{COURSE}, backwards")
