"""Scale of a speed in one bend, against the centripetal speed of accelerometer and gyroscope."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.earth import STANDARD_GRAVITY

FloatArray = npt.NDArray[np.float64]

# Standard deviations before the fit of what a bend does not measure by itself.
SCALE_SD = 0.5  # [-] of the inverse scale: nearly free
BIAS_SD = 0.1  # [m/s²] lateral accelerometer bias, 10 mg
TILT_SD = 0.02  # [rad] of the attitude before the bend: pitch is corrected with a time constant of 20 s
RATE_BIAS_SD = 2e-3  # [rad/s] level gyroscope bias, 0.1 deg/s since the last standstill
YAW_BIAS_SD = 5e-4  # [rad/s] vertical gyroscope bias since the last standstill
UNKNOWN_ARM_SD = 1.5  # [m] of the IMU ahead of the rear axle, where the vehicle's file does not state it
ARM_SD = 0.1  # [m] where it does
UNKNOWN_SIDE_SD = 0.3  # [m] of the IMU from the vehicle's centre line
MOUNTING_SD = 0.05  # [rad] yaw of the IMU's mounting: real ones are up to 4 degrees askew
MIN_SD = 0.02  # [m/s²] of a lateral acceleration over 0.1 s
MAX_CORRELATION = 0.9  # of successive residuals
ROUNDS = 3  # of noise and fit; the third changes the noise by less than a percent on recorded bends


@dataclass(frozen=True)
class BendSeries:
    """Levelled increments of a bend with the straights beside it, n of them, at equal steps."""

    step_s: float
    lateral: FloatArray  # shape (n,) [m/s²]
    forward: FloatArray  # shape (n,) [m/s²]
    yaw_rate: FloatArray  # shape (n,) [rad/s]


@dataclass(frozen=True)
class Arm:
    """IMU relative to the middle of the rear axle."""

    forward_m: float = 0.0
    right_m: float = 0.0
    forward_sd_m: float = UNKNOWN_ARM_SD
    right_sd_m: float = UNKNOWN_SIDE_SD


@dataclass(frozen=True)
class FittedScale:
    """Indicated speed over centripetal speed, with its standard deviation."""

    scale: float
    sd: float


def fit_scale(series: BendSeries, speed: FloatArray, arm: Arm) -> FittedScale | None:
    """Estimate the scale of a speed by weighted least squares.

    Parameters
    ----------
    series : BendSeries
        The bend, n increments.
    speed : ndarray, shape (n,)
        [m/s] Indicated speed of the rear axle at each increment.
    arm : Arm
        [m] Lever arm.

    Returns
    -------
    FittedScale or None
        None where the bend does not determine it.

    Notes
    -----
    The rear axle does not move sideways, and the IMU is l = (x, y) from it. With s the scale, r the yaw rate, psi its
    integral, e the tilt error before the bend, b the bias of the level gyroscopes, and a the forward acceleration::

        lateral = v r / s - v dr / s + bias + g [1 0] R(-psi) (e + int R(psi) b dt) + x r' - y r² + mounting a

    1/s is linear in it. Tilt, biases, arm and mounting have priors; the noise is that of the residuals, raised by their
    correlation as of a first-order process, (1 + rho)/(1 - rho).
    """
    A = _design(series, speed)
    prior = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, arm.forward_m, arm.right_m, 0.0])
    weight = 1.0 / np.array([
        SCALE_SD, YAW_BIAS_SD, BIAS_SD, TILT_SD, TILT_SD, RATE_BIAS_SD, RATE_BIAS_SD, arm.forward_sd_m, arm.right_sd_m,
        MOUNTING_SD,
    ])  # fmt: skip
    information = A.T @ A
    observed = A.T @ series.lateral
    sd = 0.1
    for _ in range(ROUNDS):
        N = information / sd**2 + np.diag(weight**2)
        solution = np.linalg.solve(N, observed / sd**2 + weight**2 * prior)
        sd = _noise(series.lateral - A @ solution)
    variance = float(np.linalg.inv(information / sd**2 + np.diag(weight**2))[0, 0])
    inverse = float(solution[0])
    if not (np.isfinite(inverse) and inverse > 0.1 and variance > 0.0):
        return None
    return FittedScale(1.0 / inverse, sqrt(variance) / inverse**2)


def _design(series: BendSeries, speed: FloatArray) -> FloatArray:
    """Partial derivatives of the lateral acceleration, shape (n, 10)."""
    r, step = series.yaw_rate, series.step_s
    angle = np.cumsum(r) * step
    c, s = np.cos(angle), np.sin(angle)
    C, S = np.cumsum(c) * step, np.cumsum(s) * step
    g = STANDARD_GRAVITY
    return np.column_stack([
        speed * r, -speed, np.ones(len(r)), g * c, g * s, g * (c * C + s * S), g * (s * C - c * S),
        np.gradient(r, step), -(r**2), series.forward,
    ])  # fmt: skip


def _noise(residual: FloatArray) -> float:
    """Standard deviation [m/s²] of white noise that would do as much to a mean as these residuals."""
    power = float(residual @ residual)
    if power <= 0.0:
        return MIN_SD
    correlation = min(max(float(residual[1:] @ residual[:-1]) / power, 0.0), MAX_CORRELATION)
    return max(MIN_SD, sqrt(power / len(residual) * (1.0 + correlation) / (1.0 - correlation)))


def filled_speed(
    times_s: FloatArray, forward: FloatArray, step_s: float, sampled_s: FloatArray, speeds: FloatArray
) -> FloatArray:
    """Speed at each increment: samples, with the shape between them from the forward acceleration.

    Parameters
    ----------
    times_s, forward : ndarray, shape (n,)
        [s, m/s²] Times and accelerations of the increments.
    step_s : float
        [s] Duration of an increment.
    sampled_s, speeds : ndarray, shape (m,)
        [s, m/s] Samples that cover them.

    Notes
    -----
    With S the integral of the acceleration, v(t) = S(t) + interpolation of (v_i - S(t_i)): each sample is met, so that
    the scale of the speed is that of the samples. Straight lines between samples a second apart overestimate the least
    speed in a bend.
    """
    integral = np.cumsum(forward) * step_s
    between = np.interp(sampled_s, times_s, integral)
    filled: FloatArray = integral + np.interp(times_s, sampled_s, speeds - between)
    return filled
