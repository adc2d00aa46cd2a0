"""Rotations in three dimensions: rotation vectors, matrices, quaternions, and roll, pitch and yaw.

Matrices are named `to_from_from`: `v_n = ned_from_body @ v_b`. Quaternions are Hamilton quaternions (w, x, y, z) of
unit norm with w >= 0, and represent the same rotation as their matrix. These functions are for live processes;
offline tools use `scipy.spatial.transform.Rotation`.
"""

from collections.abc import Sequence
from math import asin, atan2, cos, sin, sqrt

import numpy as np
import numpy.typing as npt

from .compiled import compilable

FloatArray = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_SMALL_ANGLE = 1e-4  # [rad] below it, three terms of the series are exact to rounding


@compilable
def skew(vector: Sequence[float] | FloatArray) -> FloatArray:
    """Skew-symmetric matrix sk(a), shape (3, 3), of the vector product: sk(a) b = a x b."""
    x, y, z = vector[0], vector[1], vector[2]
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@compilable
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product a x b, in plain floats."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compilable
def ned_from_body(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation matrix from body axes (forward, right, down) to north, east and down.

    Parameters
    ----------
    roll, pitch, yaw : float
        [rad] Applied in the order yaw, pitch, roll from NED to body. Positive: right side down, nose up, heading
        clockwise from north.

    Returns
    -------
    ndarray, shape (3, 3)
        C_nb = R_z(yaw) R_y(pitch) R_x(roll).
    """
    sr, cr, sp, cp, sy, cy = sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw)
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )


def roll_pitch_yaw_of_quaternion(quaternion: Quaternion) -> Vector:
    """Roll, pitch and yaw [rad] of a unit quaternion NED from body; at pitch ±90° the roll is 0."""
    w, x, y, z = quaternion
    sine = 2.0 * (w * y - x * z)
    pitch = asin(max(-1.0, min(1.0, sine)))
    if abs(sine) > 1.0 - 1e-12:
        return 0.0, pitch, atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    roll = atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    return roll, pitch, atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@compilable
def matrix_from_quaternion(quaternion: Quaternion) -> FloatArray:
    """Rotation matrix, shape (3, 3), of a unit quaternion."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_from_matrix(matrix: npt.ArrayLike) -> Quaternion:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix.

    Notes
    -----
    Divides by the largest of the four components, which avoids singularities.

    References
    ----------
    S. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978.
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(matrix, dtype=np.float64).tolist()
    candidates = (
        (1.0 + a + e + i, h - f, c - g, d - b),
        (h - f, 1.0 + a - e - i, b + d, c + g),
        (c - g, b + d, 1.0 - a + e - i, f + h),
        (d - b, c + g, f + h, 1.0 - a - e + i),
    )
    w, x, y, z = max(candidates, key=lambda q: sum(component * component for component in q))
    norm = sqrt(w * w + x * x + y * y + z * z)
    scale = -1.0 / norm if w < 0.0 else 1.0 / norm
    return w * scale, x * scale, y * scale, z * scale


@compilable
def quaternion_product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Hamilton product: the rotation `right` followed by the rotation `left`."""
    a, b, c, d = left
    e, f, g, h = right
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


@compilable
def quaternion_from_rotation_vector(rotation_vector: Vector) -> Quaternion:
    """Unit quaternion of a rotation vector [rad]; w < 0 for angles above pi."""
    x, y, z = rotation_vector
    angle2 = x * x + y * y + z * z
    if angle2 < _SMALL_ANGLE**2:
        scale, w = 0.5 - angle2 / 48.0, 1.0 - angle2 / 8.0
    else:
        half = 0.5 * sqrt(angle2)
        scale, w = 0.5 * sin(half) / half, cos(half)
    return w, scale * x, scale * y, scale * z
