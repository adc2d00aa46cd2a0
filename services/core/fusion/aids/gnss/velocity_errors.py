"""Are the errors of a receiver's velocities white? The sum of white ones grows slowly; of others nobody knows how fast.

A time-correlated position error is seen by the integral of velocity, which must be better than the positions for it.
It is if velocity errors are white: over a time t the integral then errs by sigma √(t τ), τ being the interval between
two of them. A receiver that smooths has errors that repeat from one velocity to the next, and then those of minutes,
which no inertial sensor sees, may be as large. So the correlation of successive residuals decides.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

CORRELATIONS = np.array([0.2, 0.4, 0.6, 0.8])  # [-] of successive errors that are not white
WHITE_PRIOR = 0.5, 0.01  # probability that they are, of a receiver that states their size, and of one that does not
FOLLOW_BELOW, UNTIL_ABOVE = 0.001, 0.9  # probability of white errors: positions are followed below one, until above
CORRELATION_S = 60.0  # of the error of velocities that are not white
WHITE_SHARE = 0.1  # of the stated variance that it has
MEMORY_S = 600.0  # forgetting time constant
POWER_MEMORY_S = 60.0  # of the residuals' mean square
INDEPENDENT_S = 0.5  # between velocities that count in full: more of them in that time count as one
MAX_LOG_RATIO = 10.0  # largest logarithm of a likelihood ratio: what was learned is unlearned in minutes
MAX_VALUE = 3.0  # [-] standard deviations at which a residual is clipped
SETTLING_S = 10.0  # from the first velocity, and the first after a gap: residuals repeat while the filter converges
BREAK_S = 2.0  # longest interval between successive velocities: a longer one is a gap


@dataclass(frozen=True)
class GnssVelocityErrors:
    """Residuals of velocities, measured minus the filter's, north, east and down, as far as they are remembered."""

    evidence: FloatArray  # shape (4,), logarithmic, of each correlation over white
    power: FloatArray  # [m²/s²] mean square
    last: FloatArray  # [-] residual over the root of that
    variance: FloatArray  # [m²/s²] of the time-correlated error
    time_ns: int = 0
    since_ns: int = 0  # stamp of the first, or of the first after a gap
    count: int = 0  # of those in the mean square
    prior: float = WHITE_PRIOR[0]
    follows: bool = False  # positions are followed, for velocity errors are not white

    @property
    def correlation_s(self) -> float:
        """Correlation time of errors that are not white [s]."""
        return CORRELATION_S

    def stationary(self, _estimated: bool) -> FloatArray:
        """Variance [m²/s²] of the time-correlated error, shape (3,); zero where errors are white."""
        return self.variance

    @cached_property
    def white(self) -> float:
        """Probability that velocity errors are white; one while no velocity is known."""
        if not self.time_ns:
            return 1.0
        others = (1.0 - self.prior) * float(np.exp(self.evidence).mean())
        return self.prior / (self.prior + others)

    def after(self, time_ns: int, residual: FloatArray, variances: FloatArray, *, stated: bool) -> "GnssVelocityErrors":
        """Learn from a residual [m/s] and its variances [m²/s²], both of shape (n,), which the receiver states or not.

        Notes
        -----
        With u a residual over its root mean square and r a correlation, each axis adds to the evidence of r::

            log p(u_k | u_k-1, r) / p(u_k | white) = (u_k² - (u_k - r u_k-1)² / (1 - r²) - log(1 - r²)) / 2
        """
        n, step_s = len(residual), (time_ns - self.time_ns) * 1e-9
        since_ns = self.since_ns if step_s <= BREAK_S else time_ns
        settled = time_ns - since_ns > SETTLING_S * 1e9
        power, last, variance, evidence = self.power.copy(), self.last.copy(), np.zeros(3), self.evidence
        if settled:
            weight = max(1.0 / (self.count + 1), 1.0 - exp(-max(step_s, 0.0) / POWER_MEMORY_S))
            power[:n] += weight * (residual**2 - power[:n])
        last[:n] = np.clip(residual / np.sqrt(power[:n] + 1e-12), -MAX_VALUE, MAX_VALUE)
        if settled and self.count and step_s > 0.0:
            rest = 1.0 - CORRELATIONS**2
            apart = last[:n] - CORRELATIONS[:, np.newaxis] * self.last[:n]
            ratio = 0.5 * (last[:n] ** 2 - apart**2 / rest[:, np.newaxis] - np.log(rest)[:, np.newaxis])
            counted = min(1.0, step_s / INDEPENDENT_S) * ratio.sum(axis=1)
            evidence = np.clip(exp(-step_s / MEMORY_S) * evidence + counted, -MAX_LOG_RATIO, MAX_LOG_RATIO)
        prior = WHITE_PRIOR[0] if stated else WHITE_PRIOR[1]
        learned = GnssVelocityErrors(evidence, power, last, variance, time_ns, since_ns, self.count + settled, prior)
        limit = UNTIL_ABOVE if self.follows else FOLLOW_BELOW
        follows = learned.white < limit or not (self.time_ns or stated)
        variance[:n] = WHITE_SHARE * variances if follows else 0.0
        return replace(learned, follows=follows)


UNKNOWN_ERRORS = GnssVelocityErrors(np.zeros(len(CORRELATIONS)), np.zeros(3), np.zeros(3), np.zeros(3))
