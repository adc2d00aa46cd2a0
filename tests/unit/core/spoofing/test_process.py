"""The process on simulated drives: clean ones, drag-off, missing inputs and bad input."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.core.fusion.process import Config as FusionConfig
from services.core.fusion.process import Process as Fusion
from services.core.spoofing.codes import Code
from services.core.spoofing.inertial import propagation
from services.core.spoofing.inertial.anchors import filter_anchor_of
from services.core.spoofing.process import Config, Process, velocity_of
from services.core.spoofing.windows.metrics import Metric
from services.core.spoofing.windows.position_step import FALSE_ALARM_RATE, NAME
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.rotation import ned_from_body
from shared.messages.base import Tick
from shared.messages.explanation import explain
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import FilterState, NavigationPhase, NavigationSolution
from shared.messages.operation import ProcessLoad, Work
from shared.messages.trust import Outcome, TrustMonitor
from shared.messages.vehicle import VehicleSpeed
from shared.trust.inputs import Input as Compared
from tests.support.drives.spoofing import GRADED, Input, Result, drag_off, inputs, monitored, run

BEGIN_S, END_S = 75.0, 120.0
SHORT, LONG = "inertial_short", "inertial_long"


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 1, END_S)


@pytest.fixture(scope="module")
def fused(drive: Drive) -> list[NavigationSolution | FilterState]:
    """What core.fusion publishes of the drive for the monitors."""
    fusion = Fusion(FusionConfig().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))
    found = (s for m in inputs(drive) if not isinstance(m, Tick) for s in fusion.handle(m))
    return [s for s in found if isinstance(s, NavigationSolution | FilterState)]


def test_the_covariance_of_an_anchor_is_that_of_its_errors(
    drive: Drive, fused: list[NavigationSolution | FilterState]
) -> None:
    """Velocity, attitude and biases of fusion's filter, with their correlations: the normalised error squared."""
    states = [s for s in fused if isinstance(s, FilterState) and s.sampled_ns > 40e9]
    bias_f, bias_w = (
        (drive.force_b - drive.ideal_force_b).mean(axis=0),
        (drive.rate_b - drive.ideal_rate_b).mean(axis=0),
    )
    squares = []
    for state in states:
        anchor = filter_anchor_of(state)
        assert anchor.mounting == pytest.approx([1.0, 0.0, 0.0], abs=0.01)
        motion = anchor.state
        k = int(np.searchsorted(drive.t_ns, anchor.time_ns))
        turn = ned_from_body(*drive.attitude[k].tolist()) @ propagation.matrices(motion[propagation.QUATERNION]).T
        error = np.r_[
            drive.velocity_n[k] - motion[propagation.VELOCITY], Rotation.from_matrix(turn).as_rotvec(),
            bias_f - motion[propagation.ACCELEROMETER_BIAS], bias_w - motion[propagation.GYROSCOPE_BIAS],
        ]  # fmt: skip
        squares.append(error @ np.linalg.solve(anchor.covariance[:12, :12], error))
    assert len(squares) > 70 and 4.0 < np.mean(squares) < 30.0, "12 expected, of errors that last for the whole drive"


def test_a_filter_state_of_another_layout_is_rejected_and_counted(
    fused: list[NavigationSolution | FilterState],
) -> None:
    state = next(s for s in fused if isinstance(s, FilterState))
    process = Process(GRADED)
    for damaged in ({"covariance": state.covariance[:-1]}, {"covariance": (1.0, 0.0, 1.0)}, {"parameters": (0.0,)}):
        assert not list(process.handle(state.model_copy(update=damaged)))
    assert process.rejects == {"filter state of another layout": 3}


@pytest.fixture(scope="module")
def clean(drive: Drive) -> Result:
    return monitored(drive)


def test_a_clean_drive_passes_both_monitors_and_accuses_nobody(clean: Result) -> None:
    assert clean.episodes(SHORT) == clean.episodes(LONG) == 0
    for monitor in (SHORT, LONG):
        later = [s for s in clean.statements[monitor] if s.sampled_ns > 60e9]
        assert {s.outcome for s in later} == {Outcome.PASS}
        assert all(s.accused == () and s.suspect_since_ns is None for s in later)
    assert not clean.process.rejects


def test_there_is_one_statement_of_each_monitor_a_second_with_all_tests(clean: Result) -> None:
    short, long = clean.statements[SHORT][-1], clean.statements[LONG][-1]
    assert [s.sampled_ns for s in clean.statements[SHORT]] == [k * 10**9 for k in range(1, 121)]
    assert {test.name for test in short.tests} == {metric.value for metric in Metric} | {NAME}
    assert [(test.name, test.window_s) for test in long.tests] == [
        ("long_30", 30.0), ("long_60", 60.0), ("way_60", 60.0), ("way_120", 120.0),
    ]  # fmt: skip
    assert all(test.outcome is Outcome.PASS for test in long.tests if test.window_s != 120.0), "the drive is short"
    assert short.window_s == 5.0
    for test in short.tests:
        expected = FALSE_ALARM_RATE if test.name == NAME else Config().profile.false_alarm_rate
        assert test.false_alarm_rate == expected
    assert long.false_alarm_rate == Config().long.false_alarm_rate
    assert long.statistic is not None and long.threshold is not None and long.statistic < long.threshold


def test_at_standstill_accelerations_are_compared_and_the_heading_rate_is_not(clean: Result) -> None:
    still = [w for w in clean.windows if max(w.speed_m_s) < 0.5]
    assert len(still) > 5
    for window in still:
        assert Metric.ACCELERATION_EAST in window.difference and Metric.ALTITUDE_RATE in window.difference
        assert window.missing[Metric.HEADING_RATE] == explain(Code.TOO_SLOW, limit_m_s=1.0)


@pytest.fixture(scope="module")
def dragged(drive: Drive) -> Result:
    """0.3 m/s2 up to 3 m/s."""
    return monitored(drag_off(drive, BEGIN_S, 0.3, 3.0))


def test_a_drag_off_of_0_3_m_s2_is_accused_by_the_long_window_from_before_it_began(dragged: Result) -> None:
    assert_accused_from_before(dragged, 15.0)


def test_a_drag_off_of_0_1_m_s2_is_accused_by_the_long_window_from_before_it_began(drive: Drive) -> None:
    assert_accused_from_before(monitored(drag_off(drive, BEGIN_S, 0.1, 1.0)), 30.0)


def assert_accused_from_before(result: Result, within_s: float) -> None:
    first_s = result.first_s(LONG)
    assert first_s is not None and BEGIN_S < first_s <= BEGIN_S + within_s
    accusing = [s for s in result.statements[LONG] if s.outcome is Outcome.ACCUSES]
    for statement in accusing:
        assert statement.accused in (("gnss",), ("gnss", "imu")) and statement.suspect_since_ns is not None
        assert BEGIN_S - 60.0 < statement.suspect_since_ns / 1e9 <= BEGIN_S, "earlier than the attack"
        assert statement.since_ns == first_s * 1e9
    assert accusing[-1].sampled_ns == END_S * 1e9, "the anchors are kept from before the suspect time"


def test_a_drag_off_of_0_3_m_s2_is_accused_by_the_short_window_as_well(dragged: Result) -> None:
    first_s = dragged.first_s(SHORT)
    assert first_s is not None and first_s <= BEGIN_S + 10.0


def test_a_velocity_that_steps_is_accused_by_the_short_window_within_seconds(drive: Drive) -> None:
    stepped = drive.fix_velocity_n + np.where(drive.fix_ns > BEGIN_S * 1e9, 1.0, 0.0)[:, None] * [0.0, 0.0, -1.0]
    result = monitored(replace(drive, fix_velocity_n=stepped))
    first_s = result.first_s(SHORT)
    assert first_s is not None and first_s <= BEGIN_S + 4.0
    up = next(t for t in result.statements[SHORT][int(first_s) - 1].tests if t.name == "acceleration_up")
    assert up.outcome is Outcome.ACCUSES


def outcomes(statements: list[TrustMonitor], after_s: float) -> set[Outcome]:
    return {s.outcome for s in statements if s.sampled_ns > after_s * 1e9}


def without(drive: Drive, kind: type, after_s: float, end_s: float, until_s: float = 1e9) -> Result:
    """Both processes on a drive whose messages of a kind end, or have a gap."""
    fusion = Fusion(FusionConfig().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))
    process = Process(GRADED.with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))

    def kept() -> Iterator[Input]:
        now_ns = 0
        for message in inputs(drive):
            now_ns = message.now_ns if isinstance(message, Tick) else message.received_ns
            if now_ns > end_s * 1e9:
                return
            if not after_s * 1e9 < now_ns <= until_s * 1e9 or not isinstance(message, kind):
                yield message

    return run(fusion, process, kept())


@pytest.mark.parametrize(("kind", "name"), [(ImuSamples, Compared.INERTIAL_SAMPLES), (GnssFix, Compared.GNSS_VELOCITY)])
def test_without_an_input_nothing_is_evaluated_and_the_reason_names_it(
    drive: Drive, kind: type, name: Compared
) -> None:
    result = without(drive, kind, 75.0, 95.0)
    for monitor in (SHORT, LONG):
        assert outcomes(result.statements[monitor], 80.0) == {Outcome.NOT_EVALUATED}
        why = result.statements[monitor][-1].reason_code
        assert why is not None and (why.code, why.values["input"]) == (Code.INPUT_SILENT, name)
        assert isinstance(why.values["age_s"], int) and why.values["age_s"] > 10
        assert result.episodes(monitor) == 0


@pytest.mark.parametrize(("kind", "gap_s"), [(GnssFix, 8.0), (ImuSamples, 0.8)])
def test_over_a_short_gap_the_long_windows_go_on(drive: Drive, kind: type, gap_s: float) -> None:
    result = without(drive, kind, 85.0, 100.0, 85.0 + gap_s)
    assert outcomes(result.statements[LONG], 85.0 + gap_s + 4.0) == {Outcome.PASS}, "not 30 s later"
    assert result.episodes(LONG) == result.episodes(SHORT) == 0


def test_without_odometer_and_after_it_ends_both_monitors_go_on(drive: Drive) -> None:
    result = without(drive, VehicleSpeed, 70.0, 110.0)
    assert outcomes(result.statements[SHORT], 75.0) == outcomes(result.statements[LONG], 75.0) == {Outcome.PASS}


def test_without_a_heading_nothing_is_evaluated() -> None:
    process = Process(GRADED)
    found = [s for s in process.handle(Tick(now_ns=10**9)) if isinstance(s, TrustMonitor)]
    assert [s.monitor for s in found] == [SHORT, LONG, "gyroscope", "drift"]
    assert {s.outcome for s in found} == {Outcome.NOT_EVALUATED}
    assert (
        found[0].reason_code == explain(Code.NO_INPUT, input=Compared.INERTIAL_SAMPLES) and found[0].statistic is None
    )
    standing = simulate("urban", 1, 15.0)  # fusion gets its heading when the vehicle drives
    last = monitored(standing).statements
    assert all(last[m][-1].reason_code == explain(Code.NO_INPUT, input=Compared.ATTITUDE) for m in (SHORT, LONG))
    waiting = NavigationSolution.model_construct(phase=NavigationPhase.WAITING_FOR_HEADING)
    assert list(process.handle(waiting)) == []


def test_bad_input_is_counted_and_changes_no_outcome(
    drive: Drive, clean: Result, fused: list[NavigationSolution | FilterState]
) -> None:
    def spoiled() -> Iterator[Input]:
        for message in inputs(drive):
            yield message
            now_ns = message.now_ns if isinstance(message, Tick) else message.received_ns
            if isinstance(message, GnssFix) and now_ns % (10 * 10**9) == 0:
                later = {"sampled_ns": now_ns + 1, "received_ns": now_ns + 1}
                yield message  # repeated
                yield message.model_copy(update={**later, "velocity_ned_m_s": None})
                yield message.model_copy(update={"sampled_ns": now_ns + 2, "velocity_ned_m_s": (1e6, 0.0, 0.0)})
                inaccurate = {"sampled_ns": now_ns + 3, "velocity_sd_ned_m_s": (50.0, 50.0, 50.0)}
                yield message.model_copy(update=inaccurate)
                yield message.model_copy(update={**later, "source": "gnss1", "velocity_ned_m_s": (9.0, 9.0, 9.0)})
                speed = VehicleSpeed(sampled_ns=now_ns + 1, received_ns=now_ns, source="can0", speed_m_s=255 / 3.6)
                yield speed
                yield speed.model_copy(update={"sampled_ns": 5, "speed_m_s": 3.0})
            if isinstance(message, ImuSamples) and now_ns % (10 * 10**9) == 0:
                yield message  # repeated
                yield message.model_copy(update={"specific_force_body_m_s2": ((1e9, 0.0, 0.0),) * 10})
                yield message.model_copy(update={"saturated": True})

    process = Process(GRADED.with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))
    # Only the monitors get what is bad: fusion has its own tests of it.
    queue = iter(sorted(fused, key=lambda s: s.sampled_ns))
    following = next(queue, None)
    statements: dict[str, list[TrustMonitor]] = {}
    for message in spoiled():
        now_ns = message.now_ns if isinstance(message, Tick) else message.received_ns
        while following is not None and following.sampled_ns <= now_ns:
            list(process.handle(following))
            following = next(queue, None)
        for statement in process.handle(message):
            assert isinstance(statement, TrustMonitor)
            statements.setdefault(statement.monitor, []).append(statement)
    for monitor in (SHORT, LONG, "gyroscope", "drift"):
        assert [s.outcome for s in statements[monitor]] == [s.outcome for s in clean.statements[monitor]]
    assert process.rejects == {
        "gnss: stamp is not after the one before": 12,
        "gnss: speed is above 150 m/s": 12,
        "GnssFix of a second source": 12,
        "odometer: speed is not within 0 to 254 km/h": 12,
        "odometer: stamp is not after the one before": 12,
        "imu: stamp is not after the one before": 120,
        "imu: value is beyond every sensor's range": 120,
        "imu: saturated": 12,
    }


def test_the_monitors_start_again_with_a_time_line_that_starts_again() -> None:
    short = simulate("parking_lot", 2, 60.0)
    process = Process(GRADED.with_values({"vehicle.gnss.lever_arm_body_m": short.lever_arm_b}))
    for _ in range(2):
        fusion = Fusion(FusionConfig().with_values({"vehicle.gnss.lever_arm_body_m": short.lever_arm_b}))
        result = run(fusion, process, inputs(short))
        assert result.statements[SHORT][-1].outcome is Outcome.PASS
    assert process.rejects == {"time line started again": 1}


def test_speed_and_course_are_a_velocity_of_unknown_vertical_part() -> None:
    fix = GnssFix(sampled_ns=1, received_ns=1, source="phone0", fix_type=FixType.THREE_D, ground_speed_m_s=10.0,
                  course_rad=np.pi / 6.0)  # fmt: skip
    velocity, sd = velocity_of(fix)
    assert velocity == pytest.approx((10.0 * np.cos(np.pi / 6.0), 5.0, 0.0)) and sd == (0.0, 0.0, 10.0)
    assert velocity_of(fix.model_copy(update={"course_rad": None})) == (None, None)
    assert velocity_of(fix.model_copy(update={"fix_type": FixType.NONE})) == (None, None)


def test_both_monitors_work_with_speed_and_course_alone_and_accuse_a_drag_off(drive: Drive) -> None:
    def horizontal() -> Iterator[Input]:
        for message in inputs(drag_off(drive, BEGIN_S, 0.3, 3.0)):
            if isinstance(message, GnssFix) and message.velocity_ned_m_s is not None:
                north, east, _ = message.velocity_ned_m_s
                update = {"velocity_ned_m_s": None, "velocity_sd_ned_m_s": None, "course_rad": np.arctan2(east, north),
                          "ground_speed_m_s": float(np.hypot(north, east))}  # fmt: skip
                yield message.model_copy(update=update)
            else:
                yield message

    fusion = Fusion(FusionConfig().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))
    process = Process(GRADED.with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b}))
    result = run(fusion, process, horizontal())
    for monitor in (SHORT, LONG):
        assert result.share(monitor, Outcome.PASS) > 0.2
    first_s = [result.first_s(monitor) for monitor in (SHORT, LONG)]
    assert any(time_s is not None and BEGIN_S < time_s <= BEGIN_S + 30.0 for time_s in first_s)
    early = [s for m in (SHORT, LONG) for s in result.statements[m] if s.sampled_ns < BEGIN_S * 1e9]
    assert all(statement.outcome is not Outcome.ACCUSES for statement in early)


def test_a_position_that_steps_aside_with_the_velocity_of_the_vehicle_is_accused_within_three_seconds() -> None:
    begin_s, drive = 38.0, simulate("urban", 1, 44.0)
    moved = drive.fix_position.copy()
    moved[drive.fix_ns > begin_s * 1e9, 0] += 100.0 / 6.37e6
    result = monitored(replace(drive, fix_position=moved))
    first_s = result.first_s(SHORT)
    assert first_s is not None and begin_s < first_s <= begin_s + 3.0
    accusing = [s for s in result.statements[SHORT] if s.outcome is Outcome.ACCUSES]
    assert all(test.name == NAME for s in accusing for test in s.tests if test.outcome is s.outcome)
    assert all(s.suspect_since_ns is not None and s.suspect_since_ns <= begin_s * 1e9 for s in accusing)


def test_a_paused_process_evaluates_nothing_says_so_and_begins_again(drive: Drive) -> None:
    process, now_ns = Process(GRADED), 1_000_000_000
    told = ProcessLoad(sampled_ns=now_ns, process="core.fusion", lag_s=0.7, paused=(Work.INERTIAL_WINDOWS,))
    assert not list(process.handle(told))
    for message in inputs(drive):
        if isinstance(message, ImuSamples | GnssFix):
            list(process.handle(message))
    stated = [
        trust_monitor
        for trust_monitor in process.handle(Tick(now_ns=now_ns))
        if isinstance(trust_monitor, TrustMonitor)
    ]
    assert {trust_monitor.monitor for trust_monitor in stated} == {SHORT, LONG, "gyroscope", "drift"}
    assert all(trust_monitor.outcome is Outcome.NOT_EVALUATED for trust_monitor in stated)
    assert all(trust_monitor.reason_code == explain(Code.PAUSED) for trust_monitor in stated)
    assert not process.monitor.taken and not process._newest_ns
    monitor = process.monitor
    list(process.handle(told.model_copy(update={"paused": ()})))
    assert process.monitor is not monitor, "what was before the pause is not compared with what follows"
