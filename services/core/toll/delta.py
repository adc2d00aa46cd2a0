"""Delta position: the GNSS error that the road-side unit and the vehicles have in common.

The unit's antenna is surveyed. What its receiver errs by is added, with the opposite sign, to the vehicles' positions::

    Δ = p_antenna - p_fix,    p_corrected = p_vehicle + Δ
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.maths.correlated_noise import mean_variance

FloatArray = npt.NDArray[np.float64]
MAXIMUM_M = 100.0  # a receiver that is further off is not in error, but broken or deceived


@dataclass(frozen=True)
class ErrorModel:
    """Standard deviations [m] of one horizontal axis and correlation times [s] of GNSS errors at the plaza."""

    common_sd: float = 3.0  # orbits, clocks, ionosphere, troposphere: the same for all receivers at the plaza
    common_s: float = 600.0
    vehicle_sd: float = 0.6  # multipath of a vehicle's receiver
    vehicle_s: float = 20.0
    unit_sd: float = 0.3  # multipath of the unit's receiver
    unit_s: float = 60.0

    def change_variance(self, elapsed_s: float) -> float:
        """Variance [m²] of the change of the common error in a time: that of a Gauss-Markov process."""
        return float(2.0 * self.common_sd**2 * -np.expm1(-elapsed_s / self.common_s))


@dataclass(frozen=True)
class Delta:
    """The smoothed common error; it is added to a vehicle's position."""

    time_ns: int  # of the newest fix in it
    east: float  # [m]
    north: float  # [m]
    sd: float  # [m] of each axis at `time_ns`
    fixes: int
    window_s: float  # time that the fixes span


class DeltaEstimator:
    """Averages antenna minus fix over a moving window.

    Notes
    -----
    The mean over T differs from the common error at its end by the change of a Gauss-Markov process (correlation time
    τ, far longer than T), by the unit's multipath, and by nothing else::

        σ² = 2 σ_c²/τ_c · T/3 + 1/n² Σᵢⱼ σ_m² exp(-|tᵢ-tⱼ|/τ_m)
    """

    def __init__(self, model: ErrorModel, *, window_s: float, least_s: float, max_age_s: float) -> None:
        self._model = model
        self._window_ns, self._least_ns = round(window_s * 1e9), round(least_s * 1e9)
        self._max_age_ns = round(max_age_s * 1e9)
        self._samples: deque[tuple[int, float, float]] = deque(maxlen=2000)

    def add(self, time_ns: int, east: float, north: float) -> str | None:
        """Use one fix: its position [m] relative to the surveyed antenna; return why it is rejected, else None."""
        if np.hypot(east, north) > MAXIMUM_M:
            return "fix_far_from_antenna"
        if self._samples and time_ns <= self._samples[-1][0]:
            return "fix_out_of_order"
        if self._samples and time_ns - self._samples[-1][0] > self._max_age_ns:
            self._samples.clear()  # the receiver may have come back with other satellites
        self._samples.append((time_ns, -east, -north))
        while time_ns - self._samples[0][0] > self._window_ns:
            self._samples.popleft()
        return None

    def delta(self, now_ns: int) -> Delta | str:
        """Return the delta position, or why there is none."""
        if not self._samples:
            return "no fix of the unit's receiver"
        newest_ns, oldest_ns = self._samples[-1][0], self._samples[0][0]
        if now_ns - newest_ns > self._max_age_ns:
            return f"no fix for {(now_ns - newest_ns) / 1e9:.0f} s"
        if newest_ns - oldest_ns < self._least_ns:
            return f"only {(newest_ns - oldest_ns) / 1e9:.0f} s of fixes"
        samples = np.array([[(t - newest_ns) * 1e-9, east, north] for t, east, north in self._samples])
        span_s = (newest_ns - oldest_ns) * 1e-9
        noise = mean_variance(samples[:, 0], np.full(len(samples), self._model.unit_sd), self._model.unit_s)
        variance = self._model.change_variance(span_s) / 3.0 + noise
        east, north = samples[:, 1:].mean(axis=0).tolist()
        return Delta(newest_ns, east, north, float(np.sqrt(variance)), len(samples), span_s)
