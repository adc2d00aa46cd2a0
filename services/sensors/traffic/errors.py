"""GNSS errors at the plaza: common to all receivers, individual of each, and those of the unit's own receiver."""

from math import exp, sqrt

import numpy as np
import numpy.typing as npt
from pydantic import Field

from shared.runtime.config import Section

ELLIPSE_95 = 2.45  # standard deviations of an axis in an ellipse of 95 %

FloatArray = npt.NDArray[np.float64]


class ErrorModel(Section):
    """Horizontal GNSS errors, standard deviations per axis; all but white noise are first-order Gauss-Markov."""

    common_sd_m: float = Field(
        default=3.0,
        ge=0.0,
        le=100.0,
        description="standard deviation of the error that all receivers share: atmosphere, orbits, clocks",
    )
    common_s: float = Field(default=600.0, gt=0.0, description="correlation time of the common error")
    multipath_sd_m: float = Field(
        default=0.6, ge=0.0, le=100.0, description="standard deviation of the multipath error of each vehicle"
    )
    multipath_s: float = Field(default=20.0, gt=0.0, description="correlation time of the multipath error")
    white_sd_m: float = Field(
        default=0.4, ge=0.0, le=100.0, description="standard deviation of the white error of each position"
    )
    unit_sd_m: float = Field(
        default=0.3, ge=0.0, le=100.0, description="standard deviation of the multipath error of the unit's own antenna"
    )
    unit_s: float = Field(default=60.0, gt=0.0, description="correlation time of the error of the unit's own antenna")
    ellipse_m: float | None = Field(
        default=None,
        gt=0.0,
        le=40.0,
        description="semi-axis of the 95 % ellipse that vehicles state; without it, that of their errors",
    )

    def stated_sd(self, *, corrected: bool) -> float:
        """Standard deviation [m] of a horizontal axis that a vehicle states."""
        if self.ellipse_m is not None:
            return self.ellipse_m / ELLIPSE_95
        common_sd = 0.0 if corrected else self.common_sd_m
        return sqrt(common_sd**2 + self.multipath_sd_m**2 + self.white_sd_m**2)


class GaussMarkov:
    """A stationary first-order Gauss-Markov process of two axes: x' = φ x + √(1 - φ²) σ w, φ = exp(-Δt/τ)."""

    def __init__(self, sd: float, correlation_s: float, step_s: float, rng: np.random.Generator) -> None:
        self._phi = exp(-step_s / correlation_s)
        self._drive = sd * sqrt(1.0 - self._phi**2)
        self._rng = rng
        self.value: FloatArray = sd * rng.standard_normal(2)

    def step(self) -> None:
        """Advance by one step."""
        self.value = self._phi * self.value + self._drive * self._rng.standard_normal(2)
