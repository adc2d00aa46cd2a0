"""The forward filter: Jacobians against finite differences, linear limits, consistency, the road."""

import numpy as np
import pytest

from services.core.cooperative.v2x.forward import (
    CLOCK,
    OSCILLATOR,
    POSITION,
    VELOCITY,
    Estimate,
    ForwardSettings,
    Neighbours,
    correct,
    correct_range_rates,
    correct_road,
    linearised_range_rates,
    predict,
    range_rates,
)
from services.core.cooperative.v2x.road import Road

SIZE = CLOCK + 1
OTHERS = Neighbours(
    np.array([[30.0, 5.0, 0.0], [-60.0, 80.0, 1.0], [15.0, -40.0, 0.0]]),
    np.array([[10.0, 0.0, 0.0], [-5.0, 12.0, 0.0], [0.0, 0.0, 0.0]]),
    np.zeros(3), np.full(3, 1.0), np.full(3, 0.5),
)  # fmt: skip


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def estimate(position_sd: float = 1.0, velocity_sd: float = 0.5, lead: tuple[int, ...] = ()) -> Estimate:
    x = np.zeros((*lead, SIZE))
    x[..., :6] = [2.0, 3.0, 0.0, 12.0, 4.0, 0.0]
    variances = np.array([position_sd**2] * 3 + [velocity_sd**2] * 3 + [1.0] * (SIZE - 6))
    return Estimate(x, np.broadcast_to(np.diag(variances), (*lead, SIZE, SIZE)).copy())


def test_sharp_estimates_have_the_slope_of_finite_differences() -> None:
    sharp = estimate(1e-3, 1e-3)
    mean, slope, rest = linearised_range_rates(sharp, OTHERS)
    assert mean == pytest.approx(range_rates(sharp.x, OTHERS), abs=1e-6)
    for axis in range(6):
        step = 1e-4 * np.eye(SIZE)[axis]
        difference = (range_rates(sharp.x + step, OTHERS) - range_rates(sharp.x - step, OTHERS)) / 2e-4
        assert slope[:, axis] == pytest.approx(difference, abs=1e-6)
    assert np.abs(rest).max() < 1e-8


def test_the_slope_is_the_closed_form() -> None:
    """d rdot/dp = (dv - rdot e)/r and d rdot/dv = e."""
    sharp = estimate(1e-3, 1e-3)
    _, slope, _ = linearised_range_rates(sharp, OTHERS)
    dp, dv = sharp.x[:3] - OTHERS.position_n, sharp.x[3:6] - OTHERS.velocity_n
    r = np.linalg.norm(dp, axis=1)[:, np.newaxis]
    e = dp / r
    rate = (e * dv).sum(axis=1)[:, np.newaxis]
    assert slope == pytest.approx(np.hstack([(dv - rate * e) / r, e]), abs=1e-6)


def test_near_a_passing_neighbour_the_moments_are_those_of_samples(rng: np.random.Generator) -> None:
    """At 4 m abreast with 3 m of uncertainty the range-rate is far from linear: cubature knows, a tangent does not."""
    passing = OTHERS._replace(position_n=np.array([[4.0, 7.0, 0.0]] * 3), velocity_n=np.array([[-12.0, -9.0, 0.0]] * 3))
    spread = estimate(3.0, 0.5)
    mean, slope, rest = linearised_range_rates(spread, passing)
    samples = spread.x + rng.standard_normal((200_000, SIZE)) @ np.sqrt(spread.P)
    z = range_rates(samples, passing)[:, 0]
    explained = float(slope[0] @ spread.P[:6, :6] @ slope[0])
    assert mean[0] == pytest.approx(z.mean(), abs=0.15 * z.std())
    assert explained + rest[0] == pytest.approx(0.959 * z.var(), rel=0.02), "cubature misses 4 %"
    assert rest[0] == pytest.approx(0.353 * z.var(), rel=0.03), "a tangent has no rest, and 0.92 in all"


def test_sequential_corrections_are_the_batch_kalman_update(rng: np.random.Generator) -> None:
    before = estimate()
    H, z, R = rng.standard_normal((4, SIZE)), rng.standard_normal(4), np.array([1.0, 2.0, 0.5, 3.0])
    after = correct(before, H, z, R, np.ones(4, dtype=np.bool_))
    S = H @ before.P @ H.T + np.diag(R)
    K = before.P @ H.T @ np.linalg.inv(S)
    assert after.x == pytest.approx(before.x + K @ z)
    assert pytest.approx(before.P - K @ S @ K.T) == after.P


def test_what_is_not_used_changes_nothing(rng: np.random.Generator) -> None:
    before = estimate()
    H, z = rng.standard_normal((4, SIZE)), 1e6 * np.ones(4)
    after = correct(before, H, z, np.ones(4), np.zeros(4, dtype=np.bool_))
    assert (after.x == before.x).all() and (after.P == before.P).all()


def test_filters_side_by_side_are_the_same_filters_one_by_one(rng: np.random.Generator) -> None:
    lead = estimate(lead=(4, 3))
    varied = Estimate(lead.x + 0.1 * rng.standard_normal(lead.x.shape), lead.P)
    settings, road = ForwardSettings(), Road(np.array([[-100.0, 0.0, 0.0], [100.0, 20.0, 0.0], [300.0, 0.0, 0.0]]))
    step = correct_road(correct_range_rates(predict(varied, 0.5, settings), OTHERS), road, settings)
    for k in range(4):
        alone = Estimate(varied.x[k, 1], varied.P[k, 1])
        alone = correct_road(correct_range_rates(predict(alone, 0.5, settings), OTHERS), road, settings)
        assert alone.x == pytest.approx(step.x[k, 1]) and pytest.approx(step.P[k, 1]) == alone.P


def test_two_half_steps_of_prediction_are_one_whole_step() -> None:
    settings = ForwardSettings()
    whole = predict(estimate(), 1.0, settings)
    halves = predict(predict(estimate(), 0.5, settings), 0.5, settings)
    assert halves.x == pytest.approx(whole.x) and pytest.approx(whole.P) == halves.P


def test_the_radios_oscillator_is_learned_from_neighbours_whose_own_is_known(rng: np.random.Generator) -> None:
    """10 m/s are 0.03 ppm; without the state every neighbour would seem to recede by as much."""
    truth, found = estimate(0.0, 0.0), estimate(1.0, 0.5)
    found.P[OSCILLATOR, OSCILLATOR] = 6000.0**2
    for _ in range(20):
        reports = OTHERS._replace(shifted_rate=range_rates(truth.x, OTHERS) + 10.0 + 0.5 * rng.standard_normal(3))
        found = correct_range_rates(found, reports)
    assert found.x[OSCILLATOR] == pytest.approx(10.0, abs=3.0 * float(np.sqrt(found.P[OSCILLATOR, OSCILLATOR])))
    assert found.P[OSCILLATOR, OSCILLATOR] < 1.0


def test_the_estimate_is_consistent_with_its_covariance(rng: np.random.Generator) -> None:
    """NEES of position and velocity over 300 drives of 20 s on a straight road: 6 on average."""
    runs, settings = 300, ForwardSettings()
    road = Road(np.array([[-1000.0, 0.0, 0.0], [5000.0, 0.0, 0.0]]))
    truth = np.zeros((runs, 6))
    truth[:, 3] = 15.0
    start_sd = np.array([1.0, 1.0, 1.0, 0.5, 0.3, 0.3])
    found = estimate(lead=(runs,))
    found.x[:, :6] = truth + start_sd * rng.standard_normal((runs, 6))
    found.P[:, :6, :6] = np.diag(start_sd**2)
    for _ in range(20):
        push = settings.acceleration_sd * rng.standard_normal(runs)
        truth[:, 0] += truth[:, 3] + push / 2.0
        truth[:, 3] += push
        others = truth[:, np.newaxis, :3] + np.array([[40.0, 3.0, 0.0], [-25.0, -3.5, 0.0], [80.0, 60.0, 0.0]])
        velocities = np.array([[14.0, 0.0, 0.0], [15.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        clean = Neighbours(others, velocities, np.zeros(3), np.full(3, 1.0), np.full(3, 1.0))
        rates = range_rates(truth, clean) + rng.standard_normal((runs, 3))
        noisy = clean._replace(shifted_rate=rates, position_n=others + rng.standard_normal(others.shape))
        found = predict(found, 1.0, settings)
        found.P[:, OSCILLATOR, :] = found.P[:, :, OSCILLATOR] = 0.0
        errors = np.array([1.0, 1.0, 0.3]) * rng.standard_normal((runs, 3))
        found = correct_road(correct_range_rates(found, noisy), road, settings, errors)
    error = found.x[:, [0, 3]] - truth[:, [0, 3]]
    cov = found.P[:, [0, 3]][:, :, [0, 3]]
    nees = float((error * np.linalg.solve(cov, error[..., np.newaxis])[..., 0]).sum(axis=1).mean())
    assert 1.5 < nees < 2.6, "along the road: 2 on average; the uniform push has the variance of the white one"
    assert (np.abs(found.x[:, 1]) < 4.0).all(), "the map holds the position across"


def test_the_foot_of_a_point_on_a_road() -> None:
    road = Road(np.array([[0.0, 0.0, 5.0], [100.0, 0.0, 5.0], [100.0, 100.0, 15.0]]))
    foot = road.foot(np.array([[40.0, 3.0, 0.0], [97.0, 50.0, 0.0], [-10.0, 4.0, 0.0], [103.0, 120.0, 0.0]]))
    expected = [[40.0, 0.0, 5.0], [100.0, 50.0, 10.0], [-10.0, 0.0, 5.0], [100.0, 120.0, 17.0]]
    assert foot.position_n == pytest.approx(np.array(expected)), "beyond the ends the end segments continue"
    assert foot.distance == pytest.approx([3.0, 3.0, 4.0, 3.0])
    assert foot.along[1] == pytest.approx([0.0, 1.0, 0.0]) and foot.across[1] == pytest.approx([-1.0, 0.0, 0.0])


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((2, 3))])
def test_a_road_without_length_is_an_error(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="two points"):
        Road(points)


def test_the_road_measures_offset_height_and_lateral_speed_and_nothing_along() -> None:
    settings = ForwardSettings()
    road = Road(np.array([[-500.0, -500.0, 2.0], [500.0, 500.0, 2.0]]))
    before = estimate(10.0, 5.0)
    after = correct_road(before, road, settings)
    along = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    assert along @ after.x[POSITION] == pytest.approx(along @ before.x[POSITION])
    assert along @ after.P[POSITION, POSITION] @ along == pytest.approx(100.0)
    assert np.sqrt(np.linalg.eigvalsh(after.P[POSITION, POSITION])[0]) < 1.0
    assert abs(after.x[VELOCITY] @ np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)) < 0.1
    assert after.x[2] == pytest.approx(2.0, abs=0.05)
