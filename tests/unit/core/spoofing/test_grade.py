"""Grades and what a vehicle teaches: thresholds before and after, warm-up, and what is never learned."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from services.core.spoofing.codes import Code
from services.core.spoofing.grade import LONG, Grade, profile_of
from services.core.spoofing.lesson import NEEDED_S, WindowCollection, profile_of_learned
from services.core.spoofing.process import Config, Process
from services.core.spoofing.profile import UNIT_IMU, Origin
from services.core.spoofing.windows.metrics import Metric
from services.core.spoofing.windows.short_window import Window
from services.sensors.simulator.drive import Drive, simulate
from shared.messages.explanation import explain
from shared.messages.trust import LearnedGrade, Outcome, TrustLevel, TrustMonitor, TrustState
from shared.runtime.config import load_vehicle
from tests.support.drives.spoofing import GRADED, SECOND_NS, Fused, fused, process_of, watched

ORIGIN = Origin(imu="imu0", gnss="gnss0", imu_rate_hz=100.0, gnss_rate_hz=1.0, configuration="c", code="", drives=())
LEARNED = LearnedGrade(
    sampled_ns=SECOND_NS, imu="imu0", gnss="gnss0", imu_rate_hz=100.0, gnss_rate_hz=1.0, configuration="c", windows=900,
    metrics=("acceleration_east",), sigma=((0.02, 0.02, 0.03, 0.04),), threshold=6.5, long_factor=1.4,
    false_alarm_rate=1e-3,
)  # fmt: skip


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 1, 110.0)


@pytest.fixture(scope="module")
def received(drive: Drive) -> list[Fused]:
    return list(fused(drive))


def window(k: int) -> Window:
    return Window(k * SECOND_NS, (k + 5) * SECOND_NS, {Metric.ACCELERATION_EAST: 0.01 * (-1) ** k}, force_m_s2=0.1)


def state(*passing: str, accusing: Sequence[str] = (), suspect_ns: int | None = None) -> TrustState:
    outcomes = {**dict.fromkeys(passing, Outcome.PASS), **dict.fromkeys(accusing, Outcome.ACCUSES)}
    return TrustState(
        sampled_ns=0, state=TrustLevel.SAFE, since_ns=0, row=14, reasons=(), alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=20.0, suspect_since_ns=suspect_ns,
        monitors=tuple(TrustMonitor(sampled_ns=0, monitor=m, outcome=o, reason="") for m, o in outcomes.items()),
    )  # fmt: skip


def taught(verdict: TrustState, windows: int) -> WindowCollection:
    lesson = WindowCollection(UNIT_IMU)
    for k in range(windows):
        lesson.heed(verdict.model_copy(update={"sampled_ns": k * SECOND_NS}))
        lesson.add(k * SECOND_NS, window(k), [0.1])
    return lesson


def test_a_stated_grade_sets_profile_and_propagation_and_larger_noise_of_fusion_stands(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(
        '[core.spoofing]\ngrade = "consumer"\n\n[core.fusion.imu]\nvelocity_random_walk_m_s_sqrt_s = 0.05\n'
    )
    config = load_vehicle(path).section("core.spoofing", Config)
    assert config.profile == profile_of(Grade.CONSUMER)
    assert config.long.gyroscope_scale_sd == LONG[Grade.CONSUMER]["gyroscope_scale_sd"]
    assert config.long.velocity_random_walk_m_s_sqrt_s == 0.05


def test_without_grade_or_profile_nothing_is_evaluated_and_the_reason_says_what_is_missing(
    drive: Drive, received: list[Fused]
) -> None:
    result = watched(process_of(drive, Config(warm_up_s=0.0)), received)
    for monitor in ("inertial_short", "inertial_long"):
        last = result.statements[monitor][-1]
        assert last.outcome is Outcome.NOT_EVALUATED and last.reason_code is not None
        assert last.reason_code == explain(Code.LEARNING_UNVOUCHED, learned_s=0, needed_s=NEEDED_S)
        assert "obu calibrate spoofing" in last.reason, "what to do"


def test_free_propagations_wait_for_a_minute_after_the_alignment_and_short_windows_for_less(
    drive: Drive, received: list[Fused]
) -> None:
    result = watched(process_of(drive, GRADED.model_copy(update={"warm_up_s": 60.0})), received)
    first = {
        monitor: next(s.sampled_ns for s in result.statements[monitor] if s.outcome is Outcome.PASS) / SECOND_NS
        for monitor in ("inertial_short", "inertial_long")
    }
    immediate = watched(process_of(drive), received).statements["inertial_long"]
    begin_s = next(s.sampled_ns for s in immediate if s.outcome is Outcome.PASS) / SECOND_NS
    assert first["inertial_long"] > begin_s + 50.0
    assert first["inertial_short"] < first["inertial_long"] - 40.0


def test_ten_minutes_that_another_source_vouches_for_make_a_grade_for_the_next_start() -> None:
    lesson = taught(state("motion"), NEEDED_S)
    assert lesson.is_due(NEEDED_S * SECOND_NS) and not lesson.is_due(NEEDED_S * SECOND_NS + 1)
    found = lesson.result(NEEDED_S * SECOND_NS, ORIGIN)
    assert found.windows == NEEDED_S and found.metrics == ("acceleration_east",)
    assert profile_of_learned(found).sigma[Metric.ACCELERATION_EAST] == found.sigma[0]


@pytest.mark.parametrize(
    "verdict",
    [state(), state("inertial_short"), state("motion", accusing=["inertial_long"]), state("motion", suspect_ns=1)],
    ids=["nobody vouches", "the monitor itself", "an accusation", "an open conflict"],
)
def test_nothing_is_learned_in_doubt_or_without_a_source_that_vouches(verdict: TrustState) -> None:
    assert not taught(verdict, NEEDED_S).is_due(10 * NEEDED_S * SECOND_NS)


def test_a_slow_drag_cannot_teach_more_than_three_times_the_stated_grade() -> None:
    lesson = WindowCollection(UNIT_IMU)
    for k in range(NEEDED_S):
        lesson.heed(state("motion").model_copy(update={"sampled_ns": k * SECOND_NS}))
        lesson.add(k * SECOND_NS, replace(window(k), difference={Metric.ACCELERATION_EAST: 2.0}), [1e4])
    found = lesson.result(0, ORIGIN)
    limit = found.threshold * found.sigma[0][0]
    assert limit <= 3.0 * UNIT_IMU.threshold * UNIT_IMU.sigma[Metric.ACCELERATION_EAST][0] * 1.001
    assert found.long_factor == 3.0


def test_a_learned_grade_is_adopted_before_the_first_sample_and_not_in_the_drive_that_taught_it(
    drive: Drive, received: list[Fused]
) -> None:
    process = Process(Config())
    list(process.handle(LEARNED))
    assert process.monitor.settings.profile.threshold == LEARNED.threshold
    assert process.monitor.settings.profile.long_factor == LEARNED.long_factor
    later = watched(process_of(drive, Config(warm_up_s=0.0)), received).process
    before = later.monitor.settings.profile
    list(later.handle(LEARNED))
    assert later.monitor.settings.profile is before
