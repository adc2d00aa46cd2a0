"""Heading and velocity for receivers that send positions only: the track by fixes and by inertial sensors.

In complex numbers (north + i east), with p the antenna's positions and d the same way in the frame of `levelling`::

    p_i = p_0 + w d_i + noise,   arg w is the turn of the level frame to NED

After a rest, d is what the inertial sensors have integrated and the swing of the lever arm, and |w| should be one. Else
the vehicle is taken to go forwards at an even speed v, so that d = v ∫ exp(i yaw) dt and the swing.
"""

from cmath import phase, rect
from collections.abc import Sequence
from math import hypot, sqrt
from typing import NamedTuple

from shared.maths.earth import ned_from_geodetic_difference

from ..filter.propagation import FASTEST_M_S, ZERO
from ..measurements.gnss import GnssPosition
from ..settings import Settings
from .heading import COURSE, MATCH_ACCELERATION_SD, MATCH_S, Heading, Motion
from .levelling import Levelling
from .velocity_matching import GAIN, LARGEST_JITTER_M

SHORTEST_M = 2.0  # a track that gives a heading, and
LARGEST_TURN_SD = 0.1  # [rad] how well
SETTLED_S = 1.0  # before it drives off, a vehicle stands: a rest takes longer to be one
MOVED_SDS = 3.0  # of a difference of positions, beyond which the vehicle has moved
MANY = 4  # positions that say themselves how noisy they are


class Point(NamedTuple):
    """A fix, and where the inertial sensors were then, in the level frame."""

    fix: GnssPosition
    ahead: complex  # [s] integral of the direction of the nose
    way: complex  # [m] since the last rest
    arm: complex  # [m] from the IMU to the antenna


class Fit(NamedTuple):
    """w, the standard deviation of its argument [rad], and that of a position [m]."""

    w: complex
    turn_sd: float
    position_sd: float


def track(points: Sequence[Point], levelling: Levelling, settings: Settings) -> tuple[Motion, Heading] | None:
    """Find velocity and heading of a vehicle that drives.

    Parameters
    ----------
    points : sequence of Point
        Of the last seconds, newest last and of this instant.
    levelling : Levelling
        As of this instant.
    settings : Settings
        For the least speed of a course and its standard deviation.

    Returns
    -------
    tuple or None
        Velocity of the IMU, and the turn of the level frame; None while the track is too short for its noise.
    """
    rested, moving_ns = levelling.quaternion_at_rest is not None, int(levelling.moving_s * 1e9)
    begin_ns = points[-1].fix.time_ns - moving_ns if rested else points[0].fix.time_ns
    if rested and levelling.moving_s < MATCH_S:
        since = [point for point in points if point.fix.time_ns >= begin_ns - int(SETTLED_S * 1e9)]
        if found := _after_rest(since, levelling, settings):
            return found
    return _forwards([point for point in points if point.fix.time_ns >= begin_ns], levelling, settings)


def moved_m_s(points: Sequence[Point]) -> float:
    """Mean speed [m/s] from the first to the last point, or zero if it may as well be noise."""
    if len(points) < 2:
        return 0.0
    first, last = points[0].fix, points[-1].fix
    distance, span_s = abs(_seen(points)[0]), (last.time_ns - first.time_ns) * 1e-9
    sd = sqrt(0.5 * float((first.cov + last.cov)[:2, :2].trace()))
    return distance / span_s if distance > MOVED_SDS * sd and span_s > 0.0 else 0.0


def _after_rest(points: Sequence[Point], levelling: Levelling, settings: Settings) -> tuple[Motion, Heading] | None:
    fit = _fit(points, [point.way + point.arm for point in points])
    gained = complex(*levelling.velocity)
    if (
        fit is None
        or not GAIN[0] < abs(fit.w) < GAIN[1]
        or not settings.alignment.course_speed_m_s <= abs(gained) < FASTEST_M_S
    ):
        return None
    turn, drift = phase(fit.w), MATCH_ACCELERATION_SD * levelling.moving_s
    turn_sd = hypot(fit.turn_sd, drift / abs(gained))
    velocity, sd = gained * rect(1.0, turn), hypot(drift, turn_sd * abs(gained))
    return _motion(points, velocity, sd), Heading(turn, turn_sd, "matched positions")


def _forwards(points: Sequence[Point], levelling: Levelling, settings: Settings) -> tuple[Motion, Heading] | None:
    rough = _fit(points, [point.ahead for point in points])
    fit = rough and _fit(points, [abs(rough.w) * point.ahead + point.arm for point in points])
    if rough is None or fit is None or not settings.alignment.course_speed_m_s <= abs(rough.w) < FASTEST_M_S:
        return None
    turn, span_s = phase(fit.w), (points[-1].fix.time_ns - points[0].fix.time_ns) * 1e-9
    sd = sqrt(2.0) * fit.position_sd / span_s + 0.5 * span_s  # of an acceleration of 1 m/s²
    velocity = rect(abs(rough.w), levelling.yaw + turn)
    return _motion(points, velocity, sd), Heading(
        turn, hypot(fit.turn_sd, settings.alignment.course_yaw_sd_rad), COURSE
    )


def _fit(points: Sequence[Point], ways: Sequence[complex]) -> Fit | None:
    """Least squares for w, if the track is long enough."""
    n = len(points)
    if n < 2:
        return None
    seen = _seen(points)
    if abs(seen[0]) < SHORTEST_M:
        return None
    mean_seen, mean_way = sum(seen) / n, sum(ways) / n
    pairs = [(p - mean_seen, d - mean_way) for p, d in zip(seen, ways, strict=True)]
    dd = sum(abs(d) ** 2 for _, d in pairs)
    if dd == 0.0:
        return None
    w = sum((d.conjugate() * p for p, d in pairs), 0j) / dd
    stated = sqrt(0.5 * max(float(point.fix.cov[:2, :2].trace()) for point in points))
    variance = min(LARGEST_JITTER_M, stated) ** 2
    if n >= MANY:
        variance = max(variance, sum(abs(p - w * d) ** 2 for p, d in pairs) / (2 * n - 4))
    if variance >= (LARGEST_TURN_SD * abs(w)) ** 2 * dd:
        return None
    return Fit(w, sqrt(variance / dd) / abs(w), sqrt(variance))


def _seen(points: Sequence[Point]) -> list[complex]:
    """Positions [m] against the newest."""
    newest = points[-1].fix.position
    differences = (ned_from_geodetic_difference(point.fix.position, newest) for point in points)
    return [complex(north, east) for north, east, _ in differences]


def _motion(points: Sequence[Point], velocity: complex, sd: float) -> Motion:
    first, last = points[0].fix, points[-1].fix
    down = ned_from_geodetic_difference(last.position, first.position)[2] / ((last.time_ns - first.time_ns) * 1e-9)
    return Motion(last.time_ns, (velocity.real, velocity.imag, down), (sd, sd, max(sd, 1.0)), ZERO)
