"""Estimates the constant mounting rotation between the IMU and the reference, which is not a solution error."""

import numpy as np
import numpy.typing as npt

from shared.maths.earth import FloatArray
from shared.maths.rotation import roll_pitch_yaw


def without_mounting(angles: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate the mounting as one constant rotation, and compute the attitude errors after its removal.

    Parameters
    ----------
    angles, reference : ndarray, shape (n, 3)
        [rad] Roll, pitch and yaw of the solution and of the reference at equal times.

    Returns
    -------
    mounting : ndarray, shape (3,)
        [rad] Roll, pitch and yaw of the solution's axes relative to those of the reference.
    errors : ndarray, shape (n, 3)
        [rad] Roll, pitch and yaw of the solution, corrected by the mounting, minus those of the reference, in
        (-pi, pi].

    Notes
    -----
    With C the rotations body to NED of the solution (s) and of the reference (r), the mounting M is the rotation
    closest to the mean of the differences (singular value decomposition)::

        U S V^T = mean( C_r^T C_s ),    M = U diag(1, 1, det(U V^T)) V^T

    References
    ----------
    F. L. Markley et al., "Averaging quaternions", J. Guid. Control Dyn. 30(4), 2007 (here for matrices).
    """
    solved, true = _matrices(angles), _matrices(reference)
    left, _, right = np.linalg.svd(np.einsum("nji,njk->ik", true, solved))
    mounting = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    turned = solved @ mounting.T
    back = np.column_stack(
        [
            np.arctan2(turned[:, 2, 1], turned[:, 2, 2]),
            -np.arcsin(np.clip(turned[:, 2, 0], -1.0, 1.0)),
            np.arctan2(turned[:, 1, 0], turned[:, 0, 0]),
        ]
    )
    errors: FloatArray = (back - reference + np.pi) % (2.0 * np.pi) - np.pi
    return np.array(roll_pitch_yaw(mounting)), errors


def _matrices(angles: FloatArray) -> npt.NDArray[np.float64]:
    """Rotations body to NED, shape (n, 3, 3): vectorised `shared.maths.rotation.ned_from_body`."""
    sines, cosines = np.sin(angles).T, np.cos(angles).T
    (sr, sp, sy), (cr, cp, cy) = sines, cosines
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
