"""Strapdown mechanisation in the local north-east-down frame, one inertial sample a step, in plain floats.

v' = C f + g - (2 w_ie + w_en) x v,    C' = C sk(w_ib) - sk(w_ie + w_en) C
"""

from math import cos, sin, sqrt, tan
from typing import NamedTuple

from shared.maths.earth import EARTH_RATE, ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS, Geodetic, gravity, wrap_angle
from shared.maths.rotation import Quaternion, Vector, quaternion_from_rotation_vector, quaternion_product

_SMALL_ANGLE2 = 1e-8  # [rad²] below it, two terms of the series are exact to rounding
_POLAR_FACTOR = 1.0 - ECCENTRICITY_SQUARED


class InertialState(NamedTuple):
    """Attitude (NED from body), velocity [m/s, NED] and position at one instant."""

    time_ns: int
    quaternion: Quaternion
    velocity: Vector
    position: Geodetic


def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """Turn a vector by a unit quaternion."""
    w, x, y, z = quaternion
    a, b, c = vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


def average_force(force: Vector, turn: Vector) -> Vector:
    """Mean over a step, in the body axes of its start, of a specific force that is constant in turning axes.

    Parameters
    ----------
    force : tuple of float
        [m/s², body] Specific force, bias removed.
    turn : tuple of float
        [rad, body] Rotation vector of the step, bias removed.

    Returns
    -------
    tuple of float
        [m/s², body at the start of the step]

    Notes
    -----
    The average rotation of `shared.maths.rotation.average_matrix_from_rotation_vector`, applied without a matrix::

        f + (1 - cos|a|)/|a|² (a x f) + (1 - sin|a|/|a|)/|a|² a x (a x f)
    """
    fx, fy, fz = force
    x, y, z = turn
    angle2 = x * x + y * y + z * z
    if angle2 < _SMALL_ANGLE2:
        first, second = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = sqrt(angle2)
        first, second = (1.0 - cos(angle)) / angle2, (1.0 - sin(angle) / angle) / angle2
    cx, cy, cz = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
    return (
        fx + first * cx + second * (y * cz - z * cy),
        fy + first * cy + second * (z * cx - x * cz),
        fz + first * cz + second * (x * cy - y * cx),
    )


def propagate(state: InertialState, force: Vector, rate: Vector, time_ns: int) -> tuple[InertialState, Vector]:
    """Carry attitude, velocity and position over one inertial sample.

    Parameters
    ----------
    state : InertialState
        At the start of the step.
    force : tuple of float
        [m/s², body] Mean specific force over the step, bias removed.
    rate : tuple of float
        [rad/s, body] Mean angular rate over the step, bias removed.
    time_ns : int
        End of the step.

    Returns
    -------
    InertialState
        At the end of the step.
    tuple of float
        [m/s², NED] Mean specific force over the step.

    Notes
    -----
    With the step t, the turn a = w t, and the average rotation A(a) over the step::

        f_n  = C A(a) f - t/2 (w_ie + w_en) x C f
        v+   = v + [f_n + g - (w_en + 2 w_ie) x v] t
        h+   = h - t/2 (v_D + v_D+)
        L+   = L + t/2 [v_N/(R_N + h) + v_N+/(R_N + h+)]
        lon+ = lon + t/2 [v_E/((R_E + h) cos L) + v_E+/((R_E+ + h+) cos L+)]
        q+   = exp(-(w_ie + (w_en + w_en+)/2) t) q exp(a)

    References
    ----------
    P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., section 5.5;
    J. Zuriarrain Sosa et al., Appl. Sci. 14, 4401, 2024, eq. 9-19, with its eq. 10, 14, 16 and 18 corrected.
    """
    _, quaternion, (north, east, down), position = state
    latitude, longitude, height = position
    step = (time_ns - state.time_ns) * 1e-9

    sine, cosine = sin(latitude), cos(latitude)
    s = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    transverse = SEMI_MAJOR_AXIS / sqrt(s)
    meridian = transverse * _POLAR_FACTOR / s
    earth_n, earth_d = EARTH_RATE * cosine, -EARTH_RATE * sine
    east_angular = east / (transverse + height)
    north_angular = north / (meridian + height)
    carried_d = -east_angular * sine / cosine

    turn = (rate[0] * step, rate[1] * step, rate[2] * step)
    fn, fe, fd = rotate(quaternion, average_force(force, turn))
    half = 0.5 * step
    gn, ge, gd = rotate(quaternion, force)
    wn, we, wd = earth_n + east_angular, -north_angular, earth_d + carried_d
    fn, fe, fd = (
        fn - half * (we * gd - wd * ge),
        fe - half * (wd * gn - wn * gd),
        fd - half * (wn * ge - we * gn),
    )

    wn, wd = wn + earth_n, wd + earth_d
    new_north = north + (fn - (we * down - wd * east)) * step
    new_east = east + (fe - (wd * north - wn * down)) * step
    new_down = down + (fd + gravity(latitude, height) - (wn * east - we * north)) * step

    new_height = height - half * (down + new_down)
    new_latitude = latitude + half * (north_angular + new_north / (meridian + new_height))
    new_cosine = cos(new_latitude)
    s = 1.0 - ECCENTRICITY_SQUARED * sin(new_latitude) ** 2
    transverse = SEMI_MAJOR_AXIS / sqrt(s)
    new_east_angular = new_east / (transverse + new_height)
    new_longitude = longitude + half * (east_angular / cosine + new_east_angular / new_cosine)

    carried = (
        earth_n + 0.5 * (east_angular + new_east_angular),
        -0.5 * (north_angular + new_north / (transverse * _POLAR_FACTOR / s + new_height)),
        earth_d + 0.5 * (carried_d - new_east_angular * tan(new_latitude)),
    )
    backwards = quaternion_from_rotation_vector((-carried[0] * step, -carried[1] * step, -carried[2] * step))
    turned = quaternion_product(quaternion_product(backwards, quaternion), quaternion_from_rotation_vector(turn))
    end = InertialState(
        time_ns,
        normalised(turned),
        (new_north, new_east, new_down),
        Geodetic(new_latitude, wrap_angle(new_longitude), new_height),
    )
    return end, (fn, fe, fd)


def normalised(quaternion: Quaternion) -> Quaternion:
    """Bring a quaternion back to unit length, from which rounding takes it."""
    w, x, y, z = quaternion
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale
