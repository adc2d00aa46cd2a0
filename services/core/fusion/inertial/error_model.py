"""Error model of the filter: its states, the system matrix F, and the process noise.

Sign convention of every state, biases, scales and parameters included::

    x = estimated - true

so that a correction subtracts the estimated errors from the state (`filter.subtract_errors`), and a measurement has
z = measured - predicted = H x + noise with H = -d(predicted)/d(state). The attitude error psi is a small rotation
vector in NED axes, C_estimated = (I + sk(psi)) C; the position error is in metres NED.

The errors grow by x' = F x + noise. Attitude, velocity and position are driven by each other and by the errors of the
IMU; every other state is constant, a random walk, or a Gauss-Markov process: those of the aids, which find their own by
name (`states.LAYOUT`).
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.strapdown import POLAR_FACTOR, LocalEarth
from shared.maths.compiled import compilable, compiled, inlined
from shared.maths.earth import EARTH_RATE
from shared.maths.rotation import Quaternion, Vector

from ..states import LAYOUT

FloatArray = npt.NDArray[np.float64]

ATTITUDE = LAYOUT.place("attitude")  # [rad, NED]
VELOCITY = LAYOUT.place("velocity")  # [m/s, NED]
LEVEL = slice(ATTITUDE.start, VELOCITY.start + 2)  # attitude, and velocity north and east
POSITION = LAYOUT.place("position")  # [m, NED]
ACCELEROMETER_BIAS = LAYOUT.place("accelerometer_bias")  # [m/s², body]
GYROSCOPE_BIAS = LAYOUT.place("gyroscope_bias")  # [rad/s, body]
ACCELEROMETER_SCALE = LAYOUT.place("accelerometer_scale")  # [-]
GYROSCOPE_SCALE = LAYOUT.place("gyroscope_scale")  # [-]
SCALES = slice(ACCELEROMETER_SCALE.start, GYROSCOPE_SCALE.stop)  # accelerometers and gyroscopes
SIZE = LAYOUT.size  # with all aids; a filter has those that its settings switch on, `Layout.size_by`
MOVING = POSITION.stop  # number of states whose derivative F gives: attitude, velocity, position
DRIVING = SCALES.stop  # number of states on which that derivative depends: these and the errors of the IMU
PARAMETERS = slice(DRIVING, SIZE)  # of the aiding sensors
UNIT = np.eye(3)


@compilable
def put(F: FloatArray, rows: slice, columns: slice, block: tuple[Vector, Vector, Vector]) -> None:
    """F[rows, columns] = block, element by element, which is three times as fast as through an array."""
    i, j = rows.start, columns.start
    first, second, third = block
    F[i, j], F[i, j + 1], F[i, j + 2] = first
    F[i + 1, j], F[i + 1, j + 1], F[i + 1, j + 2] = second
    F[i + 2, j], F[i + 2, j + 1], F[i + 2, j + 2] = third


@compilable
def system_matrix(
    quaternion: Quaternion, velocity: Vector, position: Vector, earth: LocalEarth, force_n: Vector, rate_b: Vector
) -> FloatArray:
    """Matrix F of the error dynamics x' = F x.

    Parameters
    ----------
    quaternion, velocity, position, earth
        Point of linearisation, in the forms of `strapdown.mechanise`.
    force_n : tuple of float
        [m/s², NED] Specific force f_n.
    rate_b : tuple of float
        [rad/s, body] Angular rate w.

    Returns
    -------
    ndarray, shape (9, 21)
        [1/s and mixed] The rows and columns of F that are not zero.

    Notes
    -----
    With w_ie and w_en the rates of the Earth and of the NED frame, D_v and D_p derivatives by velocity and by position
    in metres::

        psi' = -sk(w_ie + w_en) psi - D_v w_en dv - D_p(w_ie + w_en) dr - C (db_g + diag(w) ds_g)
        dv'  = -sk(f_n) psi + [sk(v) D_v w_en - sk(w_en + 2 w_ie)] dv
               + [sk(v) D_p(w_en + 2 w_ie) + 2 g/r in DD] dr - C (db_a + diag(f_b) ds_a)
        dr'  = dv + [rotation and scale of the local axes] dr

    The change of the radii with latitude is neglected (0.5 % of the smallest blocks).

    References
    ----------
    P. Groves, 2nd ed., eq. 14.63 to 14.71, here with the position in metres; equals
    J. Zuriarrain Sosa et al., 2024, appendix A, after correction of its A6, A7 and A9.
    """
    (qw, qx, qy, qz), (north, east, down), (_, _, height) = quaternion, velocity, position
    (fn, fe, fd), (wx, wy, wz) = force_n, rate_b
    sine, cosine = earth.sin_latitude, earth.cos_latitude
    m, t = 1.0 / (earth.meridian_radius + height), 1.0 / (earth.transverse_radius + height)  # [1/m]
    tan = sine / cosine
    c11, c12, c13 = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)  # C
    c21, c22, c23 = 2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)
    c31, c32, c33 = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
    fx, fy, fz = c11 * fn + c21 * fe + c31 * fd, c12 * fn + c22 * fe + c32 * fd, c13 * fn + c23 * fe + c33 * fd
    en, ed = EARTH_RATE * cosine, -EARTH_RATE * sine  # w_ie; its east component is zero
    tn, te, td = east * t, -north * m, -east * t * tan  # w_en
    td_by_latitude = -east * t / (cosine * cosine)
    wn, we, wd = en + tn, te, ed + td
    geocentric_radius = earth.transverse_radius * sqrt(cosine * cosine + (POLAR_FACTOR * sine) ** 2)
    # derivatives of the Coriolis rate w_en + 2 w_ie by north and down [1/(m s)]
    cn_by_north, cd_by_north = 2.0 * ed * m, (td_by_latitude - 2.0 * en) * m
    cn_by_down, ce_by_down, cd_by_down = tn * t, te * m, td * t

    F = np.zeros((MOVING, DRIVING))
    # -sk(w_ie + w_en)
    put(F, ATTITUDE, ATTITUDE, ((0.0, wd, -we), (-wd, 0.0, wn), (we, -wn, 0.0)))
    # -D_v w_en
    put(F, ATTITUDE, VELOCITY, ((0.0, -t, 0.0), (m, 0.0, 0.0), (0.0, t * tan, 0.0)))
    # -D_p (w_ie + w_en)
    put(
        F, ATTITUDE, POSITION, ((-ed * m, 0.0, -tn * t), (0.0, 0.0, -te * m), ((en - td_by_latitude) * m, 0.0, -td * t))
    )
    # -C
    minus_C = (-c11, -c12, -c13), (-c21, -c22, -c23), (-c31, -c32, -c33)
    put(F, ATTITUDE, GYROSCOPE_BIAS, minus_C)
    # -C diag(w)
    put(
        F,
        ATTITUDE,
        GYROSCOPE_SCALE,
        (
            (-c11 * wx, -c12 * wy, -c13 * wz),
            (-c21 * wx, -c22 * wy, -c23 * wz),
            (-c31 * wx, -c32 * wy, -c33 * wz),
        ),
    )
    # -sk(f_n)
    put(F, VELOCITY, ATTITUDE, ((0.0, fd, -fe), (-fd, 0.0, fn), (fe, -fn, 0.0)))
    # sk(v) D_v w_en - sk(w_en + 2 w_ie)
    put(
        F,
        VELOCITY,
        VELOCITY,
        (
            (down * m, 2.0 * (ed + td), -te),
            (-td - 2.0 * ed, (down + north * tan) * t, wn + en),
            (2.0 * te, -2.0 * wn, 0.0),
        ),
    )
    # sk(v) D_p (w_en + 2 w_ie) + 2 g/r in DD
    put(
        F,
        VELOCITY,
        POSITION,
        (
            (east * cd_by_north, 0.0, east * cd_by_down - down * ce_by_down),
            (down * cn_by_north - north * cd_by_north, 0.0, down * cn_by_down - north * cd_by_down),
            (
                -east * cn_by_north,
                0.0,
                north * ce_by_down - east * cn_by_down + 2.0 * earth.gravity / geocentric_radius,
            ),
        ),
    )
    # -C
    put(F, VELOCITY, ACCELEROMETER_BIAS, minus_C)
    # -C diag(f_b)
    put(
        F,
        VELOCITY,
        ACCELEROMETER_SCALE,
        (
            (-c11 * fx, -c12 * fy, -c13 * fz),
            (-c21 * fx, -c22 * fy, -c23 * fz),
            (-c31 * fx, -c32 * fy, -c33 * fz),
        ),
    )
    put(F, POSITION, VELOCITY, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    # rotation of the local axes by w_en, and their scale with height and latitude
    put(F, POSITION, POSITION, ((-down * m, 0.0, -te), (-td * m / t, -(down + north * tan) * t, tn), (0.0, 0.0, 0.0)))
    return F


def transition_matrix(Ft: FloatArray, decay: FloatArray) -> FloatArray:
    """Transition matrix Phi, shape (n, n), of a short step: I + F t, but for time-correlated errors, which decay.

    Parameters
    ----------
    Ft : ndarray, shape (9, 21)
        Nonzero block of F t.
    decay : ndarray, shape (n,)
        [-] exp(-t/T) of each error, exact for any step where no other error acts on it; 1 of one that does not decay.
    """
    Phi = np.diag(decay)
    Phi[:MOVING, :DRIVING] += Ft
    return Phi


@inlined
def predicted(P: FloatArray, Ft: FloatArray, decay: FloatArray, Q: FloatArray) -> FloatArray:
    """Covariance after a step, Phi P Phi^T + diag(Q), with Phi of `transition_matrix`: only its blocks are multiplied.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    Ft, decay
        Of `transition_matrix`.
    Q : ndarray, shape (n,)
        Diagonal of the covariance of the noise.

    Returns
    -------
    ndarray, shape (n, n)
        Exactly symmetric.
    """
    after = P.copy()
    after[:MOVING] += Ft @ P[:DRIVING]
    after[:, :MOVING] += np.ascontiguousarray(after[:, :DRIVING]) @ Ft.T
    after *= decay.reshape(-1, 1) * decay
    symmetric: FloatArray = 0.5 * (after + after.T)
    symmetric += np.diag(Q)
    return symmetric


@compilable
def fitting(H: FloatArray, P: FloatArray) -> FloatArray:
    """Columns of a matrix H, of shape (m, `SIZE`) as aids make it or (m, n), of the states of P, shape (n, n)."""
    return np.ascontiguousarray(H[:, : len(P)])


def process_noise_psd(*densities: tuple[int | slice | npt.NDArray[np.intp], float]) -> FloatArray:
    """Power spectral density of the noise that drives the errors.

    Parameters
    ----------
    densities : tuple of place and float
        [unit²/s] Place of the error in the state, and density: rad²/s of attitude (S_rg, square of the angle random
        walk), m²/s³ of velocity (S_ra, square of the velocity random walk), and so on.

    Returns
    -------
    ndarray, shape (n,)
        Diagonal of the matrix; times a short step it is the covariance that the step adds.

    References
    ----------
    J. Zuriarrain Sosa et al., 2024, eq. A10, where the names of the two bias terms are swapped.
    """
    diagonal = np.zeros(SIZE)
    for place, value in densities:
        diagonal[place] = value
    return diagonal


class ProcessNoise(NamedTuple):
    """Noise that drives the errors of one filter."""

    psd: FloatArray  # [unit²/s] shape (n,): see `process_noise_psd`
    correlation_s: FloatArray  # [s] shape (n,), time T of each Gauss-Markov process; infinite of all other errors
    variance: FloatArray  # [unit²] shape (n,), s² of each Gauss-Markov process; zero of all other errors
    vibration_factor: float  # [-] on the measured vibration PSD


@compilable
def process_noise(
    noise: ProcessNoise, attitude_psd: float, velocity_psd: float, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Diagonal of the process noise Q of a step, and the decays of the errors in it.

    Parameters
    ----------
    noise : ProcessNoise
        Of the filter.
    attitude_psd, velocity_psd : float
        [rad²/s], [m²/s³] Least densities of attitude and velocity, from the measured vibration.
    step_s : float
        [s] Length t of the step.

    Returns
    -------
    tuple of ndarray
        [unit²], shape (n,); [-], shape (n,).

    Notes
    -----
    With the density q of a random walk, the stationary variance s² and the correlation time T::

        Q = q t + s² (1 - exp(-2t/T)),  decay = exp(-t/T)

    References
    ----------
    Gelb (ed.), Applied Optimal Estimation, 1974, sec. 3.6, of first-order Gauss-Markov states.
    """
    decay = np.exp(-step_s / noise.correlation_s)
    Q: FloatArray = noise.psd * step_s + noise.variance * (1.0 - decay * decay)
    Q[ATTITUDE] = max(noise.psd[ATTITUDE.start], attitude_psd) * step_s
    Q[VELOCITY] = max(noise.psd[VELOCITY.start], velocity_psd) * step_s
    return Q, decay


@compiled
def propagated(  # noqa: PLR0913, PLR0917  # compiled code takes numbers and arrays
    P: FloatArray,
    quaternion: Quaternion,
    velocity: Vector,
    position: Vector,
    earth: LocalEarth,
    velocity_gain_n: Vector,
    rotation_b: Vector,
    step_s: float,
    noise: ProcessNoise,
    attitude_psd: float,
    velocity_psd: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance after a step, and its transition: see `predicted` and `transition_matrix`.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance before.
    quaternion, velocity, position, earth
        At the end of the step: see `system_matrix`.
    velocity_gain_n, rotation_b : tuple of float
        [m/s, NED], [rad, body] Integrals of specific force and angular rate over the step.
    step_s, noise, attitude_psd, velocity_psd
        See `process_noise`.

    Returns
    -------
    tuple of ndarray
        P, shape (n, n), the block F t, shape (9, 21), and the decays, shape (n,).
    """
    (vn, ve, vd), (rx, ry, rz), per_s = velocity_gain_n, rotation_b, 1.0 / step_s
    force_n, rate_b = (vn * per_s, ve * per_s, vd * per_s), (rx * per_s, ry * per_s, rz * per_s)
    F = system_matrix(quaternion, velocity, position, earth, force_n, rate_b)
    Ft = F * step_s
    Q, decay = process_noise(noise, attitude_psd, velocity_psd, step_s)
    return predicted(P, Ft, decay, Q), Ft, decay
