import math
from dataclasses import replace

import numpy as np
import pytest

from cli.solve.metrics.errors import errors_against
from tests.support.drives.tracks import RATE, reference, solution, track

NOWHERE = (0.0, 0.0, 0.0)
SOLUTIONS_S = [0.1 * k for k in range(301)]
TRUTH_S = [0.05 + 0.37 * k for k in range(80)]


def test_an_exact_solution_has_no_error_between_its_stamps() -> None:
    errors = errors_against(reference(TRUTH_S), track(map(solution, SOLUTIONS_S)), lever_arm_b=NOWHERE)
    assert len(errors) == len(TRUTH_S)
    assert errors.position_n is not None and errors.velocity_n is not None and errors.attitude is not None
    # The cubic through two points of a circle 1 m apart misses it by a few micrometres; the two ways to flatten the
    # Earth within 100 m differ by 2 mm.
    assert np.abs(errors.position_n).max() < 2e-3
    # The chord of a velocity that turns by 0.02 rad in a step is short by 1/8 of that squared.
    assert np.abs(errors.velocity_n).max() < 10.0 * 0.02**2 / 8 * 1.1
    assert np.abs(errors.attitude).max() < 1e-9


def test_a_constant_offset_is_the_error() -> None:
    made = track(solution(t, error_n=(0.3, -0.2, 0.1)) for t in SOLUTIONS_S)
    errors = errors_against(reference(TRUTH_S), made, lever_arm_b=NOWHERE)
    assert errors.position_n is not None
    np.testing.assert_allclose(errors.position_n, np.tile([0.3, -0.2, 0.1], (len(errors), 1)), atol=2e-3)


def test_the_solution_is_transformed_to_the_antenna_before_the_comparison() -> None:
    arm = (1.0, 0.5, -1.2)
    right = errors_against(reference(TRUTH_S, arm_b=arm), track(map(solution, SOLUTIONS_S)), lever_arm_b=arm)
    assert right.position_n is not None and right.velocity_n is not None
    assert np.abs(right.position_n).max() < 2e-3
    assert np.abs(right.velocity_n).max() < 1e-3, "the antenna is faster than the IMU by rate times arm"
    wrong = errors_against(reference(TRUTH_S, arm_b=arm), track(map(solution, SOLUTIONS_S)), lever_arm_b=NOWHERE)
    assert wrong.position_n is not None and wrong.velocity_n is not None
    assert np.hypot(*wrong.position_n[:, :2].T) == pytest.approx(math.hypot(1.0, 0.5), abs=5e-3)
    assert np.hypot(*wrong.velocity_n[:, :2].T) == pytest.approx(RATE * math.hypot(1.0, 0.5), abs=2e-3)


def test_times_outside_the_solution_or_in_a_gap_are_omitted() -> None:
    made = track(solution(t) for t in SOLUTIONS_S if not 10.0 < t < 13.0)
    times = [-1.0, 0.05, 9.5, 11.0, 12.5, 13.5, 29.5, 31.0]
    errors = errors_against(reference(times), made, lever_arm_b=NOWHERE)
    assert len(errors) == 4
    assert len(errors_against(reference(times), track([solution(1.0)]), lever_arm_b=NOWHERE)) == 0
    assert len(errors_against(reference(times), track([]), lever_arm_b=NOWHERE)) == 0


def test_heading_errors_are_wrapped_to_180_degrees() -> None:
    times = [math.pi / RATE + 0.01]  # the truth has just passed south
    truth = reference(times)
    assert truth.attitude is not None
    truth.attitude[0, 2] = math.pi - 0.01
    errors = errors_against(truth, track(map(solution, SOLUTIONS_S)), lever_arm_b=NOWHERE)
    assert errors.attitude is not None
    assert errors.attitude[0, 2] == pytest.approx(0.01 + 0.01 * RATE, abs=1e-9)


def test_the_standard_deviation_of_the_difference_includes_that_of_the_reference() -> None:
    truth = reference([1.0])
    with_sd = replace(truth, position_sd_n=np.full((1, 3), 0.4))
    errors = errors_against(with_sd, track(solution(t, sd=0.3) for t in SOLUTIONS_S), lever_arm_b=NOWHERE)
    np.testing.assert_allclose(errors.position_sd_n, 0.5)


def test_a_delayed_velocity_is_compared_at_its_time_of_validity() -> None:
    times = [5.0 + 0.3 * k for k in range(40)]
    late = 0.125
    truth, older = reference(times), reference([t - late for t in times])
    delayed = replace(truth, velocity_n=older.velocity_n, velocity_delay_ns=125_000_000)
    made = track(map(solution, SOLUTIONS_S))
    right = errors_against(delayed, made, lever_arm_b=NOWHERE)
    assert right.velocity_n is not None and right.position_n is not None
    assert np.abs(right.velocity_n).max() < 1e-3 and np.abs(right.position_n).max() < 2e-3
    wrong = errors_against(replace(delayed, velocity_delay_ns=0), made, lever_arm_b=NOWHERE)
    assert wrong.velocity_n is not None
    turned = 10.0 * 2.0 * math.sin(RATE * late / 2.0)  # 10 m/s that turn meanwhile
    assert np.linalg.norm(wrong.velocity_n, axis=1) == pytest.approx(turned, rel=0.01)
