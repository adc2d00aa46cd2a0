"""Windows of movement and of wall-clock time, the event, the distance rule and the motion-sensor rule."""

from math import radians

import pytest

from cli.papers.motion_conflict.sweeps import statistics
from services.core.motion_conflict.tachograph import (
    EVENT_S,
    KM_H,
    THRESHOLD_M_S,
    DistanceRule,
    MotionSensorRule,
    SpeedWindow,
    WindowMode,
    distance_limit,
)
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.result import Test, judged

SECOND_NS = 1_000_000_000
PERIOD_NS = 10 * SECOND_NS


def filled(mode: WindowMode, differences_km_h: list[float]) -> SpeedWindow:
    window = SpeedWindow(mode)
    for k, difference in enumerate(differences_km_h):
        window.add(k * PERIOD_NS, 20.0, 20.0 + difference * KM_H)
    return window


def test_there_is_no_statistic_before_30_values() -> None:
    assert not filled(WindowMode.MOVING, [20.0] * 29).complete
    assert filled(WindowMode.MOVING, [20.0] * 30).complete


def test_standstill_is_left_out_of_a_moving_window_and_counted_in_a_wall_window() -> None:
    for mode, kept in ((WindowMode.MOVING, 20.0), (WindowMode.WALL, 0.0)):
        window = filled(mode, [20.0] * 30)
        for k in range(30, 60):
            window.add(k * PERIOD_NS, 0.05, 0.0)
        assert window.median() == pytest.approx(kept * KM_H, abs=0.06)


def test_a_sample_with_one_speed_at_zero_is_movement() -> None:
    window = SpeedWindow(WindowMode.MOVING)
    window.add(0, 20.0, 0.0)
    window.add(PERIOD_NS, 0.0, 15.0)
    assert window.differences == [20.0, 15.0]


@pytest.mark.parametrize("mode", WindowMode)
def test_no_fix_is_never_speed_zero(mode: WindowMode) -> None:
    window = filled(mode, [0.5] * 30)
    for k in range(30, 40):
        window.add(k * PERIOD_NS, None, 30.0)
    assert max(window.differences) == pytest.approx(0.5 * KM_H)
    assert window.complete == (mode is WindowMode.MOVING)  # ten values of a wall window are missing


@pytest.mark.parametrize(("scale", "above"), [(1.0 - 1e-12, False), (1.0, False), (1.0 + 1e-12, True)])
def test_exactly_10_km_h_is_not_above_the_limit(monkeypatch: pytest.MonkeyPatch, scale: float, above: bool) -> None:
    """The regulation and the paper say *exceeds*: for the event, the verdict, the suspect time and the sweeps.

    No mean of 24 numbers is 10 km/h to the last bit (their sums are coarser), so that the window's is set.
    """
    difference = scale * THRESHOLD_M_S
    monkeypatch.setattr(SpeedWindow, "trimmed_mean", lambda _window: difference)
    window = SpeedWindow(WindowMode.MOVING)
    for k in range(30):
        window.add(k * PERIOD_NS, 0.0, difference)
    assert window.exceeded_s == (10.0 if above else 0.0)
    assert (window.suspect_since_ns is not None) == above
    base = Test(Outcome.NOT_EVALUATED, explain("motion.trimmed_mean"), "m/s")
    assert judged(base, difference, THRESHOLD_M_S).accuses == above
    swept = statistics([(10.0 * k, 0.0, scale * 10.0) for k in range(30)])
    assert (swept.mean_above, swept.median_above) == ((1, 1) if above else (0, 0))
    assert (swept.first_s is not None) == above


def test_the_event_counts_movement_and_standstill_does_not_interrupt_it() -> None:
    window = filled(WindowMode.MOVING, [20.0] * 40)
    assert window.exceeded_s == 110.0
    window.add(41 * PERIOD_NS, 0.0, 0.0)
    assert window.exceeded_s == 110.0
    for k in range(42, 62):
        window.add(k * PERIOD_NS, 20.0, 20.0 + 20.0 * KM_H)
    assert window.exceeded_s == EVENT_S + 10.0
    for k in range(62, 70):  # the trimmed mean falls to 10 km/h with the twelfth
        window.add(k * PERIOD_NS, 20.0, 20.0)
    assert window.exceeded_s > 0.0
    for k in range(70, 90):
        window.add(k * PERIOD_NS, 20.0, 20.0)
    assert window.exceeded_s == 0.0


def test_the_suspect_time_is_the_sample_before_the_first_large_difference() -> None:
    assert filled(WindowMode.MOVING, [0.5] * 10 + [30.0] * 20).suspect_since_ns == 9 * PERIOD_NS
    assert filled(WindowMode.MOVING, [0.5] * 30).suspect_since_ns is None
    assert filled(WindowMode.MOVING, [30.0] * 30).suspect_since_ns == -PERIOD_NS


@pytest.mark.parametrize(
    ("odometer_km", "ferry_h", "limit_km"),
    [(0.0, 0.0, 1.0), (20.0, 0.0, 27.0), (50.0, 0.0, 66.0), (100.0, 0.0, 121.0), (20.0, 0.5, 127.0)],
)
def test_distance_limit(odometer_km: float, ferry_h: float, limit_km: float) -> None:
    assert distance_limit(1000.0 * odometer_km, 3600.0 * ferry_h) == pytest.approx(1000.0 * limit_km)


def test_the_distance_rule_compares_once_in_15_minutes() -> None:
    rule = DistanceRule(gap_s=2.0)
    for t in range(0, 1801):
        rule.odometer(t * SECOND_NS, 20.0)
        rule.position(t * SECOND_NS, radians(50.0 + t * 20.0 / 111_230.0), radians(10.0))
        assert (rule.compared is not None) == (t >= 900)
    assert rule.compared is not None
    distance, limit, start, end = rule.compared
    assert (start, end) == (900 * SECOND_NS, 1800 * SECOND_NS)
    assert distance == pytest.approx(18_000.0, rel=1e-3)
    assert limit == pytest.approx(distance_limit(18_000.0))


def test_an_interrupted_odometer_leaves_the_distance_unjudged() -> None:
    rule = DistanceRule(gap_s=2.0)
    for t in range(0, 901):
        if not 100 < t < 110:
            rule.odometer(t * SECOND_NS, 20.0)
        rule.position(t * SECOND_NS, radians(50.0), radians(10.0 + t))
    assert rule.compared is None


def test_an_odometer_that_is_heard_late_leaves_the_distance_unjudged() -> None:
    rule = DistanceRule(gap_s=2.0)
    for t in range(0, 901):
        if t >= 600:
            rule.odometer(t * SECOND_NS, 30.0)
        rule.position(t * SECOND_NS, radians(50.0 + t * 30.0 / 111_230.0), radians(10.0))
    assert rule.compared is None


def test_a_silent_motion_sensor_is_counted_after_five_seconds_and_forgotten_after_three_hours() -> None:
    rule = MotionSensorRule(moving_m_s=1.5, gap_s=2.0)
    for t in range(100):
        rule.update(t * SECOND_NS, 20.0 if t >= 10 else 0.1, 0.0)
    assert rule.contradiction_s(99 * SECOND_NS) == pytest.approx(89.0 - 5.0)
    assert rule.suspect_since_ns == 10 * SECOND_NS
    assert rule.contradiction_s((99 + 10_700) * SECOND_NS) > 0.0
    assert rule.contradiction_s((99 + 10_900) * SECOND_NS) == 0.0


def test_pulling_away_again_and_again_does_not_add_up() -> None:
    rule = MotionSensorRule(moving_m_s=1.5, gap_s=2.0)
    for t in range(10_000):
        rule.update(t * SECOND_NS, 3.0, 0.0 if t % 60 < 4 else 3.0)
    assert rule.contradiction_s(10_000 * SECOND_NS) == 0.0


def test_a_missing_speed_is_no_contradiction() -> None:
    rule = MotionSensorRule(moving_m_s=1.5, gap_s=2.0)
    for t in range(200):
        rule.update(t * SECOND_NS, None if t % 2 else 20.0, 0.0)
        rule.update(t * SECOND_NS + 1, 20.0, None)
    assert rule.contradiction_s(200 * SECOND_NS) == 0.0
