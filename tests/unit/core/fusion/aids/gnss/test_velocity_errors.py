"""Estimation of the correlation of GNSS velocity errors, and its effect on the position error model."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.aids.gnss.position_errors import RESIDUAL_ERROR_MODEL, TIME_CORRELATED_SHARE
from services.core.fusion.aids.gnss.position_errors import UNKNOWN_ERRORS as UNKNOWN_POSITIONS
from services.core.fusion.aids.gnss.velocity_errors import UNKNOWN_ERRORS, WHITE_SHARE, GnssVelocityErrors

FloatArray = npt.NDArray[np.float64]

STATED = np.array([0.08, 0.08, 0.15]) ** 2  # [m²/s²]
PERIOD_NS = 200_000_000
COV = np.diag([4.0, 4.0, 25.0])


def residuals(correlation: float, n: int, seed: int, size: float = 1.0) -> FloatArray:
    """Draw residuals with a lag-1 correlation, shape (n, 3) [m/s]."""
    drawn = np.random.default_rng(seed).standard_normal((n, 3))
    for k in range(1, n):
        drawn[k] = correlation * drawn[k - 1] + (1.0 - correlation**2) ** 0.5 * drawn[k]
    scaled: FloatArray = size * np.sqrt(STATED) * drawn
    return scaled


def updated(errors: GnssVelocityErrors, drawn: FloatArray, *, stated: bool = True) -> GnssVelocityErrors:
    for residual in drawn:
        errors = errors.after(errors.time_ns + PERIOD_NS, residual, STATED, stated=stated)
    return errors


@pytest.mark.parametrize("size", [0.2, 1.0, 3.0])
def test_velocity_errors_of_any_size_are_estimated_as_white_within_two_minutes(size: float) -> None:
    for seed in range(5):
        drawn = residuals(0.0, 600, seed, size)
        assert (
            not updated(UNKNOWN_ERRORS, drawn[:1]).follows and updated(UNKNOWN_ERRORS, drawn[:1], stated=False).follows
        )
        assert not updated(UNKNOWN_ERRORS, drawn).follows and not updated(UNKNOWN_ERRORS, drawn, stated=False).follows


@pytest.mark.parametrize("correlation", [0.3, 0.5, 0.9])
def test_correlated_velocity_errors_are_detected_within_a_minute(correlation: float) -> None:
    for seed in range(5):
        errors = updated(UNKNOWN_ERRORS, residuals(correlation, 300, seed))
        assert errors.follows and errors.white < 0.01
        assert errors.variance == pytest.approx(WHITE_SHARE * STATED, rel=0.01)


def test_the_estimate_changes_within_four_minutes_when_the_correlation_changes() -> None:
    for seed in range(3):
        white = updated(UNKNOWN_ERRORS, residuals(0.0, 3000, seed))
        repeating = updated(white, residuals(0.5, 600, seed + 10))
        assert not white.follows and not white.variance.any()
        assert repeating.follows
        assert not updated(repeating, residuals(0.0, 1200, seed + 20)).follows


def test_white_velocity_errors_are_not_estimated_as_correlated() -> None:
    for seed in range(20):
        errors = UNKNOWN_ERRORS
        for residual in residuals(0.0, 600, seed):
            errors = updated(errors, residual[np.newaxis])
            assert not errors.follows


def test_in_the_first_minute_at_1_hz_less_than_one_white_receiver_in_200_is_followed() -> None:
    followed = 0
    for seed in range(400):
        errors, hits = UNKNOWN_ERRORS, False
        for residual in residuals(0.0, 60, seed):
            errors = errors.after(errors.time_ns + 1_000_000_000, residual, STATED, stated=True)
            hits |= errors.follows
        followed += hits
    assert followed < 2


def test_residuals_that_decay_after_an_outage_are_no_evidence() -> None:
    for seed in range(5):
        errors = updated(UNKNOWN_ERRORS, residuals(0.0, 600, seed))
        drawn = residuals(0.0, 300, seed + 30)
        drawn[:50] += np.array([1.0, 3.0, 0.3]) * np.exp(-np.arange(50) / 10.0)[:, np.newaxis]
        after = errors.after(errors.time_ns + 60_000_000_000, drawn[0], STATED, stated=True)
        for residual in drawn[1:]:
            after = updated(after, residual[np.newaxis])
            assert not after.follows and after.white > 0.9


def test_residuals_of_the_first_ten_seconds_are_not_used() -> None:
    drawn = residuals(0.9, 300, 1)
    assert updated(UNKNOWN_ERRORS, drawn[:50]).white == updated(UNKNOWN_ERRORS, drawn[:1]).white
    assert updated(UNKNOWN_ERRORS, drawn).follows


def test_without_velocities_nothing_changes() -> None:
    assert not UNKNOWN_ERRORS.follows and UNKNOWN_ERRORS.white == 1.0
    assert UNKNOWN_POSITIONS.following(False) is UNKNOWN_POSITIONS


def test_a_pause_does_not_change_the_estimate() -> None:
    errors = updated(UNKNOWN_ERRORS, residuals(0.0, 300, 1))
    later = errors.after(errors.time_ns + 3_000_000_000, errors.last * np.sqrt(errors.power), STATED, stated=True)
    assert later.white == errors.white


def test_with_correlated_velocity_errors_no_position_error_is_estimated_and_levels_hold_half_of_the_stated() -> None:
    followed = UNKNOWN_POSITIONS.following(True)
    assert followed.correlated_share == 0.0
    assert followed.scaled(COV) == pytest.approx(RESIDUAL_ERROR_MODEL[0] * COV)
    level, upright = followed.unestimated(COV)
    assert 0.4 * COV[0, 0] < level <= TIME_CORRELATED_SHARE * COV[0, 0]
    assert 0.4 * COV[2, 2] < upright <= TIME_CORRELATED_SHARE * COV[2, 2]
    assert UNKNOWN_POSITIONS.unestimated(COV) == (0.0, 0.0)


def test_with_correlated_velocity_errors_an_overstated_accuracy_is_scaled_down() -> None:
    evidence = np.zeros_like(UNKNOWN_POSITIONS.evidence)
    evidence[:, :, 0] = 100.0  # the smallest scale, an eighth
    level, _ = replace(UNKNOWN_POSITIONS, evidence=evidence, follows=True).unestimated(COV)
    assert level == pytest.approx(TIME_CORRELATED_SHARE * COV[0, 0] / 64.0, rel=0.01)
