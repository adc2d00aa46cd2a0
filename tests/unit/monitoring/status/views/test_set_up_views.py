"""The views of the set-up: attitude by gravity, noise of samples, and two speeds compared."""

from math import radians, sqrt

import numpy as np
import pytest

from services.monitoring.status.views.set_up import compared, level
from shared.maths.rotation import ned_from_body
from shared.messages.imu import ImuSamples
from tests.support.cases import each

STEP_NS, STEP_S = 10_000_000, 0.01


def batches(
    force_sd: float, rate_sd: float, roll: float = 0.0, pitch: float = 0.0, count: int = 60
) -> list[ImuSamples]:
    rng = np.random.default_rng(1)
    gravity = ned_from_body(radians(roll), radians(pitch), 0.3).T @ np.array([0.0, 0.0, -9.81])
    found = []
    for k in range(count):
        force = gravity + force_sd * rng.standard_normal((10, 3))
        rate = rate_sd * rng.standard_normal((10, 3))
        stamps = tuple((100 * k + j) * STEP_NS for j in range(10))  # the page sees one batch of ten
        found.append(
            ImuSamples(
                received_ns=stamps[-1], source="imu", sampled_ns=stamps,
                specific_force_body_m_s2=tuple(map(tuple, force.tolist())),
                angular_rate_body_rad_s=tuple(map(tuple, rate.tolist())),
            )
        )  # fmt: skip
    return found


@each(("roll", "pitch"), [(0.0, 0.0), (5.0, -3.0), (-20.0, 8.0)])
def test_the_level_is_the_attitude_by_gravity(roll: float, pitch: float) -> None:
    shown = level(batches(1e-4, 1e-6, roll, pitch))
    assert shown is not None and shown["still"]
    assert (shown["roll_deg"], shown["pitch_deg"]) == pytest.approx((roll, pitch), abs=0.02)
    assert shown["force_m_s2"] == pytest.approx(9.81, abs=1e-3)


@each(("walk", "grade"), [(2e-5, "tactical"), (1.2e-4, "industrial"), (3e-4, "automotive"), (1e-3, "consumer")])
def test_the_noise_is_that_of_the_samples_and_names_a_grade(walk: float, grade: str) -> None:
    shown = level(batches(0.005, walk / sqrt(STEP_S)))
    assert shown is not None and shown["grade"] == grade
    assert shown["rate_noise"] == pytest.approx(walk, rel=0.15)
    assert shown["force_noise"] == pytest.approx(0.005 * sqrt(STEP_S), rel=0.15)


def test_while_it_shakes_or_is_too_short_there_is_no_noise() -> None:
    shaken, short = level(batches(1.0, 0.1)), level(batches(0.005, 1e-3, count=5))
    assert shaken is not None and not shaken["still"] and shaken["grade"] is None
    assert short is not None and short["grade"] is None
    assert level([]) is None


def test_a_speed_is_compared_in_motion() -> None:
    gnss = [0.5 * k for k in range(40)]
    assert compared([(1.04 * v, v) for v in gnss]) == (1.04, 1.0)
    assert compared([(1.0, 1.0)] * 50) == (None, None)
    ratio, correlation = compared([(5.0, v) for v in gnss])
    assert ratio is not None and correlation is None, "a constant follows nothing"
