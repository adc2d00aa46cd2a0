"""Ideal inertial measurements of a known motion: the exact inverse of the strapdown mechanisation.

Velocity and attitude at the nodes are given. Position follows by the trapezoidal rule of the mechanisation, and
the ideal measurements follow by solving its equations for the inputs. The same mechanisation, applied to these
measurements, reproduces the trajectory to rounding.
"""

from dataclasses import dataclass
from math import cos

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, earth_rate_n, gravity, transport_rate_n
from shared.maths.ellipsoid import curvature_radii

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Position, gravity and frame rates at the n + 1 nodes of a track."""

    position: FloatArray  # shape (n + 1, 3) [rad, rad, m] latitude, longitude, height
    gravity: FloatArray  # shape (n + 1,) [m/s²]
    earth_rate_n: FloatArray  # shape (n + 1, 3) [rad/s] Earth against inertial space
    transport_rate_n: FloatArray  # shape (n + 1, 3) [rad/s] NED against Earth


def integrate_position(start: Geodetic, velocity_n: FloatArray, step: float) -> Place:
    """Integrate a velocity over the ellipsoid.

    Parameters
    ----------
    start : Geodetic
        [rad, rad, m] Position of the first node.
    velocity_n : ndarray, shape (n + 1, 3)
        [m/s, NED] Velocity at each node.
    step : float
        [s] Time between nodes.

    Returns
    -------
    Place
        Position, gravity and frame rates at each node.

    Notes
    -----
    With + for the next node, R_N and R_E the radii of curvature and L the latitude::

        h+ = h - T/2 (v_D + v_D+)
        L+ = L + T/2 (v_N / (R_N(L) + h) + v_N+ / (R_N(L) + h+))
        l+ = l + T/2 (v_E / ((R_E(L) + h) cos L) + v_E+ / ((R_E(L+) + h+) cos L+))

    References
    ----------
    P. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 5.56.
    """
    latitude, longitude, height = start
    half = 0.5 * step
    velocities = velocity_n.tolist()
    north, east, down = velocities[0]
    meridian, transverse = curvature_radii(latitude)
    east_rate = east / ((transverse + height) * cos(latitude))
    places: list[tuple[float, float, float]] = []
    rates: list[tuple[float, ...]] = []
    for velocity in velocities:
        lower, height = height, height - half * (down + velocity[2]) if places else height
        if places:
            latitude += half * (north / (meridian + lower) + velocity[0] / (meridian + height))
            meridian, transverse = curvature_radii(latitude)
            last, east_rate = east_rate, velocity[1] / ((transverse + height) * cos(latitude))
            longitude += half * (last + east_rate)
        north, east, down = velocity
        places.append((latitude, longitude, height))
        rates.append((
            gravity(latitude, height), *earth_rate_n(latitude), *transport_rate_n(latitude, height, velocity)
        ))  # fmt: skip
    table = np.array(rates)
    return Place(np.array(places), table[:, 0], table[:, 1:4], table[:, 4:7])


def ideal_rates(place: Place, ned_from_body: FloatArray, step: float) -> FloatArray:
    """Mean angular rate over each step, as measured by an ideal gyroscope.

    Parameters
    ----------
    place : Place
        The track, n + 1 nodes.
    ned_from_body : ndarray, shape (n + 1, 3, 3)
        Attitude at each node.
    step : float
        [s] Time between nodes.

    Returns
    -------
    ndarray, shape (n, 3)
        [rad/s, body] Relative to inertial space.

    Notes
    -----
    ::

        exp(sk(w T)) = C' exp(sk(w_ie + (w_en + w_en+)/2) T) C+

    References
    ----------
    P. Groves, 2nd ed., 5.76, solved for the angular rate.
    """
    turn_n = place.earth_rate_n[:-1] + 0.5 * (place.transport_rate_n[:-1] + place.transport_rate_n[1:])
    turned = np.swapaxes(ned_from_body[:-1], 1, 2) @ _rotations(turn_n * step) @ ned_from_body[1:]
    rates: FloatArray = _small_rotation_vectors(turned) / step
    return rates


def ideal_forces(
    place: Place, velocity_n: FloatArray, ned_from_body: FloatArray, rate_b: FloatArray, step: float
) -> FloatArray:
    """Mean specific force over each step, as measured by an ideal accelerometer.

    Parameters
    ----------
    place : Place
        The track, n + 1 nodes.
    velocity_n : ndarray, shape (n + 1, 3)
        [m/s, NED] Velocity at each node.
    ned_from_body : ndarray, shape (n + 1, 3, 3)
        Attitude at each node.
    rate_b : ndarray, shape (n, 3)
        [rad/s, body] Result of `ideal_rates`.
    step : float
        [s] Time between nodes.

    Returns
    -------
    ndarray, shape (n, 3)
        [m/s², body] About (0, 0, -9.8) at standstill.

    Notes
    -----
    With a = w T, the mean attitude of a step and the force are::

        C_mean = C (I + (1 - cos|a|)/|a|² sk(a) + (1 - sin|a|/|a|)/|a|² sk(a)²) - sk(w_ie + w_en) C T/2
        f      = C_mean^-1 ((v+ - v)/T - g + (2 w_ie + w_en) x v)

    References
    ----------
    P. Groves, 2nd ed., 5.84 to 5.86 and 5.54, solved for the specific force.
    """
    C, velocity = ned_from_body[:-1], velocity_n[:-1]
    earth, transport = place.earth_rate_n[:-1], place.transport_rate_n[:-1]
    mean = C @ _mean_rotations(rate_b * step) - 0.5 * step * _skews(earth + transport) @ C
    force_n = (velocity_n[1:] - velocity) / step
    force_n += np.cross(2.0 * earth + transport, velocity)
    force_n[:, 2] -= place.gravity[:-1]
    force: FloatArray = np.linalg.solve(mean, force_n[:, :, np.newaxis])[:, :, 0].astype(np.float64, copy=False)
    return force


def attitude_matrices(attitude: FloatArray) -> FloatArray:
    """Rotation matrices NED from body, shape (n, 3, 3), of roll, pitch and yaw [rad], shape (n, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(attitude).T, np.cos(attitude).T
    rows = [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy]
    rows += [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy]
    rows += [-sp, sr * cp, cr * cp]
    return np.stack(rows, axis=-1).reshape(-1, 3, 3)


def _skews(vectors: FloatArray) -> FloatArray:
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    return matrices - np.swapaxes(matrices, 1, 2)


def _rotations(vectors: FloatArray) -> FloatArray:
    angle = np.linalg.norm(vectors, axis=1)
    return _rodrigues(vectors, np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2)


def _mean_rotations(vectors: FloatArray) -> FloatArray:
    """Mean of exp(s sk(a)) over s from 0 to 1: the average attitude during a rotation at constant rate."""
    angle2 = (vectors**2).sum(axis=1)
    angle = np.sqrt(angle2)
    # At small angles the closed form of the second factor suffers cancellation; four series terms are exact there.
    series = 1.0 / 6.0 - angle2 / 120.0 * (1.0 - angle2 / 42.0 * (1.0 - angle2 / 72.0))
    second = np.where(angle < 0.1, series, (1.0 - np.sinc(angle / np.pi)) / np.maximum(angle2, 1e-9))
    return _rodrigues(vectors, 0.5 * np.sinc(0.5 * angle / np.pi) ** 2, second)


def _rodrigues(vectors: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """I + first sk(a) + second sk(a)², shape (n, 3, 3)."""
    S = _skews(vectors)
    matrices: FloatArray = np.eye(3) + first[:, None, None] * S + second[:, None, None] * (S @ S)
    return matrices


def _small_rotation_vectors(matrices: FloatArray) -> FloatArray:
    """Rotation vectors [rad], shape (n, 3), of rotations by less than 90 degrees."""
    doubled = np.stack([
        matrices[:, 2, 1] - matrices[:, 1, 2],
        matrices[:, 0, 2] - matrices[:, 2, 0],
        matrices[:, 1, 0] - matrices[:, 0, 1],
    ], axis=-1)  # fmt: skip
    angle = np.arcsin(0.5 * np.linalg.norm(doubled, axis=1, keepdims=True))
    vectors: FloatArray = 0.5 * doubled / np.sinc(angle / np.pi)
    return vectors
