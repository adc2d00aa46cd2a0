"""Model of time-correlated GNSS position errors, learned from the fixes: scale, white share, correlation time.

A receiver states the size of its errors, not always rightly, and never their correlation time. Between two fixes the
inertial sensors know the displacement to centimetres, so that differences of fixes minus displacement are changes of
the fixes' errors. A bank of small filters, one per hypothesis, estimates them; the likelihood of each hypothesis
follows from its innovations.

That displacement is no better than the velocities behind it. Where their errors are not white (`gnss_velocity_errors`)
the model does not hold, and positions are followed: what is stated is white to a quarter, and half of it, which is
not estimated, is a part of the protection levels.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from math import exp, log, sqrt

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

TIMES_S = (2.0, 5.0, 10.0, 20.0, 60.0, 200.0, 600.0, 2000.0)
WHITE_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 0.7)
# [s], [-] the hypotheses: correlation time, and share of the variance that is white. The first is nearly all white;
# its correlated remainder is too constant to be observed.
HYPOTHESES = ((600.0, 0.95), *product(TIMES_S, WHITE_SHARES))
CORRELATION_S = np.array([time for time, _ in HYPOTHESES])
LOG_CORRELATION = np.log(CORRELATION_S)
CORRELATED_SHARES = np.array([1.0 - share for _, share in HYPOTHESES])
WHITE_PRIOR = 0.3  # probability of the first; the other hypotheses are equally likely
SCALES = 2.0 ** np.arange(-3.0, 2.5, 0.5)  # [-] each with each of them: how large errors are, over what is stated
SCALE_PRIOR_SDS = 0.35, 0.7  # [-] of its logarithm, below 1 and above: an overconfident filter recovers slowly
SHAPE = (3, len(HYPOTHESES), len(SCALES))  # of the bank, for each axis
MEMORY_S = 600.0  # forgetting time constant, because environments differ
START_SDS = 100.0  # of the unknown initial position over the error of a fix
SURPRISE = 9.0  # d² of one axis at which its influence is clipped
FLOOR = log(0.01) - log(10.0)  # of an axis' likelihood: one fix in a hundred may be ten times as wrong as stated
PERIOD_S = 2.0  # between fixes used for learning: closer ones show the receiver's smoothing, not its errors
RESIDUAL_ERROR_MODEL = (
    0.25,
    10.0,
)  # variance over the stated one, correlation time [s] of what is left, if positions are followed
TIME_CORRELATED_SHARE = 0.5  # of the stated variance, which the levels then hold for errors that last
BREAK_S = 10.0  # without a fix, after which the displacement is unknown again
VELOCITY_CORRELATION_S = 2.0  # of the error of the filter's velocity


@dataclass(frozen=True)
class GnssErrorBank:
    """Bank of hypotheses with their log-likelihoods and estimates.

    Each has, for each scale and axis, two states: the error [m] of the inertial displacement, and the time-correlated
    error over its standard deviation.
    """

    evidence: FloatArray  # shape (2, h, s), logarithmic, of horizontal and vertical errors, whose scales may differ
    way: FloatArray  # shape (3, h, s)
    error: FloatArray
    cov: tuple[FloatArray, FloatArray, FloatArray]
    time_ns: int | None = None
    follows: bool = False  # positions are followed, not corrected by a time-correlated error

    def following(self, follows: bool) -> "GnssErrorBank":
        """Follow positions, or estimate their time-correlated error."""
        return self if follows == self.follows else replace(self, follows=follows)

    @cached_property
    def _weights(self) -> tuple[FloatArray, FloatArray]:
        """Probability of each hypothesis, shape (h,), and of each scale under it, shape (2, h, s)."""
        exponent = PRIOR + self.evidence
        most = exponent.max(axis=2, keepdims=True)
        weight = np.exp(exponent - most)
        total = weight.sum(axis=2, keepdims=True)
        level, upright = most + np.log(total)
        joint = (level + upright)[:, 0]
        weights = np.exp(joint - joint.max())
        return weights / weights.sum(), weight / total

    @property
    def weight(self) -> FloatArray:
        """Probability of each hypothesis, shape (h,)."""
        return self._weights[0]

    @cached_property
    def correlated_share(self) -> float:
        """Time-correlated share of the variance, the mean over all hypotheses."""
        return 0.0 if self.follows else float(self.weight @ CORRELATED_SHARES)

    @cached_property
    def correlation_s(self) -> float:
        """Correlation time [s], the geometric mean over all hypotheses."""
        if self.follows:
            return RESIDUAL_ERROR_MODEL[1]
        weight = self.weight * CORRELATED_SHARES + 1e-12
        return exp(float(weight @ LOG_CORRELATION) / float(weight.sum()))

    def stationary(self, estimated: bool) -> float:
        """Variance of the error over its own standard deviation, if it is a state of the filter."""
        return float(estimated)

    @cached_property
    def scale(self) -> FloatArray:
        """Standard deviations north, east and down over what the receiver states, by the mean variance; shape (3,)."""
        learned = RESIDUAL_ERROR_MODEL[0] * np.minimum(self._learned, 1.0) if self.follows else self._learned
        level, upright = np.sqrt(learned).tolist()
        return np.array([level, level, upright])

    @cached_property
    def _learned(self) -> FloatArray:
        """Variance of horizontal and vertical errors over the stated one, the mean over all hypotheses, shape (2,)."""
        weight, of_scales = self._weights
        learned: FloatArray = weight @ of_scales @ SCALES**2
        return learned

    def unestimated(self, cov: FloatArray) -> tuple[float, float]:
        """Variances [m²] on ground and up of errors that last and are followed, for a stated covariance, shape (3, 3).

        They are half the stated ones, or half the learned ones if these are smaller.
        """
        if not self.follows:
            return 0.0, 0.0
        level, upright = (TIME_CORRELATED_SHARE * np.minimum(self._learned, 1.0)).tolist()
        return level * max(cov.item(0, 0), cov.item(1, 1)), upright * cov.item(2, 2)

    @cached_property
    def unit(self) -> FloatArray:
        """Standard deviation of the time-correlated error over the stated one: north, east, down, shape (3,)."""
        return self.scale * sqrt(max(self.correlated_share, 1e-6))

    def scaled(self, cov: FloatArray) -> FloatArray:
        """Covariance, shape (3, 3), scaled to the observed size of the errors."""
        return cov * self._scales

    @cached_property
    def _scales(self) -> FloatArray:
        return np.outer(self.scale, self.scale)

    def at_start(self) -> "GnssErrorBank":
        """Keep the learned model for a new track."""
        return GnssErrorBank(self.evidence, *_unknown(), follows=self.follows)

    def is_due(self, time_ns: int) -> bool:
        """Whether a fix of this stamp is used for learning."""
        return self.time_ns is None or (time_ns - self.time_ns) * 1e-9 >= PERIOD_S - 1e-3

    def after(self, time_ns: int, path: FloatArray, sd: FloatArray, velocity_variance: FloatArray) -> "GnssErrorBank":
        """Update the bank by one fix.

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
        GnssErrorBank
            This one, if the fix is not newer than the last by `PERIOD_S`.

        Notes
        -----
        For each hypothesis, scale and axis, with w its white share, T its correlation time and k the scale::

            path = c + k s sqrt(1-w) u + k s sqrt(w) n,  c' = velocity error,  u' = -u/T + sqrt(2/T) noise
        """
        if self.time_ns is None:
            way_variance = np.broadcast_to(_of_axes((START_SDS * sd) ** 2), SHAPE)
            start = (way_variance, np.zeros(SHAPE), np.ones(SHAPE))
            return self._updated(time_ns, path, sd, self.error, start, self.evidence)
        if not self.is_due(time_ns):
            return self
        step_s = (time_ns - self.time_ns) * 1e-9
        phi, phi2, grown = _fading(step_s)
        ways, both, errors = self.cov
        drift = velocity_variance * step_s * max(step_s, VELOCITY_CORRELATION_S)
        if step_s > BREAK_S:  # the velocity may have been far worse than it is now
            drift = drift + (START_SDS * sd) ** 2
        predicted = (ways + _of_axes(drift), phi * both, phi2 * errors + grown)
        return self._updated(time_ns, path, sd, phi * self.error, predicted, exp(-step_s / MEMORY_S) * self.evidence)

    def _updated(
        self,
        time_ns: int,
        path: FloatArray,
        sd: FloatArray,
        error: FloatArray,
        cov: tuple[FloatArray, FloatArray, FloatArray],
        evidence: FloatArray,
    ) -> "GnssErrorBank":
        ways, both, errors = cov
        sd = _of_axes(sd)
        h, stated = ROOTS * sd, sd**2
        to_way, to_error = ways + h * both, both + h * errors
        S = to_way + h * to_error + WHITES * stated
        z = _of_axes(path) - self.way - h * error
        most = np.sqrt(SURPRISE * S)
        used = np.maximum(np.minimum(z, most), -most) / S
        gain_way, gain_error = to_way / S, to_error / S
        after = (ways - gain_way * to_way, both - gain_way * to_error, errors - gain_error * to_error)
        way, error = self.way + to_way * used, error + to_error * used
        if self.time_ns is not None:  # the first fix of a track has no predecessor
            likelihood = np.maximum(-0.5 * (z * z / S + np.log(S / stated)), FLOOR)
            evidence = evidence + likelihood[1:]
            evidence[0] += likelihood[0]
        return GnssErrorBank(evidence, way, error, after, time_ns, self.follows)


def _of_axes(values: FloatArray) -> FloatArray:
    """Broadcast three values over the axes of the bank."""
    return values[:, np.newaxis, np.newaxis]


@lru_cache(maxsize=8)  # fixes come evenly
def _fading(step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What remains of each hypothesis' error, shape (h, s), of its variance, and what is added to that."""
    phi = np.repeat(np.exp(-step_s / CORRELATION_S), len(SCALES)).reshape(SHAPE[1:])
    return phi, phi**2, 1.0 - phi**2


def _unknown() -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
    zeros = np.zeros(SHAPE)
    return zeros, zeros, (zeros, zeros, zeros)


def _prior() -> FloatArray:
    """Logarithmic, of each hypothesis and scale, shape (h, s); half the first in each of the two groups of axes."""
    others = len(HYPOTHESES) - 1
    of_hypotheses = 0.5 * np.log([WHITE_PRIOR] + [(1.0 - WHITE_PRIOR) / others] * others)
    of_scales = -0.5 * (np.log(SCALES) / np.where(SCALES < 1.0, *SCALE_PRIOR_SDS)) ** 2
    prior: FloatArray = of_hypotheses[:, np.newaxis] + of_scales
    return prior


ROOTS = SCALES * np.sqrt(CORRELATED_SHARES)[:, np.newaxis]  # [-] time-correlated part over what is stated
WHITES = SCALES**2 * (1.0 - CORRELATED_SHARES)[:, np.newaxis]  # [-] variance of the white part over it
PRIOR = _prior()
UNKNOWN_ERRORS = GnssErrorBank(np.zeros((2, *SHAPE[1:])), *_unknown())


@dataclass(frozen=True)
class KnownGnssErrors:
    """Known model of GNSS errors, in place of a learned one."""

    correlation_s: float
    correlated_share: float  # share of the variance

    def stationary(self, estimated: bool) -> float:
        """Variance of the error over its own standard deviation, if it is a state of the filter."""
        return float(estimated)

    @property
    def scale(self) -> FloatArray:
        """Errors are as large as stated, shape (3,)."""
        return np.ones(3)

    @property
    def unit(self) -> FloatArray:
        """Of the time-correlated error, in what the receiver states: north, east and down, shape (3,)."""
        return np.full(3, sqrt(self.correlated_share))

    def scaled(self, cov: FloatArray) -> FloatArray:
        """Covariance as stated."""
        return cov

    @property
    def follows(self) -> bool:
        """Whether positions are followed; they are corrected by the time-correlated error."""
        return False

    def unestimated(self, _cov: FloatArray) -> tuple[float, float]:
        """All that is time-correlated is estimated."""
        return 0.0, 0.0

    def following(self, _follows: bool) -> "KnownGnssErrors":
        """Keep the known model."""
        return self

    def at_start(self) -> "KnownGnssErrors":
        """Keep the known model for a new track."""
        return self

    def is_due(self, _time_ns: int) -> bool:
        """No fix is used for learning."""
        return False

    def after(
        self, _time_ns: int, _path: FloatArray, _sd: FloatArray, _velocity_variance: FloatArray
    ) -> "KnownGnssErrors":
        """The model is known and stays as it is."""
        return self


def mean_at_rest(
    times_s: FloatArray, correlated_share: float, correlation_s: float, zero_s: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Weights of fixes at standstill, given their time-correlated errors.

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        [s] When they were true, increasing.
    correlated_share : float
        [-] Time-correlated share of their variance.
    correlation_s : float
        [s] Its correlation time.
    zero_s : float, optional
        [s] When it was zero, if it ever was.

    Returns
    -------
    tuple of ndarray
        Weights of the fixes, shape (2, n), for the place and for the time-correlated error at the last of them;
        covariance of the two, shape (2, 2), both in units of the standard deviation of a fix.

    Notes
    -----
    The best linear unbiased estimate: with A the fixes' covariance, b that of fixes and last error, 1 a vector of
    ones::

        A_ij = correlated_share (exp(-|t_i - t_j|/T) - exp(-(t_i + t_j - 2 zero)/T)) + (1 - correlated_share) [i = j]
        p = A^-1 1 / (1^T A^-1 1),  e = A^-1 (b - 1 p^T b)

    References
    ----------
    Gelb (ed.), Applied Optimal Estimation, 1974, ch. 4, as kriging with an unknown mean.
    """
    apart = np.abs(times_s[:, np.newaxis] - times_s)
    alike = np.exp(-apart / correlation_s)
    if zero_s is not None:
        remains = np.exp((zero_s - times_s) / correlation_s)
        alike = alike - np.outer(remains, remains)
    A = correlated_share * alike + (1.0 - correlated_share) * np.eye(len(times_s))
    b = correlated_share * alike[-1]
    ones = np.ones(len(times_s))
    solved = np.linalg.solve(A, np.column_stack([ones, b]))
    place = solved[:, 0] / solved[:, 0].sum()
    error = solved[:, 1] - solved[:, 0] * (solved[:, 1].sum() / solved[:, 0].sum())
    weights = np.array([place, error])
    # errors of the two: place' fixes - place = place' e, and error' e - e_last
    place_error, both = place @ A @ place, place @ (A @ error - b)
    last_error = error @ A @ error - 2.0 * float(error @ b) + b[-1]
    return weights, np.array([[place_error, both], [both, last_error]])
