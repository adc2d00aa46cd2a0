"""Scale of a speed in one bend: closed forms of a steady turn, and consistency of the stated standard deviation."""

import numpy as np
import numpy.typing as npt
import pytest

from services.core.motion_conflict.inertial_speed.bend_fit import Arm, BendSeries, filled_speed, fit_scale
from shared.maths.earth import STANDARD_GRAVITY

FloatArray = npt.NDArray[np.float64]
STEP_S = 0.1
MOUNTED = Arm(0.8, 0.0, 0.1, 0.1)


def turn(angle_rad: float = 1.5, duration_s: float = 5.0, straight_s: float = 3.0) -> FloatArray:
    """Yaw rate of a turn by a raised cosine, between two straights."""
    n, m = round(duration_s / STEP_S), round(straight_s / STEP_S)
    shape = 1.0 - np.cos(2.0 * np.pi * (np.arange(n) + 0.5) / n)
    return np.concatenate([np.zeros(m), shape * angle_rad / duration_s, np.zeros(m)])


def bend(
    yaw_rate: FloatArray, speed: FloatArray, *, arm_m: float = 0.8, tilt: tuple[float, float] = (0.0, 0.0),
    bias: float = 0.0, noise: FloatArray | None = None,
) -> BendSeries:  # fmt: skip
    """What levelled sensors measure: v r + x r', the tilt error before the bend turned by the heading, and a bias."""
    heading = np.cumsum(yaw_rate) * STEP_S
    forward = np.gradient(speed, STEP_S)
    lateral = speed * yaw_rate + arm_m * np.gradient(yaw_rate, STEP_S) + bias
    lateral = lateral + STANDARD_GRAVITY * (np.cos(heading) * tilt[0] + np.sin(heading) * tilt[1])
    return BendSeries(STEP_S, lateral if noise is None else lateral + noise, forward, yaw_rate)


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_turn_without_errors_gives_the_scale_of_the_indicated_speed(scale: float, direction: float) -> None:
    yaw_rate = direction * turn()
    speed = np.full(len(yaw_rate), 6.0)
    fitted = fit_scale(bend(yaw_rate, speed), scale * speed, MOUNTED)
    assert fitted is not None
    assert fitted.scale == pytest.approx(scale, abs=0.002)
    assert 0.0 < fitted.sd < 0.02


def test_a_tilt_before_the_bend_and_a_bias_are_not_taken_for_speed() -> None:
    """One degree of each tilt is 0.17 m/s², 9 % of the mean centripetal acceleration."""
    yaw_rate = turn()
    speed = np.full(len(yaw_rate), 6.0)
    series = bend(yaw_rate, speed, tilt=(0.0175, 0.0175), bias=0.05)
    fitted = fit_scale(series, speed, MOUNTED)
    assert fitted is not None and fitted.scale == pytest.approx(1.0, abs=0.02)
    mean = float((series.lateral * yaw_rate).sum() / (speed * yaw_rate**2).sum())
    assert abs(mean - 1.0) > 0.05, "plain lateral force over yaw rate takes them for speed"


def test_a_straight_determines_no_scale() -> None:
    n = 110
    fitted = fit_scale(bend(np.zeros(n), np.full(n, 10.0)), np.full(n, 10.0), MOUNTED)
    assert fitted is None or fitted.sd > 0.3


def test_the_normalised_error_has_a_standard_deviation_of_one() -> None:
    """Monte Carlo: tilt, bias, arm and noise drawn from what is stated."""
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(300):
        yaw_rate = turn(rng.uniform(0.7, 2.0), rng.uniform(3.0, 8.0))
        speed = rng.uniform(4.0, 9.0) + 0.5 * np.sin(np.arange(len(yaw_rate)) / 20.0)
        series = bend(
            yaw_rate, speed, arm_m=0.8 + 0.1 * rng.standard_normal(), bias=0.1 * rng.standard_normal(),
            tilt=(0.02 * rng.standard_normal(), 0.02 * rng.standard_normal()),
            noise=0.1 * rng.standard_normal(len(yaw_rate)),
        )  # fmt: skip
        fitted = fit_scale(series, speed, MOUNTED)
        assert fitted is not None
        errors.append((fitted.scale - 1.0) / fitted.sd)
    # The noise is estimated with its correlation, which is never taken as negative: stated deviations are larger.
    assert 0.8 < float(np.std(errors)) < 1.05
    assert abs(float(np.mean(errors))) < 0.15


def test_samples_a_second_apart_are_met_and_the_least_speed_between_them_is_found() -> None:
    times = np.arange(0.05, 10.0, STEP_S)
    true = 6.0 + 2.0 * np.cos(2.0 * np.pi * times / 3.0)
    forward = -2.0 * 2.0 * np.pi / 3.0 * np.sin(2.0 * np.pi * times / 3.0)
    sampled = np.arange(0.0, 11.0)
    speeds = 6.0 + 2.0 * np.cos(2.0 * np.pi * sampled / 3.0)
    inner = (times > 1.0) & (times < 9.0)
    filled = filled_speed(times, forward, STEP_S, sampled, speeds)[inner]
    straight = np.interp(times, sampled, speeds)[inner]
    assert np.abs(filled - true[inner]).max() < 0.25
    assert np.abs(straight - true[inner]).max() > 0.7
    assert filled_speed(times, forward, STEP_S, sampled, 1.1 * speeds)[inner].mean() == pytest.approx(
        1.1 * filled.mean(), rel=0.01
    )
