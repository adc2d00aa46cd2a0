"""The motion monitor on simulated drives: what it learns, what it accuses, and what it leaves undecided."""

from collections.abc import Callable
from dataclasses import fields
from math import inf, nan, sin

import numpy as np
import pytest
from scipy.stats import binom

from services.core.motion_conflict.calibration import Calibration
from services.core.motion_conflict.codes import Code
from services.core.motion_conflict.comparison import SpeedComparison
from services.core.motion_conflict.monitor import MotionMonitor
from services.core.motion_conflict.settings import Settings
from services.core.motion_conflict.tachograph import KM_H, SAMPLES, WindowMode
from services.core.motion_conflict.verdicts import MotionVerdicts
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.inputs import Input
from tests.support.drives.motion import SECOND_NS, World, drives_and_stops

NAMES = [field.name for field in fields(MotionVerdicts)]
KNOWN = Calibration(1.0, 0.0, 0.001, 0.03)  # of an earlier drive


def steady(speed_km_h: float) -> Callable[[float], float]:
    """A steady speed [m/s] with a slow variation of 2 km/h, as traffic makes it."""
    return lambda time_s: (speed_km_h + 2.0 * sin(0.05 * time_s)) * KM_H


def known(speed: Callable[[float], float], **others: object) -> World:
    return World(speed, monitor=MotionMonitor(start=KNOWN), **others)  # type: ignore[arg-type]


@pytest.mark.parametrize(("scale", "delay_s"), [(1.0, 0.0), (0.93, 0.5), (1.06, 2.5), (0.97, -0.4), (1.02, 1.5)])
def test_scale_and_delay_of_the_odometer_are_learned_without_a_false_alarm(scale: float, delay_s: float) -> None:
    monitor = MotionMonitor(Settings(delay_limits_s=(-1.0, 3.0)))  # slower than the default allows
    world = World(drives_and_stops(3, 700.0), scale=scale, delay_s=delay_s, monitor=monitor)
    assert world.accusing(700.0) == set()
    learned = world.monitor.calibration.calibration
    assert learned.learned
    assert learned.scale == pytest.approx(scale, abs=0.003)
    assert learned.delay_s == pytest.approx(delay_s, abs=0.05)


def test_errors_of_the_learned_values_agree_with_their_standard_deviations() -> None:
    squares = []
    for seed in range(12):
        world = World(drives_and_stops(seed, 400.0), seed=seed, scale=1.03, delay_s=0.7)
        world.after(400.0)
        learned = world.monitor.calibration.calibration
        squares.append(
            (((learned.scale - 1.03) / learned.scale_sd) ** 2, ((learned.delay_s - 0.7) / learned.delay_sd_s) ** 2)
        )
    mean_scale, mean_delay = (sum(column) / len(squares) for column in zip(*squares, strict=True))
    assert mean_scale < 2.0  # χ² of 12 degrees over 12: 2.19 in 1 of 100
    assert mean_delay < 2.0


def test_a_frozen_estimator_learns_nothing() -> None:
    world = World(drives_and_stops(3, 300.0), scale=1.05)
    world.monitor.calibration.frozen = True
    world.after(300.0)
    assert world.monitor.calibration.calibration.scale == pytest.approx(1.0, abs=1e-12)


def test_a_scale_beyond_tyres_is_not_learned_and_is_a_finding() -> None:
    world = known(steady(90.0), scale=1.12)
    assert world.after(400.0).scale_range.outcome is Outcome.ACCUSES
    assert world.monitor.calibration.calibration.scale <= 1.08


@pytest.mark.slow
def test_false_alarms_of_the_fast_test_on_drives_do_not_exceed_the_design_rate() -> None:
    rate, windows, episodes, alarmed = 1e-3, 0, 0, False
    monitor = MotionMonitor(Settings(fast_false_alarm_rate=rate))
    for verdicts in World(drives_and_stops(5, 6000.0), monitor=monitor).run(6000.0):
        windows += verdicts.fast.outcome is not Outcome.NOT_EVALUATED
        episodes += verdicts.fast.outcome is Outcome.ACCUSES and not alarmed
        alarmed = verdicts.fast.outcome is Outcome.ACCUSES
    assert windows > 5000
    assert episodes <= binom.ppf(0.9995, windows, rate)


def test_normal_drives_accuse_nobody_and_every_speed_test_is_evaluated() -> None:
    world = World(drives_and_stops(8, 900.0))
    assert world.accusing(899.0) == set()
    last = world.after(1.0)
    assert {name for name in NAMES if getattr(last, name).outcome is Outcome.NOT_EVALUATED} == {"distance"}


def test_before_any_speed_nothing_is_evaluated() -> None:
    verdicts = MotionMonitor().verdicts(SECOND_NS)
    assert all(getattr(verdicts, name).outcome is Outcome.NOT_EVALUATED for name in NAMES)
    assert verdicts.trimmed_mean.why == explain(Code.NO_INPUT, input=Input.GNSS_SPEED)


def test_each_test_raised_alone_changes_exactly_its_own_verdict() -> None:
    held_since: list[float] = []

    def frozen_receiver(time_s: float, speed: float) -> float:
        held_since.append(speed)
        return held_since[0] if time_s < 400.0 else speed

    cases: dict[str, World] = {
        "fast": known(steady(90.0), gnss=lambda t, v: v + (15.0 * KM_H if 400.0 <= t < 410.0 else 0.0)),
        "held_speed": known(steady(60.0), gnss_sd=0.3, gnss=frozen_receiver),
        "scale_step": World(
            steady(90.0),
            monitor=MotionMonitor(Settings(fast_false_alarm_rate=1e-20), start=KNOWN),
            gnss_sd=0.3,
            odometer=lambda t, v: v * (1.04 if t > 400.0 else 1.0),
        ),
        "motion_sensor": World(
            lambda t: float(np.interp(t, (385.0, 400.0, 480.0, 495.0), (60.0, 6.0, 6.0, 60.0))) * KM_H,
            monitor=MotionMonitor(Settings(dead_zone_m_s=2.0, motion_sensor_moving_m_s=0.8), start=KNOWN),
            odometer=lambda t, v: 0.0 if 400.0 < t < 480.0 else v,
        ),
    }
    for name, world in cases.items():
        assert world.accusing(640.0) == {name}, name


def test_a_jump_of_the_position_is_a_finding_of_the_distance_rule_alone() -> None:
    world = known(steady(60.0))
    for _ in world.run(900.0):
        time_ns = round(world.time_s * SECOND_NS)
        world.monitor.position(time_ns, 50.0 if world.time_s < 890.0 else 50.4, 10.0)
    world.monitor.position(round(world.time_s * SECOND_NS), 50.4, 10.0)
    world.monitor.position(round((world.time_s + 1.0) * SECOND_NS), 50.4, 10.0)
    assert world.accusing(2.0) == {"distance"}


def test_a_spoofed_speed_is_accused_by_the_fast_test_within_seconds_and_by_the_rest_in_their_time() -> None:
    world = known(drives_and_stops(4, 900.0), gnss=lambda t, v: v + min(8.0, max(0.0, 0.3 * (t - 400.0))))
    first: dict[str, float] = {}
    for verdicts in world.run(900.0):
        for name in verdicts.accusing():
            first.setdefault(name, world.time_s)
    assert 400.0 < first["fast"] < 412.0
    assert first["fast"] < first["median"] < first["event"]
    assert first["trimmed_mean"] < first["event"]


def test_the_suspect_time_of_a_slow_drift_is_not_after_its_beginning_by_more_than_a_window() -> None:
    world = known(steady(90.0), gnss=lambda t, v: v + min(8.0, max(0.0, 0.1 * (t - 100.0))))
    for verdicts in world.run(300.0):
        if verdicts.fast.outcome is Outcome.ACCUSES:
            assert verdicts.fast.suspect_since_ns is not None
            assert 90.0 < verdicts.fast.suspect_since_ns / SECOND_NS < 110.0
            assert verdicts.fast.accused == ("gnss", "odometer")
            return
    raise AssertionError("the drift was not detected")


def test_the_scale_before_a_step_stays_the_reference() -> None:
    world = World(steady(80.0), odometer=lambda t, v: v * (1.0 if t < 600.0 else 1.03))
    world.after(1200.0)
    assert world.monitor.calibration.calibration.scale == pytest.approx(1.0, abs=0.004)
    assert "scale_step" in world.accusing(10.0)


def test_no_fix_makes_a_verdict_not_evaluated_and_never_a_conflict() -> None:
    world = known(steady(90.0), gnss=lambda t, v: None if 350.0 <= t < 600.0 else v)
    assert world.after(350.0).trimmed_mean.outcome is Outcome.PASS
    assert world.accusing(249.0) == set()
    verdicts = world.after(1.0)
    assert verdicts.trimmed_mean.outcome is Outcome.NOT_EVALUATED
    assert verdicts.trimmed_mean.why.code == Code.INPUT_SILENT and verdicts.trimmed_mean.why.values["age_s"] == 250
    assert verdicts.fast.outcome is Outcome.NOT_EVALUATED
    assert verdicts.trimmed_mean.since_ns == pytest.approx(365 * SECOND_NS, abs=2 * SECOND_NS)


def test_a_silent_odometer_makes_every_comparison_not_evaluated() -> None:
    world = known(steady(90.0))
    world.after(400.0)
    verdicts = world.monitor.verdicts(420 * SECOND_NS)
    assert verdicts.accusing() == ()
    assert verdicts.median.outcome is Outcome.NOT_EVALUATED


def test_a_speed_held_for_ten_seconds_after_a_loss_is_not_used() -> None:
    def speed(time_s: float) -> float:
        return max(10.0, 25.0 - max(0.0, time_s - 400.0))  # brakes in a tunnel

    frozen: list[float] = []

    def receiver(time_s: float, measured: float) -> float | None:
        if time_s < 398.0:
            return measured
        frozen.append(measured)
        return frozen[0] if time_s < 409.0 else None

    world = known(speed, gnss=receiver)
    world.after(405.0)
    since_ns = world.monitor.held.since_ns
    assert since_ns is not None
    assert all(stamp < since_ns for queue in (world.monitor._pending, world.monitor._window) for stamp, *_ in queue)
    for verdicts in world.run(100.0):
        assert verdicts.fast.outcome is not Outcome.ACCUSES
        assert verdicts.held_speed.outcome is not Outcome.ACCUSES
    assert max(world.monitor.raw.differences) < 2.0 * KM_H


def test_a_steady_receiver_at_steady_speed_is_not_taken_for_a_held_one() -> None:
    world = known(lambda _: 25.0, gnss=lambda _, v: round(v))
    for verdicts in world.run(300.0):
        assert verdicts.held_speed.outcome is Outcome.PASS or world.time_s < 2.0
    assert world.monitor.held.since_ns is None


def test_a_wall_window_is_incomplete_after_a_loss_and_complete_again_after_five_minutes() -> None:
    monitor = MotionMonitor(Settings(window=WindowMode.WALL), start=KNOWN)
    world = World(steady(90.0), monitor=monitor, gnss=lambda t, v: None if 400.0 <= t < 430.0 else v)
    assert world.after(390.0).trimmed_mean.outcome is Outcome.PASS
    verdicts = world.after(60.0)
    assert verdicts.trimmed_mean.outcome is Outcome.NOT_EVALUATED
    assert verdicts.trimmed_mean.why == explain(Code.WARMING_UP, samples_count=27, needed_count=30)
    assert world.after(300.0).trimmed_mean.outcome is Outcome.PASS


@pytest.mark.parametrize("bad", [nan, inf, -0.1, 151.0])
def test_implausible_gnss_speeds_are_rejected_and_counted(bad: float) -> None:
    monitor = MotionMonitor()
    monitor.gnss(SECOND_NS, bad, 0.1)
    assert sum(monitor.rejected.values()) == 1


def test_obd_255_km_h_and_stamps_that_go_back_are_rejected_and_counted() -> None:
    monitor = MotionMonitor()
    monitor.odometer(SECOND_NS, 255.0 * KM_H)
    monitor.odometer(SECOND_NS, 254.0 * KM_H)
    monitor.odometer(SECOND_NS, 100.0 * KM_H)
    monitor.gnss(SECOND_NS, 10.0)
    monitor.gnss(SECOND_NS // 2, 10.0)
    monitor.gnss(2 * SECOND_NS, 10.0, nan)
    monitor.odometer(2 * SECOND_NS, 10.0, 9.0)
    monitor.position(SECOND_NS, nan, 0.0)
    assert dict(monitor.rejected) == {
        "odometer: speed is not within 0 to 71 m/s": 1,
        "odometer: stamp is not after the one before": 1,
        "gnss: stamp is not after the one before": 1,
        "gnss: accuracy is not a positive number": 1,
        "odometer: resolution is not within 0 to 3 m/s": 1,
        "gnss: position is outside the Earth's coordinates": 1,
    }


def test_a_silence_of_a_day_is_closed_in_one_step_and_leaves_the_moving_window_as_it_is() -> None:
    world = known(steady(90.0))
    world.after(400.0)
    before = list(world.monitor.raw.slots)
    verdicts = world.monitor.verdicts(100_000 * SECOND_NS)
    assert list(world.monitor.raw.slots) == before
    assert verdicts.accusing() == ()


def test_speeds_of_both_at_the_same_instants_are_a_sample_every_ten_seconds_whichever_comes_first() -> None:
    for gnss_first in (True, False):
        comparison = SpeedComparison()
        for second in range(0, 600, 10):
            time_ns = second * SECOND_NS
            if gnss_first:
                comparison.gnss(time_ns, 20.0, 0.1)
            comparison.odometer(time_ns, 20.0)
            if not gnss_first:
                comparison.gnss(time_ns, 20.0, 0.1)
        comparison.advance(601 * SECOND_NS)
        assert [value for _, value in comparison.raw.slots] == SAMPLES * [0.0], gnss_first
