import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from services.core.fusion.filter.kalman import chi_square_limit, correct, inverse_of, predict, resized
from shared.errors import FilterDiverged


@given(st.integers(1, 3), st.floats(1e-6, 0.4))
def test_the_limits_of_chi_square_are_those_of_scipy(dimension: int, false_alarm: float) -> None:
    assert chi_square_limit(dimension, false_alarm) == pytest.approx(chi2.isf(false_alarm, dimension), rel=1e-9)


def test_a_chi_square_of_another_dimension_is_refused() -> None:
    with pytest.raises(ValueError, match="dimension 4"):
        chi_square_limit(4, 0.01)


def random_covariance(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_a_prediction_is_the_covariance_of_what_the_transition_makes_of_errors() -> None:
    rng = np.random.default_rng(1)
    P, Phi, added = random_covariance(rng, 6), rng.standard_normal((6, 6)), rng.random(6)
    predicted = predict(P, Phi, added)
    assert predicted == pytest.approx(Phi @ P @ Phi.T + np.diag(added), abs=1e-12)
    assert np.array_equal(predicted, predicted.T)


def test_a_correction_is_that_of_the_information_filter() -> None:
    rng = np.random.default_rng(2)
    P, R, H, z = random_covariance(rng, 6), random_covariance(rng, 3), rng.standard_normal((3, 6)), rng.random(3)
    result = correct(P, z, H, R)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    S = H @ P @ H.T + R
    assert np.abs(result.P - np.linalg.inv(information)).max() < 1e-10
    assert result.x == pytest.approx(np.linalg.solve(information, H.T @ np.linalg.solve(R, z)), abs=1e-10)
    assert result.distance2 == pytest.approx(z @ np.linalg.inv(S) @ z, rel=1e-10)
    assert result.innovation_sd == pytest.approx(np.sqrt(np.diag(S)))
    assert np.array_equal(result.P, result.P.T)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_the_inverse_of_a_covariance_is_that_of_numpy(size: int) -> None:
    rng = np.random.default_rng(size)
    for _ in range(100):
        scales = 10.0 ** rng.uniform(-4.0, 4.0, size)
        S = random_covariance(rng, size) * np.outer(scales, scales)
        assert inverse_of(S) * np.outer(scales, scales) @ (S / np.outer(scales, scales)) == pytest.approx(
            np.eye(size), abs=1e-10
        )


@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_no_covariance_has_no_inverse(place: int) -> None:
    for wrong in (-1.0, 0.0, np.nan, np.inf):
        S = np.eye(3)
        S[place, place] = wrong
        with pytest.raises(FilterDiverged, match="positive definite"):
            inverse_of(S)
    with pytest.raises(FilterDiverged, match="positive definite"):
        inverse_of(np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_a_nearly_perfect_measurement_leaves_a_positive_covariance() -> None:
    rng = np.random.default_rng(3)
    P = random_covariance(rng, 15) * 1e6
    for _ in range(50):
        P = correct(P, np.zeros(3), rng.standard_normal((3, 15)), 1e-6 * np.eye(3)).P
        assert np.linalg.eigvalsh(P)[0] > 0.0


def test_a_breakdown_has_a_name() -> None:
    with pytest.raises(FilterDiverged, match="positive definite"):
        correct(-np.eye(3), np.zeros(3), np.eye(3), np.zeros((3, 3)))
    with pytest.raises(FilterDiverged, match="finite"):
        correct(np.eye(3), np.array([np.nan, 0.0, 0.0]), np.eye(3), np.eye(3))


def test_a_unit_found_later_leaves_what_it_would_have_left_from_the_beginning() -> None:
    """Place r unknown, lasting error u of variance one, two fixes r + h u, and h = 2 found to be 0.5 after them."""

    def after_two_fixes(h: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        P, H, R = np.diag([1e8, 1.0]), np.array([[1.0, h]]), np.array([[0.01]])
        for _ in range(2):
            P = correct(P, np.zeros(1), H, R).P
        return P

    found = resized(after_two_fixes(2.0), 1, 2, np.array([0.25]))
    assert found == pytest.approx(after_two_fixes(0.5), rel=1e-4)


def test_what_does_not_stem_from_an_error_is_not_resized_with_it() -> None:
    P = random_covariance(np.random.default_rng(3), 5)
    P[:3, 3:] = P[3:, :3] = 0.0
    assert resized(P, 3, 5, np.array([0.1, 7.0])) == pytest.approx(P, rel=1e-12)
