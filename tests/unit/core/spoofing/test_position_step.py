"""Positions against the integral of their own velocity."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from services.core.spoofing.inertial.tracks import VelocityFix
from services.core.spoofing.windows.position_step import MIN_SD_M, THRESHOLD, position_step
from shared.inertial.increments import SECOND_NS
from shared.maths.earth import Geodetic, geodetic_from_ned_difference

START = Geodetic(radians(48.0), radians(11.0), 0.0)


def fixes(step_m: float = 0.0, *, turn_rate: float = 0.2, sd_m: float = 0.0) -> list[VelocityFix]:
    """Six fixes of a circle at 10 m/s and 1 Hz; the last three are moved to the east."""
    found = []
    for k in range(6):
        angle = turn_rate * k
        velocity = 10.0 * np.array([np.cos(angle), np.sin(angle), 0.0])
        place = 10.0 / turn_rate * np.array([np.sin(angle), 1.0 - np.cos(angle)])
        position = geodetic_from_ned_difference((place[0], place[1] + step_m * (k >= 3), 0.0), START)
        found.append(VelocityFix(k * SECOND_NS, velocity, np.zeros(3), position, sd_m))
    return found


def test_a_curve_without_noise_moves_by_the_integral_of_its_velocity() -> None:
    found = position_step(fixes())
    assert found is not None
    assert found.size < 0.2, "error of the trapezoidal rule at 1 Hz: W v omega² h² / 12 = 0.17 m"
    assert found.limit > THRESHOLD * MIN_SD_M


@pytest.mark.parametrize("step_m", [12.0, 100.0])
def test_a_step_aside_is_measured_and_exceeds_the_limit(step_m: float) -> None:
    found = position_step(fixes(step_m))
    assert found is not None
    assert found.size == pytest.approx(step_m, abs=0.2) and (found.size > found.limit) is (step_m > 50.0)
    assert found.suspect_ns == 2 * SECOND_NS, "the fix before the step"


def test_a_position_that_drifts_is_suspect_since_the_start_of_the_window() -> None:
    steady = fixes(turn_rate=1e-9)
    given = [replace(fix, velocity_n=fix.velocity_n * 0.5) for fix in steady]
    found = position_step(given)
    assert found is not None and found.size == pytest.approx(25.0) and found.suspect_ns == 0


def test_stated_standard_deviations_of_both_ends_widen_the_limit() -> None:
    found = position_step(fixes(100.0, turn_rate=1e-9, sd_m=20.0))
    assert found is not None
    assert found.limit == pytest.approx(THRESHOLD * np.sqrt(MIN_SD_M**2 + 2 * 20.0**2)) and found.size < found.limit


def test_with_a_position_missing_there_is_no_comparison() -> None:
    given = fixes()
    for k in (0, 2, 5):
        bare = VelocityFix(given[k].time_ns, given[k].velocity_n, given[k].sd)
        assert position_step([*given[:k], bare, *given[k + 1 :]]) is None


def test_the_limit_holds_what_an_inaccurate_velocity_moves_in_five_seconds() -> None:
    """Straight ahead, so that the ages of position and velocity do not matter."""
    exact, inaccurate = (
        position_step([replace(fix, sd=np.full(3, sd)) for fix in fixes(turn_rate=1e-9)]) for sd in (0.0, 0.4)
    )
    assert exact is not None and inaccurate is not None
    assert exact.limit == pytest.approx(THRESHOLD * MIN_SD_M)
    assert inaccurate.limit == pytest.approx(THRESHOLD * np.hypot(MIN_SD_M, 5.0 * 0.4))
