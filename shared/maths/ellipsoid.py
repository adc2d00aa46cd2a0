"""The ellipsoid of WGS-84 and its radii of curvature, in plain floats: also for processes without NumPy."""

from math import sin, sqrt

SEMI_MAJOR_AXIS = 6378137.0  # [m] NIMA TR8350.2, table 3.1
FLATTENING = 1.0 / 298.257223563  # [-] NIMA TR8350.2, table 3.1
SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)  # [m]
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)  # [-]


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
