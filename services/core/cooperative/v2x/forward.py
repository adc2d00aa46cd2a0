"""Cubature Kalman filter of the vehicle's position, velocity, receiver clock and radio oscillator in a local NED frame.

The leading axes of an estimate are any number of filters that run side by side: a bank, or the runs of a simulation.

::

    p' = v,  v' = n_a,  b_c' = d,  d' = n_d,  o' = n_o
    range-rate to neighbour j:   z = e (v - v_j) + o + n,       e = (p - p_j)/|p - p_j|
    road:                        0 = across (p - p_road) + n,   0 = (p - p_road)_D + n,   0 = across v + n
    pseudorange of satellite i:  y = -u_i p + b_c + n
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..measurements import FloatArray
from .road import Road

POSITION, VELOCITY = slice(0, 3), slice(3, 6)
DRIFT, OSCILLATOR, CLOCK = 6, 7, 8  # [m/s] clock drift; [m/s] c y_r of the radio; [m] first clock bias
MIN_RANGE_M = 0.1  # [m] below it no direction is computed
MIN_VARIANCE = 1e-9  # [m², m²/s²] keeps the covariance of position and velocity regular
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ForwardSettings:
    """Process noise, and standard deviations of what the map says."""

    acceleration_sd: float = 0.5  # [m/s²] horizontal, for one second
    vertical_acceleration_sd: float = 0.1
    clock_drift_sd: float = 0.1  # [m/s per sqrt(s)] of a temperature-compensated oscillator
    clock_sd: float = 0.3  # [m per sqrt(s)]
    oscillator_sd: float = 0.5  # [m/s per sqrt(s)] of the radio's oscillator
    cross_track_sd: float = 1.0  # [m]
    height_sd: float = 1.0
    lateral_speed_sd: float = 0.3  # [m/s]


class Estimate(NamedTuple):
    """State, shape (..., 8 + c), and covariance, shape (..., 8 + c, 8 + c), for c clocks."""

    x: FloatArray
    P: FloatArray


class Neighbours(NamedTuple):
    """What m neighbours published and what the radio measured, in the local frame."""

    position_n: FloatArray  # [m] shape (..., m, 3)
    velocity_n: FloatArray  # [m/s] shape (..., m, 3)
    shifted_rate: FloatArray  # [m/s] shape (..., m): range-rate plus c y_r: -(c/f0) CFO + c y_t
    position_sd: FloatArray  # [m] shape (..., m)
    rate_sd: FloatArray  # [m/s] shape (..., m), of the range-rate, the neighbour's velocity included


def predict(estimate: Estimate, dt: float, settings: ForwardSettings) -> Estimate:
    """Propagate by dt [s]."""
    size = estimate.x.shape[-1]
    F, Q = np.eye(size), np.zeros((size, size))
    F[POSITION, VELOCITY] = dt * np.eye(3)
    F[CLOCK:, DRIFT] = dt
    sd = np.array([settings.acceleration_sd, settings.acceleration_sd, settings.vertical_acceleration_sd])
    for axis, variance in enumerate((sd**2).tolist()):
        p, v = axis, 3 + axis
        Q[p, p], Q[v, v] = variance * dt**3 / 3.0, variance * dt
        Q[p, v] = Q[v, p] = variance * dt**2 / 2.0
    drift = settings.clock_drift_sd**2
    Q[DRIFT, DRIFT] = drift * dt
    Q[DRIFT, CLOCK:] = Q[CLOCK:, DRIFT] = drift * dt**2 / 2.0
    Q[CLOCK:, CLOCK:] = drift * dt**3 / 3.0 + settings.clock_sd**2 * dt  # one oscillator moves all clocks alike
    Q[OSCILLATOR, OSCILLATOR] = settings.oscillator_sd**2 * dt
    return Estimate(estimate.x @ F.T, F @ estimate.P @ F.T + Q)


def correct(
    estimate: Estimate, rows: FloatArray, innovations: FloatArray, variances: FloatArray, used: BoolArray
) -> Estimate:
    """Correct by m uncorrelated measurements, one after the other, all linearised at the same state.

    Parameters
    ----------
    estimate : Estimate
        Before.
    rows : ndarray, shape (..., m, size)
        Jacobian.
    innovations, variances : ndarray, shape (..., m)
        Measured minus predicted at the state before, and the variance of the measurement.
    used : ndarray, shape (..., m)
        Measurements that are not used leave the estimate as it is.
    """
    x, P = estimate.x.copy(), estimate.P.copy()
    lead = x.shape[:-1]
    for k in range(rows.shape[-2]):
        h = np.broadcast_to(rows[..., k, :], x.shape)
        Ph = np.einsum("...ij,...j->...i", P, h)
        moved = np.einsum("...i,...i", h, x - estimate.x)
        S = np.einsum("...i,...i", h, Ph) + variances[..., k]
        weight = np.broadcast_to(used[..., k], lead) / S
        x += (weight * (innovations[..., k] - moved))[..., np.newaxis] * Ph
        P -= (weight[..., np.newaxis] * Ph)[..., :, np.newaxis] * Ph[..., np.newaxis, :]
    return Estimate(x, P)


def range_rates(x: FloatArray, neighbours: Neighbours) -> FloatArray:
    """Range-rates e (v - v_j) [m/s], shape (..., m), of states, shape (..., 6): position and velocity."""
    dp = x[..., np.newaxis, POSITION] - neighbours.position_n
    dv = x[..., np.newaxis, VELOCITY] - neighbours.velocity_n
    distance = np.sqrt(np.einsum("...i,...i", dp, dp))
    rates: FloatArray = np.einsum("...i,...i", dp, dv) / np.maximum(distance, MIN_RANGE_M)
    return rates


def linearised_range_rates(estimate: Estimate, neighbours: Neighbours) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Linearise the range-rates over the spread of the estimate, by cubature.

    Returns
    -------
    ndarray, shape (..., m); ndarray, shape (..., m, 6); ndarray, shape (..., m)
        [m/s] Mean, slope per position and velocity, and [m²/s²] the variance that the slope does not explain. Where
        the estimate is sharp, these are the range-rate, its Jacobian and 0.

    Notes
    -----
    With L L' = P of position and velocity (n = 6) and the points x ± sqrt(n) L_i::

        z = mean z(x_i),   slope = D L^-1,  D_i = (z_i+ - z_i-)/(2 sqrt(n)),   rest = mean (z_i - z)² - |D|²

    References
    ----------
    I. Arasaratnam, S. Haykin, "Cubature Kalman filters", IEEE Trans. Automatic Control 54(6), 2009.
    """
    n = 6
    x, P = estimate.x[..., :n], estimate.P[..., :n, :n]
    L = np.linalg.cholesky(P + MIN_VARIANCE * np.eye(n))
    spread = np.sqrt(n) * np.swapaxes(L, -1, -2)  # rows are the columns of L
    points = np.concatenate([x[..., np.newaxis, :] + spread, x[..., np.newaxis, :] - spread], axis=-2)
    # (..., 12, m): the filters' axes of the neighbours are in front of the points'
    apart = neighbours._replace(
        position_n=neighbours.position_n[..., np.newaxis, :, :], velocity_n=neighbours.velocity_n[..., np.newaxis, :, :]
    )
    z = range_rates(points, apart)
    mean = z.mean(axis=-2)
    D = np.swapaxes(z[..., :n, :] - z[..., n:, :], -1, -2) / (2.0 * np.sqrt(n))
    slope = D @ np.linalg.inv(L)
    rest = ((z - mean[..., np.newaxis, :]) ** 2).mean(axis=-2) - (D**2).sum(axis=-1)
    return mean, slope, np.maximum(rest, 0.0)


def range_rate_observations(estimate: Estimate, neighbours: Neighbours) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give rows, innovations and variances of the range-rates, shapes (..., m, size), (..., m) and (..., m).

    The uncertainty of the neighbours' positions is part of the variance.
    """
    mean, slope, rest = linearised_range_rates(estimate, neighbours)
    rows = np.zeros((*mean.shape, estimate.x.shape[-1]))
    rows[..., :6] = slope
    rows[..., OSCILLATOR] = 1.0
    innovations = neighbours.shifted_rate - mean - estimate.x[..., OSCILLATOR, np.newaxis]
    variances = neighbours.rate_sd**2 + (slope[..., POSITION] ** 2).sum(axis=-1) * neighbours.position_sd**2 + rest
    return rows, innovations, variances


def correct_range_rates(estimate: Estimate, neighbours: Neighbours) -> Estimate:
    """Use the neighbours' range-rates."""
    rows, innovations, variances = range_rate_observations(estimate, neighbours)
    return correct(estimate, rows, innovations, variances, np.ones(rows.shape[-2], dtype=np.bool_))


def correct_road(
    estimate: Estimate, road: Road, settings: ForwardSettings, error_n: FloatArray | float = 0.0
) -> Estimate:
    """Use the map as pseudo-measurements: no cross-track offset, the map's height, no lateral speed.

    Parameters
    ----------
    estimate : Estimate
        Before.
    road : Road
        Centre line.
    settings : ForwardSettings
        Standard deviations.
    error_n : ndarray, shape (..., 3), or 0
        [m, m, m/s] Errors of the three, which a simulation adds.
    """
    foot = road.foot(estimate.x[..., POSITION])
    away = estimate.x[..., POSITION] - foot.position_n
    rows = np.zeros((*estimate.x.shape[:-1], 3, estimate.x.shape[-1]))
    rows[..., 0, POSITION] = foot.across
    rows[..., 1, 2] = 1.0
    rows[..., 2, VELOCITY] = foot.across
    lateral = (foot.across * estimate.x[..., VELOCITY]).sum(axis=-1)
    predicted = np.stack([(foot.across * away).sum(axis=-1), away[..., 2], lateral], axis=-1)
    variances = np.array([settings.cross_track_sd, settings.height_sd, settings.lateral_speed_sd]) ** 2
    return correct(estimate, rows, error_n - predicted, variances, np.ones(3, dtype=np.bool_))
