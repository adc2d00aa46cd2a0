"""The rules of EN 302 637-2 clause 6.1.3 on motions with a known result."""

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.v2x.generation import Dynamics, GenerationRules

ORIGIN = Geodetic(math.radians(49.0), math.radians(2.0), 0.0)
MS = 1_000_000


def sent_ms(motion: Callable[[float], tuple[float, float | None, float]], seconds: float) -> list[int]:
    """Check ten times a second; `motion` gives distance north, heading and speed at a time."""
    rules, times = GenerationRules(), []
    for step in range(round(seconds * 10)):
        north, heading, speed = motion(step / 10)
        position = geodetic_from_ned_difference((north, 0.0, 0.0), ORIGIN)
        if rules.check(Dynamics(step * 100 * MS, position, heading, speed)):
            times.append(step * 100)
    return times


def periods(times: list[int]) -> set[int]:
    return {later - earlier for earlier, later in pairwise(times)}


def test_a_standing_vehicle_sends_once_a_second() -> None:
    assert sent_ms(lambda t: (0.0, 0.0, 0.0), 10.0) == list(range(0, 10_000, 1000))


@pytest.mark.parametrize(
    ("speed_m_s", "expected"),
    [
        (30.0, {200}),  # 4 m every 133 ms, checked every 100 ms
        (45.0, {100}),
        (15.0, {300}),
        (4.9, {900}),
        (3.9, {1000}),  # less than 4 m in a second
    ],
)
def test_at_constant_speed_a_cam_follows_each_4_m(speed_m_s: float, expected: set[int]) -> None:
    assert periods(sent_ms(lambda t: (speed_m_s * t, 0.0, speed_m_s), 20.0)) == expected


def test_a_change_of_heading_of_more_than_4_degrees_is_sent() -> None:
    turning = sent_ms(lambda t: (0.0, math.radians(13.0 * t), 0.0), 10.0)  # 3.9 degrees in 300 ms, 5.2 in 400 ms
    assert periods(turning) == {400}


def test_a_heading_that_passes_north_is_a_small_change() -> None:
    swinging = sent_ms(lambda t: (0.0, math.radians(0.5 if round(t * 10) % 2 else 359.5), 0.0), 10.0)
    assert periods(swinging) == {1000}


def test_a_heading_that_is_not_known_is_no_change() -> None:
    assert periods(sent_ms(lambda t: (0.0, None if round(t * 10) % 2 else 3.0, 0.0), 10.0)) == {1000}


def test_a_change_of_speed_of_more_than_half_a_metre_a_second_is_sent() -> None:
    assert periods(sent_ms(lambda t: (0.0, 0.0, 2.0 * t), 5.0)) == {300}  # 0.4 m/s in 200 ms, 0.6 in 300 ms


def test_after_a_change_three_cams_keep_its_period_and_then_it_is_a_second_again() -> None:
    """Half a metre a second once, at 200 ms after a CAM: T_GenCam becomes 200 ms for N_GenCam = 3 CAM."""
    times = sent_ms(lambda t: (0.0, 0.0, 0.6 if t >= 1.2 else 0.0), 6.0)
    assert times == [0, 1000, 1200, 1400, 1600, 1800, 2800, 3800, 4800, 5800]


def test_the_rate_stays_within_1_to_10_a_second_when_the_rules_are_checked_more_often() -> None:
    rules, times = GenerationRules(), []
    for step in range(1000):
        now_ns = step * 13 * MS
        speed = 50.0 * math.sin(step)  # a change at every check
        if rules.check(Dynamics(now_ns, ORIGIN, 0.0, speed)):
            times.append(now_ns // MS)
    assert min(periods(times)) >= 90  # 100 ms less the tolerance for the instants of the checks
    assert max(periods(times)) <= 1000


def test_jitter_of_the_checks_does_not_halve_the_rate() -> None:
    rules, count = GenerationRules(), 0
    for step in range(100):
        jitter_ns = (3 if step % 2 else -3) * MS
        position = geodetic_from_ned_difference((5.0 * step, 0.0, 0.0), ORIGIN)
        count += rules.check(Dynamics(step * 100 * MS + jitter_ns, position, 0.0, 50.0)) is not None
    assert count == 100


def test_the_low_frequency_container_is_in_the_first_cam_and_every_500_ms() -> None:
    rules, low = GenerationRules(), []
    for step in range(31):
        position = geodetic_from_ned_difference((5.0 * step, 0.0, 0.0), ORIGIN)
        generation = rules.check(Dynamics(step * 100 * MS, position, 0.0, 50.0))
        assert generation is not None
        if generation.low_frequency:
            low.append(step * 100)
    assert low == [0, 500, 1000, 1500, 2000, 2500, 3000]


@pytest.mark.parametrize("late_ms", [0, 1, 5, 9])
def test_two_low_frequency_containers_are_at_least_500_ms_apart(late_ms: int) -> None:
    """EN 302 637-2 clause 6.1.3: where at least 500 ms have passed; a check that comes early is not late enough."""
    rules, low = GenerationRules(), []
    for step in range(200):
        time_ms = step * 100 + (late_ms if step % 5 == 0 else 0)
        position = geodetic_from_ned_difference((5.0 * step, 0.0, 0.0), ORIGIN)
        generation = rules.check(Dynamics(time_ms * MS, position, 0.0, 50.0))
        if generation and generation.low_frequency:
            low.append(time_ms)
    assert min(periods(low)) >= 500
    assert max(periods(low)) <= 600


def test_after_a_restart_of_the_time_line_cams_are_sent() -> None:
    rules = GenerationRules()
    assert rules.check(Dynamics(10**18, ORIGIN, 0.0, 0.0))
    assert rules.check(Dynamics(0, ORIGIN, 0.0, 0.0))
