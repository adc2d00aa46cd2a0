"""Velocity by inertial sensors, odometer and non-holonomic constraint from an anchor on, without GNSS.

Error state, 21 elements: velocity and attitude (NED), accelerometer and gyroscope bias (body), scale of the odometer,
yaw and pitch of the forward axis in the body frame, scale of the gyroscopes, whose error is a share of the total turn
and no random walk, and the way since the anchor (NED). An estimate is corrected at once: x_true = x + error, and for
the attitude C_true = (I + sk(psi)) C.
"""

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import SECOND_NS, FilterAnchor, Increment, Strapdown
from shared.maths.kalman import Correction, correct, predict
from shared.maths.quantiles import chi_square_limit
from shared.maths.rotation import matrix_from_quaternion, quaternion_from_rotation_vector, skew

from ..settings import UNKNOWN_AXLE_M, LongSettings

FloatArray = npt.NDArray[np.float64]

VELOCITY, ATTITUDE, ACCELEROMETER, GYROSCOPE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
SCALE, YAW, PITCH = 12, 13, 14
GYROSCOPE_SCALE = slice(15, 18)
MOVED = slice(18, 21)
ANCHORED = slice(0, 15)  # states that fusion's filter has as well
SIZE = 21
STANDSTILL_SD = 0.02  # [m/s]
# [m/s] of the forward speed, above which the non-holonomic constraint is not used: the products of the errors of speed
# and direction, which its linear form leaves out, are then as large as its own noise.
LARGEST_SPEED_SD = 2.0
LEAST_ODOMETER = 10  # speeds that aid a propagation, before it speaks for the odometer
ODOMETER_REJECTIONS = 3  # in a row, after which this propagation no longer uses it


class FreePropagation:
    """A propagation from one anchor: nominal in steps of 100 ms, covariance and aiding once a second."""

    def __init__(self, anchor: FilterAnchor, settings: LongSettings, axle_m: float = UNKNOWN_AXLE_M) -> None:
        self.anchor, self._settings = anchor, settings
        self._axle_m = axle_m  # distance of the rear axle
        self.nominal = Strapdown(anchor)
        self.scale, self.yaw, self.pitch = anchor.scale, anchor.yaw, anchor.pitch
        self.moved_n = np.zeros(3)  # [m, NED] way of the antenna since the anchor
        self.odometer_rejections = 0
        self.odometer_updates = 0
        self.acceleration = np.zeros(3)  # [m/s², NED] mean of the last second
        s = settings
        added = np.repeat(
            [s.velocity_sd_m_s, s.attitude_sd_rad, s.accelerometer_bias_sd_m_s2, s.gyroscope_bias_sd_rad_s], 3
        )
        added = np.r_[added, s.odometer_scale_sd, s.mounting_sd_rad, s.mounting_sd_rad]
        self.P = np.zeros((SIZE, SIZE))
        self.P[ANCHORED, ANCHORED] = anchor.covariance + np.diag(added**2)
        self.P[GYROSCOPE_SCALE, GYROSCOPE_SCALE] = np.eye(3) * s.gyroscope_scale_sd**2
        self._gate = chi_square_limit(1, s.odometer_gate)
        self._begin()

    def age_s(self, time_ns: int) -> float:
        """Time since the anchor [s]."""
        return (time_ns - self.anchor.time_ns) / SECOND_NS

    @property
    def odometer_agrees(self) -> bool:
        """Whether the odometer has aided this propagation, and does not contradict it."""
        return self.odometer_updates >= LEAST_ODOMETER and self.odometer_rejections == 0

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
        With dv the integral of the specific force (NED), C the mean attitude, T the time, a the turn (body)::

            dv_err' = -sk(dv) psi - C T db_a,    psi' = -C T db_g - C diag(a) dk_g,
            r_err' = T v_err,    Phi = I + F + F²/2
        """
        s, T = self._settings, self._elapsed
        F = np.zeros((SIZE, SIZE))
        F[VELOCITY, ATTITUDE] = -skew(self._force)
        F[VELOCITY, ACCELEROMETER] = F[ATTITUDE, GYROSCOPE] = -self._attitude
        F[MOVED, VELOCITY] = np.eye(3) * T
        F[ATTITUDE, GYROSCOPE_SCALE] = -self._attitude * self._angle / T
        Phi = np.eye(SIZE) + F + 0.5 * F @ F
        level = self._force + np.array([0.0, 0.0, 9.80665 * T])
        force_variance = s.velocity_random_walk_m_s_sqrt_s**2 * T + (s.scale_sd**2) * float(level @ level)
        angle_variance = s.angle_random_walk_rad_sqrt_s**2 * T
        Q = np.zeros((SIZE, SIZE))
        Q[VELOCITY, VELOCITY], Q[ATTITUDE, ATTITUDE] = np.eye(3) * force_variance, np.eye(3) * angle_variance
        self.P = predict(self.P, Phi, Q)
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

        Their errors are correlated over `correlation_s`; R is multiplied by it, for one update a second. The constraint
        is used while the standard deviation of v_bx is at most `LARGEST_SPEED_SD`.
        """
        s = self._settings
        if speed is not None and self.odometer_rejections < ODOMETER_REJECTIONS:
            forward, H = self.body_row(0)
            H[SCALE] = -speed
            variance = np.array([[speed_sd**2 * s.correlation_s]])
            found = correct(self.P, np.array([self.scale * speed - forward]), H[None], variance)
            used = bool(found.distance2 <= self._gate)
            self.odometer_rejections = 0 if used else self.odometer_rejections + 1
            if used:
                self.odometer_updates += 1
                self._apply(found)
        forward, H_forward = self.body_row(0)
        if s.non_holonomic and H_forward @ self.P @ H_forward <= LARGEST_SPEED_SD**2:
            lateral, H_lateral = self.body_row(1)
            vertical, H_vertical = self.body_row(2)
            H_lateral[YAW], H_vertical[PITCH] = -forward, forward
            z = np.array([self.yaw * forward - lateral, -self.pitch * forward - vertical])
            variances = [s.lateral_sd_m_s**2 + (self._axle_m * yaw_rate) ** 2, s.vertical_sd_m_s**2]
            R = np.diag(variances) * s.correlation_s
            self._apply(correct(self.P, z, np.stack([H_lateral, H_vertical]), R))

    def stand(self) -> None:
        """Use zero velocity at a standstill that the inertial samples show."""
        H = np.eye(3, SIZE)
        self._apply(correct(self.P, -self.nominal.velocity, H, np.eye(3) * STANDSTILL_SD**2))

    def body_row(self, axis: int) -> tuple[float, FloatArray]:
        """Velocity [m/s] along a body axis, and its derivatives by the error state, shape (21,)."""
        C, v = self.nominal.ned_from_body, self.nominal.velocity
        H = np.zeros(SIZE)
        H[VELOCITY] = C[:, axis]
        H[ATTITUDE] = C[:, axis] @ skew(v)
        return float(C[:, axis] @ v), H

    def _apply(self, correction: Correction) -> None:
        """Add the estimated errors to the nominal values."""
        error, nominal = correction.x, self.nominal
        self.P = correction.P
        nominal.velocity = nominal.velocity + error[VELOCITY]
        north, east, down = error[ATTITUDE].tolist()
        turn = matrix_from_quaternion(quaternion_from_rotation_vector((north, east, down)))
        nominal.ned_from_body = turn @ nominal.ned_from_body
        nominal.accelerometer_bias = nominal.accelerometer_bias + error[ACCELEROMETER]
        nominal.gyroscope_bias = nominal.gyroscope_bias + error[GYROSCOPE]
        nominal.gyroscope_scale = nominal.gyroscope_scale + error[GYROSCOPE_SCALE]
        self.moved_n = self.moved_n + error[MOVED]
        self.scale += float(error[SCALE])
        self.yaw += float(error[YAW])
        self.pitch += float(error[PITCH])
