from math import exp, pi, sqrt

import numpy as np
import numpy.typing as npt
import pytest

from services.sensors.simulator.imu.imu_errors import (
    MTI_630_ACCELEROMETER,
    MTI_630_GYROSCOPE,
    SensorErrors,
    SensorGrade,
)

STEP = 0.01
DEGREE = pi / 180.0


def allan_deviation(x: npt.NDArray[np.float64], tau: float) -> float:
    """Overlapping Allan deviation, mean over the axes."""
    m = round(tau / STEP)
    sums = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    means = (sums[m:] - sums[:-m]) / m
    return float(np.sqrt(0.5 * ((means[m:] - means[:-m]) ** 2).mean()))


def closed_form(grade: SensorGrade, tau: float) -> float:
    x = tau / grade.in_run_bias_time
    in_run = 2.0 * grade.in_run_bias**2 / x * (1.0 - (3.0 - 4.0 * exp(-x) + exp(-2.0 * x)) / (2.0 * x))
    return sqrt(grade.density**2 / tau + in_run)


def test_the_closed_form_has_the_published_numbers() -> None:
    assert closed_form(MTI_630_GYROSCOPE, 1.0) / DEGREE == pytest.approx(0.00700, rel=0.01)
    assert 0.0022 < closed_form(MTI_630_GYROSCOPE, 10.0) / DEGREE < 0.0023
    assert 0.0014 < closed_form(MTI_630_GYROSCOPE, 378.0) / DEGREE < 0.0015
    assert closed_form(MTI_630_ACCELEROMETER, 1.0) == pytest.approx(5.89e-4, rel=0.01)
    assert 6.4e-5 < closed_form(MTI_630_ACCELEROMETER, 378.0) < 6.9e-5


@pytest.mark.parametrize("grade", [MTI_630_GYROSCOPE, MTI_630_ACCELEROMETER], ids=["gyroscope", "accelerometer"])
def test_five_hours_at_standstill_have_the_allan_deviation_of_the_closed_form(grade: SensorGrade) -> None:
    errors = SensorErrors(grade, STEP, (11,))
    record = np.concatenate([errors.advance(np.zeros(60_000, dtype=bool)) for _ in range(30)])
    assert allan_deviation(record, 1.0) == pytest.approx(closed_form(grade, 1.0), rel=0.01)
    assert allan_deviation(record, 10.0) == pytest.approx(closed_form(grade, 10.0), rel=0.05)
    assert allan_deviation(record, 378.0) == pytest.approx(closed_form(grade, 378.0), rel=0.15)


def test_the_errors_are_independent_of_the_block_lengths() -> None:
    moving = np.arange(3000) % 700 > 300
    whole = SensorErrors(MTI_630_GYROSCOPE, STEP, (5,)).advance(moving)
    parts = SensorErrors(MTI_630_GYROSCOPE, STEP, (5,))
    cut = np.concatenate([parts.advance(block) for block in np.split(moving, [1, 100, 1999])])
    assert np.abs(cut - whole).max() < 1e-15


def test_vibration_is_added_in_motion_only() -> None:
    errors = SensorErrors(MTI_630_ACCELEROMETER, STEP, (6,))
    rest, drive = errors.advance(np.zeros(5000, dtype=bool)), errors.advance(np.ones(5000, dtype=bool))
    assert rest.std(axis=0) == pytest.approx(np.full(3, 10.0 * MTI_630_ACCELEROMETER.density), rel=0.05)
    assert drive.std(axis=0) == pytest.approx(np.full(3, 0.05), rel=0.05)


def test_the_turn_on_bias_differs_between_seeds_and_is_constant() -> None:
    biases = np.array([SensorErrors(MTI_630_ACCELEROMETER, STEP, (seed,)).turn_on for seed in range(400)])
    assert biases.std() == pytest.approx(2e-3 * 9.80665, rel=0.1)
    errors = SensorErrors(MTI_630_ACCELEROMETER, STEP, (1,))
    mean = errors.advance(np.zeros(20_000, dtype=bool)).mean(axis=0)
    assert mean == pytest.approx(errors.turn_on, abs=5e-4)
