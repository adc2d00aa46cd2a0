"""Strapdown mechanisation in the local north-east-down (NED) frame: attitude, velocity and position, sample by sample.

v' = C f + g - (2 w_ie + w_en) x v,    C' = C sk(w_ib) - sk(w_ie + w_en) C

It runs for every sample, with plain floats and tuples: Python handles them faster than small arrays, and Numba
compiles them.
"""

from collections.abc import Sequence
from math import cos, pi, sin, sqrt
from typing import NamedTuple

from shared.maths.compiled import compilable
from shared.maths.earth import (
    EARTH_RATE,
    EQUATORIAL_GRAVITY,
    GRAVITY_RATIO,
    SOMIGLIANA_CONSTANT,
    Geodetic,
    geodetic_from_ned_difference,
)
from shared.maths.ellipsoid import ECCENTRICITY_SQUARED, FLATTENING, SEMI_MAJOR_AXIS
from shared.maths.rotation import Quaternion, Vector, quaternion_from_rotation_vector, quaternion_product

SMALL_ANGLE2 = 1e-8  # [rad²] below it, two terms of the series are exact to rounding
POLAR_FACTOR = 1.0 - ECCENTRICITY_SQUARED
# Decrease of gravity with height: slope at the equator, its change with latitude, and curvature.
EQUATORIAL_SLOPE = 2.0 * (1.0 + FLATTENING + GRAVITY_RATIO) / SEMI_MAJOR_AXIS  # [1/m]
POLEWARD_SLOPE = -4.0 * FLATTENING / SEMI_MAJOR_AXIS  # [1/m]
SLOPE_CHANGE = 3.0 / SEMI_MAJOR_AXIS**2  # [1/m²]


class InertialState(NamedTuple):
    """Attitude (NED from body), velocity [m/s, NED] and position of the IMU at one instant."""

    time_ns: int
    quaternion: Quaternion
    velocity: Vector
    position: Geodetic


class LocalEarth(NamedTuple):
    """Shape and gravity of the Earth at one latitude; computed once for the end of a step and the start of the next."""

    sin_latitude: float
    cos_latitude: float
    meridian_radius: float  # [m] R_N
    transverse_radius: float  # [m] R_E
    gravity: float  # [m/s²] on the ellipsoid
    gravity_slope: float  # [1/m] relative decrease with height


@compilable
def local_earth(latitude: float) -> LocalEarth:
    """Radii and gravity of the ellipsoid at a latitude [rad], by the formulae of `shared.maths.earth`."""
    sine = sin(latitude)
    sin2 = sine * sine
    s = 1.0 - ECCENTRICITY_SQUARED * sin2
    root = sqrt(s)
    transverse = SEMI_MAJOR_AXIS / root
    return LocalEarth(
        sine,
        cos(latitude),
        transverse * POLAR_FACTOR / s,
        transverse,
        EQUATORIAL_GRAVITY * (1.0 + SOMIGLIANA_CONSTANT * sin2) / root,
        EQUATORIAL_SLOPE + POLEWARD_SLOPE * sin2,
    )


@compilable
def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """Rotate a vector by a unit quaternion."""
    w, x, y, z = quaternion
    a, b, c = vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


@compilable
def rotation_series(angle2: float) -> tuple[float, float, float, float]:
    """Compute the coefficients of a rotation vector a from its squared length [rad²].

    Returns
    -------
    tuple of float
        cos(|a|/2) and sin(|a|/2)/|a| of its quaternion; (1 - cos|a|)/|a|² and (1 - sin|a|/|a|)/|a|² of the average
        rotation, `shared.maths.rotation.average_matrix_from_rotation_vector`.
    """
    if angle2 < SMALL_ANGLE2:
        return 1.0 - angle2 / 8.0, 0.5 - angle2 / 48.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    angle = sqrt(angle2)
    cosine, scale = cos(0.5 * angle), sin(0.5 * angle) / angle
    return cosine, scale, 2.0 * scale * scale, (1.0 - 2.0 * scale * cosine) / angle2


@compilable
def mechanise(
    quaternion: Quaternion,
    velocity: Vector,
    position: Vector,
    earth: LocalEarth,
    force: Vector,
    rate: Vector,
    step: float,
) -> tuple[Quaternion, Vector, Vector, LocalEarth, Vector, Vector]:
    """Propagate attitude, velocity and position over one inertial sample.

    Parameters
    ----------
    quaternion : tuple of float
        NED from body, at the start of the step.
    velocity : tuple of float
        [m/s, NED] At the start of the step.
    position : tuple of float
        [rad, rad, m] Latitude, longitude and height at the start of the step.
    earth : LocalEarth
        At this latitude.
    force : tuple of float
        [m/s², body] Mean specific force over the step, bias and scale removed.
    rate : tuple of float
        [rad/s, body] Mean angular rate over the step, bias and scale removed.
    step : float
        [s] Length of the step.

    Returns
    -------
    quaternion, velocity, position, earth
        At the end of the step.
    tuple of float
        [m/s², NED] Mean specific force over the step.
    tuple of float
        [m/s², NED] Mean acceleration over the step.

    Notes
    -----
    With the step t, the rotation vector a = w t, and the average rotation A(a) over the step::

        f_n  = C A(a) f - t/2 (w_ie + w_en) x C f
        v+   = v + [f_n + g - (w_en + 2 w_ie) x v] t
        h+   = h - t/2 (v_D + v_D+)
        L+   = L + t/2 [v_N/(R_N + h) + v_N+/(R_N + h+)]
        lon+ = lon + t/2 [v_E/((R_E + h) cos L) + v_E+/((R_E+ + h+) cos L+)]
        q+   = exp(-(w_ie + (w_en + w_en+)/2) t) q exp(a)

    The first exponential, of a few microradians, is 1 minus half its vector, and q+ is normalised by one Newton step
    of 1/sqrt: both are exact to rounding.

    References
    ----------
    P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., section 5.5;
    J. Zuriarrain Sosa et al., Appl. Sci. 14, 4401, 2024, eq. 9-19, with its eq. 10, 14, 16 and 18 corrected.
    """
    (w, x, y, z), (north, east, down), (latitude, longitude, height) = quaternion, velocity, position
    sine, cosine, meridian, transverse, surface_gravity, slope = earth
    fx, fy, fz = force
    half = 0.5 * step

    # A(a) f = f + (1 - cos|a|)/|a|² c + (1 - sin|a|/|a|)/|a|² a x c  with  c = a x f; here what is added to f.
    ax, ay, az = rate[0] * step, rate[1] * step, rate[2] * step
    half_cosine, scale, first, second = rotation_series(ax * ax + ay * ay + az * az)
    cx, cy, cz = ay * fz - az * fy, az * fx - ax * fz, ax * fy - ay * fx
    dx = first * cx + second * (ay * cz - az * cy)
    dy = first * cy + second * (az * cx - ax * cz)
    dz = first * cz + second * (ax * cy - ay * cx)

    tx, ty, tz = 2.0 * (y * fz - z * fy), 2.0 * (z * fx - x * fz), 2.0 * (x * fy - y * fx)
    gn, ge, gd = fx + w * tx + y * tz - z * ty, fy + w * ty + z * tx - x * tz, fz + w * tz + x * ty - y * tx
    tx, ty, tz = 2.0 * (y * dz - z * dy), 2.0 * (z * dx - x * dz), 2.0 * (x * dy - y * dx)

    earth_n, earth_d = EARTH_RATE * cosine, -EARTH_RATE * sine
    by_east, by_north = east / (transverse + height), north / (meridian + height)
    carried_d = by_east * sine / cosine
    wn, we, wd = earth_n + by_east, -by_north, earth_d - carried_d
    fn = gn + dx + w * tx + y * tz - z * ty - half * (we * gd - wd * ge)
    fe = ge + dy + w * ty + z * tx - x * tz - half * (wd * gn - wn * gd)
    fd = gd + dz + w * tz + x * ty - y * tx - half * (wn * ge - we * gn)

    wn, wd = wn + earth_n, wd + earth_d
    gravity = surface_gravity * (1.0 - height * (slope - SLOPE_CHANGE * height))
    an, ae, ad = fn - we * down + wd * east, fe - wd * north + wn * down, fd + gravity - wn * east + we * north
    new_north, new_east, new_down = north + an * step, east + ae * step, down + ad * step

    new_height = height - half * (down + new_down)
    new_latitude = latitude + half * (by_north + new_north / (meridian + new_height))
    new_earth = local_earth(new_latitude)
    _, new_cosine, new_meridian, new_transverse, _, _ = new_earth
    new_by_east = new_east / (new_transverse + new_height)
    new_longitude = longitude + half * (by_east / cosine + new_by_east / new_cosine)
    if new_longitude > pi:
        new_longitude -= 2.0 * pi
    elif new_longitude <= -pi:
        new_longitude += 2.0 * pi

    half = 0.5 * half
    quaternion = rotated(
        quaternion,
        (half_cosine, scale * ax, scale * ay, scale * az),
        half * (2.0 * earth_n + by_east + new_by_east),
        -half * (by_north + new_north / (new_meridian + new_height)),
        half * (2.0 * earth_d - carried_d - new_by_east * sine / new_cosine),
    )
    velocity, position = (new_north, new_east, new_down), (new_latitude, new_longitude, new_height)
    return quaternion, velocity, position, new_earth, (fn, fe, fd), (an, ae, ad)


@compilable
def rotated(quaternion: Quaternion, turn: Quaternion, bn: float, be: float, bd: float) -> Quaternion:
    """Multiply a quaternion on the right by another, and on the left by the inverse of a small rotation vector 2 b."""
    w, x, y, z = quaternion
    c, ax, ay, az = turn
    p, q = c * w - ax * x - ay * y - az * z, c * x + ax * w + az * y - ay * z
    r, s = c * y + ay * w + ax * z - az * x, c * z + az * w + ay * x - ax * y
    w, x = p + bn * q + be * r + bd * s, q - bn * p - be * s + bd * r
    y, z = r - be * p - bd * q + bn * s, s - bd * p - bn * r + be * q
    to_unit = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return w * to_unit, x * to_unit, y * to_unit, z * to_unit


@compilable
def normalised(quaternion: Quaternion) -> Quaternion:
    """Scale a quaternion to unit length."""
    w, x, y, z = quaternion
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale


@compilable
def corrected(state: InertialState, errors: Sequence[float]) -> InertialState:
    """Subtract errors of attitude [rad, NED], velocity [m/s, NED] and position [m, NED], nine in all, from a state."""
    a, b, c, u, v, w, north, east, down = errors
    time_ns, quaternion, velocity, position = state
    inverse_error = quaternion_from_rotation_vector((-a, -b, -c))  # of exp(-sk(psi)) C
    return InertialState(
        time_ns,
        normalised(quaternion_product(inverse_error, quaternion)),
        (velocity[0] - u, velocity[1] - v, velocity[2] - w),
        geodetic_from_ned_difference((-north, -east, -down), position),
    )
