"""The tracking filters: reference vectors, Jacobians, limits, and the comparison on the mixed trajectory."""

from math import cos, isclose, pi, radians, sin

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cli.papers.toll.trajectory import cam_of, mixed
from services.core.toll.trackers.filters import MANOEUVRE, Estimates, Tracker, imm
from services.core.toll.trackers.models import Cruise, Ctra, Ctrv, FourState, LinearMotion, Model
from services.core.toll.trackers.motion import arc, integrated_noise
from services.core.toll.trackers.observation import ACCELERATION, HEADING, YAW_RATE, Observation, cartesian
from shared.maths.earth import wrap_angles

MODELS: tuple[Model, ...] = (LinearMotion(2, 1.5), LinearMotion(3, 1.0), Ctrv(), Ctra(), Cruise(), FourState())
RUNS = 20


def one(*values: float) -> list[np.ndarray]:
    return [np.array([value]) for value in values]


def closed_form(th: float, v: float, a: float, w: float, dt: float) -> tuple[float, float]:
    """The corrected equations of CTRA, which divide by w²."""
    end = th + w * dt
    x = ((v * w + a * w * dt) * sin(end) + a * cos(end) - v * w * sin(th) - a * cos(th)) / w**2
    y = (-(v * w + a * w * dt) * cos(end) + a * sin(end) + v * w * cos(th) - a * sin(th)) / w**2
    return x, y


@pytest.mark.parametrize(
    ("dt", "v", "w", "th", "a", "expected"),
    [
        (0.1, 20.0, 0.3, 0.7, -3.0, (1.498853047, 1.301295139)),
        (1.0, 10.0, 0.5, 1.0, 1.0, (3.237209592, 9.873923688)),
        (1.0, 10.0, 0.5, 1.0, 0.0, (3.120480036, 9.391302084)),
    ],
)
def test_the_displacement_is_that_of_the_reference_vectors(dt, v, w, th, a, expected) -> None:  # type: ignore[no-untyped-def]
    moved = arc(*one(th, v, a, w, dt)).displacement[0]
    assert_allclose(moved, expected, rtol=0.0, atol=1e-9)
    assert_allclose(moved, closed_form(th, v, a, w, dt), rtol=0.0, atol=1e-11)


def test_the_jacobian_is_that_of_the_reference_vector() -> None:
    expected = [
        [-1.30129513945, 0.0755064925534, 0.00375893456103, -0.0652755702718],
        [1.49885304738, 0.0655592831321, 0.00329684106290, 0.0744285489782],
    ]
    assert_allclose(arc(*one(0.7, 20.0, -3.0, 0.3, 0.1)).jacobian[0], expected, rtol=0.0, atol=1e-11)


def test_the_printed_equation_of_ctrv_is_wrong_by_metres() -> None:
    th, v, w, dt = 0.7, 20.0, 0.3, 0.1
    printed = v / w * (cos(w * dt + th) - sin(th))
    correct = arc(*one(th, v, 0.0, w, dt)).displacement[0, 1]
    assert isclose(printed, 6.7304, abs_tol=1e-4)
    assert isclose(correct, 1.3112, abs_tol=1e-4)


def test_a_vanishing_yaw_rate_is_a_straight_line_without_a_step() -> None:
    straight = arc(*one(1.0, 10.0, 1.0, 0.0, 1.0)).displacement[0]
    length, moment = 10.0 + 0.5, 10.0 / 2.0 + 1.0 / 3.0
    assert_allclose(straight, [length * cos(1.0), length * sin(1.0)], rtol=1e-14)
    nearly = arc(*one(1.0, 10.0, 1.0, 1e-5, 1.0)).displacement[0]
    assert_allclose(nearly - straight, 1e-5 * moment * np.array([-sin(1.0), cos(1.0)]), atol=1e-9)
    assert isclose(float(np.hypot(*(nearly - straight))), 5.3e-5, rel_tol=0.02)


def test_the_quadrature_is_exact_to_rounding_up_to_a_radian() -> None:
    for w in (0.01, 0.1, 0.5, 1.0):
        assert_allclose(arc(*one(0.3, 15.0, -2.0, w, 1.0)).displacement[0], closed_form(0.3, 15, -2, w, 1), rtol=2e-12)


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_every_jacobian_agrees_with_finite_differences(model: Model) -> None:
    rng = np.random.default_rng(5)
    for yaw_scale in (0.5, 1e-7):
        x = rng.normal(size=(1, model.size)) * [50.0, 50.0, *([1.0] * (model.size - 2))]
        x[:, 2:] += 3.0  # no component near a limit of the four-state model
        x[:, -1] *= yaw_scale if not isinstance(model, FourState) else 1.0
        dt = np.array([0.7])
        Phi = model.transition(x, dt).Phi[0]
        for column in range(model.size):
            step = np.zeros_like(x)
            step[0, column] = 1e-5
            ahead, behind = model.transition(x + step, dt).x, model.transition(x - step, dt).x
            difference = (ahead - behind)[0]
            if model.heading is not None:
                difference[model.heading] = wrap_angles(difference[model.heading])
            assert_allclose(Phi[:, column], difference / 2e-5, rtol=1e-6, atol=1e-7)


def test_the_cartesian_observation_has_the_covariance_of_its_jacobian() -> None:
    z = np.array([[3.0, -2.0, 0.8, 12.0, -1.5, 0.2]])
    sd = np.array([1.0, 1.2, 0.02, 0.15, 0.2, 0.01])
    seen = cartesian(Observation.of(z, sd), acceleration=True)
    J = np.empty((6, 6))
    for column in range(6):
        step = np.zeros((1, 6))
        step[0, column] = 1e-6
        ends = [cartesian(Observation.of(z + sign * step, sd), acceleration=True).z[0] for sign in (1, -1)]
        J[:, column] = (ends[0] - ends[1]) / 2e-6
    assert_allclose(seen.R[0], J @ np.diag(sd**2) @ J.T, atol=1e-7)


def test_the_noise_of_a_step_is_that_of_its_two_halves() -> None:
    for order in (2, 3):
        whole, half = integrated_noise(order, np.array([0.8]))[0], integrated_noise(order, np.array([0.4]))[0]
        Phi = LinearMotion(order, 1.0).transition(np.zeros((1, 2 * order)), np.array([0.4])).Phi[0][::2, ::2]
        assert_allclose(Phi @ half @ Phi.T + half, whole, rtol=1e-12)


@pytest.mark.parametrize("tracker", [imm(), *(Tracker((model,)) for model in MODELS)], ids=repr)
def test_an_unavailable_component_changes_nothing_whatever_its_value(tracker: Tracker) -> None:
    sd = np.array([1.0, 1.0, 0.02, 0.15, 0.2, 0.01])
    z = np.array([[5.0, 3.0, 0.5, 20.0, 0.4, 0.05]] * 2)
    has = np.ones((2, 6), dtype=bool)
    has[:, [ACCELERATION, YAW_RATE]] = False
    z[1, [ACCELERATION, YAW_RATE]] = 1e6
    start = tracker.start(Observation.of(z, sd, has))
    after = tracker.update(tracker.predict(start, np.array([0.1, 0.1])), Observation.of(z, sd, has))
    assert_allclose(after.x[0], after.x[1])
    assert_allclose(after.probability[0], after.probability[1])
    nothing = Observation.of(z, sd, np.zeros((2, 6), dtype=bool))
    assert_allclose(tracker.update(after, nothing).P, after.P, rtol=1e-12)
    assert_allclose(tracker.update(after, nothing).probability, after.probability)


def test_every_vehicle_of_a_batch_gets_what_it_would_get_alone() -> None:
    rng = np.random.default_rng(3)
    z = rng.normal(size=(4, 6)) * [100.0, 100.0, 1.0, 5.0, 1.0, 0.2]
    observation = Observation.of(z, np.array([1.0, 1.0, 0.02, 0.15, 0.2, 0.01]))
    dt = np.array([0.1, 0.3, 1.0, 2.0])
    together = imm().update(imm().predict(imm().start(observation), dt), observation)
    for k in range(4):
        row = slice(k, k + 1)
        alone = imm().update(imm().predict(imm().start(observation[row]), dt[row]), observation[row])
        assert_allclose(together.x[row], alone.x, rtol=1e-12)
        assert_allclose(together.cov[row], alone.cov, rtol=1e-9, atol=1e-15)


def test_headings_on_both_sides_of_south_west_north_are_averaged_across_the_wrap() -> None:
    sd = np.array([1.0, 1.0, 0.02, 0.15, 0.2, 0.01])
    west = Observation.of(np.array([[0.0, 0.0, pi - 0.01, 10.0, 0.0, 0.0]]), sd)
    beyond = Observation.of(np.array([[-1.0, 0.0, -pi + 0.01, 10.0, 0.0, 0.0]]), sd)
    tracker = imm()
    after = tracker.update(tracker.predict(tracker.start(west), np.array([0.1])), beyond)
    assert abs(wrap_angles(after.mean[:, 2] - pi)[0]) < 0.02
    assert after.cov[0, 2, 2] < 0.02**2


@pytest.mark.parametrize(("dt", "stay"), [(0.1, 0.97060), (1.0, 0.77274), (3.3, 0.56767), (33.0, 0.50000)])
def test_a_mode_is_held_with_the_probability_of_its_markov_chain(dt: float, stay: float) -> None:
    """p = (1 + exp(-2 dt/3.3 s))/2: vectors by hand, 3.3 s being the mean holding time."""
    estimates = two_modes(np.array([1.0, 0.0]))
    assert_allclose(imm().predict(estimates, np.array([dt])).probability[0], [stay, 1.0 - stay], atol=2e-5)
    mixed_up = imm().predict(two_modes(np.array([0.3, 0.7])), np.array([dt])).probability[0]
    assert_allclose(mixed_up[0], 0.3 * stay + 0.7 * (1.0 - stay), atol=2e-5)


def two_modes(probability: np.ndarray, distance: float = 1.0) -> Estimates:
    """Two modes with means 2 m and 0.2 rad apart, times `distance`, and unit covariances."""
    x = np.zeros((1, 2, 6))
    x[0, 1, :4] = distance * np.array([2.0, 0.0, 0.2, 0.0])
    return Estimates(x, np.broadcast_to(np.eye(6), (1, 2, 6, 6)).copy(), probability[None], 2)


def test_the_covariance_of_a_mixture_holds_the_spread_of_its_means() -> None:
    """P = Σ μ_j (P_j + (x_j - x)(x_j - x)'): with 0.25 and 0.75, 0.1875 of the squared distance beside P_j."""
    mixture = two_modes(np.array([0.25, 0.75]))
    expected = np.eye(6)
    away = np.array([2.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    expected += 0.25 * 0.75 * np.outer(away, away)
    assert_allclose(mixture.mean[0], [1.5, 0.0, 0.15, 0.0, 0.0, 0.0], atol=1e-15)
    assert_allclose(mixture.cov[0], expected, atol=1e-15)


def test_the_mixing_before_a_prediction_holds_the_spread_of_the_means_too() -> None:
    """After a long step the modes were mixed half and half: a quarter of the squared distance of the headings."""
    long_step = np.array([33.0])
    apart, together = two_modes(np.array([0.5, 0.5])), two_modes(np.array([0.5, 0.5]), distance=0.0)
    spread = imm().predict(apart, long_step).P[0, 0, 2, 2] - imm().predict(together, long_step).P[0, 0, 2, 2]
    assert spread == pytest.approx(0.25 * 0.2**2, rel=1e-3)


def mean_square(tracker: Tracker, cams: list[Observation], truth: np.ndarray) -> tuple[float, np.ndarray]:
    """MSE_x + MSE_y over all runs, and the mean probability of the last mode."""
    estimates = tracker.start(cams[0])
    squares, probability = [], []
    for k, cam in enumerate(cams):
        if k:
            estimates = tracker.update(tracker.predict(estimates, np.full(RUNS, 0.1)), cam)
        squares.append(((estimates.mean[:, :2] - truth[k, :2]) ** 2).sum(axis=1).mean())
        probability.append(estimates.probability[:, -1].mean())
    return float(np.mean(squares)), np.array(probability)


def test_the_mixed_trajectory_is_that_of_the_reference() -> None:
    trajectory = mixed()
    assert isclose(trajectory.time_s[-1], 84.2, abs_tol=0.15)
    assert isclose(trajectory.length_m, 1069.0, abs_tol=1.0)


def test_the_imm_is_as_good_as_the_best_model_and_knows_the_mode() -> None:
    trajectory = mixed()
    rng = np.random.default_rng(1)
    error = 3.0 * rng.standard_normal((RUNS, len(trajectory.time_s), 2))
    cams = cam_of(trajectory, error, 3.0, rng)
    raw = float((error**2).sum(axis=2).mean())
    single = [mean_square(Tracker((model,)), cams, trajectory.states)[0] for model in MODELS[:4]]
    of_imm, probability = mean_square(imm(), cams, trajectory.states)
    assert of_imm <= 1.02 * min(single)
    assert max(single) / raw < 0.0155  # reference: 0.013 to 0.015
    position_only = mean_square(Tracker((LinearMotion(2, 1.5, position_only=True),)), cams, trajectory.states)[0]
    assert isclose(position_only / raw, 0.172, abs_tol=0.01)
    assert MANOEUVRE == 1
    assert probability[trajectory.during("roundabout")].mean() > 0.99
    assert probability[trajectory.during("braking")].mean() > 0.99
    assert probability[trajectory.during("cruise")].mean() < 0.02


def test_a_constant_error_leaves_the_ratio_of_table_iii() -> None:
    trajectory = mixed()
    rng = np.random.default_rng(2)
    angle = rng.uniform(0.0, 2.0 * pi, (RUNS // 2, 1, 1))
    bias = 5.94 * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)
    white = 1.13 * rng.standard_normal((RUNS // 2, len(trajectory.time_s), 2))
    error = np.concatenate([white + bias, white - bias])  # opposite errors in pairs cancel the products with the noise
    cams = cam_of(trajectory, error, 1.13, rng)
    raw = float((error**2).sum(axis=2).mean())
    assert isclose(mean_square(Tracker((Ctra(),)), cams, trajectory.states)[0] / raw, 0.936, abs_tol=0.003)


def test_mercator_positions_without_their_scale_make_ctra_diverge() -> None:
    trajectory = mixed()
    rng = np.random.default_rng(3)
    truth = trajectory.states.copy()
    error = 0.2 * rng.standard_normal((RUNS, len(truth), 2))
    scale = 1.0 / cos(radians(49.44))
    assert isclose(scale, 1.53788, abs_tol=1e-5)
    good = mean_square(Tracker((Ctra(),)), cam_of(trajectory, error, 0.2, rng), truth)[0]
    cams = [
        Observation(np.column_stack([cam.z[:, :2] * scale, cam.z[:, 2:]]), cam.R, cam.available)
        for cam in cam_of(trajectory, error, 0.2, rng)
    ]
    truth[:, :2] *= scale
    assert good < 0.05
    assert mean_square(Tracker((Ctra(),)), cams, truth)[0] > 40.0 * good


def test_the_covariance_of_ctra_is_consistent_with_its_own_noise() -> None:
    """Mean normalised estimation error squared (NEES) of 400 vehicles that move by the model: 6 by theory."""
    rng = np.random.default_rng(7)
    count, model = 400, Ctra()
    sd = np.array([1.0, 1.0, radians(1.0), 0.15, 0.2, radians(0.4)])
    state = np.array([0.0, 0.0, 0.4, 20.0, 0.0, 0.0]) + np.zeros((count, 6))
    tracker = Tracker((model,))
    estimates = tracker.start(Observation.of(state + sd * rng.standard_normal(state.shape), sd))
    nees = []
    for _ in range(40):
        dt = rng.uniform(0.1, 0.5, count)
        state, _, Q = model.transition(state, dt)
        root = np.linalg.cholesky(Q + 1e-12 * np.eye(6))
        state = state + np.matvec(root, rng.standard_normal(state.shape))
        z = Observation.of(state + sd * rng.standard_normal(state.shape), sd)
        estimates = tracker.update(tracker.predict(estimates, dt), z)
        error = estimates.mean - state
        error[:, 2] = wrap_angles(error[:, 2])
        nees.append(np.vecdot(error, np.linalg.solve(estimates.cov, error[..., None])[..., 0]).mean())
    assert isclose(float(np.mean(nees)), 6.0, abs_tol=0.3)


@pytest.mark.parametrize("tracker", [imm(), Tracker((Ctra(),)), Tracker((Ctrv(),))], ids=repr)
def test_a_vehicle_that_begins_to_reverse_is_tracked_on(tracker: Tracker) -> None:
    """Brakes from 2 m/s, and goes on with the same deceleration: the heading of its movement turns by 180 degrees."""
    sd = np.array([0.5, 0.5, radians(1.0), 0.15, 0.2, radians(0.4)])
    estimates = None
    for k in range(41):
        t = 0.1 * k
        v = 2.0 - t
        z = Observation.of(
            np.array([[2.0 * t - 0.5 * t**2, 0.0, 0.0 if v >= 0.0 else pi, abs(v), -np.sign(v), 0.0]]), sd
        )
        estimates = (
            tracker.start(z) if estimates is None else tracker.update(tracker.predict(estimates, np.array([0.1])), z)
        )
    assert estimates is not None
    assert_allclose(estimates.mean[0, :2], 0.0, atol=0.3)
    assert abs(wrap_angles(estimates.mean[0, 2:3] - pi)[0]) < 0.02
    assert isclose(estimates.mean[0, 3], 2.0, abs_tol=0.3)


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_noise_of_the_yaw_acceleration_is_integrated_into_yaw_rate_and_heading(dt: float) -> None:
    """White noise of density q: q t of its integral, q t³/3 of the second one, q t²/2 between them."""
    model = Ctra()
    x = np.array([[3.0, 4.0, 0.4, 12.0, 0.5, 0.1]])
    noise, q = model.transition(x, np.array([dt])).Q[0], model.yaw_acceleration_density
    block = noise[np.ix_([HEADING, YAW_RATE], [HEADING, YAW_RATE])]
    assert_allclose(block, q * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]), rtol=1e-12)
