"""Estimates the constant mounting rotation between the IMU and the reference, which is not a solution error."""

import numpy as np

from shared.maths.earth import FloatArray

from ..attitude import angles_of, rotations


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
    With C the rotations body to NED of the solution (s) and of the reference (r), the mounting is the mean of
    C_r^T C_s, the rotation with the least sum of squared chordal distances.

    References
    ----------
    F. L. Markley et al., "Averaging quaternions", J. Guid. Control Dyn. 30(4), 2007.
    """
    solved, true = rotations(angles), rotations(reference)
    mounting = (true.inv() * solved).mean()
    errors: FloatArray = (angles_of(solved * mounting.inv()) - reference + np.pi) % (2.0 * np.pi) - np.pi
    return angles_of(mounting), errors
