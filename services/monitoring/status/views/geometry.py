"""What the close-up view draws: the 95 % error ellipse of a covariance, and offsets on the ground."""

from dataclasses import dataclass
from math import atan2, cos, hypot, log, radians, remainder, sqrt

from shared.maths.ellipsoid import curvature_radii
from shared.messages.base import Symmetric3
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution, TruthState

LatitudeLongitude = tuple[float, float]  # [deg, deg]

CHI_SQUARE_95_TWO = -2.0 * log(0.05)  # 95 % quantile: with two degrees of freedom it is closed


@dataclass(frozen=True)
class Ellipse:
    """An ellipse on the ground; `orientation_rad` is the azimuth of the major axis, clockwise from north."""

    semi_major_m: float
    semi_minor_m: float
    orientation_rad: float


def ellipse_95(covariance_ned: Symmetric3) -> Ellipse:
    """Find the ellipse that holds the true horizontal position with a probability of 95 %.

    Parameters
    ----------
    covariance_ned : tuple of 6 floats
        [m², NED] Upper triangle of the position covariance, row by row: NN NE ND EE ED DD.

    Returns
    -------
    Ellipse
        [m, rad] Semi-axes and the azimuth of the major one, in (-π/2, π/2].

    Notes
    -----
    The eigenvalues of the symmetric 2x2 block, scaled by the quantile of χ² with two degrees of freedom::

        λ = (P_NN + P_EE)/2 ± √( ((P_NN - P_EE)/2)² + P_NE² )
        a = √(5.991 λ₁),  b = √(5.991 λ₂),  azimuth = ½ atan2(2 P_NE, P_NN - P_EE)

    References
    ----------
    Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    2001, section 2.3.4 (the confidence region of a Gaussian pair).
    """
    north, cross, _, east, _, _ = covariance_ned
    middle, spread = (north + east) / 2.0, hypot((north - east) / 2.0, cross)
    major, minor = max(middle + spread, 0.0), max(middle - spread, 0.0)
    return Ellipse(
        sqrt(CHI_SQUARE_95_TWO * major), sqrt(CHI_SQUARE_95_TWO * minor), atan2(2.0 * cross, north - east) / 2.0
    )


def horizontal_sd(covariance_ned: Symmetric3) -> float:
    """Give the root of the summed horizontal variances, DRMS [m or m/s, NED]."""
    return sqrt(max(covariance_ned[0] + covariance_ned[3], 0.0))


def vertical_sd(covariance_ned: Symmetric3) -> float:
    """Give the standard deviation of the last axis [m, NED], or of the heading [rad] of an attitude covariance."""
    return sqrt(max(covariance_ned[5], 0.0))


def ground_offset(point: LatitudeLongitude, origin: LatitudeLongitude) -> tuple[float, float]:
    """Give the metres north and east of an origin [deg, deg], by the radii of curvature there."""
    latitude = radians(origin[0])
    meridian, transverse = curvature_radii(latitude)
    return (
        radians(point[0] - origin[0]) * meridian,
        radians(remainder(point[1] - origin[1], 360.0)) * transverse * cos(latitude),
    )


def offset_m(solution: NavigationSolution, reference: TruthState | GnssFix) -> tuple[float, float] | None:
    """Offset of a solution from a reference, north and east [m]; None if the reference has no position.

    The reference is moved by its own velocity to the moment of the solution, and the difference of the
    two geodetic positions is taken to metres with the radii of curvature of the WGS84 ellipsoid.
    """
    velocity = reference.velocity_ned_m_s or (0.0, 0.0, 0.0)
    if reference.latitude_deg is None or reference.longitude_deg is None:
        return None
    delay_s = (solution.sampled_ns - reference.sampled_ns) * 1e-9
    north, east = ground_offset(
        (solution.latitude_deg, solution.longitude_deg), (reference.latitude_deg, reference.longitude_deg)
    )
    return north - velocity[0] * delay_s, east - velocity[1] * delay_s
