"""Estimation of the GNSS error model by a bank of hypotheses, and the initial covariance."""

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.aids.gnss.fix import GnssPosition
from services.core.fusion.aids.gnss.position_errors import UNKNOWN_ERRORS, GnssErrorBank, mean_at_rest
from services.core.fusion.start.initial_position import first_place
from services.sensors.simulator.gnss.gnss_errors import ErrorKind, InjectedError, position_errors
from shared.maths.earth import Geodetic, geodetic_from_ned_difference

FloatArray = npt.NDArray[np.float64]

SD = np.array([3.0, 2.0, 5.0])
ORIGIN = Geodetic(0.74, 0.23, 700.0)


def bank_after(kind: ErrorKind, correlation_s: float, n: int = 180, seed: int = 1, size: float = 1.0) -> GnssErrorBank:
    """Bank after n seconds of errors of a kind and size, on a track with a velocity error of 3 cm/s."""
    rmse = (float(SD[0]), float(SD[1]), float(SD[2]))
    drawn = position_errors(InjectedError(kind, rmse, correlation_s), n, 1.0, seed=(seed,))
    wandering = np.cumsum(0.03 * np.random.default_rng(seed).standard_normal((n, 3)), axis=0)
    gnss_errors = UNKNOWN_ERRORS
    for i, path in enumerate(size * drawn.injected + 0.02 * SD * drawn.noise + wandering + 100.0):
        gnss_errors = gnss_errors.after(i * 10**9, path, SD, np.full(3, 0.03**2))
    return gnss_errors


def test_white_errors_are_estimated_as_white() -> None:
    gnss_errors = bank_after(ErrorKind.WHITE, 1.0)
    assert gnss_errors.correlated_share < 0.1 or gnss_errors.correlation_s < 2.5


@pytest.mark.parametrize("correlation_s", [5.0, 20.0, 60.0])
def test_the_correlation_time_is_estimated_within_a_factor_of_two(correlation_s: float) -> None:
    for seed in (1, 2, 3):
        gnss_errors = bank_after(ErrorKind.GAUSS_MARKOV, correlation_s, seed=seed)
        assert gnss_errors.correlated_share > 0.9
        assert 0.5 < gnss_errors.correlation_s / correlation_s < 2.0


@pytest.mark.parametrize(
    ("kind", "correlation_s", "size"),
    [
        (ErrorKind.WHITE, 1.0, 1.0),
        (ErrorKind.WHITE, 1.0, 3.0),
        (ErrorKind.GAUSS_MARKOV, 5.0, 0.33),
        (ErrorKind.GAUSS_MARKOV, 5.0, 1.0),
        (ErrorKind.GAUSS_MARKOV, 5.0, 3.0),
    ],
)
def test_the_scale_of_changing_errors_is_estimated_within_a_factor_of_1_5(
    kind: ErrorKind, correlation_s: float, size: float
) -> None:
    """In five minutes; white errors below the stated accuracy may have a constant error in addition."""
    for seed in (1, 2):
        found = bank_after(kind, correlation_s, n=300, seed=seed, size=size).scale / size
        assert (found > 1.0 / 1.5).all() and (found < 1.5).all(), found


def test_a_slowly_changing_error_keeps_at_least_half_of_the_stated_scale() -> None:
    """Data over a tenth of the correlation time."""
    for seed in (1, 2, 3):
        assert (bank_after(ErrorKind.GAUSS_MARKOV, 600.0, n=60, seed=seed).scale > 0.5).all()


def test_after_a_gap_the_estimated_scale_is_unchanged() -> None:
    gnss_errors = bank_after(ErrorKind.GAUSS_MARKOV, 20.0)
    later = gnss_errors.after(240 * 10**9, np.full(3, 500.0), SD, np.full(3, 0.03**2))
    assert later.scale == pytest.approx(gnss_errors.scale, rel=0.05)


def test_fixes_within_two_seconds_do_not_change_the_error_model() -> None:
    gnss_errors = bank_after(ErrorKind.WHITE, 1.0, n=11)
    assert gnss_errors.after(10_100_000_000, np.zeros(3), SD, np.full(3, 0.03**2)) is gnss_errors


def test_the_error_model_adapts_to_errors_with_another_correlation_time() -> None:
    gnss_errors = bank_after(ErrorKind.WHITE, 1.0)
    drawn = position_errors(InjectedError(ErrorKind.GAUSS_MARKOV, (3.0, 2.0, 5.0), 60.0), 300, 1.0, seed=(9,))
    for i, path in enumerate(drawn.injected):
        gnss_errors = gnss_errors.after((1000 + i) * 10**9, path, SD, np.full(3, 0.03**2))
    assert gnss_errors.correlated_share > 0.8
    assert gnss_errors.correlation_s > 20.0


def test_one_outlier_changes_the_correlated_share_by_less_than_0_1() -> None:
    gnss_errors = bank_after(ErrorKind.GAUSS_MARKOV, 60.0)
    struck = gnss_errors.after(180 * 10**9, np.full(3, 1e6), SD, np.full(3, 0.03**2))
    assert abs(struck.correlated_share - gnss_errors.correlated_share) < 0.1
    assert np.isfinite(struck.way).all()


def test_a_fix_that_is_not_newer_does_not_change_the_error_model() -> None:
    gnss_errors = bank_after(ErrorKind.WHITE, 1.0)
    assert gnss_errors.after(0, np.zeros(3), SD, np.full(3, 0.03**2)) is gnss_errors


def test_the_mean_of_16_white_errors_has_a_sixteenth_of_their_variance() -> None:
    weights, joint = mean_at_rest(np.arange(-15.0, 1.0), 1e-6, 60.0)
    assert weights[0] == pytest.approx(np.full(16, 1 / 16), abs=1e-6)
    assert joint[0, 0] == pytest.approx(1 / 16, abs=1e-5)


def test_the_mean_of_correlated_errors_has_more_than_80_percent_of_their_variance() -> None:
    _, joint = mean_at_rest(np.arange(-15.0, 1.0), 0.99, 60.0)
    assert 0.8 < joint[0, 0] < 1.0
    assert joint[0, 1] / np.sqrt(joint[0, 0] * joint[1, 1]) < -0.9


def test_the_covariance_of_the_initial_position_agrees_with_drawn_errors() -> None:
    """20,000 draws of fixes at standstill against `mean_at_rest`; 3 % tolerance."""
    times, correlated_share, correlation_s = np.array([-9.0, -5.0, -4.0, -1.0, 0.0]), 0.7, 6.0
    weights, joint = mean_at_rest(times, correlated_share, correlation_s)
    K = correlated_share * np.exp(-np.abs(times[:, None] - times) / correlation_s)
    rng = np.random.default_rng(0)
    correlated_part = rng.standard_normal((20_000, 5)) @ np.linalg.cholesky(K).T
    fixes = correlated_part + np.sqrt(1.0 - correlated_share) * rng.standard_normal((20_000, 5))
    wrong = fixes @ weights.T - np.column_stack([np.zeros(20_000), correlated_part[:, -1]])
    assert np.cov(wrong.T) == pytest.approx(joint, rel=0.03, abs=0.01)


def rest(time_correlated: bool) -> list[GnssPosition]:
    rng = np.random.default_rng(3)
    shifted = (geodetic_from_ned_difference(tuple(rng.standard_normal(3) * SD), ORIGIN) for _ in range(16))
    return [
        GnssPosition(i * 10**9, i * 10**9, "", place, np.diag(SD**2), 3, (0.0, 0.0, 0.0), 0.0, time_correlated)
        for i, place in enumerate(shifted)
    ]


def test_initial_position_and_time_correlated_error_have_a_positive_covariance() -> None:
    first = first_place(rest(time_correlated=True), UNKNOWN_ERRORS)
    whole = np.block([[first.cov, first.cross_cov], [first.cross_cov.T, first.error_cov]])
    assert np.linalg.eigvalsh(whole)[0] > 0.0
    assert (np.diag(first.cross_cov) < 0.0).all()


def test_fixes_with_corrections_start_without_a_time_correlated_error() -> None:
    first = first_place(rest(time_correlated=False), UNKNOWN_ERRORS)
    assert first.error == (0.0, 0.0, 0.0)
    assert not first.cross_cov.any()
    assert first.cov == pytest.approx(np.diag(SD**2) / 4.0)  # 15 s of errors of 5 s
