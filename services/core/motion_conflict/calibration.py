"""Scale and delay of the odometer against GNSS, by recursive least squares on moving samples.

The model, with s the scale (true over indicated speed) and τ the delay of the odometer's stamps::

    v_gnss(t) = s · v_odo(t + τ) + noise

linearised about the present estimate: H = [ v_odo, s · dv_odo/dt ].
"""

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from .aligned import SECOND_NS, AlignedPair

FloatArray = npt.NDArray[np.float64]

SCALE_LIMIT = 0.08  # [-] what tyres explain: wear, pressure, another size
SCALE_SD = 0.04  # [-] before anything is learned
DELAY_SD_S = 1.0
LEARNING_SPEED_M_S = 5.0  # odometer speed below which nothing is learned
CORRELATED = 5.0  # [-] successive errors (rounding, Doppler filter) that count as one: factor of the variance
GATE = 4.0  # [-] standard deviations of an innovation beyond which a sample is not learned from
SCALE_WALK = 1e-4  # [1/√s] random walks that keep the estimator open for slow changes
DELAY_WALK_S = 2e-3  # [s/√s]
LEARNED_SCALE_SD = 0.005  # [-] known well enough for the calibrated verdict
STEP_LIMIT = 0.02  # [-]
STEP_WINDOW_S = 120.0
STEP_REFERENCE_S = 300.0  # of learning before a step can be judged


@dataclass(frozen=True)
class Calibration:
    """Learned scale (true over indicated speed) and delay of the odometer, with standard deviations."""

    scale: float = 1.0
    delay_s: float = 0.0
    scale_sd: float = SCALE_SD
    delay_sd_s: float = DELAY_SD_S

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
    start : Calibration
        The starting point; what an earlier drive has learned, with its standard deviations.
    """

    def __init__(self, *, delay_limits_s: tuple[float, float], start: Calibration | None = None) -> None:
        start = start or Calibration()
        self.delay_limits_s = delay_limits_s
        self.theta: FloatArray = np.array([start.scale, start.delay_s])
        self.P: FloatArray = np.diag([start.scale_sd**2, start.delay_sd_s**2])
        self.frozen = False  # set from outside while GNSS is not trusted
        self.learning_s = STEP_REFERENCE_S if start.learned else 0.0
        self._last_ns: int | None = None
        self._recent: deque[tuple[AlignedPair, float]] = deque(maxlen=4096)  # pair, scale known at its time

    @property
    def calibration(self) -> Calibration:
        """The present estimate."""
        return Calibration(float(self.theta[0]), float(self.theta[1]), sqrt(self.P[0, 0]), sqrt(self.P[1, 1]))

    def speed_variance(self, odometer: float, slope: float) -> float:
        """Variance [m²/s²] of s · v_odo(t + τ) that the errors of scale and delay cause."""
        H = np.array([odometer, self.theta[0] * slope])
        return float(H @ self.P @ H)

    def update(self, pair: AlignedPair) -> None:
        """Learn from one pair, unless the vehicle is slow, the estimator frozen or the scale in doubt."""
        if pair.odometer < LEARNING_SPEED_M_S:
            return
        self._remember(pair)
        elapsed_s = 0.0 if self._last_ns is None else min(10.0, (pair.time_ns - self._last_ns) / SECOND_NS)
        self._last_ns = pair.time_ns
        if self.frozen or self._undo_step():
            return
        self._learn(pair, elapsed_s)

    def _learn(self, pair: AlignedPair, elapsed_s: float) -> None:
        walk = np.diag([SCALE_WALK**2, DELAY_WALK_S**2]) * elapsed_s
        P = self.P + walk
        H = np.array([pair.odometer, self.theta[0] * pair.slope])
        R = CORRELATED * (pair.gnss_sd**2 + pair.resolution**2 / 12.0)
        innovation, S = pair.gnss - self.theta[0] * pair.odometer, float(H @ P @ H) + R
        if innovation**2 > GATE**2 * S:
            return
        K = P @ H / S
        theta = self.theta + K * innovation
        self.theta = np.clip(theta, [1.0 - SCALE_LIMIT, self.delay_limits_s[0]],
                             [1.0 + SCALE_LIMIT, self.delay_limits_s[1]])  # fmt: skip
        A = np.eye(2) - np.outer(K, H)
        self.P = A @ P @ A.T + R * np.outer(K, K)
        self.learning_s += elapsed_s

    def _remember(self, pair: AlignedPair) -> None:
        self._recent.append((pair, float(self.theta[0])))
        while pair.time_ns - self._recent[0][0].time_ns > STEP_WINDOW_S * SECOND_NS:
            self._recent.popleft()

    def _undo_step(self) -> bool:
        """Return to the scale that was learned before a step, so that the step is not learned."""
        recent = self.recent()
        if recent is None or abs(recent.scale / recent.reference - 1.0) <= STEP_LIMIT:
            return False
        self.theta[0] = recent.reference
        return True

    def recent(self) -> RecentScale | None:
        """Scale of the last two minutes; None before a reference has been learned or with less than a minute.

        Notes
        -----
        Least squares through the origin, s = Σ v_gnss v_odo / Σ v_odo², with the variance of the residuals.
        """
        if self.learning_s < STEP_REFERENCE_S or len(self._recent) < 10:
            return None
        pairs = [pair for pair, _ in self._recent]
        if pairs[-1].time_ns - pairs[0].time_ns < 0.5 * STEP_WINDOW_S * SECOND_NS:
            return None
        odometer, gnss = np.array([pair.odometer for pair in pairs]), np.array([pair.gnss for pair in pairs])
        weight = float(odometer @ odometer)
        scale = float(gnss @ odometer) / weight
        residual = gnss - scale * odometer
        scale_sd = sqrt(CORRELATED * float(residual @ residual) / (len(pairs) - 1) / weight)
        return RecentScale(scale, scale_sd, self._recent[0][1], pairs[0].time_ns)
