"""Antenna of the receiver: its velocity against the IMU, and the matrices H of its position and velocity."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import rotate
from shared.maths.earth import earth_rate_n
from shared.maths.rotation import Quaternion, Vector, cross, skew

from ...inertial import error_model as em
from ...inertial.filter import ErrorStateFilter

FloatArray = npt.NDArray[np.float64]


def antenna_velocity(navigation: ErrorStateFilter, lever_arm: Vector) -> Vector:
    """Velocity of the antenna against the IMU [m/s, NED]: C (w x l) - w_ie x C l."""
    return _swing(navigation.quaternion, navigation.position.latitude, navigation.rate, lever_arm)


@lru_cache(maxsize=1)  # of one velocity it is asked twice
def _swing(quaternion: Quaternion, latitude: float, rate: Vector, lever_arm: Vector) -> Vector:
    north, east, down = rotate(quaternion, cross(rate, lever_arm))
    n, e, d = cross(earth_rate_n(latitude), rotate(quaternion, lever_arm))
    return north - n, east - e, down - d


def antenna_position_matrix(arm_n: Vector) -> FloatArray:
    """Matrix H, shape (3, 37), of GNSS minus predicted antenna position [m, NED], for the arm C l [m, NED]."""
    H = np.zeros((3, em.SIZE))
    H[:, em.ATTITUDE] = skew(arm_n)
    H[:, em.POSITION] = -em.UNIT
    return H


def antenna_velocity_matrix(arm_b: Vector, rate_b: Vector, ned_from_body: FloatArray) -> FloatArray:
    """Matrix H of GNSS minus predicted antenna velocity.

    Parameters
    ----------
    arm_b : tuple of float
        [m, body] Lever arm l from the IMU to the antenna.
    rate_b : tuple of float
        [rad/s, body] Angular rate w, bias removed.
    ned_from_body : ndarray, shape (3, 3)
        [-] Attitude C.

    Returns
    -------
    ndarray, shape (3, 37)
        The term of the Earth's rate in the prediction is neglected.

    Notes
    -----
    ::

        H = [ sk(C (w x l)), -I, 0, 0, -C sk(l), 0, 0 ]

    References
    ----------
    P. Groves, 2nd ed., eq. 14.115; J. Zuriarrain Sosa et al., 2024, eq. A12.
    """
    H = np.zeros((3, em.SIZE))
    H[:, em.ATTITUDE] = skew(ned_from_body @ cross(rate_b, arm_b))
    H[:, em.VELOCITY] = -em.UNIT
    H[:, em.GYROSCOPE_BIAS] = -ned_from_body @ skew(arm_b)
    return H
