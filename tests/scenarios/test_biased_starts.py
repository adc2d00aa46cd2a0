"""Starts with gyroscope biases of up to 5 degrees a second about each axis, with default settings."""

from dataclasses import replace
from math import degrees, radians

import numpy as np
import pytest

from benchmarks.starts.start import Receiver, Start, drive
from shared.maths.rotation import ned_from_body

LARGEST = radians(5.0)
MOVING_S = 40.0
WARM_S, LONG_S = 5.0, 15.0  # after the speed has exceeded 3 m/s


def heading_errors(seed: int, at_s: float, yaw: float = 0.0, pitch: float = 0.0) -> tuple[list[float], list[float]]:
    """Heading errors [rad] and normalised ones, from 5 s after exceeding 3 m/s, for a mounting of the IMU."""
    car = drive("parking_lot", seed, 120.0)
    rng = np.random.default_rng((seed, 5))
    body_from_vehicle = ned_from_body(0.0, pitch, yaw).T
    bias = rng.uniform(-LARGEST, LARGEST, 3)
    biased = replace(car, force_b=car.force_b @ body_from_vehicle.T, rate_b=car.rate_b @ body_from_vehicle.T + bias)
    start = Start(car, Receiver(rate_hz=4), at_s, 0.0, seed)
    fast_s, errors, pulls = None, [], []
    for i, made in replace(start, drive=biased).run(at_s + LONG_S if at_s else 40.0):
        now_s = float(car.t_ns[i]) * 1e-9
        if fast_s is None and np.hypot(*car.velocity_n[i, :2]) > 3.0:
            fast_s = now_s
        solution = made.solution()
        if i % 20 == 0 and solution is not None and fast_s is not None and WARM_S < now_s - fast_s < LONG_S:
            error = float(np.remainder(start.yaw_error(i, solution) - yaw + np.pi, 2.0 * np.pi) - np.pi)
            errors.append(error)
            pulls.append(error / float(np.sqrt(solution.triangles[2][5])))
    assert errors
    return errors, pulls


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_after_a_start_at_standstill_the_heading_error_is_below_2_degrees(seed: int) -> None:
    errors, pulls = heading_errors(seed, 0.0)
    assert degrees(np.abs(errors).max()) < 2.0
    assert np.mean(np.square(pulls)) < 3.0


@pytest.mark.slow
def test_after_a_start_in_motion_normalised_heading_errors_squared_are_below_3_5() -> None:
    """Mean of the squared errors over their variances, over starts with other biases."""
    pulls = np.concatenate([heading_errors(seed, MOVING_S)[1] for seed in (0, 1, 3)])
    assert np.mean(np.square(pulls)) < 3.5


def test_with_an_imu_mounted_at_20_degrees_the_heading_error_is_below_3_degrees() -> None:
    errors, pulls = heading_errors(1, 0.0, yaw=radians(20.0), pitch=radians(15.0))
    assert degrees(np.abs(errors).max()) < 3.0
    assert np.mean(np.square(pulls)) < 3.0
