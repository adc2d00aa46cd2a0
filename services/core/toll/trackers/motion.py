"""Displacement on an arc with constant acceleration and yaw rate, and the noise of chains of integrators.

Frame: a local tangent plane, x east and y north; headings are mathematical, counter-clockwise from +x.
"""

from math import factorial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


class Arc(NamedTuple):
    """Displacement during a step, and its derivatives."""

    displacement: FloatArray  # shape (..., 2) [m]
    jacobian: FloatArray  # shape (..., 2, 4): with respect to heading, speed, acceleration and yaw rate


def arc(heading: FloatArray, speed: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, dt: FloatArray) -> Arc:
    """Displacement with constant acceleration and constant yaw rate (CTRA); CTRV and straight lines are its limits.

    Parameters
    ----------
    heading, speed, acceleration, yaw_rate : ndarray, shape (...)
        [rad], [m/s], [m/s²], [rad/s] At the begin of the step.
    dt : ndarray, shape (...)
        [s] Length of the step.

    Returns
    -------
    Arc
        Displacement and Jacobian.

    Notes
    -----
    ::

        d = ∫₀^dt V(t) (cos θ(t), sin θ(t)) dt,    V(t) = v + a t,    θ(t) = θ + w t

    and its derivatives, differentiated under the integral. The closed form divides by w² and loses its digits on
    straight roads. Gauss-Legendre quadrature with six nodes has no such limit: its relative error is below 2e-13 for
    |w dt| up to 1 rad.
    """
    t = 0.5 * dt[..., None] * (NODES + 1.0)
    weight = 0.5 * dt[..., None] * WEIGHTS
    angle = heading[..., None] + yaw_rate[..., None] * t
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-2)  # shape (..., 2, nodes)
    across = np.stack([-along[..., 1, :], along[..., 0, :]], axis=-2)
    V = speed[..., None] + acceleration[..., None] * t
    jacobian = np.stack(
        [
            np.matvec(across, weight * V),
            np.matvec(along, weight),
            np.matvec(along, weight * t),
            np.matvec(across, weight * V * t),
        ],
        axis=-1,
    )
    return Arc(np.matvec(along, weight * V), jacobian)


def integrated_noise(order: int, dt: FloatArray) -> FloatArray:
    """Covariance of a chain of integrators that is driven by white noise of unit spectral density.

    Parameters
    ----------
    order : int
        Number of states n; the noise drives the last one, each state is the integral of the next.
    dt : ndarray, shape (...)
        [s] Length of the step.

    Returns
    -------
    ndarray, shape (..., order, order)
        Q; a step of dt adds as much as its two halves.

    Notes
    -----
    ::

        Q_ij = dt^(p+q+1) / (p! q! (p+q+1)),    p = n-1-i,  q = n-1-j
    """
    p = np.arange(order - 1, -1, -1)
    factorials = np.array([factorial(k) for k in p], dtype=np.float64)
    power = p[:, None] + p[None, :] + 1
    Q: FloatArray = dt[..., None, None] ** power / (factorials[:, None] * factorials[None, :] * power)
    return Q
