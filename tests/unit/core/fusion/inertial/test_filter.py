import numpy as np
import pytest

from services.core.fusion.inertial.filter import rescaled
from shared.maths.kalman import correct


def random_covariance(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_a_scale_estimated_after_two_fixes_results_in_the_covariance_of_that_scale_from_the_start() -> None:
    """Unknown position r, time-correlated error u of variance one, two fixes r + h u; h = 2, then 0.5."""

    def after_two_fixes(h: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        P, H, R = np.diag([1e8, 1.0]), np.array([[1.0, h]]), np.array([[0.01]])
        for _ in range(2):
            P = correct(P, np.zeros(1), H, R).P
        return P

    found = rescaled(after_two_fixes(2.0), slice(1, 2), np.array([0.25]))
    assert found == pytest.approx(after_two_fixes(0.5), rel=1e-4)


def test_resizing_an_error_leaves_uncorrelated_states_unchanged() -> None:
    P = random_covariance(np.random.default_rng(3), 5)
    P[:3, 3:] = P[3:, :3] = 0.0
    assert rescaled(P, slice(3, 5), np.array([0.1, 7.0])) == pytest.approx(P, rel=1e-12)
