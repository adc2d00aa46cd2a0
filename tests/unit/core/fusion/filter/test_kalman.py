import numpy as np
import pytest

from services.core.fusion.filter.kalman import predict, resized
from shared.maths.kalman import correct


def random_covariance(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_a_predicted_covariance_is_phi_p_phi_transposed_plus_noise() -> None:
    rng = np.random.default_rng(1)
    P, Phi, added = random_covariance(rng, 6), rng.standard_normal((6, 6)), rng.random(6)
    predicted = predict(P, Phi, added)
    assert predicted == pytest.approx(Phi @ P @ Phi.T + np.diag(added), abs=1e-12)
    assert np.array_equal(predicted, predicted.T)


def test_a_scale_estimated_after_two_fixes_results_in_the_covariance_of_that_scale_from_the_start() -> None:
    """Unknown position r, time-correlated error u of variance one, two fixes r + h u; h = 2, then 0.5."""

    def after_two_fixes(h: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        P, H, R = np.diag([1e8, 1.0]), np.array([[1.0, h]]), np.array([[0.01]])
        for _ in range(2):
            P = correct(P, np.zeros(1), H, R).P
        return P

    found = resized(after_two_fixes(2.0), 1, 2, np.array([0.25]))
    assert found == pytest.approx(after_two_fixes(0.5), rel=1e-4)


def test_resizing_an_error_leaves_uncorrelated_states_unchanged() -> None:
    P = random_covariance(np.random.default_rng(3), 5)
    P[:3, 3:] = P[3:, :3] = 0.0
    assert resized(P, 3, 5, np.array([0.1, 7.0])) == pytest.approx(P, rel=1e-12)
