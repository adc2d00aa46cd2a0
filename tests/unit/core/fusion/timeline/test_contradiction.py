"""What a contradiction holds: nothing within its spread, what was largest in spreads, and what a return leaves."""

from itertools import pairwise
from math import hypot

import numpy as np
import pytest

from services.core.fusion.integrity.disagreement import CLOSURE_SDS
from services.core.fusion.timeline.contradiction import Contradiction, ResidualOffset, SolutionDifference

SECOND_NS = 1_000_000_000
SDS, RISK = 3.3, 1e-3


def apart(second: float, north_m: float, sd_m: float, down_m: float = 0.0) -> SolutionDifference:
    return SolutionDifference.of(round(second * SECOND_NS), (north_m, 0.0, down_m), np.eye(3) * sd_m**2)


def seen(*differences: SolutionDifference, decides: bool = True) -> Contradiction:
    found = Contradiction()
    for difference in differences:
        found = found.after(difference, decides=decides)
    return found


def test_a_difference_within_three_standard_deviations_of_it_holds_nothing_however_large_it_is() -> None:
    found = seen(*(apart(k, 0.99 * CLOSURE_SDS * k, k) for k in range(1, 60)))
    assert not found.is_any and found.left(apart(61, 500.0, 200.0), SDS, RISK) == ResidualOffset()


def test_it_keeps_what_was_the_most_standard_deviations_and_a_growing_spread_takes_nothing_back() -> None:
    found = seen(apart(1, 20.0, 2.0), *(apart(k, 20.0, 2.0 + k) for k in range(2, 30)))
    assert found.vector_n == (20.0, 0.0, 0.0) and found.spread[0] == pytest.approx(2.0)


def test_what_gnss_moves_afterwards_is_added_while_the_other_one_decides() -> None:
    differences = [apart(1, 20.0, 2.0), apart(2, 26.0, 8.0)]
    assert seen(*differences).vector_n[0] == 26.0
    assert seen(differences[0]).after(differences[1], decides=False).vector_n[0] == 20.0


def test_a_solution_that_does_not_decide_contradicts_nothing_however_small_its_covariance_is() -> None:
    assert not seen(apart(1, 20.0, 2.0), decides=False).is_any


def test_each_axis_is_a_contradiction_of_its_own() -> None:
    found = seen(apart(1, 1.0, 1.0, down_m=30.0))
    assert found.vector_n == (0.0, 0.0, 30.0) and found.ratio[0] == 0.0


@pytest.mark.parametrize(
    ("left_m", "sd_m", "least_m", "most_m"),
    [(0.0, 1.0, 0.0, 0.0), (1.0, 2.0, 0.0, 3.0), (0.0, 5.0, 7.0, 14.0), (15.0, 2.0, 20.0, 24.0),
     (15.0, 6.0, 30.0, 43.3), (20.0, 3.0, 28.0, 32.0), (35.0, 15.0, 43.3, 43.3)],
    ids=["back", "back within the spread", "blunt", "another offset", "within a blunt spread", "half way", "no return"],
)  # fmt: skip
def test_a_return_leaves_what_the_other_solution_cannot_tell_from_another_offset(
    left_m: float, sd_m: float, least_m: float, most_m: float
) -> None:
    left = seen(apart(1, 40.0, 1.0)).left(apart(60, left_m, sd_m), SDS, RISK)
    bound_m = abs(left.vector_n[0]) + left.slack[0]
    assert least_m - 1e-9 <= bound_m <= most_m + 1e-9


@pytest.mark.parametrize("sd_m", [0.5, 2.0, 3.0, 5.0])
def test_the_bound_after_a_step_to_another_offset_holds_but_for_the_risk(sd_m: float) -> None:
    rng, before, count = np.random.default_rng(1), seen(apart(1, 40.0, 1.0)), 20_000
    radii, angles = 60.0 * np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, size=count)
    noise, exceeded = rng.normal(0.0, sd_m, size=(count, 2)), 0
    for radius, angle, (north, east) in zip(radii, angles, noise, strict=True):
        seen_n = radius * np.cos(angle) + north, radius * np.sin(angle) + east, 0.0
        left = before.left(
            SolutionDifference.of(60 * SECOND_NS, seen_n, np.eye(3) * sd_m**2), 1e3, RISK
        )  # never what was before
        exceeded += hypot(left.vector_n[0], left.vector_n[1]) + left.slack[0] < radius
    assert exceeded / count <= 4.0 * RISK


def test_growth_is_the_rate_of_the_last_seconds_and_neither_a_step_nor_a_constant_offset() -> None:
    growing = [apart(k, 2.0 * k, 0.1) for k in range(20)]
    assert seen(*growing).growth_m_s == pytest.approx(2.0)
    assert seen(*(apart(k, 50.0, 0.1) for k in range(20))).growth_m_s == 0.0
    found = seen(*(apart(k, 0.0, 0.1) for k in range(9))).after(apart(9, 50.0, 0.1), decides=True, stepped=True)
    assert found.growth_m_s == 0.0
    assert all(apart.time_ns < other.time_ns for apart, other in pairwise(seen(*growing).earlier))
