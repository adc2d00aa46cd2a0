"""Searches delays of GNSS that are too large for the filter, which is linear about zero.

Two measurements of one motion are compared at many lags: the changes of speed and course of GNSS over an interval, and
the inertial measurements of the same interval, shifted by the lag. At the right lag, and only there, changes
of speed are a linear function of the mean force, and changes of course one of the mean rate::

    change of speed / time = a . mean force + a0 + noise,    change of course / time = b . mean rate + b0 + noise

Mounting, biases and heading are in the coefficients, which are fitted at each lag. The search is independent of the
filter, which the delay may have led astray.
"""

from bisect import bisect_left, insort
from collections import deque
from math import atan2, hypot, inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import wrap_angle
from shared.maths.rotation import Vector

from ..inertial.propagation import GAP_S
from ..aids.gnss.fix import GnssVelocity

FloatArray = npt.NDArray[np.float64]

LARGEST_S = 1.6
STEP_S = 0.05
LAGS_S = np.arange(-round(LARGEST_S / STEP_S), round(LARGEST_S / STEP_S) + 1) * STEP_S
MOST_WAITING = 1000  # velocities
NODE_S = 0.04  # between two points of the inertial account
SHORTEST_S, LONGEST_S = 0.45, 1.2  # of an interval
COURSE_M_S = 3.0  # below it a course is noise
FEWEST = 20  # intervals of either kind
EXPLAINED = 0.4  # share of the variance
CLEAR = 6.0  # logarithm of the likelihood over that of any lag that is not next to the best, and
BETTER = 12.0  # over that of the delay that is assumed
BESIDE_S = 0.3
REPEATED = 3.0  # residuals in a row that count as one
NOT_SURE_S = 0.15


class Found(NamedTuple):
    """Delay beyond the settings, and its standard deviation [s]; infinite while unknown."""

    delay_s: float = 0.0
    sd_s: float = inf


class _Fit:
    """Least squares of one quantity on four others, at each lag."""

    def __init__(self) -> None:
        lags = len(LAGS_S)
        self.n, self.y, self.yy = 0, 0.0, 0.0
        self._xx, self._xy = np.zeros((lags, 4, 4)), np.zeros((lags, 4))

    def add(self, x: FloatArray, y: float) -> None:
        """Add a row of regressors for each lag, shape (lags, 3), and the observation."""
        row = np.column_stack([np.ones(len(x)), x])
        self._xx += row[:, :, np.newaxis] * row[:, np.newaxis, :]
        self._xy += row * y
        self.n, self.y, self.yy = self.n + 1, self.y + y, self.yy + y * y

    def log_likelihood(self) -> tuple[FloatArray, float]:
        """Of each lag, and the share of the variance that the best one explains."""
        variance = self.yy - self.y * self.y / max(self.n, 1)
        if self.n < FEWEST or variance <= 0.0:
            return np.zeros(len(LAGS_S)), 0.0
        solved = np.linalg.solve(self._xx + 1e-9 * np.eye(4), self._xy[:, :, np.newaxis])[:, :, 0]
        left = np.maximum(self.yy - (solved * self._xy).sum(axis=1), 1e-9 * variance)
        return -0.5 * self.n * np.log(left / variance), 1.0 - float(left.min()) / variance


class DelaySearch:
    """Finds the delay at which inertial samples and GNSS velocities agree.

    The result depends on stamps alone, provided that measurements older than `memory_s` are not passed to it.
    """

    def __init__(self, memory_s: float) -> None:
        self._behind_ns = round(max(memory_s, LARGEST_S + NODE_S) * 1e9)
        kept_s = self._behind_ns * 1e-9 + LARGEST_S + LONGEST_S + 1.0
        self._nodes: deque[tuple[float, ...]] = deque(maxlen=round(kept_s / NODE_S))  # time [s], then integrals
        self._sums = [0.0] * 6
        self._start_ns: int | None = None
        self._last_ns = 0
        self._waiting: list[GnssVelocity] = []
        self._before: GnssVelocity | None = None
        self._speed, self._course = _Fit(), _Fit()
        self._likelihood = np.zeros(len(LAGS_S))  # its logarithm
        self._explained = 0.0

    def sample(self, time_ns: int, force: Vector, rate: Vector) -> None:
        """Add the next sample, and use the velocities that waited for it."""
        if self._start_ns is None or time_ns - self._last_ns > GAP_S * 1e9:
            self._begin(time_ns)
            return
        step, sums = (time_ns - self._last_ns) * 1e-9, self._sums
        for place, value in enumerate((*force, *rate)):
            sums[place] += value * step
        self._last_ns = time_ns
        now_s = (time_ns - self._start_ns) * 1e-9
        if now_s - self._nodes[-1][0] >= NODE_S - 1e-6:
            self._nodes.append((now_s, *sums))
            self._compare(time_ns - self._behind_ns)

    def see(self, seen: GnssVelocity) -> None:
        """Add a velocity with its stamp."""
        insort(self._waiting, seen, key=lambda m: (m.time_ns, m.source))
        if len(self._waiting) > MOST_WAITING:
            self._waiting.pop(0)

    def result(self, assumed_s: float = 0.0) -> Found:
        """The delay, if its likelihood is clearly above that of an assumed delay [s]."""
        total = self._likelihood
        best, assumed = int(np.argmax(total)), int(np.argmin(np.abs(LAGS_S - assumed_s)))
        away = np.abs(LAGS_S - LAGS_S[best]) > BESIDE_S
        if self._explained < EXPLAINED or total[best] - total[away].max() < CLEAR:
            return Found()
        if total[best] - total[assumed] < BETTER:
            return Found()
        weight = np.exp((total - total[best]) / REPEATED)
        weight /= weight.sum()
        delay_s = float(weight @ LAGS_S)
        sd_s = hypot(float(weight @ (LAGS_S - delay_s) ** 2) ** 0.5, STEP_S)
        return Found(delay_s, sd_s) if sd_s < NOT_SURE_S else Found()

    def _begin(self, time_ns: int) -> None:
        """Start a new inertial velocity after a gap."""
        self._nodes.clear()
        self._nodes.append((0.0,) * 7)
        self._sums, self._start_ns, self._last_ns, self._before = [0.0] * 6, time_ns, time_ns, None

    def _compare(self, until_ns: int) -> None:
        """Use the velocities up to a time."""
        count = bisect_left(self._waiting, until_ns, key=lambda m: m.time_ns)
        added = False
        for seen in self._waiting[:count]:
            before = self._before
            span_s = (seen.time_ns - before.time_ns) * 1e-9 if before else inf
            if span_s < SHORTEST_S:
                continue
            if before is not None and span_s <= LONGEST_S:
                added |= self._take(before, seen, span_s)
            self._before = seen
        del self._waiting[:count]
        if added:
            (speed, by_force), (course, by_rate) = self._speed.log_likelihood(), self._course.log_likelihood()
            self._likelihood, self._explained = speed + course, max(by_force, by_rate)

    def _take(self, before: GnssVelocity, seen: GnssVelocity, span_s: float) -> bool:
        assert self._start_ns is not None
        nodes = np.array(self._nodes)
        end = (seen.time_ns - self._start_ns) * 1e-9 - LAGS_S
        if end[-1] - span_s < nodes[0, 0] or end[0] > nodes[-1, 0]:
            return False
        means = np.empty((len(LAGS_S), 6))
        for place in range(6):
            integral = nodes[:, place + 1]
            gained = np.interp(end, nodes[:, 0], integral) - np.interp(end - span_s, nodes[:, 0], integral)
            means[:, place] = gained / span_s
        (n0, e0, _), (n1, e1, _) = before.velocity, seen.velocity
        slow, fast = hypot(n0, e0), hypot(n1, e1)
        if max(slow, fast) > 0.5:
            self._speed.add(means[:, :3], (fast - slow) / span_s)
        if min(slow, fast) > COURSE_M_S:
            self._course.add(means[:, 3:], wrap_angle(atan2(e1, n1) - atan2(e0, n0)) / span_s)
        return True
