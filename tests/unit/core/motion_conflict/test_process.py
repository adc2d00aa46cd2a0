from math import pi, sin

import pytest

from services.core.motion_conflict.process import Config, Process, forbids_learning
from shared.messages.base import Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.trust import MonitorOutcome, TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed

SECOND_NS = 1_000_000_000
KM_H = 1.0 / 3.6


def fix(time_ns: int, speed_m_s: float | None) -> GnssFix:
    velocity = None if speed_m_s is None else (speed_m_s, 0.0, 0.0)
    return GnssFix(
        sampled_ns=time_ns, received_ns=time_ns, source="gnss0", fix_type=FixType.THREE_D, velocity_ned_m_s=velocity,
        velocity_sd_ned_m_s=(0.1, 0.1, 0.2), latitude_deg=45.0 + 1e-6 * time_ns / SECOND_NS, longitude_deg=9.0,
    )  # fmt: skip


def odometer(time_ns: int, speed_m_s: float) -> VehicleSpeed:
    rounded = round(speed_m_s / KM_H) * KM_H
    return VehicleSpeed(sampled_ns=time_ns, received_ns=time_ns, source="can0", speed_m_s=rounded, resolution_m_s=KM_H)


def drive(process: Process, seconds: range, gnss_m_s: float | None, odometer_m_s: float) -> dict[str, TrustMonitor]:
    """Drive at constant speeds; give the last statement of each monitor."""
    last: dict[str, TrustMonitor] = {}
    for k in seconds:
        for message in (
            fix(k * SECOND_NS, gnss_m_s),
            odometer(k * SECOND_NS, odometer_m_s),
            Tick(now_ns=k * SECOND_NS),
        ):
            last |= {statement.monitor: statement for statement in process.handle(message)}
    return last


def test_three_statements_are_published_with_each_tick_and_nothing_between() -> None:
    process = Process(Config())
    assert list(process.handle(fix(SECOND_NS, 10.0))) == []
    statements = list(process.handle(Tick(now_ns=SECOND_NS)))
    assert [statement.monitor for statement in statements] == ["motion", "motion_fast", "coherent_scale"]
    assert all(statement.outcome is MonitorOutcome.NOT_EVALUATED for statement in statements)


def test_equal_speeds_pass_once_the_window_of_thirty_samples_is_full() -> None:
    last = drive(Process(Config()), range(1, 331), 10.0, 10.0)
    assert last["motion"].outcome is MonitorOutcome.PASS
    tests = {test.name: test for test in last["motion"].tests}
    assert tests["trimmed_mean"].statistic is not None
    assert tests["trimmed_mean"].statistic < 1.0 * KM_H


def test_a_difference_above_ten_km_h_accuses_either_sensor() -> None:
    last = drive(Process(Config()), range(1, 331), 10.0, 14.0)
    assert last["motion"].outcome is MonitorOutcome.ACCUSES
    assert set(last["motion"].accused) == {"gnss", "odometer"}


def test_no_velocity_is_no_evaluation_and_never_standstill() -> None:
    last = drive(Process(Config()), range(1, 331), None, 14.0)
    assert last["motion"].outcome is MonitorOutcome.NOT_EVALUATED
    assert "no GNSS speed" in last["motion"].reason


def trust(level: TrustLevel, *accusing: TrustMonitor, odometer_excluded: bool = False) -> TrustState:
    return TrustState(
        sampled_ns=0, state=level, since_ns=0, row=1, reasons=("test",), alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=20.0, odometer_excluded=odometer_excluded, monitors=accusing,
    )  # fmt: skip


def accusation(monitor: str) -> TrustMonitor:
    return TrustMonitor(
        sampled_ns=0, monitor=monitor, outcome=MonitorOutcome.ACCUSES, reason="test", accused=("gnss", "odometer")
    )


def test_nothing_is_learned_while_a_speed_may_be_wrong() -> None:
    assert not forbids_learning(trust(TrustLevel.SAFE)) and not forbids_learning(trust(TrustLevel.CAUTION))
    assert all(
        forbids_learning(trust(level)) for level in (TrustLevel.UNSAFE, TrustLevel.DEAD_RECKONING, TrustLevel.NO_FIX)
    )
    assert forbids_learning(trust(TrustLevel.CAUTION, odometer_excluded=True))
    assert forbids_learning(trust(TrustLevel.CAUTION, accusation("evidence")))
    assert not forbids_learning(trust(TrustLevel.CAUTION, accusation("motion"))), "its own, of a change of scale"


@pytest.mark.parametrize("fix_type", [FixType.NONE, FixType.TIME_ONLY, FixType.DEAD_RECKONING])
def test_a_fix_without_satellites_is_no_speed_whatever_it_reports(fix_type: FixType) -> None:
    process = Process(Config())
    last: dict[str, TrustMonitor] = {}
    for k in range(1, 331):
        reported = fix(k * SECOND_NS, 0.0).model_copy(update={"fix_type": fix_type})
        for message in (reported, odometer(k * SECOND_NS, 14.0), Tick(now_ns=k * SECOND_NS)):
            last |= {statement.monitor: statement for statement in process.handle(message)}
    assert last["motion"].outcome is MonitorOutcome.NOT_EVALUATED
    assert "no GNSS speed" in last["motion"].reason


@pytest.mark.parametrize(("level", "learned"), [(TrustLevel.CAUTION, True), (TrustLevel.UNSAFE, False)])
def test_the_delay_is_learned_unless_the_position_is_unsafe(level: TrustLevel, learned: bool) -> None:
    process = Process(Config())
    list(process.handle(trust(level)))
    last: dict[str, TrustMonitor] = {}
    for k in range(1, 400):
        speed = 12.0 + 6.0 * sin(2.0 * pi * k / 40.0)
        last = drive(process, range(k, k + 1), speed, speed) or last
    assert (last["motion_fast"].outcome is not MonitorOutcome.NOT_EVALUATED) == learned
