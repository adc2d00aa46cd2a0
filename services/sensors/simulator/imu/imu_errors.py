"""Errors of a MEMS inertial sensor: white noise, in-run bias (Gauss-Markov), turn-on bias and vibration.

The Allan variance of the first two is, with N the noise density, B and T standard deviation and correlation
time of the in-run bias::

    s²(t) = N²/t + 2 B² T/t (1 - T/(2t) (3 - 4 exp(-t/T) + exp(-2t/T)))
"""

from dataclasses import dataclass
from math import exp, pi, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.earth import STANDARD_GRAVITY

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_DEGREE = pi / 180.0
_BLOCK = 1000  # [steps] over which the recursion is vectorised; longer blocks lose precision


@dataclass(frozen=True)
class SensorGrade:
    """Error parameters of one triad, 1 sigma per axis; in rad/s or m/s²."""

    density: float  # [unit/sqrt(Hz)] white noise
    in_run_bias: float  # [unit] first-order Gauss-Markov bias
    in_run_bias_time: float  # [s] its correlation time
    turn_on: float  # [unit] turn-on bias, constant until power-off
    vibration: float  # [unit] white noise of each sample while the vehicle moves


# Xsens, MTi 600-series datasheet: noise densities and in-run bias stability; turn-on and vibration as in a car.
MTI_630_GYROSCOPE = SensorGrade(0.007 * _DEGREE, 8.0 * _DEGREE / 3600.0, 200.0, 0.1 * _DEGREE, 0.05 * _DEGREE)
MTI_630_ACCELEROMETER = SensorGrade(
    60e-6 * STANDARD_GRAVITY, 10e-6 * STANDARD_GRAVITY, 200.0, 2e-3 * STANDARD_GRAVITY, 0.05
)


class SensorErrors:
    """The errors of one triad; the result for a seed is independent of the block lengths."""

    def __init__(self, grade: SensorGrade, step: float, seed: tuple[int, ...]) -> None:
        self._grade, self._step = grade, step
        self._noise, self._drift, self._vibration, start = (np.random.default_rng((*seed, i)) for i in range(4))
        self.turn_on: FloatArray = grade.turn_on * start.standard_normal(3)
        self._in_run_bias: FloatArray = grade.in_run_bias * start.standard_normal(3)

    def advance(self, moving: BoolArray) -> FloatArray:
        """Draw the errors of the next samples.

        Parameters
        ----------
        moving : ndarray, shape (n,)
            Whether the vehicle moves during each sample.

        Returns
        -------
        ndarray, shape (n, 3)
            [rad/s or m/s²] To be added to the ideal readings, which are means over a step.
        """
        noise = self._noise.standard_normal((len(moving), 3)) * (self._grade.density / sqrt(self._step))
        vibration = self._vibration.standard_normal((len(moving), 3)) * self._grade.vibration
        blocks = [self._advance_in_run_bias(min(_BLOCK, len(moving) - i)) for i in range(0, len(moving), _BLOCK)]
        errors: FloatArray = self.turn_on + np.concatenate(blocks) + noise + moving[:, np.newaxis] * vibration
        return errors

    def _advance_in_run_bias(self, n: int) -> FloatArray:
        """Bias of the next n samples: b+ = phi b + sqrt(1 - phi²) B w, exact at any step."""
        phi = exp(-self._step / self._grade.in_run_bias_time)
        powers = phi ** np.arange(1, n + 1)[:, np.newaxis]
        driven = self._drift.standard_normal((n, 3)) * (sqrt(1.0 - phi * phi) * self._grade.in_run_bias)
        bias: FloatArray = powers * (self._in_run_bias + np.cumsum(driven / powers, axis=0))
        self._in_run_bias = bias[-1]
        return bias
