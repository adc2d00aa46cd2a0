"""The navigation solution: state, covariance and counts at the newest sample."""

from math import hypot
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector, roll_pitch_yaw_of_quaternion
from shared.messages.base import Symmetric3
from shared.messages.navigation import NavigationPhase

from .inertial import error_model as em
from .inertial.filter import ErrorStateFilter
from .integrity.error_monitor import ErrorMonitor
from .integrity.protection_levels import MAX_DISTANCE_M, Levels, protection_levels
from .integrity.set_up_spread import SetUpSpread
from .settings import Settings
from .timeline.engine import Engine

FloatArray = npt.NDArray[np.float64]


class Solution(NamedTuple):
    """State of the IMU at an inertial sample, with covariances (3, 3) in m², m²/s² and rad², NED."""

    time_ns: int
    phase: NavigationPhase
    position: Geodetic
    velocity: Vector
    roll: float
    pitch: float
    yaw: float
    position_cov: FloatArray
    velocity_cov: FloatArray
    attitude_cov: FloatArray
    rate: Vector
    accelerometer_bias: Vector
    gyroscope_bias: Vector
    stationary: bool
    gnss_age_s: float | None
    protection_level_horizontal: float  # [m] exceeded by the error with probability `integrity_risk`
    protection_level_vertical: float  # [m] likewise, of the height
    integrity_risk: float
    triangles: tuple[Symmetric3, Symmetric3, Symmetric3]  # upper halves of the three covariances
    gyroscope_bias_sd: Vector
    gnss_excluded_since_ns: int | None  # no GNSS with a later stamp is used

    def reaching(self, apart_n: Vector, levels_m: tuple[float, float]) -> "Solution":
        """Widen the levels, and the covariance with them, to another solution that may be the true one.

        Parameters
        ----------
        apart_n : tuple of float
            [m, NED] This position minus the other.
        levels_m : tuple of float
            [m] Horizontal and vertical protection level of the other.

        Notes
        -----
        Of hypotheses that cannot be told apart, each bounds the error about its own solution::

            L = max( L_this, |d| + L_other )
        """
        horizontal = max(self.protection_level_horizontal, hypot(apart_n[0], apart_n[1]) + levels_m[0])
        vertical = max(self.protection_level_vertical, abs(apart_n[2]) + levels_m[1])
        position_cov = self.position_cov + np.outer(apart_n, apart_n)
        return self._replace(
            protection_level_horizontal=min(horizontal, MAX_DISTANCE_M),
            protection_level_vertical=min(vertical, MAX_DISTANCE_M),
            position_cov=position_cov,
            triangles=(upper(position_cov.tolist()), *self.triangles[1:]),
        )


class Uncertainty(NamedTuple):
    """Protection levels and covariances of a solution."""

    levels: Levels
    covariances: tuple[FloatArray, FloatArray, FloatArray]  # of position, velocity, attitude
    triangles: tuple[Symmetric3, Symmetric3, Symmetric3]
    gyroscope_bias_sd: Vector


class UncertaintyCache:
    """Uncertainty of the solution, which is computed when the covariance or the innovation statistics change."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.spread = SetUpSpread.of(settings)  # of lever arm and delay; replaced by what the checks find
        self._key: tuple[FloatArray, ErrorMonitor, SetUpSpread] | None = None
        self._uncertainty: Uncertainty

    def of(self, navigation: ErrorStateFilter, monitor: ErrorMonitor) -> Uncertainty:
        """Uncertainty of a filter; covariance and statistics are never changed in place, so identity is enough."""
        key = navigation.P, monitor, self.spread
        if self._key is None or any(value is not other for value, other in zip(self._key, key, strict=True)):
            time_ns, _, velocity, _ = navigation.inertial
            P = navigation.P
            position_cov = P[em.POSITION, em.POSITION]
            way = np.multiply(monitor.delay_s, velocity)  # driven in a delay that is not corrected
            held = monitor.held.vector_n
            covariances = (
                position_cov + np.outer(way, way) + np.outer(held, held),
                P[em.VELOCITY, em.VELOCITY],
                P[em.ATTITUDE, em.ATTITUDE],
            )
            rows = [covariance.tolist() for covariance in covariances]
            levels = protection_levels(
                position_cov.tolist(),
                velocity,
                time_ns,
                monitor,
                risk=self._settings.integrity.risk,
                time_sd_s=self._settings.gnss.time_sd_s,
                spread=self.spread,
            )
            x, y, z = np.sqrt(P.diagonal()[em.GYROSCOPE_BIAS]).tolist()
            triangles = upper(rows[0]), upper(rows[1]), upper(rows[2])
            self._uncertainty = Uncertainty(levels, covariances, triangles, (x, y, z))
            self._key = key
        return self._uncertainty


def solution_of(engine: Engine, uncertainty: UncertaintyCache) -> Solution | None:
    """State at the newest inertial sample, or None while there is no valid one."""
    navigation = engine.filter
    if navigation is None:
        return None
    time_ns, quaternion, velocity, _ = navigation.inertial
    roll, pitch, yaw = roll_pitch_yaw_of_quaternion(quaternion)
    levels, covariances, triangles, gyroscope_bias_sd = uncertainty.of(navigation, engine.aids.error_monitor)
    return Solution(
        time_ns=time_ns,
        phase=engine.phase,
        position=navigation.published_position,
        velocity=velocity,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        position_cov=covariances[0],
        velocity_cov=covariances[1],
        attitude_cov=covariances[2],
        rate=navigation.rate,
        accelerometer_bias=navigation.imu.accelerometer_bias,
        gyroscope_bias=navigation.imu.gyroscope_bias,
        stationary=engine.stationary,
        gnss_age_s=None if engine.accepted_ns is None else (time_ns - engine.accepted_ns) * 1e-9,
        protection_level_horizontal=levels.horizontal,
        protection_level_vertical=levels.vertical,
        integrity_risk=levels.risk,
        triangles=triangles,
        gyroscope_bias_sd=gyroscope_bias_sd,
        gnss_excluded_since_ns=engine.exclusions.gnss_since_ns,
    )


def upper(rows: list[list[float]]) -> Symmetric3:
    """Upper half of a symmetric matrix (3, 3): NN NE ND EE ED DD."""
    (nn, ne, nd), (_, ee, ed), (_, _, dd) = rows
    return nn, ne, nd, ee, ed, dd
