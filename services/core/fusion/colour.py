"""How GNSS position errors run over time, learned from the fixes themselves: how much of them lasts, and how long.

A receiver says how large its errors are, but not whether they last. Between two fixes the inertial sensors know the
way to centimetres, so what the fixes show of themselves beside that way are the changes of their errors. A bank of
small filters, one for each hypothesis, follows them; each is as likely as the changes are under it.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import exp

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

TIMES_S = (2.0, 5.0, 10.0, 20.0, 60.0, 200.0)
WHITE_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 0.7)
# [s], [-] the hypotheses: correlation time, and share of the variance that is white. The first is nearly all white;
# what is left of it is so constant that no fix can show it, and not to be forgotten for that.
HYPOTHESES = ((600.0, 0.95), *product(TIMES_S, WHITE_SHARES))
CORRELATION_S = np.array([[time] for time, _ in HYPOTHESES])
WHITE = np.array([[share] for _, share in HYPOTHESES])
LASTING = 1.0 - WHITE
WHITE_PRIOR = 0.3  # probability of the first; the other hypotheses are equally likely
MEMORY_S = 600.0  # after which what was learned counts for 1/e, for places differ
START_SDS = 100.0  # of the unknown place against the error of a fix
SURPRISE = 9.0  # d² of one axis beyond which it is an outlier, and says nothing of correlation
VELOCITY_CORRELATION_S = 2.0  # of the error of the filter's velocity


@dataclass(frozen=True)
class Colour:
    """A bank of hypotheses with their logarithmic weights, and where each takes way and error to be.

    Each has, an axis, two states: the way [m] by which the inertial track is off, and the lasting error over its
    standard deviation. Their covariance is that of way, both, and error.
    """

    log_weight: FloatArray  # shape (h,)
    way: FloatArray  # shape (h, 3)
    error: FloatArray
    cov: tuple[FloatArray, FloatArray, FloatArray]
    time_ns: int | None = None

    @cached_property
    def weight(self) -> FloatArray:
        """Probability of each hypothesis, shape (h,)."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        normalised: FloatArray = weight / weight.sum()
        return normalised

    @cached_property
    def lasting(self) -> float:
        """Share of the variance that lasts, the mean over all hypotheses."""
        return float(self.weight @ LASTING[:, 0])

    @cached_property
    def correlation_s(self) -> float:
        """Correlation time [s] of what lasts, the geometric mean over all hypotheses."""
        weight = self.weight * LASTING[:, 0] + 1e-12
        return exp(float(weight @ np.log(CORRELATION_S[:, 0])) / float(weight.sum()))

    def at_start(self) -> "Colour":
        """Keep what was learned, of a track that begins anew."""
        return Colour(self.log_weight, *_unknown())

    def after(self, time_ns: int, path: FloatArray, sd: FloatArray, velocity_variance: FloatArray) -> "Colour":
        """Learn from one more fix.

        Parameters
        ----------
        time_ns : int
            When it was true.
        path : ndarray, shape (3,)
            [m, NED] Measured position minus that of an inertial track that positions have not moved.
        sd : ndarray, shape (3,)
            [m, NED] Stated.
        velocity_variance : ndarray, shape (3,)
            [m²/s², NED] Of the track.

        Returns
        -------
        Colour
            This one, if the fix is not newer than the last.

        Notes
        -----
        For each hypothesis and axis, with w its white share and T its correlation time::

            path = c + s sqrt(1-w) u + s sqrt(w) n,  c' = velocity error,  u' = -u/T + sqrt(2/T) noise
        """
        if self.time_ns is None:
            way_variance = np.broadcast_to((START_SDS * sd) ** 2, self.way.shape)
            start = (way_variance, np.zeros_like(self.way), np.ones_like(self.way))
            return self._updated(time_ns, path, sd, self.way, self.error, start, self.log_weight)
        step_s = (time_ns - self.time_ns) * 1e-9
        if step_s <= 0.0:
            return self
        phi = np.exp(-step_s / CORRELATION_S)
        ways, both, errors = self.cov
        drift = velocity_variance * step_s * max(step_s, VELOCITY_CORRELATION_S)
        predicted = (ways + drift, phi * both, phi**2 * errors + 1.0 - phi**2)
        kept = exp(-step_s / MEMORY_S) * self.log_weight
        return self._updated(time_ns, path, sd, self.way, phi * self.error, predicted, kept)

    def _updated(
        self,
        time_ns: int,
        path: FloatArray,
        sd: FloatArray,
        way: FloatArray,
        error: FloatArray,
        cov: tuple[FloatArray, FloatArray, FloatArray],
        log_weight: FloatArray,
    ) -> "Colour":
        ways, both, errors = cov
        h = np.sqrt(LASTING) * sd
        to_way, to_error = ways + h * both, both + h * errors
        S = to_way + h * to_error + WHITE * sd**2
        z = path - way - h * error
        surprise = z * z / S
        used = np.where(surprise < SURPRISE, z, np.copysign(np.sqrt(SURPRISE * S), z)) / S
        likelihood = -0.5 * (np.minimum(surprise, SURPRISE) + np.log(S / sd**2)).sum(axis=1)
        after = (ways - to_way**2 / S, both - to_way * to_error / S, errors - to_error**2 / S)
        log_weight = log_weight + likelihood
        return Colour(log_weight - log_weight.max(), way + to_way * used, error + to_error * used, after, time_ns)


def _unknown() -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
    zeros = np.zeros((len(HYPOTHESES), 3))
    return zeros, zeros, (zeros, zeros, zeros)


UNKNOWN = Colour(
    np.log([WHITE_PRIOR] + [(1.0 - WHITE_PRIOR) / (len(HYPOTHESES) - 1)] * (len(HYPOTHESES) - 1)), *_unknown()
)


def mean_at_rest(times_s: FloatArray, lasting: float, correlation_s: float) -> tuple[FloatArray, FloatArray]:
    """Weigh fixes of a place that does not move, as far as their errors last.

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        [s] When they were true, increasing.
    lasting : float
        [-] Share of their variance that lasts.
    correlation_s : float
        [s] How long it does.

    Returns
    -------
    tuple of ndarray
        Weights of the fixes, shape (2, n), for the place and for the lasting error at the last of them; covariance
        of the two, shape (2, 2), both in units of the standard deviation of a fix.

    Notes
    -----
    The best linear unbiased estimate: with A the fixes' covariance, b that of fixes and last error, 1 a vector of
    ones::

        p = A^-1 1 / (1^T A^-1 1),  e = A^-1 (b - 1 p^T b)

    References
    ----------
    Gelb (ed.), Applied Optimal Estimation, 1974, ch. 4, as kriging with an unknown mean.
    """
    apart = np.abs(times_s[:, np.newaxis] - times_s)
    A = lasting * np.exp(-apart / correlation_s) + (1.0 - lasting) * np.eye(len(times_s))
    b = lasting * np.exp(-apart[-1] / correlation_s)
    ones = np.ones(len(times_s))
    solved = np.linalg.solve(A, np.column_stack([ones, b]))
    place = solved[:, 0] / solved[:, 0].sum()
    error = solved[:, 1] - solved[:, 0] * (solved[:, 1].sum() / solved[:, 0].sum())
    weights = np.array([place, error])
    # errors of the two: place' fixes - place = place' e, and error' e - e_last
    place_error, both = place @ A @ place, place @ (A @ error - b)
    last_error = error @ A @ error - 2.0 * float(error @ b) + lasting
    return weights, np.array([[place_error, both], [both, last_error]])
