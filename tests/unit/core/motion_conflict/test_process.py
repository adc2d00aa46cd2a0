from collections.abc import Iterator
from dataclasses import replace
from math import pi, sin

import numpy as np
import pytest

from services.core.motion_conflict.codes import Code
from services.core.motion_conflict.process import Config, Out, Process, forbids_learning
from services.sensors.simulator.drive import Drive, simulate
from shared.messages.base import Tick
from shared.messages.explanation import explain
from shared.messages.gnss import FixType, GnssFix
from shared.messages.trust import LearnedScale, Outcome, TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import VehicleFile
from shared.trust.inputs import Input
from tests.support.drives.spoofing import inputs

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
            last |= {
                trust_monitor.monitor: trust_monitor
                for trust_monitor in process.handle(message)
                if isinstance(trust_monitor, TrustMonitor)
            }
    return last


def test_three_statements_are_published_with_each_tick_and_nothing_between() -> None:
    process = Process(Config())
    assert list(process.handle(fix(SECOND_NS, 10.0))) == []
    statements = list(process.handle(Tick(now_ns=SECOND_NS)))
    assert [statement.monitor for statement in statements if isinstance(statement, TrustMonitor)] == [
        "motion",
        "motion_fast",
        "coherent_scale",
    ]
    assert all(
        statement.outcome is Outcome.NOT_EVALUATED for statement in statements if isinstance(statement, TrustMonitor)
    )


def test_equal_speeds_pass_once_the_window_of_thirty_samples_is_full() -> None:
    last = drive(Process(Config()), range(1, 331), 10.0, 10.0)
    assert last["motion"].outcome is Outcome.PASS
    tests = {test.name: test for test in last["motion"].tests}
    assert tests["trimmed_mean"].statistic is not None
    assert tests["trimmed_mean"].statistic < 1.0 * KM_H


def test_a_difference_above_ten_km_h_accuses_either_sensor() -> None:
    last = drive(Process(Config()), range(1, 331), 10.0, 14.0)
    assert last["motion"].outcome is Outcome.ACCUSES
    assert set(last["motion"].accused) == {"gnss", "odometer"}


def test_no_velocity_is_no_evaluation_and_never_standstill() -> None:
    last = drive(Process(Config()), range(1, 331), None, 14.0)
    assert last["motion"].outcome is Outcome.NOT_EVALUATED
    assert last["motion"].reason_code == explain(Code.NO_INPUT, input=Input.GNSS_SPEED)


def trust(level: TrustLevel, *accusing: TrustMonitor, odometer_excluded: bool = False) -> TrustState:
    return TrustState(
        sampled_ns=0, state=level, since_ns=0, row=1, reasons=("test",), alert_limit_horizontal_m=10.0,
        alert_limit_vertical_m=20.0, odometer_excluded=odometer_excluded, monitors=accusing,
    )  # fmt: skip


def accusation(monitor: str) -> TrustMonitor:
    return TrustMonitor(
        sampled_ns=0, monitor=monitor, outcome=Outcome.ACCUSES, reason="test", accused=("gnss", "odometer")
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
            last |= {
                trust_monitor.monitor: trust_monitor
                for trust_monitor in process.handle(message)
                if isinstance(trust_monitor, TrustMonitor)
            }
    assert last["motion"].outcome is Outcome.NOT_EVALUATED
    assert last["motion"].reason_code == explain(Code.NO_INPUT, input=Input.GNSS_SPEED)


@pytest.mark.parametrize(("level", "learned"), [(TrustLevel.CAUTION, True), (TrustLevel.UNSAFE, False)])
def test_the_delay_is_learned_unless_the_position_is_unsafe(level: TrustLevel, learned: bool) -> None:
    process = Process(Config())
    list(process.handle(trust(level)))
    last: dict[str, TrustMonitor] = {}
    for k in range(1, 400):
        speed = 12.0 + 6.0 * sin(2.0 * pi * k / 40.0)
        last = drive(process, range(k, k + 1), speed, speed) or last
    assert (last["motion_fast"].outcome is not Outcome.NOT_EVALUATED) == learned


@pytest.fixture(scope="module")
def town() -> Drive:
    return simulate("urban", 2, 720.0)


def scaled(drive: Drive, factor: float, begin_s: float) -> Drive:
    """Both speeds times a factor from a time on."""
    begin_ns = begin_s * SECOND_NS
    return replace(
        drive,
        fix_velocity_n=drive.fix_velocity_n * np.where(drive.fix_ns >= begin_ns, factor, 1.0)[:, None],
        odometer=drive.odometer * np.where(drive.odometer_ns >= begin_ns, factor, 1.0),
    )


def published(process: Process, drive: Drive) -> Iterator[Out]:
    """Messages of a drive with an odometer in steps of 1 km/h."""
    for message in inputs(drive, resolution_m_s=KM_H):
        yield from process.handle(message)


def test_gnss_and_odometer_scaled_alike_are_accused_by_coherent_scale_alone(town: Drive) -> None:
    last: dict[str, TrustMonitor] = {}
    for trust_monitor in published(Process(Config()), scaled(town, 1.1, 400.0)):
        last |= {trust_monitor.monitor: trust_monitor} if isinstance(trust_monitor, TrustMonitor) else {}
    assert last["motion"].outcome is last["motion_fast"].outcome is Outcome.PASS
    found = last["coherent_scale"]
    assert found.outcome is Outcome.ACCUSES and found.accused == ("gnss", "odometer")
    assert found.suspect_since_ns is not None and found.suspect_since_ns < 400 * SECOND_NS < (found.since_ns or 0)
    assert found.statistic is not None and found.threshold is not None and found.statistic > found.threshold


def test_what_bends_have_taught_is_published_and_used_by_the_next_drive(town: Drive) -> None:
    process = Process(Config())
    lessons = [learned_scale for learned_scale in published(process, town) if isinstance(learned_scale, LearnedScale)]
    assert lessons and lessons[-1].imu == "imu0"
    assert lessons[-1].gnss == pytest.approx(1.0, abs=0.015) and lessons[-1].gnss_sd < 0.01
    after = Process(Config())
    list(after.handle(lessons[-1]))
    outcomes = [
        trust_monitor.outcome for trust_monitor in published(after, scaled(town, 1.06, 0.0))
        if isinstance(trust_monitor, TrustMonitor) and trust_monitor.monitor == "coherent_scale"
    ]  # fmt: skip
    assert outcomes[-1] is Outcome.ACCUSES, "6 % from the first second on"
    other = Process(Config())
    list(other.handle(lessons[-1].model_copy(update={"imu": "another"})))
    assert not [
        trust_monitor
        for trust_monitor in published(other, town)
        if isinstance(trust_monitor, TrustMonitor) and "odometer" in trust_monitor.accused
    ]
    assert other.rejects["learned scale of another IMU"] == 1


def test_delay_and_odometer_are_those_of_fusion() -> None:
    tables = {"core.fusion": {"gnss": {"delay_s": 0.1, "velocity_delay_s": 0.125}, "odometer": {"enabled": False}}}
    config = VehicleFile("car.toml", "", tables).section("core.motion_conflict", Config)
    assert config.velocity_delay_s == pytest.approx(0.225)
    assert not config.odometer
