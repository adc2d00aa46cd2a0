"""The pulses of a plaza's detectors, and how they err."""

import numpy as np
from pydantic import Field

from shared.runtime.config import Section

NS = 1_000_000_000
HOUR_S = 3600.0
DOUBLE_S = (0.15, 0.6)  # [s] by which the second pulse of a vehicle is later: its rear axle, or a trailer


class Detectors(Section):
    """How the detectors at the gate line err."""

    jitter_s: float = Field(default=0.0, ge=0.0, le=1.0, description="standard deviation of the time of a pulse")
    missed: float = Field(default=0.0, ge=0.0, le=1.0, description="share of vehicles without a pulse")
    doubled: float = Field(default=0.0, ge=0.0, le=1.0, description="share of vehicles with two pulses")
    false_per_hour: float = Field(
        default=0.0, ge=0.0, le=3600.0, description="pulses of a lane that no vehicle causes, in an hour"
    )


class Detector:
    """Draws the pulses; its random numbers are its own, so that it changes nothing else."""

    def __init__(self, settings: Detectors, rng: np.random.Generator) -> None:
        self._settings, self._rng = settings, rng

    def of_vehicle(self, crossing_ns: int) -> list[int]:
        """Times of the pulses of a vehicle that crosses the gate line."""
        settings = self._settings
        missed, doubled = self._rng.random(2)
        jitter, later = self._rng.standard_normal(), self._rng.uniform(*DOUBLE_S)
        if missed < settings.missed:
            return []
        first_ns = crossing_ns + round(settings.jitter_s * jitter * NS)
        return [first_ns, first_ns + round(later * NS)] if doubled < settings.doubled else [first_ns]

    def of_nothing(self, begin_ns: int, step_s: float, lanes: int) -> list[tuple[int, int]]:
        """Lanes and times of the false pulses in a step of all lanes (a Poisson process)."""
        mean = self._settings.false_per_hour * step_s / HOUR_S
        if mean == 0.0:
            return []
        return [
            (lane, begin_ns + round(float(self._rng.random()) * step_s * NS))
            for lane, number in enumerate(self._rng.poisson(mean, lanes))
            for _ in range(number)
        ]
