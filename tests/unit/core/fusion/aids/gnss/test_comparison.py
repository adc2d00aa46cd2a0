"""Rotation between the accelerations of the IMU and of GNSS: any angle, with tilt, noise and outliers."""

from cmath import rect
from math import degrees, inf, pi, radians, sqrt

import numpy as np
import pytest

from services.core.fusion.aids.gnss.comparison import (
    MOTION_OFFSET_SD,
    SHIFT_SD,
    STANDSTILL_OFFSET_SD,
    Comparison,
    Corrections,
    Match,
)
from services.core.fusion.aids.gnss.fix import GnssPosition, GnssVelocity
from shared.maths.earth import STANDARD_GRAVITY, Geodetic, geodetic_from_ned_difference

TURN, SD, STEP_S = 2.5, 0.05, 1.0
PLACE = Geodetic(0.74, 0.2, 100.0)


def compared(turn: float = TURN, *, offset: complex = 0j, noise: float = SD, n: int = 25, seed: int = 1) -> Match:
    """Match a drive with turns and braking, measured by a tilted and rotated IMU and by GNSS."""
    rng, match = np.random.default_rng(seed), Match()
    inertial, seen = 3.0 + 4.0j, 10.0 + 0j
    for k in range(n):
        a = complex(*rng.uniform(-1.5, 1.5, 2))
        inertial, seen = inertial + a * STEP_S, seen + (rect(1.0, turn) * a + offset) * STEP_S
        match = match.after(k * 10**9, inertial, seen + noise * complex(*rng.standard_normal(2)), SD)
    return match


@pytest.mark.parametrize("turn", [0.0, 1.0, pi / 2, 3.1, -3.1])
def test_a_rotation_of_any_angle_is_estimated_within_four_sigma(turn: float) -> None:
    found, sd = compared(turn).result(1.0)
    assert abs(rect(1.0, found) - rect(1.0, turn)) < 4.0 * sd < 0.2


def test_a_tilt_of_five_degrees_does_not_change_the_estimated_rotation() -> None:
    """Five degrees of tilt are a constant acceleration of 0.85 m/s²."""
    found, sd = compared(offset=0.85 + 0j).result(1.0)
    assert found == pytest.approx(TURN, abs=4.0 * sd)


def test_normalised_errors_of_the_rotation_have_a_deviation_between_0_5_and_1_1() -> None:
    """200 runs; a pessimistic factor of less than two is allowed."""
    sizes = []
    for seed in range(200):
        found, sd = compared(seed=seed).result(1.0)
        sizes.append((found - TURN) / sd)
    assert 0.5 < np.std(sizes) < 1.1


def test_intervals_without_acceleration_do_not_reduce_the_standard_deviation_of_one_manoeuvre() -> None:
    """50 s of standstill, then 2 s at 1 m/s² in which levelling has changed the tilt by 1.5 degrees."""
    match, inertial, seen = Match(), 0j, 0j
    for k in range(52):
        a, lean = (1.0 + 0j, 0.26j) if k >= 50 else (0j, 0j)
        inertial, seen = inertial + a + lean + 0.2, seen + a
        match = match.after(k * 10**9, inertial, seen, SD)
    found, plain_sd = match.result(MOTION_OFFSET_SD)
    precise, sd = Comparison(match).precise()
    assert precise == found and plain_sd < abs(found) / 3.0
    assert sd == pytest.approx(SHIFT_SD / sqrt(2.0), rel=0.2) and abs(found) < 1.5 * sd
    assert Comparison(match, offset_sd=STANDSTILL_OFFSET_SD).precise() == match.result(STANDSTILL_OFFSET_SD)


def test_without_accelerations_or_with_a_frozen_receiver_the_deviation_is_infinite() -> None:
    still, frozen = Match(), Match()
    for k in range(30):
        still = still.after(k * 10**9, 20.0 + 0j, 20.0 + 0j, SD)
        frozen = frozen.after(k * 10**9, complex(k % 3, k % 2), 7.0 + 0j, SD)
    assert still.result(1.0)[1] == frozen.result(1.0)[1] == inf


def test_an_outlier_increases_the_standard_deviation_above_the_error() -> None:
    match = compared(0.0, n=20)
    for k, jump in enumerate((25.0 + 25.0j, 0j)):
        match = match.after((20 + k) * 10**9, match.inertial, match.gnss + jump, SD)
    found, sd = match.result(1.0)
    assert sd > radians(20.0) or abs(found) < 3.0 * sd


def test_a_rotated_match_gives_the_rotated_angle_with_the_same_deviation() -> None:
    match = compared()
    assert match.turned(TURN).result(1.0)[0] == pytest.approx(0.0, abs=4.0 * match.result(1.0)[1])
    assert match.turned(TURN).result(1.0)[1] == pytest.approx(match.result(1.0)[1])


def test_a_heading_correction_at_constant_speed_is_not_an_acceleration() -> None:
    """A filter at a constant 30 m/s whose heading is corrected by a degree at times."""
    match = Match()
    for k in range(20):
        match = match.turned(radians(1.0)).after(k * 10**9, 30.0 + 0j, 30.0 + 0j, SD)
    assert match.n > 10.0 and match.aa == pytest.approx(0.0, abs=1e-12)


def test_at_constant_speed_noise_does_not_contradict_the_heading() -> None:
    """A tilt that is being estimated appears as an acceleration of 0.1 m/s²; GNSS noise has any direction."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        comparison = Comparison()
        for k in range(20):
            noise = 0.05 * complex(*rng.standard_normal(2))
            velocities = comparison.velocities.after(k * 600_000_000, 0.03j * k * (1.0 + 0.05 * k), 20.0 + noise, 0.05)
            comparison = comparison._replace(velocities=velocities)
            assert not comparison.contradicts(0.0)


@pytest.mark.parametrize("velocity", [True, False])
def test_velocities_and_positions_give_the_same_rotation(velocity: bool) -> None:
    """A circle of 20 m at 8 m/s; the IMU frame is rotated by 150 degrees."""
    comparison, rate, radius, turn = Comparison(offset_sd=STANDSTILL_OFFSET_SD), 0.4, 20.0, radians(150.0)
    for k in range(60):
        time_ns, angle = k * 200_000_000, rate * k * 0.2
        speed = radius * rate * rect(1.0, angle)
        place = geodetic_from_ned_difference((radius * np.sin(angle), radius * (1.0 - np.cos(angle)), 0.0), PLACE)
        cov, arm = np.eye(3) * 0.05**2, (0.0, 0.0, 0.0)
        own = rect(1.0, -turn) * speed + 3.0
        moving = GnssVelocity(time_ns, 0, "gnss", (speed.real, speed.imag, 0.0), cov, 3, arm)
        comparison = comparison.after(
            moving if velocity else GnssPosition(time_ns, 0, "gnss", place, cov, 3, arm, 0.0), own
        )
    found, sd = comparison.result()
    assert degrees(abs(found - turn)) < (1.0 if velocity else 5.0) and sd < radians(10.0)
    assert comparison.contradicts(0.0) and not comparison.contradicts(turn)


def test_velocities_of_a_second_receiver_are_not_used() -> None:
    comparison = Comparison()
    for k in range(10):
        for source, shift in (("first", 0.0), ("second", 5.0)):
            cov = np.eye(3) * 0.01
            seen = GnssVelocity(k * 10**9, 0, source, (k + shift, 0.0, 0.0), cov, 3, (0.0, 0.0, 0.0))
            comparison = comparison.after(seen, complex(k))
    assert comparison.velocities.g == pytest.approx(comparison.velocities.a)


def test_corrections_of_the_filter_are_removed_from_the_velocity_gain() -> None:
    """A tilt of 1 mrad about north, corrected at 1 s, changes the velocity gain eastwards from then on."""
    corrections = Corrections(10**9).after(10**9, (1e-3, 0.0, 0.02, 0.1, -0.2))
    later = corrections.at(3 * 10**9)
    assert later.velocity == pytest.approx(complex(0.1, -0.2 + 2.0 * 1e-3 * STANDARD_GRAVITY))
    assert later.yaw == 0.02


def test_a_delay_that_changes_moves_a_velocity_by_the_difference_and_back() -> None:
    seen = GnssVelocity(10**9, 0, "gnss", (1.0, 0.0, 0.0), np.eye(3), 3, (0.0, 0.0, 0.0))
    late = seen.corrected(0.1, 0.3)
    assert (late.time_ns, late.corrected(0.1, 0.3)) == (700_000_000, late)
    assert late.corrected(0.0, 0.2).time_ns == 800_000_000
    assert late.corrected(0.0, 0.0) == seen
