"""Data elements of the vehicle's own CAM from the navigation solution.

Solution: position p and velocity v of the IMU, attitude C_nb, angular rate w_b. The reference point of the CAM is the
ground below the middle of the front, at r_b from the IMU::

    p_ref = p + C_nb r_b,     v_ref = v + C_nb (w_b x r_b)

Confidences are for 95 %: 1.96 sigma of a scalar, sqrt(chi2_2(0.95)) = 2.4477 sigma of an axis of the ellipse. The share
of the attitude error in the covariance of p_ref is left out: 3 cm at 2 m and 1 degree.
"""

from collections import deque
from dataclasses import dataclass, field
from math import atan2, cos, degrees, hypot, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.confidence import ELLIPSE_95, SCALAR_95
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference, wrap_angle
from shared.maths.rotation import cross, ned_from_body
from shared.messages.base import Symmetric3, Vector3
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.trust import TrustLevel, TrustState
from shared.messages.v2x import (
    DriveDirection,
    LowFrequencyContainer,
    OwnCam,
    PathPoint,
    StationType,
    VehicleRole,
)
from shared.v2x.generation import Dynamics

NS = 1_000_000_000
SLOWEST_COURSE_M_S = 1.0  # below it the heading is that of the body, since the course is noise
ACCELERATION_WINDOW_NS = NS // 2
TRUST_SILENT_NS = 5 * NS
PATH_STEP_M = 10.0  # between two points of the path
PATH_POINTS = 23  # 230 m at least
MAX_STEP_DEG = 0.0131  # of latitude or longitude between two points: 131071 units of 1e-7 degrees
MAX_PATH_NS = 600 * NS  # a point that is older is left out; its code ends at 655 s
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Vehicle:
    """What a CAM states of the vehicle itself."""

    station_id: int
    station_type: StationType
    role: VehicleRole
    reference_point_body_m: Vector3  # from the IMU
    length_m: float | None
    width_m: float | None


@dataclass
class Motion:
    """Forward speeds of the last half second, for the longitudinal acceleration."""

    _speeds: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=100))

    def add(self, solution: NavigationSolution) -> None:
        """Append the forward speed of a solution."""
        north, east, _ = solution.velocity_ned_m_s
        forward = north * cos(solution.yaw_rad) + east * sin(solution.yaw_rad)
        if self._speeds and solution.sampled_ns <= self._speeds[-1][0]:
            self._speeds.clear()
        self._speeds.append((solution.sampled_ns, forward))
        while solution.sampled_ns - self._speeds[0][0] > ACCELERATION_WINDOW_NS:
            self._speeds.popleft()

    @property
    def longitudinal_acceleration_m_s2(self) -> float | None:
        """Mean over the window: (v_k - v_0) / (t_k - t_0); None with less than half of a window."""
        if not self._speeds:
            return None
        (first_ns, first), (last_ns, last) = self._speeds[0], self._speeds[-1]
        if last_ns - first_ns < ACCELERATION_WINDOW_NS // 2:
            return None
        return (last - first) / ((last_ns - first_ns) / NS)


@dataclass
class PathHistory:
    """Where the reference point has been: a point every 10 m, the newest first."""

    _points: deque[tuple[int, Geodetic]] = field(default_factory=lambda: deque(maxlen=PATH_POINTS))

    def add(self, time_ns: int, point: Geodetic) -> None:
        """Keep a point that is 10 m or more from the last one; delete all of them if time goes back."""
        if self._points and time_ns < self._points[0][0]:
            self._points.clear()
        if not self._points or hypot(*ned_from_geodetic_difference(point, self._points[0][1])[:2]) >= PATH_STEP_M:
            self._points.appendleft((time_ns, point))

    def points(self, time_ns: int, here: Geodetic) -> tuple[PathPoint, ...]:
        """Differences from each point to the one before it, as a CAM has them; the first from the place of the CAM."""
        found, before_ns, before = [], time_ns, here
        for past_ns, past in self._points:
            if past_ns == time_ns:
                continue
            latitude = degrees(past.latitude - before.latitude)
            longitude = degrees(wrap_angle(past.longitude - before.longitude))
            if time_ns - past_ns > MAX_PATH_NS or max(abs(latitude), abs(longitude)) > MAX_STEP_DEG:
                break
            elapsed_s = (before_ns - past_ns) / NS
            found.append(
                PathPoint(delta_latitude_deg=latitude, delta_longitude_deg=longitude, delta_time_s=max(elapsed_s, 0.01))
            )
            before_ns, before = past_ns, past
        return tuple(found)


def dynamics(solution: NavigationSolution, vehicle: Vehicle) -> Dynamics:
    """What the generation rules look at."""
    velocity_n = _reference_velocity(solution, vehicle)
    speed, heading, _ = _speed_heading_direction(solution, velocity_n)
    return Dynamics(solution.sampled_ns, _reference_point(solution, vehicle), heading, speed)


def own_cam(
    solution: NavigationSolution,
    vehicle: Vehicle,
    motion: Motion,
    path: PathHistory,
    trust: TrustState | None,
    *,
    its_time_ms: int,
    low_frequency: bool,
) -> OwnCam:
    """Fill a CAM; position confidences are unavailable without a recent verdict, and out of range when it is unsafe."""
    known = trust is not None and abs(solution.sampled_ns - trust.sampled_ns) <= TRUST_SILENT_NS
    major_m, minor_m, orientation = confidence_ellipse(_matrix(solution.position_cov_ned_m2)[:2, :2])
    point, velocity_n = _reference_point(solution, vehicle), _reference_velocity(solution, vehicle)
    speed, heading, direction = _speed_heading_direction(solution, velocity_n)
    measured = solution.phase is not NavigationPhase.GNSS_ONLY  # the rates of GNSS alone are zero
    yaw_rate = -heading_rate(solution) if measured else None
    return OwnCam(
        sampled_ns=solution.sampled_ns,
        its_time_ms=its_time_ms,
        station_id=vehicle.station_id,
        station_type=vehicle.station_type,
        latitude_deg=degrees(point.latitude),
        longitude_deg=degrees(point.longitude),
        position_semi_major_m=major_m if known else None,
        position_semi_minor_m=minor_m if known else None,
        position_semi_major_orientation_rad=orientation if known else None,
        position_out_of_range=known and trust is not None and trust.state is TrustLevel.UNSAFE,
        height_ellipsoid_m=point.height,
        height_confidence_m=SCALAR_95 * sqrt(solution.position_cov_ned_m2[5]) if known else None,
        heading_rad=heading,
        heading_confidence_rad=SCALAR_95 * _heading_sd(solution, velocity_n, speed),
        speed_m_s=speed,
        speed_confidence_m_s=SCALAR_95 * _sd_along(solution.velocity_cov_ned_m2_s2, heading),
        drive_direction=direction,
        vehicle_length_m=vehicle.length_m,
        vehicle_width_m=vehicle.width_m,
        longitudinal_acceleration_m_s2=motion.longitudinal_acceleration_m_s2,
        curvature=yaw_rate / speed if yaw_rate is not None and speed >= SLOWEST_COURSE_M_S else None,
        yaw_rate_rad_s=yaw_rate,
        low_frequency=(
            LowFrequencyContainer(vehicle_role=vehicle.role, path=path.points(solution.sampled_ns, point))
            if low_frequency
            else None
        ),
    )


def confidence_ellipse(cov_ne: FloatArray) -> tuple[float, float, float]:
    """Semi-axes and orientation of the 95 % ellipse of a horizontal covariance.

    Parameters
    ----------
    cov_ne : ndarray, shape (2, 2)
        [m2, north and east] Covariance of the position.

    Returns
    -------
    tuple of float
        [m] Semi-major and semi-minor axis, [rad] orientation of the major axis in [0, pi), clockwise from north.
    """
    variances, axes = np.linalg.eigh(cov_ne)  # ascending
    minor, major = ELLIPSE_95 * np.sqrt(np.maximum(variances, 0.0))
    return float(major), float(minor), float(atan2(axes[1, 1], axes[0, 1])) % pi


def heading_rate(solution: NavigationSolution) -> float:
    """Rate of the yaw angle [rad/s], positive clockwise: (w_y sin(roll) + w_z cos(roll)) / cos(pitch)."""
    _, right, down = solution.angular_rate_body_rad_s
    return (right * sin(solution.roll_rad) + down * cos(solution.roll_rad)) / cos(solution.pitch_rad)


def _reference_point(solution: NavigationSolution, vehicle: Vehicle) -> Geodetic:
    imu = Geodetic(radians(solution.latitude_deg), radians(solution.longitude_deg), solution.height_ellipsoid_m)
    north, east, down = _rotation(solution) @ np.array(vehicle.reference_point_body_m)
    return geodetic_from_ned_difference((float(north), float(east), float(down)), imu)


def _reference_velocity(solution: NavigationSolution, vehicle: Vehicle) -> FloatArray:
    lever_rate = np.array(cross(solution.angular_rate_body_rad_s, vehicle.reference_point_body_m))
    velocity: FloatArray = np.array(solution.velocity_ned_m_s) + _rotation(solution) @ lever_rate
    return velocity


def _speed_heading_direction(
    solution: NavigationSolution, velocity_n: FloatArray
) -> tuple[float, float, DriveDirection | None]:
    """Horizontal speed, heading of the movement (of the body when slow) and direction."""
    north, east = float(velocity_n[0]), float(velocity_n[1])
    speed = hypot(north, east)
    if speed < SLOWEST_COURSE_M_S:
        return speed, solution.yaw_rad % (2 * pi), None
    forward = north * cos(solution.yaw_rad) + east * sin(solution.yaw_rad) >= 0.0
    return speed, atan2(east, north) % (2 * pi), DriveDirection.FORWARD if forward else DriveDirection.BACKWARD


def _heading_sd(solution: NavigationSolution, velocity_n: FloatArray, speed: float) -> float:
    if speed < SLOWEST_COURSE_M_S:
        return sqrt(solution.attitude_cov_ned_rad2[5])
    course = atan2(float(velocity_n[1]), float(velocity_n[0]))
    return _sd_along(solution.velocity_cov_ned_m2_s2, course + pi / 2) / speed


def _sd_along(cov_ned: Symmetric3, azimuth: float) -> float:
    """Standard deviation of the component along a horizontal direction u: sqrt(u^T P u)."""
    along = np.array([cos(azimuth), sin(azimuth), 0.0])
    return sqrt(max(0.0, float(along @ _matrix(cov_ned) @ along)))


def _rotation(solution: NavigationSolution) -> FloatArray:
    return ned_from_body(solution.roll_rad, solution.pitch_rad, solution.yaw_rad)


def _matrix(upper: Symmetric3) -> FloatArray:
    nn, ne, nd, ee, ed, dd = upper
    return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]])
