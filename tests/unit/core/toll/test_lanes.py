"""Delta position, lane geometry and lane posterior."""

from math import isclose, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cli.papers.toll.lane_decisions import ROWS, gauss_markov, simulate
from services.core.toll.codes import Code
from services.core.toll.delta import Delta, DeltaEstimator, ErrorModel
from services.core.toll.lanes import LaneGeometry, lane_likelihood
from shared.messages.explanation import explain
from tests.support.cases import each

SECOND_NS = 10**9


def estimator(model: ErrorModel | None = None) -> DeltaEstimator:
    return DeltaEstimator(model or ErrorModel(), window_s=30.0, least_s=10.0, max_age_s=10.0)


@each(
    ("sd", "percent"),
    [
        (0.3, 100.00), (0.5, 99.95), (0.6, 99.65), (0.68, 98.99), (0.8, 97.13), (1.0, 91.99), (1.2, 85.53),
        (1.5, 75.67), (2.0, 61.84), (3.0, 44.03), (4.2, 32.31),
    ],
)  # fmt: skip
def test_a_centred_vehicle_is_in_its_lane_as_often_as_the_reference_says(sd: float, percent: float) -> None:
    """The share of the normal distribution of positions for which its lane of three is the most probable one."""
    measured = np.linspace(-8.0 * sd, 8.0 * sd, 40_001)
    left = measured[:, None] - np.array([-3.5, 0.0, 3.5])
    prior = np.full_like(left, 1.0 / 3.0)
    in_own_lane = lane_likelihood(left, np.full_like(left, sd**2), prior).argmax(axis=1) == 1
    density = np.exp(-0.5 * (measured / sd) ** 2)
    assert isclose(100.0 * float(density[in_own_lane].sum() / density.sum()), percent, abs_tol=0.02)


def test_the_delta_is_the_surveyed_position_minus_the_fix() -> None:
    one = estimator()
    for second in range(31):
        assert one.add(second * SECOND_NS, east=2.0, north=-3.0) is None
    delta = one.delta(31 * SECOND_NS)
    assert isinstance(delta, Delta)
    assert_allclose((delta.east, delta.north), (-2.0, 3.0), rtol=1e-12)
    assert delta.time_ns == 30 * SECOND_NS
    assert delta.fixes == 31


def test_fixes_before_the_window_do_not_count() -> None:
    one, fresh = estimator(), estimator()
    for second in range(100):
        one.add(second * SECOND_NS, east=float(second) if second >= 69 else 50.0, north=0.0)
        if second >= 69:
            fresh.add(second * SECOND_NS, east=float(second), north=0.0)
    assert one.delta(99 * SECOND_NS) == fresh.delta(99 * SECOND_NS)


def test_independent_fixes_of_a_constant_error_are_averaged() -> None:
    """With white noise alone and a common error that does not change the best prediction is the mean, with σ²/n."""
    model = ErrorModel(common_s=1e9, unit_sd=1e-6, unit_white_sd=0.5)
    one, east = estimator(model), np.random.default_rng(3).normal(2.0, 0.5, 31)
    for second in range(31):
        one.add(second * SECOND_NS, east[second], 0.0)
    delta = one.delta(30 * SECOND_NS)
    assert isinstance(delta, Delta)
    assert isclose(delta.east, -east.mean(), rel_tol=1e-4)
    assert isclose(delta.sd, 0.5 / sqrt(31.0), rel_tol=1e-3)


def test_there_is_no_delta_from_few_or_old_fixes() -> None:
    one = estimator()
    assert one.delta(0) == explain(Code.NO_FIX)
    for second in range(10):
        one.add(second * SECOND_NS, 0.0, 0.0)
    assert one.delta(9 * SECOND_NS) == explain(Code.FEW_FIXES, span_s=9)
    for second in range(10, 30):
        one.add(second * SECOND_NS, 0.0, 0.0)
    assert isinstance(one.delta(39 * SECOND_NS), Delta)
    assert one.delta(40 * SECOND_NS) == explain(Code.OLD_FIX, age_s=11)
    one.add(60 * SECOND_NS, 0.0, 0.0)
    assert one.delta(60 * SECOND_NS) == explain(Code.FEW_FIXES, span_s=0)


def test_fixes_far_away_or_out_of_order_are_rejected() -> None:
    one = estimator()
    assert one.add(SECOND_NS, 80.0, 80.0) == "fix_far_from_antenna"
    assert one.add(SECOND_NS, 1.0, 1.0) is None
    assert one.add(SECOND_NS, 1.0, 1.0) == "fix_out_of_order"


def test_the_standard_deviation_of_the_delta_is_that_of_simulated_errors() -> None:
    rng = np.random.default_rng(1)
    model, runs = ErrorModel(), 1500
    common = gauss_markov(rng, (runs, 301, 2), model.common_sd, model.common_s)
    fixes = (common + gauss_markov(rng, (runs, 301, 2), model.unit_sd, model.unit_s))[:, ::10]
    fixes += model.unit_white_sd * rng.standard_normal(fixes.shape)
    left, stated = [], []
    for run in range(runs):
        one = estimator()
        for second, (east, north) in enumerate(fixes[run].tolist()):
            one.add(second * SECOND_NS, east, north)
        delta = one.delta(30 * SECOND_NS)
        assert isinstance(delta, Delta)
        left += [common[run, -1, 0] + delta.east, common[run, -1, 1] + delta.north]
        stated.append(delta.sd)
    assert isclose(float(np.std(left)), stated[0], rel_tol=0.06)
    assert stated[0] < 0.4


def curve() -> LaneGeometry:
    """A lane to the north that bends to the east by 45 degrees, and a straight one; the gates are at 50 m."""
    bent = np.array([[0.0, 0.0], [0.0, 100.0], [100.0, 200.0]])
    return LaneGeometry.of([bent, np.array([[20.0, 0.0], [20.0, 300.0]])], [3.5, 3.5], [(20.0, 50.0, 80.0)] * 2)


def test_positions_are_projected_on_the_nearest_segment_of_each_lane() -> None:
    found = curve().project(np.array([[-1.0, 70.0], [49.0, 151.0], [0.0, -30.0], [151.0, 251.0]]))
    root = sqrt(2.0)
    assert_allclose(found.along[:, 0], [20.0, 50.0 + 50.0 * root, -80.0, 50.0 + 151.0 * root], atol=1e-9)
    assert_allclose(found.left[:, 0], [1.0, root, 0.0, 0.0], atol=1e-9)
    assert_allclose(found.direction[1, 0], [1.0 / root, 1.0 / root])
    assert_allclose(found.left[:, 1], [21.0, -29.0, 20.0, -131.0], atol=1e-9)
    assert_allclose(curve().approach, [-30.0, -30.0])
    assert_allclose(curve().exit, [30.0, 30.0])


def test_the_delta_and_the_filter_find_the_lane_and_filtering_alone_does_not() -> None:
    found = simulate(ROWS[0], 150, 1)
    assert found.most_probable >= 0.90
    assert found.decided > 0.75
    assert found.decided_wrong <= 0.01
    assert 0.35 < found.filtered < 0.62
    assert found.wrong_sign < found.raw
    assert found.careless_decided > 0.9
    assert found.careless_wrong > 0.3
    assert 0.6 < found.lateral_rms_m < 0.85  # with a plain mean over 30 s the reference has 0.85 m


def test_vehicles_that_are_corrected_already_keep_their_lanes() -> None:
    found = simulate(ROWS[0], 150, 1, corrected=True)
    assert found.filtered_delta < 0.6  # with the delta applied to all: the reference has 44 %
    assert found.most_probable >= 0.95
    assert found.decided_wrong <= 0.01


@pytest.mark.parametrize("row", [1, 2, 3])
def test_a_decided_lane_is_hardly_ever_wrong_in_the_other_rows(row: int) -> None:
    assert simulate(ROWS[row], 150, 2).decided_wrong <= 0.01


def test_the_weights_of_fixes_sum_to_one_so_that_a_constant_error_is_no_bias() -> None:
    for times in (np.arange(-30.0, 1.0), np.array([-30.0, -29.5, -3.0, 0.0])):
        weights, variance = estimator()._weights(times)
        assert isclose(weights.sum(), 1.0, rel_tol=1e-9) and variance > 0.0


def test_a_vehicle_is_somewhere_in_its_lane_and_not_on_its_centre_line() -> None:
    """Uniform within 0.3 m: with an exact position that much beside the centre is no surprise."""
    left = np.array([[0.3]])
    found = lane_likelihood(left, np.zeros_like(left), np.ones_like(left))[0, 0]
    assert isclose(found, np.exp(-1.5) / sqrt(2.0 * np.pi * 0.03), rel_tol=1e-9)
