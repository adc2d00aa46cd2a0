"""Solutions and truths of a vehicle whose path is known in closed form, for tests of error metrics."""

from collections.abc import Iterable
from math import cos, degrees, pi, sin

import numpy as np

from cli.solve.reference_track import Reference
from cli.solve.track import Track, TrackBuilder
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Vector3
from shared.messages.navigation import NavigationPhase, NavigationSolution

PLACE = Geodetic(0.8, 0.2, 300.0)
RADIUS, RATE = 50.0, 0.2  # [m], [rad/s]: 10 m/s
START_NS = 1_700_000_000_000_000_000


def circle(time_s: float) -> tuple[Vector3, Vector3, float]:
    """Position and velocity [m, m/s, NED] and heading [rad] on a circle driven clockwise."""
    angle = RATE * time_s
    position = (RADIUS * sin(angle), RADIUS * (1.0 - cos(angle)), 0.0)
    velocity = (RADIUS * RATE * cos(angle), RADIUS * RATE * sin(angle), 0.0)
    return position, velocity, (angle + pi) % (2.0 * pi) - pi


def solution(
    time_s: float, *, error_n: Vector3 = (0.0, 0.0, 0.0), sd: float = 0.1, phase: str = "navigating"
) -> NavigationSolution:
    """Make the solution of an instant, off by an error."""
    position, velocity, yaw = circle(time_s)
    north, east, down = np.add(position, error_n).tolist()
    place = geodetic_from_ned_difference((north, east, down), PLACE)
    variance = sd**2
    return NavigationSolution(
        sampled_ns=START_NS + round(time_s * 1e9),
        phase=NavigationPhase(phase),
        latitude_deg=degrees(place.latitude),
        longitude_deg=degrees(place.longitude),
        height_ellipsoid_m=place.height,
        velocity_ned_m_s=velocity,
        roll_rad=0.0,
        pitch_rad=0.0,
        yaw_rad=yaw,
        position_cov_ned_m2=(variance, 0.0, 0.0, variance, 0.0, variance),
        velocity_cov_ned_m2_s2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01),
        attitude_cov_ned_rad2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4),
        angular_rate_body_rad_s=(0.0, 0.0, RATE),
        accelerometer_bias_m_s2=(0.0, 0.0, 0.0),
        gyroscope_bias_rad_s=(0.0, 0.0, 0.0),
        stationary=False,
        gnss_age_s=0.2,
        protection_level_horizontal_m=5.0 * sd,
        protection_level_vertical_m=4.0 * sd,
        integrity_risk=1e-3,
    )


def track(solutions: Iterable[NavigationSolution]) -> Track:
    """Collect solutions."""
    builder = TrackBuilder()
    for made in solutions:
        builder.add(made)
    return builder.track()


def reference(times_s: Iterable[float], *, arm_b: Vector3 | None = None) -> Reference:
    """Make the truth at some instants: of the IMU, or of an antenna at the end of an arm."""
    times = list(times_s)
    positions, velocities, attitudes = [], [], []
    for time_s in times:
        position, velocity, yaw = circle(time_s)
        forward, right, down = arm_b or (0.0, 0.0, 0.0)
        arm = (forward * cos(yaw) - right * sin(yaw), forward * sin(yaw) + right * cos(yaw), down)
        positions.append(geodetic_from_ned_difference(tuple(np.add(position, arm).tolist()), PLACE))
        velocities.append((velocity[0] - RATE * arm[1], velocity[1] + RATE * arm[0], velocity[2]))
        attitudes.append((0.0, 0.0, yaw))
    return Reference(
        "a circle",
        START_NS + np.round(np.array(times) * 1e9).astype(np.int64),
        at_antenna=arm_b is not None,
        geodetic=np.array(positions),
        velocity_n=np.array(velocities),
        attitude=np.array(attitudes),
    )
