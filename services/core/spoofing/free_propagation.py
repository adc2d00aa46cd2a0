"""Velocity by inertial sensors, odometer and non-holonomic constraint from an anchor on, without GNSS.

Error state, 15 elements: velocity and attitude (NED), accelerometer and gyroscope bias (body), scale of the odometer,
and yaw and pitch of the forward axis in the body frame. An estimate is corrected at once: x_true = x + error, and for
the attitude C_true = (I + sk(psi)) C.
"""

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from shared.maths.rotation import matrix_from_rotation_vector, skew

from .settings import LongSettings
from .strapdown import SECOND_NS, Anchor, Increment, Strapdown

FloatArray = npt.NDArray[np.float64]

VELOCITY, ATTITUDE, ACCELEROMETER, GYROSCOPE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
SCALE, YAW, PITCH = 12, 13, 14
SIZE = 15
STANDSTILL_SD = 0.02  # [m/s]
ODOMETER_REJECTIONS = 3  # in a row, after which this propagation no longer uses it


class FreePropagation:
    """A propagation from one anchor: nominal in steps of 100 ms, covariance and aiding once a second."""

    def __init__(self, anchor: Anchor, settings: LongSettings) -> None:
        self.anchor, self._settings = anchor, settings
        self.nominal = Strapdown(anchor)
        self.scale, self.yaw, self.pitch = 1.0, 0.0, 0.0
        self.odometer_rejections = 0
        self.acceleration = np.zeros(3)  # [m/s², NED] mean of the last second
        s = settings
        self.P = np.zeros((SIZE, SIZE))
        self.P[VELOCITY, VELOCITY] = anchor.velocity_cov + np.eye(3) * s.velocity_sd_floor_m_s**2
        self.P[ATTITUDE, ATTITUDE] = anchor.attitude_cov + np.eye(3) * s.attitude_sd_floor_rad**2
        self.P[ACCELEROMETER, ACCELEROMETER] = np.eye(3) * s.accelerometer_bias_sd_m_s2**2
        self.P[GYROSCOPE, GYROSCOPE] = np.eye(3) * s.gyroscope_bias_sd_rad_s**2
        self.P[SCALE, SCALE] = s.odometer_scale_sd**2
        self.P[YAW, YAW] = self.P[PITCH, PITCH] = s.mounting_sd_rad**2
        self._gate = float(chdtri(1, s.odometer_gate))
        self._begin()

    def age_s(self, time_ns: int) -> float:
        """Time since the anchor [s]."""
        return (time_ns - self.anchor.time_ns) / SECOND_NS

    def advance(self, increment: Increment) -> None:
        """Propagate attitude and velocity by one increment."""
        self._attitude += self.nominal.ned_from_body * increment.duration
        self._force += self.nominal.advance(increment)
        self._angle += increment.rate_b * increment.duration
        self._elapsed += increment.duration

    def predict(self) -> None:
        """Propagate the covariance over the increments since the last call: P+ = Phi P Phi' + Q.

        Notes
        -----
        With dv the integral of the specific force (NED), C the mean attitude, T the time::

            dv_err' = -sk(dv) psi - C T db_a,    psi' = -C T db_g,    Phi = I + F + F²/2
        """
        s, T = self._settings, self._elapsed
        F = np.zeros((SIZE, SIZE))
        F[VELOCITY, ATTITUDE] = -skew(self._force)
        F[VELOCITY, ACCELEROMETER] = F[ATTITUDE, GYROSCOPE] = -self._attitude
        Phi = np.eye(SIZE) + F + 0.5 * F @ F
        self.P = Phi @ self.P @ Phi.T
        level = self._force + np.array([0.0, 0.0, 9.80665 * T])
        force_variance = s.velocity_random_walk_m_s_sqrt_s**2 * T + (s.scale_sd**2) * float(level @ level)
        angle_variance = s.angle_random_walk_rad_sqrt_s**2 * T + (s.scale_sd**2) * float(self._angle @ self._angle)
        self.P[VELOCITY, VELOCITY] += np.eye(3) * force_variance
        self.P[ATTITUDE, ATTITUDE] += np.eye(3) * angle_variance
        self.acceleration = level / T
        self._begin()

    def _begin(self) -> None:
        self._attitude, self._force, self._angle = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
        self._elapsed = 0.0

    def aid(self, speed: float | None, speed_sd: float, yaw_rate: float) -> None:
        """Use the odometer's speed and the non-holonomic constraint.

        Parameters
        ----------
        speed, speed_sd : float
            [m/s] Of the odometer at the time of the last increment, None without one.
        yaw_rate : float
            [rad/s] By which the lateral velocity of the IMU differs from that of the rear axle.

        Notes
        -----
        With v_b = C' v, residuals r = H error and the variances R::

            s u - v_bx = 0,    v_by - yaw v_bx = 0,    v_bz + pitch v_bx = 0
            H of v_b: [C', C' sk(v)]

        Their errors are correlated over `correlation_s`; R is multiplied by it, for one update a second.
        """
        s = self._settings
        if speed is not None and self.odometer_rejections < ODOMETER_REJECTIONS:
            forward, H = self._body_row(0)
            H[SCALE] = -speed
            used = self._update(self.scale * speed - forward, H, speed_sd**2 * s.correlation_s, gate=self._gate)
            self.odometer_rejections = 0 if used else self.odometer_rejections + 1
        if s.non_holonomic:
            lateral_variance = s.lateral_sd_m_s**2 + (s.rear_axle_distance_m * yaw_rate) ** 2
            forward = self._body_row(0)[0]
            lateral, H = self._body_row(1)
            H[YAW] = -forward
            self._update(self.yaw * forward - lateral, H, lateral_variance * s.correlation_s)
            vertical, H = self._body_row(2)
            H[PITCH] = forward
            self._update(-self.pitch * forward - vertical, H, s.vertical_sd_m_s**2 * s.correlation_s)

    def stand(self) -> None:
        """Use zero velocity at a standstill that the inertial samples show."""
        for axis in range(3):
            H = np.zeros(SIZE)
            H[axis] = 1.0
            self._update(-float(self.nominal.velocity[axis]), H, STANDSTILL_SD**2)

    def _body_row(self, axis: int) -> tuple[float, FloatArray]:
        """Velocity [m/s] along a body axis, and its derivatives by the error state, shape (15,)."""
        C, v = self.nominal.ned_from_body, self.nominal.velocity
        H = np.zeros(SIZE)
        H[VELOCITY] = C[:, axis]
        H[ATTITUDE] = C[:, axis] @ skew(v)
        return float(C[:, axis] @ v), H

    def _update(self, residual: float, H: FloatArray, variance: float, *, gate: float | None = None) -> bool:
        """Update by a scalar residual; False if the gate on r²/S rejects it."""
        PH = self.P @ H
        S = float(H @ PH) + variance
        if gate is not None and residual**2 / S > gate:
            return False
        error = PH * (residual / S)
        self.P = self.P - np.outer(PH, PH) / S
        nominal = self.nominal
        nominal.velocity = nominal.velocity + error[VELOCITY]
        nominal.ned_from_body = matrix_from_rotation_vector(error[ATTITUDE]) @ nominal.ned_from_body
        nominal.accelerometer_bias = nominal.accelerometer_bias + error[ACCELEROMETER]
        nominal.gyroscope_bias = nominal.gyroscope_bias + error[GYROSCOPE]
        self.scale += float(error[SCALE])
        self.yaw += float(error[YAW])
        self.pitch += float(error[PITCH])
        return True
