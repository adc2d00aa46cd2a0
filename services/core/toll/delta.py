"""Delta position: the GNSS error that the road-side unit and the vehicles have in common.

The unit's antenna is surveyed. What its receiver errs by is added, with the opposite sign, to the vehicles' positions::

    Δ = p_antenna - p_fix,    p_corrected = p_vehicle + Δ
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.messages.explanation import Explanation, explain

from .codes import Code

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
    unit_white_sd: float = 0.2  # noise of the unit's receiver
    white_sd: float = 0.5  # noise of a vehicle's receiver

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
    """Predicts the common error at the newest fix from antenna minus fix over a moving window.

    Notes
    -----
    The samples z are the common error c, whose mean is taken as unknown, the unit's multipath and white noise. The
    prediction Δ = w'z of least variance among those without bias (Σw = 1) is, with the covariances K = cov(z, z) and
    k = cov(z, c(t_newest))::

        w = K⁻¹ (k + λ 1),   λ = (1 - 1'K⁻¹k) / (1'K⁻¹1),   σ² = σ_c² - 2 w'k + w'K w

    The plain mean over T is later by T/2: it adds 2 σ_c²/τ_c · T/3, 0.54 m where T = 30 s, σ_c = 3 m and τ_c = 600 s.
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

    def delta(self, now_ns: int) -> Delta | Explanation:
        """Return the delta position, or why there is none."""
        if not self._samples:
            return explain(Code.NO_FIX)
        newest_ns, oldest_ns = self._samples[-1][0], self._samples[0][0]
        if now_ns - newest_ns > self._max_age_ns:
            return explain(Code.OLD_FIX, age_s=round((now_ns - newest_ns) / 1e9))
        if newest_ns - oldest_ns < self._least_ns:
            return explain(Code.FEW_FIXES, span_s=round((newest_ns - oldest_ns) / 1e9))
        samples = np.array([[(t - newest_ns) * 1e-9, east, north] for t, east, north in self._samples])
        weights, variance = self._weights(samples[:, 0])
        east, north = (weights @ samples[:, 1:]).tolist()
        span_s = (newest_ns - oldest_ns) * 1e-9
        return Delta(newest_ns, east, north, float(np.sqrt(variance)), len(samples), span_s)

    def _weights(self, time_s: FloatArray) -> tuple[FloatArray, float]:
        """Weights w of the samples, shape (n,), and the variance σ² [m²] of what they leave of each axis."""
        model, elapsed_s = self._model, np.abs(time_s[:, None] - time_s)
        common = model.common_sd**2 * np.exp(-elapsed_s / model.common_s)
        multipath = model.unit_sd**2 * np.exp(-elapsed_s / model.unit_s)
        K, k = common + multipath + model.unit_white_sd**2 * np.eye(len(time_s)), common[:, -1]
        of_k, of_one = np.linalg.solve(K, np.stack([k, np.ones(len(k))], axis=1)).T
        w: FloatArray = of_k + (1.0 - of_k.sum()) / of_one.sum() * of_one
        return w, float(model.common_sd**2 - 2.0 * w @ k + w @ K @ w)
