"""Heading from accelerations seen twice: any turn is found, tilt does not matter, and nonsense says nothing."""

from cmath import rect
from math import degrees, inf, pi, radians, sqrt

import numpy as np
import pytest

from services.core.fusion.alignment.velocity_matching import (
    MOTION_OFFSET_SD,
    SHIFT_SD,
    STANDSTILL_OFFSET_SD,
    Comparison,
    Corrections,
    Match,
)
from services.core.fusion.measurements.gnss import GnssPosition, GnssVelocity
from shared.maths.earth import STANDARD_GRAVITY, Geodetic, geodetic_from_ned_difference

TURN, SD, STEP_S = 2.5, 0.05, 1.0
PLACE = Geodetic(0.74, 0.2, 100.0)


def compared(turn: float = TURN, *, offset: complex = 0j, noise: float = SD, n: int = 25, seed: int = 1) -> Match:
    """A drive of turns and brakes, by inertial sensors that lean and are turned, and by GNSS."""
    rng, match = np.random.default_rng(seed), Match()
    inertial, seen = 3.0 + 4.0j, 10.0 + 0j
    for k in range(n):
        a = complex(*rng.uniform(-1.5, 1.5, 2))
        inertial, seen = inertial + a * STEP_S, seen + (rect(1.0, turn) * a + offset) * STEP_S
        match = match.after(k * 10**9, inertial, seen + noise * complex(*rng.standard_normal(2)), SD)
    return match


@pytest.mark.parametrize("turn", [0.0, 1.0, pi / 2, 3.1, -3.1])
def test_any_turn_is_found(turn: float) -> None:
    found, sd = compared(turn).result(1.0)
    assert abs(rect(1.0, found) - rect(1.0, turn)) < 4.0 * sd < 0.2


def test_a_tilt_is_no_turn() -> None:
    """Five degrees of tilt look like an acceleration of 0.85 m/s² that never ends."""
    found, sd = compared(offset=0.85 + 0j).result(1.0)
    assert found == pytest.approx(TURN, abs=4.0 * sd)


def test_the_standard_deviation_is_honest() -> None:
    """Errors over their standard deviations, 200 runs: it may err on the safe side by less than two."""
    sizes = []
    for seed in range(200):
        found, sd = compared(seed=seed).result(1.0)
        sizes.append((found - TURN) / sd)
    assert 0.5 < np.std(sizes) < 1.1


def test_many_quiet_intervals_do_not_make_one_manoeuvre_precise() -> None:
    """Idling for 50 s, then 2 s at 1 m/s², in which levelling has leant the frame by another 1.5 degrees."""
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


def test_nothing_is_known_without_accelerations_or_with_a_receiver_that_does_not_move() -> None:
    still, frozen = Match(), Match()
    for k in range(30):
        still = still.after(k * 10**9, 20.0 + 0j, 20.0 + 0j, SD)
        frozen = frozen.after(k * 10**9, complex(k % 3, k % 2), 7.0 + 0j, SD)
    assert still.result(1.0)[1] == frozen.result(1.0)[1] == inf


def test_an_outlier_makes_it_unsure_and_not_wrong() -> None:
    match = compared(0.0, n=20)
    for k, jump in enumerate((25.0 + 25.0j, 0j)):
        match = match.after((20 + k) * 10**9, match.inertial, match.gnss + jump, SD)
    found, sd = match.result(1.0)
    assert sd > radians(20.0) or abs(found) < 3.0 * sd


def test_turning_the_view_turns_the_result() -> None:
    match = compared()
    assert match.turned(TURN).result(1.0)[0] == pytest.approx(0.0, abs=4.0 * match.result(1.0)[1])
    assert match.turned(TURN).result(1.0)[1] == pytest.approx(match.result(1.0)[1])


def test_turning_the_view_at_speed_is_no_acceleration() -> None:
    """A filter at an even 30 m/s whose heading is corrected by a degree now and then goes on as it went."""
    match = Match()
    for k in range(20):
        match = match.turned(radians(1.0)).after(k * 10**9, 30.0 + 0j, 30.0 + 0j, SD)
    assert match.n > 10.0 and match.aa == pytest.approx(0.0, abs=1e-12)


def test_at_even_speed_noise_contradicts_nothing() -> None:
    """A tilt that is being learnt looks like an acceleration of 0.1 m/s², and GNSS noise has any direction."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        comparison = Comparison()
        for k in range(20):
            noise = 0.05 * complex(*rng.standard_normal(2))
            velocities = comparison.velocities.after(k * 600_000_000, 0.03j * k * (1.0 + 0.05 * k), 20.0 + noise, 0.05)
            comparison = comparison._replace(velocities=velocities)
            assert not comparison.contradicts(0.0)


@pytest.mark.parametrize("velocity", [True, False])
def test_velocities_and_positions_say_the_same(velocity: bool) -> None:
    """A circle of 20 m at 8 m/s; inertial sensors see it turned by 150 degrees."""
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


def test_a_second_receiver_is_not_mixed_in() -> None:
    comparison = Comparison()
    for k in range(10):
        for source, shift in (("first", 0.0), ("second", 5.0)):
            cov = np.eye(3) * 0.01
            seen = GnssVelocity(k * 10**9, 0, source, (k + shift, 0.0, 0.0), cov, 3, (0.0, 0.0, 0.0))
            comparison = comparison.after(seen, complex(k))
    assert comparison.velocities.g == pytest.approx(comparison.velocities.a)


def test_what_was_corrected_is_undone() -> None:
    """A tilt of 1 mrad about north that was taken out at 1 s makes the velocity gain as much less eastwards since."""
    corrections = Corrections(10**9).after(10**9, (1e-3, 0.0, 0.02, 0.1, -0.2))
    later = corrections.at(3 * 10**9)
    assert later.velocity == pytest.approx(complex(0.1, -0.2 + 2.0 * 1e-3 * STANDARD_GRAVITY))
    assert later.yaw == 0.02
