"""Covariance of the difference of two solutions, of which one uses more: closed form, and clean simulated drives."""

import numpy as np
import pytest

from services.core.fusion.integrity.error_monitor import ErrorMonitor
from services.core.fusion.integrity.separation import MIN_SD_M, difference_covariance, spreads, squared


def test_the_error_of_nested_least_squares_is_orthogonal_to_their_difference() -> None:
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, [1.0, 1.0, 0.5], size=(200_000, 3))  # of two measurements of both, and a further one
    sub = noise[:, :2].mean(axis=1)
    weights = np.array([1.0, 1.0, 4.0]) / 6.0
    full = noise @ weights
    P_sub, P_full = np.eye(3) / 2.0, np.eye(3) / 6.0
    S = difference_covariance(P_sub, P_full, ErrorMonitor(used_ns=1))
    assert S[0, 0] == pytest.approx(np.var(sub - full) + MIN_SD_M**2, rel=0.02)


def test_where_a_solution_is_not_the_better_informed_the_sum_bounds_the_difference() -> None:
    S = difference_covariance(np.diag([1.0, 4.0, 9.0]), np.diag([2.0, 1.0, 9.0]), ErrorMonitor(used_ns=1))
    assert np.diag(S) == pytest.approx(np.array([3.0, 3.0, 0.0]) + MIN_SD_M**2)
    assert spreads(S) == pytest.approx((np.sqrt(3.0 + MIN_SD_M**2), MIN_SD_M))
    assert squared((np.sqrt(3.0), 0.0, 5.0), S) == pytest.approx(1.0, rel=0.01)
