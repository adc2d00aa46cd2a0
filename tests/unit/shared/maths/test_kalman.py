import numpy as np
import numpy.typing as npt
import pytest

from shared.errors import FilterDiverged
from shared.maths.kalman import consider, correct, predict, root_of

FloatArray = npt.NDArray[np.float64]


def random_covariance(rng: np.random.Generator, n: int) -> FloatArray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_a_predicted_covariance_is_phi_p_phi_transposed_plus_noise() -> None:
    rng = np.random.default_rng(1)
    P, Phi, Q = random_covariance(rng, 6), rng.standard_normal((6, 6)), random_covariance(rng, 6)
    predicted = predict(P, Phi, Q)
    assert predicted == pytest.approx(Phi @ P @ Phi.T + Q, abs=1e-12)
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


def test_a_stack_of_filters_is_predicted_and_corrected_as_each_of_them() -> None:
    rng = np.random.default_rng(4)
    P = np.array([[random_covariance(rng, 4) for _ in range(3)] for _ in range(2)])
    Phi, Q = rng.standard_normal((2, 3, 4, 4)), np.eye(4)
    z, H, R = rng.standard_normal((2, 3, 2)), rng.standard_normal((2, 4)), random_covariance(rng, 2)
    predicted = predict(P, Phi, Q)
    together = correct(predicted, z, H, R)
    for place in np.ndindex(2, 3):
        assert predicted[place] == pytest.approx(predict(P[place], Phi[place], Q), abs=1e-12)
        alone = correct(predicted[place], z[place], H, R)
        assert together.x[place] == pytest.approx(alone.x, abs=1e-12)
        assert together.P[place] == pytest.approx(alone.P, abs=1e-12)
        assert np.asarray(together.distance2)[place] == pytest.approx(alone.distance2, rel=1e-12)
        assert together.innovation_sd[place] == pytest.approx(alone.innovation_sd, rel=1e-12)


def test_considered_states_keep_value_and_covariance_and_the_others_count_them_as_noise() -> None:
    """A state that is considered and has no correlation is a further noise of the measurement."""
    rng = np.random.default_rng(5)
    P = np.zeros((5, 5))
    P[:3, :3], P[3:, 3:] = random_covariance(rng, 3), random_covariance(rng, 2)
    R, H, z = random_covariance(rng, 2), rng.standard_normal((2, 5)), rng.random(2)
    found = consider(P, correct(P, z, H, R), R, slice(3, 5))
    assert np.array_equal(found.x[3:], np.zeros(2))
    assert found.P[3:, 3:] == pytest.approx(P[3:, 3:], abs=1e-12)
    noisier = correct(P[:3, :3].copy(), z, H[:, :3], R + H[:, 3:] @ P[3:, 3:] @ H[:, 3:].T)
    assert found.x[:3] == pytest.approx(noisier.x, abs=1e-12)
    assert found.P[:3, :3] == pytest.approx(noisier.P, abs=1e-12)
    assert np.array_equal(found.P, found.P.T) and np.linalg.eigvalsh(found.P)[0] > 0.0
    stacked = consider(np.array([P, P]), correct(np.array([P, P]), np.array([z, z]), H, R), R, slice(3, 5))
    assert stacked.P[1] == pytest.approx(found.P, abs=1e-12)
    assert pytest.approx(correct(P, z, H, R).P, abs=1e-12) == consider(P, correct(P, z, H, R), R, slice(0, 0)).P


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_matrix_that_is_no_covariance_raises_an_error(place: int) -> None:
    for wrong in (-1.0, 0.0, np.nan, np.inf):
        S = np.eye(3)
        S[place, place] = wrong
        with pytest.raises(FilterDiverged, match="covariance of this is not positive definite"):
            root_of(S, "this")
        with pytest.raises(FilterDiverged, match="covariance of this is not positive definite"):
            root_of(np.array([np.eye(3), S]), "this")
    with pytest.raises(FilterDiverged, match="positive definite"):
        root_of(np.array([[1.0, 2.0], [2.0, 1.0]]), "this")


def test_a_nearly_perfect_measurement_leaves_a_positive_covariance() -> None:
    rng = np.random.default_rng(3)
    P = random_covariance(rng, 15) * 1e6
    for _ in range(50):
        P = correct(P, np.zeros(3), rng.standard_normal((3, 15)), 1e-6 * np.eye(3)).P
        assert np.linalg.eigvalsh(P)[0] > 0.0


def test_a_numerical_breakdown_raises_a_named_error() -> None:
    with pytest.raises(FilterDiverged, match="positive definite"):
        correct(-np.eye(3), np.zeros(3), np.eye(3), np.zeros((3, 3)))
    with pytest.raises(FilterDiverged, match="finite"):
        correct(np.eye(3), np.array([np.nan, 0.0, 0.0]), np.eye(3), np.eye(3))
