"""The paper's construction against the reference numbers of section 001, and against least squares."""

from itertools import combinations
from math import radians, sqrt

import numpy as np
import pytest

from services.core.cooperative.detection import noncentrality, weighted_fit
from services.core.cooperative.paper.scenario import real_rows, virtual_rows
from services.core.cooperative.v2x.virtual import (
    baarda_biases,
    baarda_statistics,
    choose_virtual,
    design_row,
    hdop,
    horizontal_protection_level,
    horizontal_slopes,
    local_biases,
    prediction_matrix,
    residual_cov,
    residual_test,
    snooping_test,
)
from shared.maths.frequency_offset import cfo_from_range_rate, range_rate_from_cfo
from shared.maths.quantiles import chi_square_limit

SD, P_FA, P_MD = 3.0, 1e-5, 1e-4
ANGLES = 5e-4  # tolerance of the reference geometry, whose angles are rounded
H_REAL, H_VIRTUAL = real_rows(), virtual_rows()
H = np.vstack([H_VIRTUAL, H_REAL])
REAL = (4, 5, 6, 7)
OMEGA = prediction_matrix(H_REAL, H_VIRTUAL)
W = residual_cov(OMEGA, np.full(4, SD), np.full(4, SD))


def test_the_row_of_a_satellite_is_the_reference_in_other_axes() -> None:
    """The reference uses east, north, up: [-cos el sin az, -cos el cos az, -sin el, 1]."""
    north, east, down, clock = design_row(radians(57.464), radians(44.111))
    assert (east, north, -down, clock) == pytest.approx((-0.37436, -0.38613, -0.84305, 1.0), abs=1e-4)


def test_omega_is_the_reference() -> None:
    expected = [
        [1.0288, -0.8978, 1.0230, -0.1540],
        [0.8392, 0.0487, -0.3657, 0.4778],
        [0.6616, -0.4182, 0.1038, 0.6528],
        [0.2843, 1.1768, -1.0053, 0.5442],
    ]
    assert pytest.approx(np.array(expected), abs=2e-3) == OMEGA


def test_the_covariance_and_the_thresholds_in_metres_are_the_reference() -> None:
    assert np.diag(W) / SD**2 == pytest.approx([3.9348, 2.0686, 2.0495, 3.7724], rel=ANGLES)
    assert local_biases(W, P_FA) == pytest.approx([28.02, 20.31, 20.22, 27.43], rel=ANGLES)
    assert baarda_biases(W, P_FA) == pytest.approx([21.72, 16.97, 17.38, 21.32], rel=ANGLES)


def test_dilution_slopes_and_protection_level_are_the_reference() -> None:
    assert hdop(H) == pytest.approx(0.9726, rel=ANGLES)
    without = [hdop(np.delete(H, row, axis=0)) for row in REAL]
    assert without == pytest.approx([1.1680, 0.9970, 1.0304, 1.2462], rel=ANGLES)
    slopes = horizontal_slopes(H, REAL)
    assert slopes == pytest.approx([0.6468, 0.2195, 0.3404, 0.7791], abs=ANGLES)
    assert slopes == pytest.approx([sqrt(value**2 - hdop(H) ** 2) for value in without]), "d_i² = HDOP_i² - HDOP²"
    level = horizontal_protection_level(H, REAL, SD, false_alarm_rate=P_FA, missed_detection_rate=P_MD)
    assert level == pytest.approx(20.657, rel=ANGLES)


@pytest.mark.parametrize(
    ("bias", "statistic", "t"), [(20.0, 18.800, 3.361), (30.0, 42.300, 5.041), (50.0, 117.50, 8.402)]
)
def test_a_bias_gives_the_reference_statistics(bias: float, statistic: float, t: float) -> None:
    test = residual_test(np.array([bias, 0.0, 0.0, 0.0]), W, P_FA)
    assert float(test.statistic) == pytest.approx(statistic, rel=ANGLES)
    assert test.t[0] == pytest.approx(t, rel=ANGLES)
    assert test.excluded.tolist() == [bias > 28.02, False, False, False]


def test_the_tests_fire_at_the_reference_biases() -> None:
    unit = float(residual_test(np.array([1.0, 0.0, 0.0, 0.0]), W, P_FA).statistic)
    assert sqrt(chi_square_limit(4, P_FA) / unit) == pytest.approx(24.6, abs=0.05)
    below, above = (residual_test(np.array([bias, 0, 0, 0.0]), W, P_FA).excluded[0] for bias in (28.0, 28.04))
    assert not below and above


@pytest.mark.parametrize(("scale", "global_fires", "local_fires"), [(4.6, False, False), (5.0, False, True),
                                                                    (5.4, True, True)])  # fmt: skip
def test_a_local_test_alone_excludes_nothing(scale: float, global_fires: bool, local_fires: bool) -> None:
    """Residuals along a column of W have T = t_1²: t_1 = 5 is above 4.708, and T = 25 below 28.47."""
    for row in range(4):
        q = scale * W[row] / sqrt(W[row, row])
        test = residual_test(q, W, P_FA)
        assert float(test.statistic) == pytest.approx(scale**2) and test.t[row] == pytest.approx(scale)
        assert bool(test.statistic > test.threshold) == global_fires
        assert bool(test.t[row] > test.local) == local_fires
        assert test.excluded[row] == (global_fires and local_fires)
        assert test.excluded.any() == global_fires


def test_baardas_statistic_fires_at_its_bias() -> None:
    for row, bias in enumerate(baarda_biases(W, P_FA)):
        w = baarda_statistics(bias * np.eye(4)[row], W)
        assert w[row] == pytest.approx(4.7081, abs=1e-4) and w.argmax() == row


def test_with_four_virtual_satellites_the_statistic_is_that_of_the_full_least_squares() -> None:
    y = 10.0 * np.random.default_rng(1).standard_normal(8)
    fit = weighted_fit(H, y, np.full(8, SD))
    assert fit is not None
    q = y[4:] - OMEGA @ y[:4]
    assert float(residual_test(q, W, P_FA).statistic) == pytest.approx(fit.statistic, rel=1e-9)
    assert fit.dof == 4


def test_of_two_faults_baardas_test_excludes_both_and_no_other() -> None:
    q = np.array([[0.0, 0.0, 0.0, 0.0], [24.9, 0.0, 0.0, 0.0], [60.0, 0.0, 0.0, -50.0]])
    test = snooping_test(q, W, P_FA)
    assert test.excluded.tolist() == [[False] * 4, [True, False, False, False], [True, False, False, True]]
    assert not residual_test(q[1], W, P_FA).excluded.any(), "the printed local test fires at 28.02 m"
    assert test.t[1] == pytest.approx(baarda_statistics(q[1], W))
    assert snooping_test(q.reshape(3, 1, 4), W, P_FA).excluded.shape == (3, 1, 4)


def test_a_protection_level_above_the_alert_limit_selects_other_virtual_satellites() -> None:
    rng = np.random.default_rng(3)
    candidates = np.array([design_row(float(el), float(az)) for el, az in rng.uniform((0.1, 0.0), (1.5, 6.28), (9, 2))])

    def level(H_virtual: np.ndarray) -> float:
        return horizontal_protection_level(
            np.vstack([H_virtual, H_REAL]), REAL, SD, false_alarm_rate=P_FA, missed_detection_rate=P_MD
        )

    sharpest = choose_virtual(H_REAL, candidates)
    assert sharpest is not None
    first = level(candidates[list(sharpest)])
    assert choose_virtual(H_REAL, candidates, level=level, limit=first) == sharpest
    anew = choose_virtual(H_REAL, candidates, level=level, limit=0.97 * first)
    assert anew is not None and anew != sharpest and level(candidates[list(anew)]) <= 0.97 * first
    least = choose_virtual(H_REAL, candidates, level=level, limit=1.0)
    assert least is not None
    levels = [level(candidates[list(rows)]) for rows in combinations(range(9), 4)]
    assert level(candidates[list(least)]) == pytest.approx(min(levels)), "none is within it: the one with the least"


def test_with_six_virtual_satellites_the_expected_statistic_is_the_number_of_real_ones() -> None:
    rng = np.random.default_rng(2)
    six = np.vstack([H_VIRTUAL, design_row(0.9, 1.0), design_row(0.4, 4.0)])
    omega = prediction_matrix(H_REAL, six)
    cov = residual_cov(omega, np.full(4, SD), np.full(6, SD))
    noise = SD * rng.standard_normal((100_000, 10))
    statistics = residual_test(noise[:, :4] - noise[:, 4:] @ omega.T, cov, P_FA).statistic
    assert statistics.mean() == pytest.approx(4.0, abs=4 * sqrt(8.0 / 100_000))


def test_weighting_by_the_measurements_alone_would_alarm_too_often() -> None:
    """The printed T = q' R^-1 q has the mean n + tr(Omega Omega'), 11.83 instead of 4."""
    assert 4.0 + float(np.trace(OMEGA @ OMEGA.T)) == pytest.approx(11.83, abs=0.01)


def test_the_best_virtual_satellites_have_the_least_largest_variance() -> None:
    rng = np.random.default_rng(3)
    candidates = np.array([design_row(float(el), float(az)) for el, az in rng.uniform((0.1, 0.0), (1.5, 6.28), (9, 2))])
    chosen = choose_virtual(H_REAL, candidates)
    assert chosen is not None

    def worst(rows: tuple[int, ...]) -> float:
        omega = prediction_matrix(H_REAL, candidates[list(rows)])
        return float(np.diag(residual_cov(omega, np.ones(4), np.ones(4))).max())

    for _ in range(50):
        assert worst(chosen) <= worst(tuple(rng.choice(9, 4, replace=False).tolist())) + 1e-9


def test_virtual_satellites_that_determine_nothing_are_refused() -> None:
    same = np.repeat(H_VIRTUAL[:1], 4, axis=0)
    with pytest.raises(ValueError, match="determine"):
        prediction_matrix(H_REAL, same)
    assert choose_virtual(H_REAL, same) is None


def test_range_rate_and_frequency_offset_are_the_reference() -> None:
    cfo = cfo_from_range_rate(30.0, 2e-7, -5e-7)
    assert cfo == pytest.approx(3539.591, abs=1e-3)
    assert range_rate_from_cfo(cfo, 2e-7, -5e-7) == pytest.approx(30.0, abs=6e-5)
    assert range_rate_from_cfo(cfo, 0.0, 0.0) == pytest.approx(-179.85, abs=0.01)


def test_the_noncentrality_of_the_reference_geometry_is_that_of_four_tests() -> None:
    assert sqrt(noncentrality(4, P_FA, P_MD)) * SD * 0.7791 == pytest.approx(20.657, rel=ANGLES)
