"""Heading and velocity for receivers without velocity: GNSS positions against the displacement by inertial sensors.

In complex numbers (north + i east), with p the antenna's positions and d its displacement in the level frame::

    p_i = p_0 + w d_i + noise,   arg w is the turn from the level frame to NED

Shortly after a standstill d is the displacement by dead reckoning plus the lever arm, and |w| should be one. Otherwise
forward motion at constant speed v is assumed: d = v ∫ exp(i yaw) dt, plus the lever arm.
"""

from cmath import phase, rect
from collections.abc import Sequence
from math import hypot, sqrt
from typing import NamedTuple

from shared.maths.earth import ned_from_geodetic_difference

from ..aids.gnss.comparison import GAIN, MAX_JITTER_M
from ..aids.gnss.fix import GnssPosition
from ..codes import HeadingMethod
from ..inertial.propagation import MAX_SPEED_M_S, ZERO
from ..settings import Settings
from .heading import MATCH_ACCELERATION_SD, MATCH_S, Heading, Motion
from .levelling import Levelling

SHORTEST_M = 2.0  # shortest track that gives a heading
MAX_TURN_SD = 0.1  # [rad] of a heading
STANDSTILL_FIXES_S = 1.0  # time before the vehicle moves off of which fixes are used as well
MAX_PARKING_OFFSET_SDS = 3.0  # standard deviations of a difference of positions above which the vehicle has moved
MANY = 4  # number of positions from which their noise is estimated


class Point(NamedTuple):
    """A fix, with the integrals of `Levelling` at its stamp, in the level frame (north + i east)."""

    fix: GnssPosition
    heading_integral: complex  # [s]
    displacement: complex  # [m] since the last standstill
    arm: complex  # [m] from the IMU to the antenna


class Fit(NamedTuple):
    """Estimate of w, and standard deviations of its argument [rad] and of a position [m]."""

    w: complex
    turn_sd: float
    position_sd: float


def track(points: Sequence[Point], levelling: Levelling, settings: Settings) -> tuple[Motion, Heading] | None:
    """Velocity and heading of a moving vehicle.

    Parameters
    ----------
    points : sequence of Point
        Of the last seconds, newest last.
    levelling : Levelling
        At the time of the newest.
    settings : Settings
        For the lowest speed of a course and its standard deviation.

    Returns
    -------
    tuple or None
        Velocity of the IMU, and heading; None while the track is too short for its noise.
    """
    had_standstill, moving_ns = levelling.standstill_quaternion is not None, int(levelling.moving_s * 1e9)
    begin_ns = points[-1].fix.time_ns - moving_ns if had_standstill else points[0].fix.time_ns
    if had_standstill and levelling.moving_s < MATCH_S:
        recent = [point for point in points if point.fix.time_ns >= begin_ns - int(STANDSTILL_FIXES_S * 1e9)]
        if found := _by_displacement(recent, levelling, settings):
            return found
    return _by_course([point for point in points if point.fix.time_ns >= begin_ns], levelling, settings)


def moved_m_s(points: Sequence[Point]) -> float:
    """Mean speed [m/s] from the first to the last point; zero if it is not significant."""
    if len(points) < 2:
        return 0.0
    first, last = points[0].fix, points[-1].fix
    distance, span_s = abs(_offsets(points)[0]), (last.time_ns - first.time_ns) * 1e-9
    sd = sqrt(0.5 * float((first.cov + last.cov)[:2, :2].trace()))
    return distance / span_s if distance > MAX_PARKING_OFFSET_SDS * sd and span_s > 0.0 else 0.0


def _by_displacement(
    points: Sequence[Point], levelling: Levelling, settings: Settings
) -> tuple[Motion, Heading] | None:
    fit = _fit(points, [point.displacement + point.arm for point in points])
    gained = complex(*levelling.velocity)
    if (
        fit is None
        or not GAIN[0] < abs(fit.w) < GAIN[1]
        or not settings.alignment.course_speed_m_s <= abs(gained) < MAX_SPEED_M_S
    ):
        return None
    turn, drift = phase(fit.w), MATCH_ACCELERATION_SD * levelling.moving_s
    turn_sd = hypot(fit.turn_sd, drift / abs(gained))
    velocity, sd = gained * rect(1.0, turn), hypot(drift, turn_sd * abs(gained))
    return _motion(points, velocity, sd), Heading(turn, turn_sd, HeadingMethod.POSITIONS)


def _by_course(points: Sequence[Point], levelling: Levelling, settings: Settings) -> tuple[Motion, Heading] | None:
    rough = _fit(points, [point.heading_integral for point in points])
    fit = rough and _fit(points, [abs(rough.w) * point.heading_integral + point.arm for point in points])
    if rough is None or fit is None or not settings.alignment.course_speed_m_s <= abs(rough.w) < MAX_SPEED_M_S:
        return None
    turn, span_s = phase(fit.w), (points[-1].fix.time_ns - points[0].fix.time_ns) * 1e-9
    sd = sqrt(2.0) * fit.position_sd / span_s + 0.5 * span_s  # of an acceleration of 1 m/s²
    velocity = rect(abs(rough.w), levelling.yaw + turn)
    return _motion(points, velocity, sd), Heading(
        turn, hypot(fit.turn_sd, settings.alignment.course_yaw_sd_rad), HeadingMethod.COURSE
    )


def _fit(points: Sequence[Point], displacements: Sequence[complex]) -> Fit | None:
    """Least-squares estimate of w; None if the track is too short."""
    n = len(points)
    if n < 2:
        return None
    positions = _offsets(points)
    if abs(positions[0]) < SHORTEST_M:
        return None
    mean_position, mean_displacement = sum(positions) / n, sum(displacements) / n
    pairs = [(p - mean_position, d - mean_displacement) for p, d in zip(positions, displacements, strict=True)]
    dd = sum(abs(d) ** 2 for _, d in pairs)
    if dd == 0.0:
        return None
    w = sum((d.conjugate() * p for p, d in pairs), 0j) / dd
    stated = sqrt(0.5 * max(float(point.fix.cov[:2, :2].trace()) for point in points))
    variance = min(MAX_JITTER_M, stated) ** 2
    if n >= MANY:
        variance = max(variance, sum(abs(p - w * d) ** 2 for p, d in pairs) / (2 * n - 4))
    if variance >= (MAX_TURN_SD * abs(w)) ** 2 * dd:
        return None
    return Fit(w, sqrt(variance / dd) / abs(w), sqrt(variance))


def _offsets(points: Sequence[Point]) -> list[complex]:
    """Positions [m, north + i east] relative to the newest."""
    newest = points[-1].fix.position
    differences = (ned_from_geodetic_difference(point.fix.position, newest) for point in points)
    return [complex(north, east) for north, east, _ in differences]


def _motion(points: Sequence[Point], velocity: complex, sd: float) -> Motion:
    first, last = points[0].fix, points[-1].fix
    down = ned_from_geodetic_difference(last.position, first.position)[2] / ((last.time_ns - first.time_ns) * 1e-9)
    return Motion(last.time_ns, (velocity.real, velocity.imag, down), (sd, sd, max(sd, 1.0)), ZERO)
