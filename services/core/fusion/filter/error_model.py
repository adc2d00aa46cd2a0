"""How errors grow: x = (attitude, velocity, position; biases and scales of the IMU; parameters of what aids it).

Errors are estimated minus true. The attitude error is a small rotation vector in NED axes, with which
C_estimated = (I + sk(psi)) C; the position error is in metres NED; biases and scales are what is left of them after
the correction already made, and are therefore added to it. x' = F x + noise: the first nine are driven by the first
twenty-one, and every other one goes its own way, constant or with a walk or a decay of its own.
"""

from math import sqrt
from struct import Struct

import numpy as np
import numpy.typing as npt

from shared.maths.earth import EARTH_RATE
from shared.maths.rotation import Vector, cross, skew

from .strapdown import POLAR_FACTOR, Motion

FloatArray = npt.NDArray[np.float64]

ATTITUDE = slice(0, 3)
VELOCITY = slice(3, 6)
POSITION = slice(6, 9)
ACCELEROMETER_BIAS = slice(9, 12)
GYROSCOPE_BIAS = slice(12, 15)
ACCELEROMETER_SCALE = slice(15, 18)
GYROSCOPE_SCALE = slice(18, 21)
SCALES = slice(15, 21)
ODOMETER_SCALE = 21
MOUNTING = slice(22, 24)  # pitch, yaw
VEHICLE = slice(21, 24)
GNSS_ERROR = slice(24, 27)  # [-] of GNSS positions, the part that lasts over its standard deviation
GNSS_DELAY = 27  # [s] by which GNSS is older than its stamp
ODOMETER_DELAY = 28  # [s]
BAROMETER_OFFSET = 29  # [m] of barometric height
GNSS_VELOCITY_DELAY = 30  # [s] by which GNSS velocity is older still
DELAYS = np.array([GNSS_DELAY, ODOMETER_DELAY, GNSS_VELOCITY_DELAY])
SIZE = 31
MOVING = 9  # the first nine errors grow by
DRIVING = 21  # the first twenty-one
PARAMETERS = slice(DRIVING, SIZE)
MINUS_ONE = -np.eye(3)


# Where F is not zero: rows of attitude, velocity, position; columns of the same, biases and scales of the IMU.
PATTERN = """
    . x x  . x .  x . x   . . .  x x x   . . .  x x x
    x . x  x . .  . . x   . . .  x x x   . . .  x x x
    x x .  . x .  x . x   . . .  x x x   . . .  x x x
    . x x  x x x  x . x   x x x  . . .   x x x  . . .
    x . x  x x x  x . x   x x x  . . .   x x x  . . .
    x x .  x x .  x . x   x x x  . . .   x x x  . . .
    . . .  x . .  x . x   . . .  . . .   . . .  . . .
    . . .  . x .  x x x   . . .  . . .   . . .  . . .
    . . .  . . x  . . .   . . .  . . .   . . .  . . .
"""
PLACES = np.array([place for place, mark in enumerate(PATTERN.split()) if mark == "x"])
# The same in Phi, with what is there of the unit matrix, and the diagonal of the lasting errors.
UNCHANGED = np.eye(SIZE)
PLACES_OF_PHI = PLACES // DRIVING * SIZE + PLACES % DRIVING
ONES = UNCHANGED.reshape(-1)[PLACES_OF_PHI]
LASTING = slice(GNSS_ERROR.start * (SIZE + 1), GNSS_ERROR.stop * (SIZE + 1), SIZE + 1)
RATES = Struct(f"{len(PLACES)}d")  # NumPy takes numbers from bytes at a fifth of what a tuple costs


def system_matrix(motion: Motion, force_n: Vector, rate_b: Vector) -> FloatArray:
    """Matrix F of the error model, shape (9, 21) [1/s and mixed], as far as it is not zero: see `error_rates`."""
    F = np.zeros(MOVING * DRIVING)
    F[PLACES] = error_rates(motion, force_n, rate_b)
    return F.reshape(MOVING, DRIVING)


def transition_matrix(rates: tuple[float, ...], step_s: float, remains: float) -> FloatArray:
    """Matrix Phi of a short step.

    Parameters
    ----------
    rates : tuple of float
        [1/s and mixed] Elements of F, as of `error_rates`.
    step_s : float
        [s] Its length.
    remains : float
        [-] exp(-step / correlation time): what remains of the lasting errors of GNSS.

    Returns
    -------
    ndarray, shape (31, 31)
        I + F t, with `remains` on the diagonal of `GNSS_ERROR`: exact at any step for these, as nothing drives them.
    """
    Phi = UNCHANGED.copy()
    elements = Phi.reshape(-1)
    elements[PLACES_OF_PHI] = ONES + np.frombuffer(RATES.pack(*rates)) * step_s
    elements[LASTING] = remains
    return Phi


def error_rates(motion: Motion, force_n: Vector, rate_b: Vector) -> tuple[float, ...]:
    """Elements of the matrix F of the error model, row by row, where `PATTERN` has a mark.

    Parameters
    ----------
    motion : tuple
        Where the errors are linearised, as of `strapdown.mechanise`.
    force_n : tuple of float
        [m/s², NED] Specific force.
    rate_b : tuple of float
        [rad/s, body] Angular rate, for the errors of its scale.

    Returns
    -------
    tuple of float
        [1/s and mixed]

    Notes
    -----
    With w the rates w_ie and w_en, and D_v, D_p their derivatives by velocity and by position in metres::

        psi' = -sk(w_ie + w_en) psi - D_v w_en dv - D_p(w_ie + w_en) dr + C (b_g + diag(w) s_g)
        dv'  = -sk(f_n) psi + [sk(v) D_v w_en - sk(w_en + 2 w_ie)] dv
               + [sk(v) D_p(w_en + 2 w_ie) + 2 g/r in DD] dr + C (b_a + diag(f_b) s_a)
        dr'  = dv + [turn and stretch of the local axes] dr

    The change of the radii with latitude is neglected (0.5 % of the smallest blocks). The body is these products,
    multiplied out in plain floats, for it runs twenty times a second.

    References
    ----------
    P. Groves, 2nd ed., eq. 14.63 to 14.71, here with the position in metres; equals
    J. Zuriarrain Sosa et al., 2024, appendix A, after correction of its A6, A7 and A9.
    """
    (qw, qx, qy, qz), (north, east, down), (_, _, height), (sine, cosine, meridian, transverse, surface, _) = motion
    m, t = 1.0 / (meridian + height), 1.0 / (transverse + height)
    tangent, secant2 = sine / cosine, 1.0 / (cosine * cosine)
    earth_n, earth_d = EARTH_RATE * cosine, -EARTH_RATE * sine
    et, nm = east * t, north * m
    turn_n, turn_e, turn_d = earth_n + et, -nm, earth_d - et * tangent
    fn, fe, fd = force_n
    wx, wy, wz = rate_b
    c11, c12, c13 = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)
    c21, c22, c23 = 2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)
    c31, c32, c33 = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
    fx, fy, fz = c11 * fn + c21 * fe + c31 * fd, c12 * fn + c22 * fe + c32 * fd, c13 * fn + c23 * fe + c33 * fd
    free_air = 2.0 * surface / (transverse * sqrt(cosine * cosine + (POLAR_FACTOR * sine) ** 2))

    # fmt: off
    return (
        turn_d, -turn_e, -t, -earth_d * m, -et * t, c11, c12, c13, c11 * wx, c12 * wy, c13 * wz,
        -turn_d, turn_n, m, nm * m, c21, c22, c23, c21 * wx, c22 * wy, c23 * wz,
        turn_e, -turn_n, tangent * t, (earth_n + et * secant2) * m, et * tangent * t,
        c31, c32, c33, c31 * wx, c32 * wy, c33 * wz,
        fd, -fe, down * m, 2.0 * (earth_d - et * tangent), nm,
        -(et * secant2 + 2.0 * earth_n) * east * m, nm * down * m - et * et * tangent,
        c11, c12, c13, c11 * fx, c12 * fy, c13 * fz,
        -fd, fn, et * tangent - 2.0 * earth_d, (north * tangent + down) * t, et + 2.0 * earth_n,
        (north * et * secant2 + 2.0 * (north * earth_n + down * earth_d)) * m, (north * tangent + down) * et * t,
        c21, c22, c23, c21 * fx, c22 * fy, c23 * fz,
        fe, -fn, -2.0 * nm, -2.0 * (et + earth_n), -2.0 * east * earth_d * m, free_air - et * et - nm * nm,
        c31, c32, c33, c31 * fx, c32 * fy, c33 * fz,
        1.0, -down * m, nm,
        1.0, east * tangent * m, -(down + north * tangent) * t, et,
        1.0,
    )
    # fmt: on


def noise_density(*densities: tuple[int | slice | npt.NDArray[np.intp], float]) -> FloatArray:
    """Power spectral density of the noise that drives the errors.

    Parameters
    ----------
    densities : tuple of place and float
        [unit²/s] Place of the error in the state, and density: rad²/s of attitude (S_rg, square of the angle random
        walk), m²/s³ of velocity (S_ra, square of the velocity random walk), and so on.

    Returns
    -------
    ndarray, shape (31,)
        Diagonal of the matrix; times a short step it is the covariance that the step adds.

    References
    ----------
    J. Zuriarrain Sosa et al., 2024, eq. A10, with the names of the two bias terms put right.
    """
    diagonal = np.zeros(SIZE)
    for place, value in densities:
        diagonal[place] = value
    return diagonal


def added_variances(
    density: FloatArray, shaking: tuple[float, ...], factor: float, step_s: float, remains: float
) -> FloatArray:
    """Variances that a step adds to the errors.

    Parameters
    ----------
    density : ndarray, shape (31,)
        [unit²/s] As of `noise_density`.
    shaking : tuple of float
        [m²/s³], [rad²/s] Density of the measured vibration: force, rate.
    factor : float
        [-] Share of it that velocity and attitude are given, if they have less.
    step_s : float
        [s] Length of the step.
    remains : float
        [-] As of `transition_matrix`; the lasting errors of GNSS keep the variance one.

    Returns
    -------
    ndarray, shape (31,)
        [unit²]

    References
    ----------
    Gelb (ed.), Applied Optimal Estimation, 1974, sec. 3.6, of first-order Gauss-Markov states.
    """
    added: FloatArray = density * step_s
    added[ATTITUDE] = step_s * max(density.item(0), factor * shaking[1])
    added[VELOCITY] = step_s * max(density.item(3), factor * shaking[0])
    added[GNSS_ERROR] = 1.0 - remains * remains
    return added


def antenna_position_matrix(arm_n: Vector) -> FloatArray:
    """Matrix H, shape (3, 31), of GNSS minus predicted antenna position [m, NED], for the arm C l [m, NED]."""
    H = np.zeros((3, SIZE))
    H[:, ATTITUDE] = skew(arm_n)
    H[:, POSITION] = MINUS_ONE
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
    ndarray, shape (3, 31)
        The small term of the Earth's rate in the prediction is neglected.

    Notes
    -----
    ::

        H = [ sk(C (w x l)), -I, 0, 0, C sk(l), 0, 0 ]

    References
    ----------
    P. Groves, 2nd ed., eq. 14.115; J. Zuriarrain Sosa et al., 2024, eq. A12.
    """
    H = np.zeros((3, SIZE))
    H[:, ATTITUDE] = skew(ned_from_body @ cross(rate_b, arm_b))
    H[:, VELOCITY] = MINUS_ONE
    H[:, GYROSCOPE_BIAS] = ned_from_body @ skew(arm_b)
    return H


def axle_velocity_matrix(
    arm_b: Vector, velocity_n: Vector, axle_velocity_b: FloatArray, ned_from_body: FloatArray, M: FloatArray
) -> FloatArray:
    """Matrix H of true minus predicted velocity of the rear axle, in the axes of the vehicle.

    Parameters
    ----------
    arm_b : tuple of float
        [m, body] Lever arm l from the IMU to the middle of the rear axle.
    velocity_n : tuple of float
        [m/s, NED] Velocity v of the IMU.
    axle_velocity_b : ndarray, shape (3,)
        [m/s, body] u = C^T v + w x l.
    ned_from_body : ndarray, shape (3, 3)
        [-] Attitude C.
    M : ndarray, shape (3, 3)
        [-] Vehicle from body: the mounting's yaw about the vehicle's z, after its pitch about the IMU's y.

    Returns
    -------
    ndarray, shape (3, 31)
        Rows forward, right, down. The roll of the mounting is taken for zero: driving does not show it.

    Notes
    -----
    With e_y and e_z unit vectors::

        H = [ -M C^T sk(v), -M C^T, 0, 0, M sk(l), 0, -M (e_y x u), -e_z x M u ]
    """
    u, ahead = axle_velocity_b, M @ axle_velocity_b
    vehicle_from_ned = M @ ned_from_body.T
    H = np.zeros((3, SIZE))
    H[:, ATTITUDE] = -vehicle_from_ned @ skew(velocity_n)
    H[:, VELOCITY] = -vehicle_from_ned
    H[:, GYROSCOPE_BIAS] = M @ skew(arm_b)
    H[:, MOUNTING.start] = -M @ np.array([u[2], 0.0, -u[0]])
    H[:, MOUNTING.start + 1] = ahead[1], -ahead[0], 0.0
    return H
