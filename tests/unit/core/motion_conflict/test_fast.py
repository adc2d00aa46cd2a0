"""The fast GNSS-odometer test: its noise model, its false-alarm rate and its threshold."""

from math import exp, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import binom, chi2, norm

from services.core.motion_conflict.aligned import AlignedPair
from services.core.motion_conflict.fast import fast_statistic, tail_probability
from shared.maths.correlated_noise import mean_variance
from shared.maths.quantiles import chi_square_limit
from tests.support.cases import each

SECOND_NS = 1_000_000_000
STEP = 1.0 / 3.6
SD, CORRELATION_S = 0.1, 2.0


@each("half_width", [0.01, 0.1, 0.5])
@each("difference", [0.0, 0.05, 0.3, -0.6, 1.2])
def test_the_tail_probability_is_the_convolution_of_normal_and_uniform(difference: float, half_width: float) -> None:
    def tail(u: float) -> float:
        return float(norm.sf((abs(difference) - u) / SD) + norm.cdf((-abs(difference) - u) / SD)) / (2.0 * half_width)

    expected, _ = quad(tail, -half_width, half_width, epsabs=0.0, epsrel=1e-10)
    found = tail_probability(difference, sd=SD, half_width=half_width)
    assert found == pytest.approx(expected, rel=1e-7)


def test_without_rounding_the_statistic_is_the_normalised_square() -> None:
    assert tail_probability(0.3, sd=SD, half_width=0.0) == pytest.approx(2.0 * norm.sf(3.0))
    pairs = [AlignedPair(k * SECOND_NS, 20.3, SD, 20.0, 0.0, 0.0) for k in range(6)]
    variance = mean_variance(np.arange(6.0), np.full(6, SD), CORRELATION_S) + 0.01
    found = fast_statistic(pairs, scale=1.0, calibration_variance=0.01, correlation_s=CORRELATION_S, dead_zone_m_s=0.8)
    assert found == pytest.approx(0.09 / variance, rel=1e-9)


def test_the_variance_of_a_mean_lies_between_that_of_white_and_of_constant_errors() -> None:
    times, sd = np.arange(5.0), np.full(5, 0.2)
    assert mean_variance(times, sd, 1e-3) == pytest.approx(0.04 / 5.0)
    assert mean_variance(times, sd, 1e9) == pytest.approx(0.04)


@pytest.mark.parametrize("rate", [1e-2, 1e-3, 1e-5])
def test_the_threshold_is_the_chi_square_quantile_and_not_its_square(rate: float) -> None:
    assert chi_square_limit(1, rate) == pytest.approx(chi2.isf(rate, 1), rel=1e-9)


def test_the_statistic_of_a_gross_difference_is_finite() -> None:
    pairs = [AlignedPair(k * SECOND_NS, 140.0, 0.05, 0.0, 0.0, STEP) for k in range(6)]
    found = fast_statistic(pairs, scale=1.0, calibration_variance=0.0, correlation_s=2.0, dead_zone_m_s=0.8)
    assert chi_square_limit(1, 1e-5) < found < 2000.0


def test_a_dead_zone_explains_a_slow_speed_at_an_odometer_of_zero() -> None:
    def found(gnss: float, odometer: float) -> float:
        pairs = [AlignedPair(k * SECOND_NS, gnss, SD, odometer, 0.0, STEP) for k in range(6)]
        return fast_statistic(pairs, scale=1.0, calibration_variance=0.0, correlation_s=2.0, dead_zone_m_s=0.83)

    assert found(0.8, 0.0) < chi_square_limit(1, 1e-2)
    assert found(10.8, 10.0) > chi_square_limit(1, 1e-5)
    assert found(2.0, 0.0) > chi_square_limit(1, 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e-2, 1e-3])
def test_the_false_alarm_rate_of_100_000_windows_lies_in_the_binomial_interval(rate: float) -> None:
    """Steady speeds: GNSS errors are a first-order Markov process, the odometer's rounding is constant in a window."""
    windows, samples = 100_000, 6
    rng = np.random.default_rng(12)
    keep = exp(-1.0 / CORRELATION_S)
    errors = np.empty((windows, samples))
    errors[:, 0] = rng.normal(0.0, SD, windows)
    for k in range(1, samples):
        errors[:, k] = keep * errors[:, k - 1] + rng.normal(0.0, SD * sqrt(1.0 - keep**2), windows)
    true = rng.uniform(5.0, 40.0, windows)
    scale_error = rng.normal(0.0, 0.002, windows)
    odometer = np.floor(true * (1.0 + scale_error) / STEP + 0.5) * STEP
    limit, alarms = chi_square_limit(1, rate), 0
    for index in range(windows):
        speed = float(odometer[index])
        pairs = [
            AlignedPair(k * SECOND_NS, float(true[index] + errors[index, k]), SD, speed, 0.0, STEP)
            for k in range(samples)
        ]
        found = fast_statistic(
            pairs, scale=1.0, calibration_variance=(0.002 * speed) ** 2, correlation_s=2.0, dead_zone_m_s=0.8
        )
        alarms += found > limit
    low, high = binom.interval(0.999, windows, rate)
    assert low <= alarms <= high


def test_rounding_that_passes_several_steps_is_noise_of_independent_samples() -> None:
    """A uniform error of width s has the variance s²/12, and the mean of n of them s²/12n."""
    speeds = [10.0, 12.0, 14.0, 16.0]
    pairs = [AlignedPair(k * SECOND_NS, v + 0.4, SD, v, 0.0, STEP) for k, v in enumerate(speeds)]
    variance = mean_variance(np.arange(4.0), np.full(4, SD), CORRELATION_S) + STEP**2 / 12.0 / 4.0
    found = fast_statistic(pairs, scale=1.0, calibration_variance=0.0, correlation_s=CORRELATION_S, dead_zone_m_s=0.8)
    assert found == pytest.approx(0.16 / variance, rel=1e-9)
