"""The rotation by which an IMU sits askew in the axes of its reference, which is no error of a solution."""

import numpy as np

from shared.maths.earth import FloatArray

from ..attitude import angles_of, rotations


def without_mounting(angles: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate the mounting as one constant rotation, and give the errors of attitude that are left without it.

    Parameters
    ----------
    angles, reference : ndarray, shape (n, 3)
        [rad] Roll, pitch and yaw of the solution and of the reference at the same instants.

    Returns
    -------
    mounting : ndarray, shape (3,)
        [rad] Roll, pitch and yaw of the solution's axes in those of the reference.
    errors : ndarray, shape (n, 3)
        [rad] Roll, pitch and yaw of the solution, turned back by the mounting, minus the reference's, in (-pi, pi].

    Notes
    -----
    With C the rotations body to NED of the solution (s) and of the reference (r), the mounting is the mean of
    C_r^T C_s: the rotation with the least sum of squared chordal distances.

    References
    ----------
    F. L. Markley et al., "Averaging quaternions", J. Guid. Control Dyn. 30(4), 2007.
    """
    solved, true = rotations(angles), rotations(reference)
    mounting = (true.inv() * solved).mean()
    errors: FloatArray = (angles_of(solved * mounting.inv()) - reference + np.pi) % (2.0 * np.pi) - np.pi
    return angles_of(mounting), errors
