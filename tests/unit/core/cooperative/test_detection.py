"""Least squares, thresholds and tests against closed forms, and their false-alarm rates."""

from math import sqrt

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import binom, chi2, ncx2, norm

from services.core.cooperative.detection import (
    Fit,
    horizontal_levels,
    innovation_test,
    largest_correlations,
    local_threshold,
    minimal_detectable_biases,
    minimal_identifiable_biases,
    noncentrality,
    weighted_fit,
)
from shared.maths.quantiles import chi_square_limit

P_FA, P_MD = 1e-5, 1e-4
# n, T_H, D_H, lambda, sqrt(lambda): reference numbers of section 001
TABLE = (
    (1, 19.5114, 4.4172, 66.1976, 8.1362), (2, 23.0259, 4.5648, 71.2279, 8.4397), (3, 25.9017, 4.6491, 74.9761, 8.6589),
    (4, 28.4733, 4.7081, 78.1106, 8.8380), (5, 30.8562, 4.7534, 80.8640, 8.9924), (6, 33.1071, 4.7901, 83.3502, 9.1296),
    (8, 37.3316, 4.8475, 87.7610, 9.3681),
)  # fmt: skip


@pytest.mark.parametrize(("n", "global_", "local", "lambda_", "root"), TABLE)
def test_thresholds_are_the_reference_numbers(
    n: int, global_: float, local: float, lambda_: float, root: float
) -> None:
    assert chi_square_limit(n, P_FA) == pytest.approx(global_, abs=1e-3)
    assert local_threshold(n, P_FA) == pytest.approx(local, abs=1e-3)
    assert noncentrality(n, P_FA, P_MD) == pytest.approx(lambda_, abs=1e-3)
    assert sqrt(noncentrality(n, P_FA, P_MD)) == pytest.approx(root, abs=1e-3)


@pytest.mark.parametrize(("dof", "rate"), [(1, 1e-2), (3, 1e-5), (17, 1e-7)])
def test_thresholds_are_the_quantiles_of_scipy_stats(dof: int, rate: float) -> None:
    assert chi_square_limit(dof, rate) == pytest.approx(chi2.isf(rate, dof))
    assert ncx2.cdf(chi_square_limit(dof, rate), dof, noncentrality(dof, rate, P_MD)) == pytest.approx(P_MD, rel=1e-3)
    assert 2.0 * dof * ndtr(-local_threshold(dof, rate)) == pytest.approx(rate)


def random_case(seed: int, n: int = 9, m: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    H, sd = rng.standard_normal((n, m)), rng.uniform(0.5, 5.0, n)
    return H, H @ rng.standard_normal(m) + sd * rng.standard_normal(n), sd


def fitted(seed: int = 1, n: int = 9, m: int = 5) -> Fit:
    fit = weighted_fit(*random_case(seed, n, m))
    assert fit is not None
    return fit


def test_the_fit_is_the_solution_of_the_normal_equations() -> None:
    H, y, sd = random_case(1)
    fit, N = fitted(1), H.T @ np.diag(sd**-2) @ H
    assert fit.parameters == pytest.approx(np.linalg.solve(N, H.T @ (y / sd**2)))
    assert fit.cov == pytest.approx(np.linalg.inv(N))
    assert fit.gain @ y == pytest.approx(fit.parameters)
    assert fit.statistic == pytest.approx(float(((y - H @ fit.parameters) ** 2 / sd**2).sum()))
    assert fit.dof == 4 and fit.redundancy.sum() == pytest.approx(4.0), "the trace of S is the number of redundancies"


def test_equal_weights_give_the_mean_and_its_closed_form_tests() -> None:
    """One unknown, n equal measurements: S_ii = 1 - 1/n, w = |y - mean|/(sd sqrt(1 - 1/n))."""
    y = np.array([1.0, 2.0, 4.0, 9.0])
    fit = weighted_fit(np.ones((4, 1)), y, np.full(4, 2.0))
    assert fit is not None
    assert fit.parameters == pytest.approx([4.0]) and fit.cov == pytest.approx(np.array([[1.0]]))
    assert fit.redundancy == pytest.approx(np.full(4, 0.75))
    assert fit.w == pytest.approx(np.abs(y - 4.0) / (2.0 * sqrt(0.75)))
    assert minimal_detectable_biases(fit, 64.0) == pytest.approx(np.full(4, 2.0 * 8.0 / sqrt(0.75)))


def test_leaving_a_measurement_out_lowers_the_statistic_by_its_w_squared() -> None:
    H, y, sd = random_case(3)
    fit = fitted(3)
    for row in range(len(y)):
        rest = weighted_fit(*(np.delete(part, row, axis=0) for part in (H, y, sd)))
        assert rest is not None
        assert rest.statistic == pytest.approx(fit.statistic - fit.w[row] ** 2)
        innovation, t = innovation_test(H[row], float(y[row]), float(sd[row]), rest)
        assert t == pytest.approx(fit.w[row]), "the w-test is the innovation against all others"
        assert innovation == pytest.approx(fit.residuals[row] / fit.redundancy[row])


def test_a_bias_adds_its_noncentrality_to_the_statistic() -> None:
    H, _, sd = random_case(4)
    for row, bias in enumerate(minimal_detectable_biases(fitted(4), 80.0)):
        fit = weighted_fit(H, bias * np.eye(len(sd))[row], sd)
        assert fit is not None and fit.statistic == pytest.approx(80.0)
        error = np.hypot(*fit.parameters[:2])
        assert horizontal_levels(fit, 80.0)[row] == pytest.approx(error), "the level is the error that the bias causes"


def test_what_alone_determines_a_parameter_cannot_be_tested() -> None:
    H = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    fit = weighted_fit(H, np.array([0.0, 1.0, 50.0]), np.ones(3))
    assert fit is not None and fit.w[2] == 0.0
    assert np.isinf(minimal_detectable_biases(fit, 80.0)).tolist() == [False, False, True]


def test_with_one_redundancy_a_fault_is_detected_but_never_attributed() -> None:
    fit = fitted(5, n=6, m=5)
    assert np.isfinite(minimal_detectable_biases(fit, 66.0)).all()
    assert np.isinf(minimal_identifiable_biases(fit, 66.0, P_MD)).all()
    assert fit.w == pytest.approx(np.full(6, fit.w[0])), "all w are equal"


def test_an_identifiable_bias_is_attributed_to_its_measurement() -> None:
    """At the bound the wrong one has the larger w with at most P_MD = 2 %."""
    H, _, sd = random_case(6, n=8, m=4)
    first = weighted_fit(H, np.zeros(8), sd)
    assert first is not None
    bias = float(minimal_identifiable_biases(first, noncentrality(4, 1e-3, 0.02), 0.02)[2])
    rng = np.random.default_rng(7)
    wrong = 0
    for _ in range(2000):
        fit = weighted_fit(H, sd * rng.standard_normal(8) + bias * np.eye(8)[2], sd)
        assert fit is not None
        wrong += int(fit.w.argmax()) != 2
    assert wrong <= binom.ppf(0.999, 2000, 0.02)


@pytest.mark.parametrize("H", [np.ones((3, 4)), np.ones((5, 2)), np.zeros((5, 2))])
def test_a_geometry_that_determines_nothing_has_no_fit(H: np.ndarray) -> None:
    assert weighted_fit(H, np.zeros(len(H)), np.ones(len(H))) is None


@pytest.mark.parametrize("rate", [1e-2, 1e-3])
def test_false_alarms_come_at_the_design_rate_in_100000_epochs(rate: float) -> None:
    """The projection of `weighted_fit` for one geometry, applied to all epochs at once."""
    H, _, sd = random_case(8, n=10, m=5)
    fit = weighted_fit(H, np.zeros(10), sd)
    assert fit is not None
    noise = sd * np.random.default_rng(9).standard_normal((100_000, 10))
    residuals = noise - noise @ (H @ fit.gain).T
    alarms = int((((residuals / sd) ** 2).sum(axis=1) > chi_square_limit(fit.dof, rate)).sum())
    assert binom.ppf(0.001, 100_000, rate) <= alarms <= binom.ppf(0.999, 100_000, rate)


def test_a_bias_is_identifiable_where_two_local_statistics_are_apart_by_their_own_spread() -> None:
    """w_i - w_j of a bias of d standard deviations of w_i: mean (1 - rho) d, variance 2 (1 - rho)."""
    fit, lambda_ = fitted(), noncentrality(4, P_FA, P_MD)
    apart, k = 1.0 - largest_correlations(fit), -norm.ppf(P_MD / (len(fit.sd) - 1))
    factor = minimal_identifiable_biases(fit, lambda_, P_MD) / minimal_detectable_biases(fit, lambda_)
    least = k * np.sqrt(2.0 / apart) / sqrt(lambda_)
    np.testing.assert_allclose(factor, np.maximum(1.0, least), rtol=1e-9)
    assert (factor > 1.0).any(), "the second term decides for some of them"
