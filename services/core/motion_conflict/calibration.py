"""Scale and delay of the odometer against GNSS, by recursive least squares on moving samples.

The model, with s the scale (true over indicated speed) and τ the delay of the odometer's stamps::

    v_gnss(t) = s · v_odo(t + τ) + noise

For a given τ this is linear in s, so three weighted sums for each τ of a grid hold all that has been measured::

    ŝ(τ) = Σ v_gnss v_odo / Σ v_odo²,   J(τ) = Σ v_gnss² - (Σ v_gnss v_odo)² / Σ v_odo²,   p(τ) ∝ exp(-J(τ)/2)

Linearising about one delay instead converges to a wrong one when the first guess is seconds off.
"""

from collections import deque
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np
import numpy.typing as npt

from .aligned import SECOND_NS, AlignedPair

FloatArray = npt.NDArray[np.float64]

SCALE_LIMIT = 0.08  # [-] what tyres explain: wear, pressure, another size
SCALE_SD = 0.04  # [-] before anything is learned
DELAY_STEP_S = 0.05  # of the grid
LEARNING_SPEED_M_S = 5.0  # odometer speed below which nothing is learned
CORRELATED = 10.0  # [-] successive errors (Doppler filter, rounding at steady speed) that count as one
GATE = 4.0  # [-] standard deviations of an innovation beyond which a sample is not learned from
MEMORY_S = 900.0  # of learning after which a sample counts 1/e
LEARNED_SCALE_SD = 0.005  # [-] known well enough for the calibrated verdict
LEARNED_DELAY_SD_S = 0.2  # known well enough for the fast test: driving off makes 0.4 m/s of it
STEP_LIMIT = 0.02  # [-]
STEP_WINDOW_S = 120.0
STEP_REFERENCE_S = 300.0  # of learning before a step can be judged


@dataclass(frozen=True)
class Calibration:
    """Learned scale (true over indicated speed) and delay of the odometer, with standard deviations."""

    scale: float
    delay_s: float
    scale_sd: float
    delay_sd_s: float

    @property
    def learned(self) -> bool:
        """Whether the scale is known to half a percent."""
        return self.scale_sd <= LEARNED_SCALE_SD


@dataclass(frozen=True)
class RecentScale:
    """Scale over the last two minutes of movement, beside the one that had been learned before them."""

    scale: float
    scale_sd: float
    reference: float
    oldest_ns: int  # stamp of the first sample


class CalibrationEstimator:
    """Recursive least squares of scale and delay.

    Parameters
    ----------
    delay_limits_s : tuple of float
        [s] Smallest and largest delay that is learned.
    start : Calibration, optional
        What an earlier drive has learned; by default scale one, and every delay within the limits alike.
    """

    def __init__(self, *, delay_limits_s: tuple[float, float], start: Calibration | None = None) -> None:
        low, high = delay_limits_s
        self.delays_s: FloatArray = np.linspace(low, high, round((high - low) / DELAY_STEP_S) + 1)
        scale, scale_sd = (start.scale, start.scale_sd) if start else (1.0, SCALE_SD)
        prior = np.array([[1.0], [scale], [scale**2]]) / scale_sd**2  # as one measurement of the scale
        self._prior = np.broadcast_to(prior, (3, len(self.delays_s)))
        self._prior_cost = ((self.delays_s - start.delay_s) / start.delay_sd_s) ** 2 if start else 0.0 * self.delays_s
        self._sums = np.zeros((3, len(self.delays_s)))  # of v_odo², v_gnss v_odo and v_gnss², over their variance
        self.frozen = False  # set from outside while GNSS is not trusted
        self.learning_s = STEP_REFERENCE_S if start is not None and start.learned else 0.0
        self._last_ns: int | None = None
        self._recent: deque[tuple[AlignedPair, float, FloatArray]] = deque(maxlen=4096)  # with scale and sums before
        self._solve()

    def _solve(self) -> None:
        """Find mean and covariance of scale and delay."""
        xx, xy, yy = self._sums + self._prior
        scales, cost = xy / xx, yy - xy**2 / xx + self._prior_cost
        weight = np.exp(-0.5 * (cost - cost.min()))
        weight /= weight.sum()
        values = np.array([scales, self.delays_s])
        self.mean: FloatArray = values @ weight
        off = values - self.mean[:, None]
        self.P: FloatArray = (weight * off) @ off.T + np.diag([float(weight @ (1.0 / xx)), DELAY_STEP_S**2 / 12.0])
        self.mean[0] = min(max(self.mean[0], 1.0 - SCALE_LIMIT), 1.0 + SCALE_LIMIT)

    @property
    def calibration(self) -> Calibration:
        """The present estimate."""
        return Calibration(float(self.mean[0]), float(self.mean[1]), sqrt(self.P[0, 0]), sqrt(self.P[1, 1]))

    def speed_variance(self, odometer: float, slope: float) -> float:
        """Variance [m²/s²] of s · v_odo(t + τ) that the errors of scale and delay cause."""
        H = np.array([odometer, self.mean[0] * slope])
        return float(H @ self.P @ H)

    def update(self, pair: AlignedPair, odometer: FloatArray) -> None:
        """Learn from one sample, unless the vehicle is slow, the estimator frozen or the scale in doubt.

        Parameters
        ----------
        pair : AlignedPair
            The sample, aligned with the present delay.
        odometer : ndarray, shape of `delays_s`
            [m/s] Odometer speed at the sample's time plus each delay.
        """
        if pair.odometer < LEARNING_SPEED_M_S:
            return
        self._remember(pair)
        elapsed_s = 0.0 if self._last_ns is None else min(10.0, (pair.time_ns - self._last_ns) / SECOND_NS)
        self._last_ns = pair.time_ns
        R = CORRELATED * (pair.gnss_sd**2 + pair.resolution**2 / 12.0)
        innovation = pair.gnss - self.mean[0] * pair.odometer
        outlier = innovation**2 > GATE**2 * (self.speed_variance(pair.odometer, pair.slope) + R)
        if self.frozen or outlier or self._undo_step():
            return
        new = np.array([odometer**2, pair.gnss * odometer, np.full(len(odometer), pair.gnss**2)]) / R
        self._sums = exp(-elapsed_s / MEMORY_S) * self._sums + new
        self.learning_s += elapsed_s
        self._solve()

    def _remember(self, pair: AlignedPair) -> None:
        self._recent.append((pair, float(self.mean[0]), self._sums))
        while pair.time_ns - self._recent[0][0].time_ns > STEP_WINDOW_S * SECOND_NS:
            self._recent.popleft()

    def _undo_step(self) -> bool:
        """Return to what was learned before a step, so that the step is not learned."""
        recent = self.recent()
        if recent is None or abs(recent.scale / recent.reference - 1.0) <= STEP_LIMIT:
            return False
        self._sums = self._recent[0][2]
        self._solve()
        return True

    def recent(self) -> RecentScale | None:
        """Scale of the last two minutes; None before a reference has been learned or with less than a minute.

        Notes
        -----
        Least squares through the origin, s = Σ v_gnss v_odo / Σ v_odo², with the variance of the residuals.
        """
        if self.learning_s < STEP_REFERENCE_S or len(self._recent) < 10:
            return None
        pairs = [pair for pair, _, _ in self._recent]
        if pairs[-1].time_ns - pairs[0].time_ns < 0.5 * STEP_WINDOW_S * SECOND_NS:
            return None
        odometer, gnss = np.array([pair.odometer for pair in pairs]), np.array([pair.gnss for pair in pairs])
        weight = float(odometer @ odometer)
        scale = float(gnss @ odometer) / weight
        residual = gnss - scale * odometer
        scale_sd = sqrt(CORRELATED * float(residual @ residual) / (len(pairs) - 1) / weight)
        return RecentScale(scale, scale_sd, self._recent[0][1], pairs[0].time_ns)
