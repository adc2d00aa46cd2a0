"""The ellipsoid of WGS-84: radii of curvature and geodetic positions, in plain floats: for processes without NumPy."""

from math import atan2, cos, hypot, sin, sqrt
from typing import NamedTuple

SEMI_MAJOR_AXIS = 6378137.0  # [m] NIMA TR8350.2, table 3.1
FLATTENING = 1.0 / 298.257223563  # [-] NIMA TR8350.2, table 3.1
SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)  # [m]
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)  # [-]


class Geodetic(NamedTuple):
    """A position: latitude and longitude [rad], height above the ellipsoid [m]."""

    latitude: float
    longitude: float
    height: float


def curvature_radii(latitude: float) -> tuple[float, float]:
    """Radii of curvature of the ellipsoid along the meridian and across it.

    Parameters
    ----------
    latitude : float
        [rad] Geodetic latitude.

    Returns
    -------
    tuple of float
        [m] Meridian radius R_N and transverse radius R_E; R_N < R_E except near the poles,
        where both are a²/b.

    Notes
    -----
    With s = 1 - e² sin²L::

        R_N = a (1 - e²) / s^1.5,    R_E = a / sqrt(s)

    References
    ----------
    P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 2.105, 2.106.
    """
    s = 1.0 - ECCENTRICITY_SQUARED * sin(latitude) ** 2
    transverse = SEMI_MAJOR_AXIS / sqrt(s)
    return transverse * (1.0 - ECCENTRICITY_SQUARED) / s, transverse


def geodetic_from_ecef(ecef: tuple[float, float, float]) -> Geodetic:
    """Geodetic position of a point in Cartesian ECEF coordinates.

    Parameters
    ----------
    ecef : tuple of float
        [m, ECEF] More than 50 km from the Earth's centre.

    Returns
    -------
    Geodetic
        On the polar axis the longitude is 0.

    Notes
    -----
    Bowring's fixed-point iteration on the reduced latitude u; near the surface it converges to rounding in two or
    three iterations::

        tan L = (z + e'² b sin³u) / (p - e² a cos³u),    tan u = (1 - f) tan L

    References
    ----------
    B. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (181), 1976.
    """
    x, y, z = ecef
    p = hypot(x, y)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    reduced = atan2(z, (1.0 - FLATTENING) * p)
    latitude = 0.0
    for _ in range(5):
        latitude = atan2(
            z + second * SEMI_MINOR_AXIS * sin(reduced) ** 3,
            p - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * cos(reduced) ** 3,
        )
        reduced = atan2((1.0 - FLATTENING) * sin(latitude), cos(latitude))
    transverse = curvature_radii(latitude)[1]
    along_normal = p * cos(latitude) + z * sin(latitude)
    height = along_normal - transverse * (1.0 - ECCENTRICITY_SQUARED * sin(latitude) ** 2)
    return Geodetic(latitude, atan2(y, x), height)
