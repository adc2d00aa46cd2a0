"""Protection levels: risk, and what increases them above those of the covariance."""

from dataclasses import replace
from math import exp, hypot, sqrt

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from services.core.fusion.integrity.disagreement import Disagreement
from services.core.fusion.integrity.error_monitor import ErrorMonitor
from services.core.fusion.integrity.innovation_statistics import (
    ESTIMATED,
    MEMORY_S,
    NORMAL_QUANTILE_1E_3,
    Axis,
    InnovationStatistics,
)
from services.core.fusion.integrity.protection_levels import (
    FAULT_PROBABILITY,
    MAX_DISTANCE_M,
    horizontal_level,
    horizontal_level_with_fault,
    protection_levels,
    vertical_level,
    vertical_level_with_fault,
)
from shared.maths.kalman import correct
from shared.maths.quantiles import chi_square_limit, circle_factor, line_factor

SECOND_NS = 1_000_000_000
FloatArray = npt.NDArray[np.float64]
COV = ((4.0, 1.0, 0.0), (1.0, 2.0, 0.0), (0.0, 0.0, 9.0))


def test_a_share_of_1e_3_of_a_million_draws_is_outside_the_horizontal_level() -> None:
    rng = np.random.default_rng(3)
    cov = np.array([[4.0, 1.8], [1.8, 1.0]])
    draws = rng.multivariate_normal(np.zeros(2), cov, size=1_000_000)
    outside = (np.hypot(*draws.T) > horizontal_level(4.0, 1.8, 1.0, 1e-3)).sum()
    assert abs(outside - 1000) < 4.0 * sqrt(1000)


@given(st.floats(0.0, 6.3), st.floats(0.01, 50.0), st.floats(0.0, 1.0))
def test_a_horizontal_level_is_invariant_to_rotation_of_the_covariance(turn: float, major: float, ratio: float) -> None:
    C = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    cov = C @ np.diag([major**2, (ratio * major) ** 2]) @ C.T
    level = horizontal_level(cov[0, 0], cov[0, 1], cov[1, 1], 1e-3)
    assert level == pytest.approx(major * circle_factor(ratio, 1e-3), rel=1e-6)


KNOWING = ErrorMonitor(used_ns=SECOND_NS, cov_after_fix=(4.0, 1.0, 2.0, 9.0))


def monitor(
    position: InnovationStatistics | None = None,
    *,
    cov_after_fix: tuple[float, float, float, float] = KNOWING.cov_after_fix,
    fault_shift: tuple[float, float] = (0.0, 0.0),
    rejected_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ErrorMonitor:
    """Monitor in which a position has just been used, with optional changes."""
    known = statistics_of(white(400)) if position is None else position
    return replace(KNOWING, position=known, cov_after_fix=cov_after_fix, fault_shift=fault_shift, rejected_n=rejected_n)


def white(count: int, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((count, 3))


def correlated(count: int, correlation_s: float, seed: int = 1) -> FloatArray:
    draws, phi = white(count, seed), exp(-1.0 / correlation_s)
    for k in range(1, count):
        draws[k] = phi * draws[k - 1] + sqrt(1.0 - phi**2) * draws[k]
    return draws


def statistics_of(innovations: FloatArray, sd: float = 2.0) -> InnovationStatistics:
    """Statistics of one innovation a second, in units of the expected standard deviation."""
    found = InnovationStatistics()
    for k, row in enumerate(innovations.tolist()):
        found = found.after((k + 1) * SECOND_NS, [sd * u for u in row], (sd, sd, sd))
    return found


def levels(
    seen: ErrorMonitor, *, after_s: float = 0.0, cov: object = COV, velocity: float = 0.0
) -> tuple[float, float]:
    found = protection_levels(
        cov,  # type: ignore[arg-type]  # some tests pass invalid ones
        (velocity, 0.0, 0.0),
        SECOND_NS + round(after_s * 1e9),
        seen,
        risk=1e-3,
        time_sd_s=0.002,
    )
    return found.horizontal, found.vertical


@given(
    st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), min_size=0, max_size=30),
    st.floats(0.0, 100.0),
    st.floats(0.0, 60.0),
)
def test_levels_are_at_least_those_of_the_covariance(
    innovations: list[tuple[float, float, float]], after_s: float, velocity: float
) -> None:
    seen = monitor(position=statistics_of(np.array(innovations).reshape(-1, 3)))
    horizontal, vertical = levels(seen, after_s=after_s, velocity=velocity)
    assert horizontal >= horizontal_level(4.0, 1.0, 2.0, 1e-3)
    assert vertical >= vertical_level(9.0, 1e-3)


def test_white_innovations_add_less_than_30_percent_and_correlated_ones_their_common_variance() -> None:
    quiet = np.median([levels(monitor(position=statistics_of(white(400, seed))))[0] for seed in range(20)])
    assert quiet < 1.3 * horizontal_level(4.0, 1.0, 2.0, 5e-4)
    variances = np.array(
        [
            [statistics_of(correlated(400, 60.0, seed)).correlated_variance(axis) for axis in range(3)]
            for seed in range(5)
        ]
    )
    assert variances.mean() > 0.4 * 4.0 and variances.max() <= 4.0, "most of (2 m)², and at most that"


def test_very_small_innovations_add_less_than_0_1_m() -> None:
    """A receiver with a stated accuracy of metres and errors of centimetres."""
    evidence = statistics_of(0.01 * correlated(400, 60.0))
    assert evidence.correlated_variance(0) < 0.1**2


def test_the_added_variance_decreases_with_the_number_of_white_innovations() -> None:
    some, more = statistics_of(white(5)), statistics_of(white(100))
    assert some.correlated_variance(0) > 0.3 * 4.0
    assert more.correlated_variance(0) < 0.1 * 4.0


def test_innovations_larger_than_expected_scale_the_covariance() -> None:
    surprised = monitor(position=statistics_of(2.0 * white(400)))
    assert levels(surprised)[0] > 1.6 * levels(monitor())[0]


def test_in_an_outage_the_level_grows_faster_than_the_covariance() -> None:
    cov = ((40.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 0.0, 40.0))
    bare = horizontal_level(40.0, 0.0, 40.0, 5e-4)
    found = [levels(monitor(), after_s=t, cov=cov)[0] for t in (0.0, 1.0, 5.0, 20.0, 60.0)]
    assert found == sorted(found) and found[-1] > 1.4 * bare


def test_the_undetected_effect_of_a_fix_is_the_largest_within_the_gate() -> None:
    """Search over all innovations on the gate's surface for the one that moves the position most."""
    rng = np.random.default_rng(5)
    root = rng.standard_normal((9, 9))
    P, R = root @ root.T, np.diag([4.0, 6.0, 9.0])
    H = np.hstack([np.zeros((3, 6)), -np.eye(3)])
    S, limit = H @ P @ H.T + R, chi_square_limit(3, 1e-3)
    taken = (P - correct(P, np.zeros(3), H, R).P)[6:, 6:]
    nn, ne, ee, dd = taken[0, 0], taken[0, 1], taken[1, 1], taken[2, 2]
    bound = sqrt(limit * (0.5 * (nn + ee) + hypot(0.5 * (nn - ee), ne)))
    directions = rng.standard_normal((20_000, 3))
    surface = sqrt(limit) * (np.linalg.cholesky(S) @ (directions / np.linalg.norm(directions, axis=1)[:, None]).T).T
    moves = surface @ (P @ H.T @ np.linalg.inv(S)).T[:, 6:]
    assert np.hypot(moves[:, 0], moves[:, 1]).max() == pytest.approx(bound, rel=5e-3)
    assert np.hypot(moves[:, 0], moves[:, 1]).max() <= bound
    assert np.abs(moves[:, 2]).max() == pytest.approx(sqrt(limit * dd), rel=5e-3)
    shifted = monitor(fault_shift=(bound, sqrt(limit * dd)))
    assert levels(shifted)[0] >= bound + horizontal_level(4.0, 1.0, 2.0, 0.05)


@pytest.mark.parametrize("fault", [0.0, 0.5, 2.0, 4.0, 20.0])
def test_with_faults_of_the_assumed_probability_the_vertical_level_has_its_risk(fault: float) -> None:
    sd = 3.0
    level = vertical_level_with_fault(sd**2, fault * sd, 1e-3)
    moved = norm.sf(level / sd - fault) + norm.sf(level / sd + fault)
    outside = 2.0 * (1.0 - FAULT_PROBABILITY) * norm.sf(level / sd) + FAULT_PROBABILITY * moved
    assert 0.999e-3 < outside <= 1e-3


@pytest.mark.parametrize("fault", [0.0, 2.0, 8.0])
def test_with_faults_of_the_assumed_probability_at_most_1e_3_are_outside_the_horizontal_level(fault: float) -> None:
    """A million draws, moved in the worst direction, along the major axis."""
    rng = np.random.default_rng(6)
    draws = rng.standard_normal((1_000_000, 2)) * (2.0, 1.0)
    draws[rng.random(1_000_000) < FAULT_PROBABILITY, 0] += fault
    level = horizontal_level_with_fault((4.0, 0.0, 1.0), fault, 1e-3)
    assert (np.hypot(*draws.T) > level).sum() < 1000 + 4.0 * sqrt(1000)
    assert level < fault + horizontal_level(4.0, 0.0, 1.0, 5e-4), "less than the sum"


def test_a_rare_large_innovation_scales_the_covariance_for_a_minute() -> None:
    calm, struck = white(200), white(200)
    calm = np.clip(calm, -3.0, 3.0)
    struck = np.vstack([np.clip(struck, -3.0, 3.0), [[0.0, 0.0, 4.5]]])
    then, before = statistics_of(struck), statistics_of(calm)
    assert before.scale_vertical == pytest.approx(1.0, abs=0.15)
    assert then.scale_vertical == pytest.approx((4.5 / NORMAL_QUANTILE_1E_3) ** 2)
    assert then.scale_horizontal == before.scale_horizontal == 1.0
    later = then
    for k in range(60):
        later = later.after((202 + k) * SECOND_NS, [0.0, 0.0, 0.0], (2.0, 2.0, 2.0))
    assert later.scale_vertical == 1.0


def test_time_correlated_errors_in_the_filter_are_not_assumed_a_second_time() -> None:
    first = ESTIMATED.after(SECOND_NS, [1.0, 1.0, 1.0], (2.0, 2.0, 2.0))
    later = InnovationStatistics().after(SECOND_NS, [1.0, 1.0, 1.0], (2.0, 2.0, 2.0))
    assert first.correlated_variance(0) == 0.0 < later.correlated_variance(0)
    found = ESTIMATED
    for k, row in enumerate(correlated(100, 60.0).tolist()):
        found = found.after((k + 1) * SECOND_NS, [2.0 * u for u in row], (2.0, 2.0, 2.0))
    assert max(found.correlated_variance(axis) for axis in range(3)) > 0.4 * 4.0, "added where the innovations show it"


def test_the_innovation_of_rejected_positions_is_part_of_the_levels() -> None:
    """Either the position or the solution is wrong."""
    assert levels(monitor(rejected_n=(18.0, 24.0, -12.0)))[0] > 30.0
    assert levels(monitor(rejected_n=(18.0, 24.0, -12.0)))[1] > 12.0


def test_after_a_reset_to_rejected_positions_their_distance_is_part_of_the_levels() -> None:
    rejecting = monitor(rejected_n=(18.0, 24.0, -12.0))
    held = Disagreement().after(rejecting.rejected_n, (1.0, 1.0), SECOND_NS, grew=False)
    restarted = replace(KNOWING, position=rejecting.position, held=held)
    assert restarted.rejection_bound == (30.0, 12.0)
    assert levels(restarted)[0] > 30.0 and levels(restarted)[1] > 12.0


def test_a_stamp_error_increases_the_level_with_speed() -> None:
    sharp = ((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
    seen = monitor(position=statistics_of(white(400), sd=1e-3), cov_after_fix=(1e-6, 0.0, 1e-6, 1e-6))
    slow, fast = levels(seen, cov=sharp)[0], levels(seen, cov=sharp, velocity=30.0)[0]
    assert fast >= line_factor(1e-3) * 0.06 > 5.0 * slow


def test_the_way_driven_in_a_delay_that_is_not_corrected_is_added() -> None:
    level, upright = levels(ErrorMonitor(), velocity=20.0)
    late, late_upright = levels(replace(ErrorMonitor(), delay_s=0.5), velocity=20.0)
    assert (late - level, late_upright - upright) == pytest.approx((10.0, 0.0))


def test_a_covariance_that_is_not_finite_or_not_positive_gives_the_largest_level() -> None:
    broken = ((float("nan"), 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert levels(monitor(), cov=broken) == (MAX_DISTANCE_M, MAX_DISTANCE_M)
    endless = ((1e30, 0.0, 0.0), (0.0, 1e30, 0.0), (0.0, 0.0, 1e30))
    assert levels(monitor(), cov=endless) == (MAX_DISTANCE_M, MAX_DISTANCE_M)


def test_what_lacks_to_the_variance_of_white_noise_counts_less_two_sampling_errors() -> None:
    axis = Axis(mean_square=0.5, lag_1=0.3, variance=4.0, newest=4.0)
    statistics = InnovationStatistics(interval_s=1.0, axes=(axis, axis, axis))
    unseen = 1.0 - (0.5 - 0.3) - 2.0 * sqrt(3.0 / (2.0 * MEMORY_S))
    assert statistics.correlated_variance(0) == pytest.approx(4.0 * min(unseen, 1.25 * 0.5, 4.0 * 0.3))
    small = Axis(mean_square=0.7, lag_1=0.05, variance=4.0, newest=4.0)
    unseen = 1.0 - 0.65 - 2.0 * sqrt(3.0 / (2.0 * MEMORY_S))
    assert 0.0 < unseen < 0.2
    found = InnovationStatistics(interval_s=1.0, axes=(small, small, small)).correlated_variance(0)
    assert found == pytest.approx(4.0 * unseen)
