"""The steering angle as a measurement of CTRV: its gain, and its step."""

import numpy as np
import pytest

from cli.papers.toll.steering import (
    NONE,
    RATIO,
    STEP_RAD,
    WHEELBASE_M,
    YAW,
    compare_steering,
    steering_angle,
    with_steering,
    without_turn,
)
from cli.papers.toll.trajectory import cam_of, mixed
from services.core.toll.trackers.observation import SPEED, YAW_RATE


def test_the_stated_angle_gives_the_yaw_rate_back_to_its_step() -> None:
    trajectory = mixed()
    angle = steering_angle(trajectory)
    assert np.abs(angle / STEP_RAD - np.round(angle / STEP_RAD)).max() < 1e-9
    speed = trajectory.states[:, SPEED]
    found = speed / WHEELBASE_M * np.tan(angle / RATIO)
    step = speed / WHEELBASE_M * STEP_RAD / RATIO
    assert (np.abs(found - trajectory.states[:, YAW_RATE])[speed > 0.1] <= 0.52 * step[speed > 0.1] + 1e-9).all()


def test_the_gain_is_a_factor_of_the_measured_yaw_rate() -> None:
    trajectory, rng = mixed(), np.random.default_rng(1)
    cams = cam_of(trajectory, np.zeros((1, len(trajectory.time_s), 2)), 1.0, rng)
    angle = steering_angle(trajectory)
    right, wrong = (with_steering(cams, angle, gain) for gain in (1.0, 1.1))
    turning = int(np.argmax(np.abs(angle)))
    assert wrong[turning].z[0, YAW_RATE] == pytest.approx(1.1 * right[turning].z[0, YAW_RATE])
    assert not without_turn(cams)[turning].available[0, YAW_RATE]


@pytest.mark.slow  # six filters over 84 s at 10 Hz
def test_a_right_gain_is_as_good_as_the_yaw_rate_and_a_wrong_one_worse_than_neither_in_a_roundabout() -> None:
    result = compare_steering(10, seed=1)
    bend = result.roundabout
    assert bend["steering angle, gain 1"] == pytest.approx(bend[YAW], rel=0.25)
    assert bend["steering angle, gain 1.5"] > bend[NONE] > 0.8 * bend[YAW]
