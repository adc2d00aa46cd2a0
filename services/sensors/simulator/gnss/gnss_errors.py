"""Errors of a GNSS receiver's position and velocity, and the standard deviations that match them."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from math import exp, sqrt

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

BASE_SD = {"none": (0.25, 0.25, 0.4), "float": (0.1, 0.1, 0.16), "fixed": (0.01, 0.01, 0.015)}  # [m, NED]
VELOCITY_SD = (0.05, 0.05, 0.08)  # [m/s, NED]


class ErrorKind(StrEnum):
    """Random process of an injected position error."""

    NONE = "none"
    WHITE = "white"
    GAUSS_MARKOV = "gauss_markov"
    WIENER = "wiener"  # zero at the start of each period


@dataclass(frozen=True)
class InjectedError:
    """A position error that is added to the receiver noise."""

    kind: ErrorKind = ErrorKind.NONE
    rmse_ned_m: Vector = (0.0, 0.0, 0.0)
    correlation_s: float = 5.0  # correlation time of the Gauss-Markov process
    exact: bool = False  # the total position error of a period, receiver noise included, has exactly this RMSE


@dataclass(frozen=True)
class PositionErrors:
    """Errors of the epochs of one period."""

    noise: FloatArray  # shape (n, 3) [-] receiver noise of unit standard deviation
    injected: FloatArray  # shape (n, 3) [m, NED]
    velocity: FloatArray  # shape (n, 3) [m/s, NED]
    last: FloatArray  # shape (3,) [-] last value of the injected error of unit standard deviation


def position_errors(
    error: InjectedError,
    n: int,
    step: float,
    *,
    seed: tuple[int, ...],
    settled: int = 0,
    last: FloatArray | None = None,
) -> PositionErrors:
    """Draw the errors of one period.

    Parameters
    ----------
    error : InjectedError
        The error to inject.
    n : int
        Number of epochs.
    step : float
        [s] Time between epochs.
    seed : tuple of int
        The same seed gives the same errors.
    settled : int
        Number of initial epochs (alignment) excluded from an exact RMSE.
    last : ndarray, shape (3,), optional
        `last` of the previous period, from which a Gauss-Markov error continues.

    Returns
    -------
    PositionErrors
        If the error is exact, the injected part is scaled so that its sum with the noise of an
        autonomous fix has the given RMSE over the epochs from `settled` on.
    """
    noise_rng, velocity_rng, injected_rng = (np.random.default_rng((*seed, i)) for i in range(3))
    noise = noise_rng.standard_normal((n, 3))
    shape = _SHAPES[error.kind](injected_rng.standard_normal((n, 3)), exp(-step / error.correlation_s), last)
    rmse = np.array(error.rmse_ned_m)
    if error.exact:
        injected = shape * _exact_scale(shape[settled:], noise[settled:] * BASE_SD["none"], rmse)
    else:
        injected = shape * rmse
    return PositionErrors(noise, injected, velocity_rng.standard_normal((n, 3)) * VELOCITY_SD, shape[-1])


def position_sd(error: InjectedError, carrier: str) -> FloatArray:
    """Standard deviation [m, NED], shape (3,), of the total position error."""
    own = np.zeros(3) if error.exact else np.array(BASE_SD[carrier])
    return np.hypot(own, error.rmse_ned_m)


def _exact_scale(shape: FloatArray, noise: FloatArray, rmse: FloatArray) -> FloatArray:
    """Positive root k of mean((noise + k shape)²) = rmse², axis by axis."""
    a, half_b, c = (shape**2).mean(axis=0), (shape * noise).mean(axis=0), (noise**2).mean(axis=0) - rmse**2
    if np.any(c >= 0.0):
        raise ValueError(f"the receiver noise exceeds the RMSE {rmse.tolist()}")
    scale: FloatArray = (-half_b + np.sqrt(half_b**2 - a * c)) / a
    return scale


def _white(draws: FloatArray, _phi: float, _last: FloatArray | None) -> FloatArray:
    return draws


def _gauss_markov(draws: FloatArray, phi: float, last: FloatArray | None) -> FloatArray:
    drive = sqrt(1.0 - phi * phi)
    walk = [draws[0] if last is None else phi * last + drive * draws[0]]
    for draw in draws[1:]:
        walk.append(phi * walk[-1] + drive * draw)
    return np.array(walk)


def _wiener(draws: FloatArray, _phi: float, _last: FloatArray | None) -> FloatArray:
    """Random walk from zero, with a mean square of about one over the period."""
    walk: FloatArray = np.cumsum(draws, axis=0) * sqrt(2.0 / len(draws))
    return walk


def _zero(draws: FloatArray, _phi: float, _last: FloatArray | None) -> FloatArray:
    return np.zeros_like(draws)


_SHAPES: dict[ErrorKind, Callable[[FloatArray, float, FloatArray | None], FloatArray]] = {
    ErrorKind.NONE: _zero,
    ErrorKind.WHITE: _white,
    ErrorKind.GAUSS_MARKOV: _gauss_markov,
    ErrorKind.WIENER: _wiener,
}
