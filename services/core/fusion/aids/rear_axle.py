"""Velocity of the middle of the rear axle, which wheels measure and which the non-holonomic constraint is about."""

import numpy as np
import numpy.typing as npt

from shared.maths.compiled import compiled
from shared.maths.rotation import Quaternion, Vector, cross, matrix_from_quaternion, ned_from_body, skew

from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..settings import Settings
from ..states import LAYOUT

FloatArray = npt.NDArray[np.float64]

MOUNTING = LAYOUT.place("mounting")  # [rad] pitch, yaw
UNKNOWN_ARM_SD = 1.0  # [m] of the rear axle, where its position is not configured


def rear_axle_of(navigation: ErrorStateFilter, settings: Settings) -> tuple[FloatArray, FloatArray]:
    """Velocity of the rear axle by a filter [m/s, vehicle], and the matrix of its errors: see `rear_axle`."""
    first, arm = MOUNTING.start, settings.vehicle.rear_axle_body_m or (0.0, 0.0, 0.0)
    pitch, yaw = navigation.parameter(first), navigation.parameter(first + 1)
    return rear_axle(navigation.quaternion, navigation.velocity, navigation.rate, arm, pitch, yaw)


@compiled
def rear_axle(
    quaternion: Quaternion, velocity_n: Vector, rate_b: Vector, arm_b: Vector, pitch: float, yaw: float
) -> tuple[FloatArray, FloatArray]:
    """Velocity of the rear axle in the axes of the vehicle, and matrix H of true minus this velocity.

    Parameters
    ----------
    quaternion : tuple of float
        Attitude, NED from body, C.
    velocity_n : tuple of float
        [m/s, NED] Velocity v of the IMU.
    rate_b : tuple of float
        [rad/s, body] Angular rate w, bias removed; the Earth's rate times the arm is left out.
    arm_b : tuple of float
        [m, body] Lever arm l from the IMU to the middle of the rear axle.
    pitch, yaw : float
        [rad] Mounting M, vehicle from body: its yaw about the vehicle's z, after its pitch about the IMU's y. Its roll
        is not observable, and zero.

    Returns
    -------
    tuple of ndarray
        [m/s] M u, shape (3,), with u = C^T v + w x l; and H, shape (3, 37), rows forward, right, down.

    Notes
    -----
    With e_y and e_z unit vectors::

        H = [ -M C^T sk(v), -M C^T, 0, 0, -M sk(l), 0, -M (e_y x u), -e_z x M u ]
    """
    C, M = matrix_from_quaternion(quaternion), ned_from_body(0.0, pitch, yaw)
    vehicle_from_ned = M @ C.T
    u = C.T @ np.array(velocity_n) + np.array(cross(rate_b, arm_b))
    Mu = M @ u
    H = np.zeros((3, em.SIZE))
    H[:, em.ATTITUDE] = -vehicle_from_ned @ skew(velocity_n)
    H[:, em.VELOCITY] = -vehicle_from_ned
    H[:, em.GYROSCOPE_BIAS] = -M @ skew(arm_b)
    H[:, MOUNTING.start] = -M @ np.array([u[2], 0.0, -u[0]])
    H[:, MOUNTING.start + 1] = np.array([Mu[1], -Mu[0], 0.0])
    return Mu, H
