"""Tests whether the scale of the speeds in the last bends differs from the vehicle's own.

The scale of accelerometer and gyroscope is an error of every bend alike, which no mean reduces. It is known to a few
percent before anything is learned, and better after bends that nothing accuses: the reference.
"""

from collections import deque
from dataclasses import dataclass, field
from math import sqrt

import numpy as np
import numpy.typing as npt

from .bends import Bend

FloatArray = npt.NDArray[np.float64]

MIN_BENDS = 5
MAX_BENDS = 40  # in the window; older ones belong to the reference
MAX_SUSPECT = 120  # in the window while it is suspicious: what was before a change must stay apart from it
MAX_REFERENCE = 0.03  # [-] by which the reference may differ from one: what inertial sensors are off
REFERENCE_WALK = 5e-4  # [-] of the reference for each bend: load, temperature; 1 % over 400 bends
MIN_SD = 0.008  # [-] of a bend; in simulation, without slip and with an industrial IMU, 0.009 was measured
UNLEARNED = 10  # newest bends that are not handed on: a change within them may not be seen yet
START_WALK = 3e-3  # [-] of the scale from one start to the next: temperature, load
SPREAD_BENDS = 60  # from whose differences the spread is estimated
SPREAD_NEEDED = 12
SPREAD_PRIOR = 6
SPREAD_LIMITS = (0.5, 4.0)  # of the measured spread over the stated one; 0.5 and 1.3 were measured
CONSISTENT = 1.4826  # standard deviation of a normal error over its median magnitude
HUBER = 2.0  # standard deviations from the neighbours beyond which a bend counts less
# Standard deviations of the most conspicuous of all windows that accuse. Monte Carlo without a fault, 500 drives of 150
# bends: 3.9 is exceeded by 1e-3 of the bends and 4.1 by 1e-4 (normal errors; 4.8 with Student's, 5 degrees of freedom).
LIMIT = 4.7
FALSE_ALARM_RATE = 1e-5
SUSPICIOUS = 2.5  # standard deviations: from here on nothing is learned
ONSET = 13.82  # chi-square 0.999 with two degrees of freedom: change points that are likely enough
RELEASE_BENDS = 10
RELEASED = 2.0  # standard deviations of the last bends, below which an accusation ends
SHARED_CHANGE = 0.5  # share of the change of GNSS that the odometer shows if both are falsified


@dataclass(frozen=True)
class Change:
    """The most conspicuous change of scale: mean of the last bends minus the reference."""

    bends: int
    difference: float  # [-]
    sd: float  # [-] of the difference
    odometer: float | None  # [-] its change over the same bends, None where it is not known
    first_ns: int  # start of the first bend that may be falsified
    suspect_since_ns: int  # start of the bend before it: a change may have begun within that one

    @property
    def size(self) -> float:
        """Magnitude in standard deviations."""
        return abs(self.difference) / self.sd


@dataclass(frozen=True)
class BendScale:
    """Scale that a vehicle's bends have taught."""

    mean: float  # of GNSS
    sd: float  # [-]
    odometer: float | None
    bends: int
    spread: float


@dataclass
class Reference:
    """Scale before the window: mean and variance."""

    mean: float
    variance: float
    odometer: float | None = None  # running mean of its scale

    def with_bends(self, values: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and variance after the first 0, 1, ... n of further bends, each of shape (n + 1,)."""
        information = 1.0 / self.variance + np.concatenate([[0.0], np.cumsum(1.0 / variances)])
        total = self.mean / self.variance + np.concatenate([[0.0], np.cumsum(values / variances)])
        return total / information, 1.0 / information


@dataclass
class ScaleChange:
    """Window of the last bends, the reference of older ones, and the accusation.

    Parameters
    ----------
    common_sd : float
        [-] Standard deviation of the scale of the inertial sensors before anything is learned.
    """

    common_sd: float
    frozen: bool = False  # set from outside while a speed is not trusted
    accusing: bool = False
    learned: int = 0  # bends in the reference
    change: Change | None = None
    window: deque[Bend] = field(default_factory=lambda: deque(maxlen=MAX_SUSPECT))

    def __post_init__(self) -> None:
        self.reference = Reference(1.0, self.common_sd**2)
        self._ratios: deque[float] = deque(maxlen=SPREAD_BENDS)  # |difference| of successive bends, normalised
        self._spread = 1.0

    def adopt(self, learned: BendScale) -> None:
        """Begin with what earlier drives have taught; within the bounds of a reference."""
        mean = min(max(learned.mean, 1.0 - MAX_REFERENCE), 1.0 + MAX_REFERENCE)
        variance = min(learned.sd**2 + START_WALK**2, self.common_sd**2)
        self.reference = Reference(mean, variance, learned.odometer)
        self.learned, self._spread = learned.bends, learned.spread

    def lesson(self) -> BendScale | None:
        """What the next start may begin with: all bends but the newest; None while anything is suspicious."""
        if self.frozen or self._is_suspicious():
            return None
        bends = list(self.window)[:-UNLEARNED]
        if self.learned + len(bends) < MIN_BENDS:
            return None
        values = np.array([bend.scale for bend in bends])
        means, variances = self.reference.with_bends(values, np.array([self._variance(bend) for bend in bends]))
        mean = min(max(float(means[-1]), 1.0 - MAX_REFERENCE), 1.0 + MAX_REFERENCE)
        wheels = [bend.odometer for bend in bends if bend.odometer is not None]
        odometer = self.reference.odometer if not wheels else float(np.median(wheels))
        return BendScale(mean, sqrt(float(variances[-1])), odometer, self.learned + len(bends), self._spread)

    def _measure_spread(self) -> None:
        """Measured spread of the bends over the stated one, from differences of successive bends.

        The root mean square of the normalised differences, those beyond three robust deviations cut off there. The
        stated spread counts as `SPREAD_PRIOR` differences: a few that are small by chance must not narrow the limits.
        """
        if len(self._ratios) < SPREAD_NEEDED:
            return
        ratios = np.array(self._ratios)
        cut = np.minimum(ratios, 3.0 * CONSISTENT * np.median(ratios))
        squares = (float((cut**2).sum()) + SPREAD_PRIOR) / (len(ratios) + SPREAD_PRIOR)
        low, high = SPREAD_LIMITS
        self._spread = min(max(sqrt(squares), low), high)

    def add(self, bend: Bend) -> None:
        """Use a bend, later than all before."""
        if self.window:
            last = self.window[-1]
            self._ratios.append(abs(bend.scale - last.scale) / sqrt(bend.sd**2 + last.sd**2))
            self._measure_spread()
        if len(self.window) == MAX_SUSPECT:
            oldest = self.window.popleft()
            if self.change is not None and oldest.end_ns <= self.change.first_ns:
                self._learn(oldest)
        self.window.append(bend)
        self.change = self._largest()
        while len(self.window) > MAX_BENDS and not self._is_suspicious():
            self._learn(self.window.popleft())
        self._decide()

    def _variance(self, bend: Bend) -> float:
        return max(self._spread * bend.sd, MIN_SD) ** 2

    def _is_suspicious(self) -> bool:
        return self.accusing or (self.change is not None and self.change.size > SUSPICIOUS)

    def _learn(self, bend: Bend) -> None:
        """Let the oldest bend into the reference."""
        if self.frozen:
            return
        reference, variance = self.reference, self._variance(bend)
        prior = reference.variance + REFERENCE_WALK**2
        gain = prior / (prior + variance)
        innovation = bend.scale - reference.mean
        bound = 3.0 * sqrt(prior + variance)
        reference.mean += gain * min(max(innovation, -bound), bound)
        reference.mean = min(max(reference.mean, 1.0 - MAX_REFERENCE), 1.0 + MAX_REFERENCE)
        reference.variance = (1.0 - gain) * prior
        self.learned += 1
        if bend.odometer is not None:
            old = reference.odometer
            reference.odometer = bend.odometer if old is None else old + (bend.odometer - old) / MAX_BENDS

    def _largest(self) -> Change | None:
        """Change with the largest size, over all lengths of the last bends from five on."""
        n = len(self.window)
        if n < MIN_BENDS:
            return None
        values = np.array([bend.scale for bend in self.window])
        variances = np.array([self._variance(bend) for bend in self.window])
        variances /= _weights(values, np.sqrt(variances))
        before, before_variance = self._before(values, variances)
        backwards = np.cumsum(1.0 / variances[::-1])[::-1]
        after = np.cumsum((values / variances)[::-1])[::-1] / backwards
        difference, sd = after - before[:n], np.sqrt(1.0 / backwards + before_variance[:n])
        size = np.abs(difference) / sd
        k = int(np.argmax(size[: n - MIN_BENDS + 1]))
        first = int(np.flatnonzero(size**2 >= size[k] ** 2 - ONSET)[0])
        first_ns, suspect_ns = self.window[first].start_ns, self.window[max(0, first - 1)].start_ns
        if self.accusing and self.change is not None:  # an accusation keeps its earliest
            first_ns = min(first_ns, self.change.first_ns)
            suspect_ns = min(suspect_ns, self.change.suspect_since_ns)
        odometer = self._odometer_change(k, first_ns)
        return Change(n - k, float(difference[k]), float(sd[k]), odometer, first_ns, suspect_ns)

    def _before(self, values: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of what is before each bend of the window; while accusing, of those before the change."""
        mean, variance = self.reference.with_bends(values, variances)
        if self.accusing and self.change is not None:
            clean = sum(bend.end_ns <= self.change.first_ns for bend in self.window)
            mean[clean:], variance[clean:] = mean[clean], variance[clean]
        return mean, variance

    def _odometer_change(self, k: int, first_ns: int) -> float | None:
        """Change of the odometer's scale, from before the first falsified bend to the last bends from k on."""
        bends = list(self.window)
        before = [bend.odometer for bend in bends if bend.odometer is not None and bend.end_ns <= first_ns]
        after = [bend.odometer for bend in bends[k:] if bend.odometer is not None]
        if not after:
            return None
        if before:
            old = float(np.median(before))
        elif self.reference.odometer is not None:
            old = self.reference.odometer
        else:
            old = 1.0
        return float(np.median(after)) - old

    def _decide(self) -> None:
        change = self.change
        if change is None:
            return
        if not self.accusing:
            self.accusing = change.size > LIMIT
        elif self._has_returned(change):
            recent = list(self.window)[-RELEASE_BENDS:]
            self.accusing, self.window = False, deque(recent, maxlen=MAX_SUSPECT)
            self.change = self._largest()

    def _has_returned(self, change: Change) -> bool:
        """Whether the last ten bends have the scale of the reference, and not that of the accusation."""
        recent = list(self.window)[-RELEASE_BENDS:]
        if len(recent) < RELEASE_BENDS or recent[0].start_ns <= change.first_ns:
            return False
        values = np.array([bend.scale for bend in recent])
        variances = np.array([self._variance(bend) for bend in recent])
        mean, variance = self._clean_before()
        information = float((1.0 / variances).sum())
        difference = float((values / variances).sum()) / information - mean
        sd = sqrt(1.0 / information + variance)
        return abs(difference) < RELEASED * sd and abs(difference) + RELEASED * sd < abs(change.difference)

    def _clean_before(self) -> tuple[float, float]:
        assert self.change is not None
        clean = [bend for bend in self.window if bend.end_ns <= self.change.first_ns]
        values = np.array([bend.scale for bend in clean])
        variances = np.array([self._variance(bend) for bend in clean])
        mean, variance = self.reference.with_bends(values, variances)
        return float(mean[-1]), float(variance[-1])


def _weights(values: FloatArray, sds: FloatArray) -> FloatArray:
    """Huber weights, shape (n,), by the distance of each value from the median of the five around it."""
    n = len(values)
    first = np.clip(np.arange(n) - 2, 0, n - MIN_BENDS)
    around = np.median(values[first[:, None] + np.arange(MIN_BENDS)], axis=1)
    distance = np.abs(values - around) / sds
    weights: FloatArray = np.minimum(1.0, HUBER / np.maximum(distance, HUBER))
    return weights
