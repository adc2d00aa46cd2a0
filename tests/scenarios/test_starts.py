"""Alignment of the heading after switch-on at any place and speed.

The goal is 3 degrees within 5 s of exceeding 3 m/s, with unknown heading and no standstill. It holds for receivers with
velocity; for others see `docs/explanation/navigation.md`.
"""

from math import degrees, inf, radians

import numpy as np
import pytest

from benchmarks.starts.report import moments
from benchmarks.starts.start import Receiver, Start, drive
from services.core.fusion.codes import Code
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Prior
from shared.maths.earth import Geodetic
from shared.runtime.config import GnssAntenna, Vehicle
from tests.support.cases import crossed
from tests.support.drives.starts import Leg, manoeuvre

LIMIT = radians(3.0)
REVERSING_OUT: tuple[Leg, ...] = (
    (3, 0, 0),
    (3, -1.0, -0.1),
    (1, 0, -0.1),
    (3, 1.0, 0),
    (1, 0, 0),
    (6, 1.5, 0),
    (9, 0, 0.01),
)
REVERSING_LONG: tuple[Leg, ...] = ((3, 0, 0), (3, -1.0, 0), (12, 0, 0), (3, 1.0, 0), (2, 0, 0), (6, 1.5, 0))
DRIVING_OFF: tuple[Leg, ...] = ((3, 0, 0), (6, 1.5, 0), (10, 0, 0.02), (6, 0, -0.02))
WITH_VELOCITY = [Receiver(1), Receiver(5), Receiver(10)]


@pytest.mark.parametrize(
    ("where", "moving"),
    crossed([("parking_lot", 8, 240.0), ("urban", 2, 300.0), ("tunnel", 3, 200.0)], [False, True]),
)
def test_an_unknown_heading_is_known_to_3_degrees_within_5_s_of_exceeding_3_m_s(
    where: tuple[str, int, float], moving: bool
) -> None:
    """Bends, slopes and straights, at 1, 5 and 10 Hz, with the errors of a receiver without corrections."""
    rng = np.random.default_rng(where[1])
    travelled = drive(*where)
    times = moments(travelled, moving)
    for k, receiver in enumerate(WITH_VELOCITY):
        start = Start(travelled, receiver, float(rng.choice(times)), rng.uniform(0.0, 1.5), k)
        settled_s, _, how = start.known_after_s(LIMIT, 20.0)
        assert settled_s <= 5.0, (start.at_s, receiver, how)


@pytest.mark.parametrize(
    ("where", "rate_hz"), crossed([("parking_lot", 75.12), ("parking_lot", 112.03), ("tunnel", 60.64)], [1, 5])
)
def test_without_gnss_velocity_constant_speed_is_not_a_standstill(where: tuple[str, float], rate_hz: int) -> None:
    """Switch-on at 5 and 20 m/s on a straight, where integrated acceleration gives no heading."""
    scenario, at_s = where
    travelled = drive(scenario, 1, 240.0) if scenario == "parking_lot" else drive(scenario, 3, 200.0)
    start = Start(travelled, Receiver(rate_hz, velocity=False), at_s, 0.76, 1)
    _, worst, how = start.known_after_s(LIMIT, 20.0)
    assert how.startswith("course")
    assert worst < radians(12.0)


def errors_of(start: Start, made: Navigator, duration_s: float) -> dict[float, float]:
    """Error of the heading [degrees] by time, infinite without a solution."""
    found = {}
    for i, navigator in start.lead(made, duration_s):
        solution = navigator.solution()
        found[round(i * 0.01, 2)] = degrees(start.yaw_error(i, solution)) if solution else inf
    return found


def plain(start: Start) -> Navigator:
    return Navigator(Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=start.drive.lever_arm_b))))


# Switched on after a standstill, without one, and while reversing.
@pytest.mark.parametrize(("at_s", "receiver"), crossed([0.0, 2.9, 6.0], WITH_VELOCITY))
def test_reversing_out_of_a_parking_space_gives_a_heading_within_15_degrees(at_s: float, receiver: Receiver) -> None:
    start = Start(manoeuvre(REVERSING_OUT, seed=3, yaw=1.0), receiver, at_s, 0.3, 1)
    errors = errors_of(start, plain(start), 30.0)
    assert all(abs(error) < 15.0 for error in errors.values() if error != inf)
    assert abs(errors[14.0]) < LIMIT * 60.0


@pytest.mark.parametrize("receiver", [Receiver(1), Receiver(5)])
def test_a_heading_reversed_at_constant_speed_backwards_is_corrected_within_3_s_of_braking(receiver: Receiver) -> None:
    """At constant speed forwards and backwards are indistinguishable; braking begins at 18 s."""
    start = Start(manoeuvre(REVERSING_LONG, seed=3, yaw=1.0), receiver, 7.0, 0.3, 1)
    made = plain(start)
    errors = errors_of(start, made, 30.0)
    assert abs(errors[17.9]) > 170.0
    assert abs(errors[21.0]) < 15.0 and abs(errors[26.0]) < 3.0
    assert made.counts.resets == 1


@pytest.mark.parametrize(("receiver", "wrong_deg"), crossed(WITH_VELOCITY, [180.0, 90.0, -60.0]))
def test_a_wrong_saved_heading_is_corrected_within_5_5_s_of_moving_off(receiver: Receiver, wrong_deg: float) -> None:
    """The vehicle was turned while switched off; it moves off at 3 s with 1.5 m/s²."""
    start = Start(manoeuvre(DRIVING_OFF, seed=3, yaw=1.0), receiver, 0.0, 0.3, 1)
    made, place = plain(start), Geodetic(*start.drive.position[0].tolist())
    made.use_prior(Prior(place, (1.0, 1.0, 2.0), 1.0 + radians(wrong_deg), radians(1.0)))
    reasons = set()
    errors = {}
    for i, navigator in start.lead(made, 25.0):
        solution = navigator.solution()
        errors[i] = degrees(start.yaw_error(i, solution)) if solution else inf
        reasons |= {explanation.code for explanation in navigator.why}
    wrong = [i for i, error in errors.items() if error != inf and abs(error) > 20.0]
    assert max(wrong) < 850, "5.5 s after moving off, 3.5 s after 3 m/s"
    assert max(abs(errors[i]) for i in range(1200, 2499)) < 3.0
    assert Code.HEADING_WRONG in reasons


def test_velocity_outliers_do_not_reset_a_correct_heading() -> None:
    """Two drives with bends and stops, and random velocity outliers of 20 m/s."""
    for seed in range(2):
        start = Start(drive("parking_lot", seed, 100.0), Receiver(5), 10.0, 0.3, seed)
        made, rng = plain(start), np.random.default_rng(seed)
        for i, navigator in start.lead(made, 50.0):
            solution = navigator.solution()
            if solution and rng.random() < 0.002:
                north, east, _ = (20.0 * rng.standard_normal(3)).tolist()
                navigator.fix(int(start.drive.t_ns[i]), position=solution.position, velocity=(north, east, 0.0))
        assert made.counts.resets == 0, made.why
        assert made.counts.fixes_used > 180
