"""The slope of a heading against the gyroscope: its value, its variance, and what is a jump."""

import numpy as np
import pytest

from services.core.spoofing.gyroscope.sources import Reading
from services.core.spoofing.gyroscope.track import Turn
from services.core.spoofing.observer.trend import OFFSET_SD, Trend, row_of, trend

NS = 1_000_000_000
NOISE = 0.01  # [rad]
NO_BIAS = (0.0, 0.0, 0.0)


def slope(angles: list[float], *, yaw: float = 0.0, length: int = 60) -> Trend | None:
    """Trend of courses, one a second, of a vehicle that turns at a rate [rad/s]."""
    readings = [
        Reading(angle + yaw * k, NOISE**2, Turn(k * NS, yaw * k, (0.0, 0.0, float(k)), yaw, (0.0, 0.0, 1.0)))
        for k, angle in enumerate(angles)
    ]
    table = np.array([row_of(reading, 0) for reading in readings]).reshape(-1, 8)
    return trend(table, NO_BIAS, float(length), correlation_s=0.1, time_sd_s=0.0)


def test_a_slope_is_found_whatever_the_vehicle_turns_by() -> None:
    for yaw in (0.0, 0.3):
        found = slope([3.0 + 0.002 * k for k in range(61)], yaw=yaw)
        assert found is not None and found.rate == pytest.approx(0.002, abs=1e-9)
        assert found.turn_rate == pytest.approx(yaw, abs=1e-9) and not found.jumps


def test_its_spread_is_the_one_that_it_states() -> None:
    rng = np.random.default_rng(1)
    found = [slope((NOISE * rng.standard_normal(61)).tolist()) for _ in range(400)]
    rates = np.array([trend.rate for trend in found if trend is not None])
    stated = np.mean([trend.variance for trend in found if trend is not None]) - (2.0 * OFFSET_SD / 60.0) ** 2
    assert len(rates) == 400
    assert rates.std() == pytest.approx(np.sqrt(stated), rel=0.15)


def test_one_wild_course_moves_it_little() -> None:
    angles = [0.0] * 61
    angles[-1] = 1.0
    found = slope(angles)
    assert found is not None and abs(found.rate) < 1e-9


@pytest.mark.parametrize("at", [20, 30, 40])
def test_a_jump_is_no_turn(at: int) -> None:
    rng = np.random.default_rng(2)
    angles = [0.1 * (k >= at) + NOISE * float(rng.standard_normal()) for k in range(61)]
    found = slope(angles)
    assert found is not None and found.jumps


def test_without_readings_over_the_window_there_is_none() -> None:
    assert slope([0.0] * 40) is None
    assert slope([]) is None
