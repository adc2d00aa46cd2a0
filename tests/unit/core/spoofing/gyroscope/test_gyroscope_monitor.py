"""The gyroscope's yaw rate against wheels, GNSS course and antennas on a level drive with bends, and on a recording."""

from collections import Counter
from math import radians

import numpy as np
import pytest

from services.core.spoofing.codes import Code
from services.core.spoofing.gyroscope.monitor import GyroscopeMonitor
from shared.inertial.increments import Decimator, Increment
from shared.messages.gnss import FixType, GnssFix
from shared.messages.trust import Outcome
from shared.messages.vehicle import WheelSpeeds
from tests.support.data import recording
from tests.support.drives.yaw_rates import BIAS, INDUSTRIAL, NS, TRACK_M, Faults, Profile, driven, solution_of, town

ONSET_S = 120


def after(value: float, before: float = 0.0) -> Profile:
    """Profile that steps at the onset."""
    return lambda t: value if t > ONSET_S else before


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_drive_without_a_fault_accuses_nobody_and_learns_the_wheels(seed: int) -> None:
    run = driven(300, seed=seed)
    assert run.first() is None
    assert run.monitor.rear.track_m == pytest.approx(TRACK_M, rel=0.03)
    assert run.monitor.rear.ratio == pytest.approx(0.003, abs=2e-4)
    last = run.verdicts[-1]
    assert {test.outcome for test in last.values()} == {Outcome.PASS}
    assert all(test.statistic is not None and test.threshold is not None for test in last.values())
    assert last["yaw_rate_30"].why.code == Code.YAW_RATES
    assert last["yaw_rate_30"].why.values["sources"] == ("course", "wheels")


@pytest.mark.parametrize(("bias_deg_s", "within_s"), [(0.5, 10), (-0.5, 10), (0.1, 60)])
def test_a_bias_of_the_gyroscope_is_found_and_named(bias_deg_s: float, within_s: int) -> None:
    run = driven(ONSET_S + 70, Faults(rate=after(radians(bias_deg_s))))
    first = run.first()
    assert first is not None and ONSET_S < first <= ONSET_S + within_s
    assert run.names() <= {("imu",), ("gnss", "imu"), ("imu", "odometer")}
    assert ("imu",) in run.names() or abs(bias_deg_s) < 0.5
    since = [
        verdict.suspect_since_ns for verdict in run.verdicts[first - 1].values() if verdict.suspect_since_ns is not None
    ]
    assert since and max(since) <= ONSET_S * NS, "before the fault began"


def test_a_bias_of_0_1_deg_s_is_the_gyroscopes_when_the_vehicle_stops() -> None:
    run = driven(
        ONSET_S + 40, Faults(rate=after(radians(0.1))), speed=lambda t: 0.0 if t > ONSET_S + 20 else 12.0
    )  # fmt: skip
    assert ("imu",) in run.names()


@pytest.mark.parametrize("rate_deg_s", [0.5, -2.0])
def test_a_gnss_course_that_turns_away_is_never_blamed_on_the_gyroscope_alone(rate_deg_s: float) -> None:
    def course(t: float) -> float:
        return radians(rate_deg_s) * min(max(t - ONSET_S, 0.0), 20.0)

    run = driven(ONSET_S + 40, Faults(course=course))
    first = run.first()
    assert first is not None and ONSET_S < first <= ONSET_S + 12
    assert run.names() <= {("gnss",), ("gnss", "imu")} and ("gnss",) in run.names()


def test_a_wheel_of_another_radius_is_the_odometers() -> None:
    run = driven(ONSET_S + 20, Faults(left=after(1.01, 1.0)))
    first = run.first()
    assert first is not None and ONSET_S < first <= ONSET_S + 5
    assert run.names() <= {("odometer",), ("imu", "odometer")} and ("odometer",) in run.names()


def test_without_wheel_speeds_two_remain_and_both_are_named() -> None:
    run = driven(ONSET_S + 15, Faults(rate=after(radians(0.5)), wheels=False))
    assert run.first(ONSET_S) is not None and run.names() == {("gnss", "imu")}
    assert run.verdicts[-1]["yaw_rate_5"].why.code == Code.YAW_RATES_WITHOUT_WHEELS


def test_a_second_antenna_is_one_more_yaw_rate_by_gnss() -> None:
    run = driven(ONSET_S + 15, Faults(rate=after(radians(0.5)), wheels=False, antenna=True))
    assert run.first(ONSET_S) is not None and run.names() == {("gnss", "imu")}
    assert run.verdicts[-1]["yaw_rate_5"].why.values["sources"] == ("course", "second_antenna")


def test_until_the_wheels_are_learned_they_are_not_evaluated() -> None:
    run = driven(30)
    why = run.verdicts[-1]["yaw_rate_5"].why
    assert why.code == Code.YAW_RATES_LEARNING and why.values["track_sd_m"] == pytest.approx(0.25, abs=0.05)


def test_a_bias_that_the_filter_has_learned_and_all_agree_with_ends_the_accusation() -> None:
    shift = radians(0.5)
    run = driven(ONSET_S + 130, Faults(rate=after(shift), known=lambda t: BIAS + (shift if t > ONSET_S + 30 else 0.0)))
    assert run.accusing(ONSET_S + 60) == {("imu",)}
    assert not run.accusing(ONSET_S + 130)


def test_nothing_is_learned_from_seconds_that_a_fault_has_called_into_question() -> None:
    axle = driven(ONSET_S + 90, Faults(rate=after(radians(0.5)))).monitor.rear
    assert axle.ratio == pytest.approx(0.003, abs=2e-4), "0.5 deg/s would be 0.0011"


def test_a_vehicle_that_creeps_around_a_corner_does_not_stand() -> None:
    """Wheels and GNSS are below the limits of a standstill; the inertial sensors are at none."""

    def speed(t: float) -> float:
        return 12.0 if t < ONSET_S else 0.2

    run = driven(ONSET_S + 20, speed=speed, turn=lambda t: town(t) if t < ONSET_S else radians(2.0))
    assert run.first() is None


def test_bad_input_is_counted_and_changes_nothing() -> None:
    run = driven(60)
    monitor = run.monitor
    wheels = WheelSpeeds(
        sampled_ns=10 * NS, received_ns=10 * NS, source="can0", rear_left_m_s=1.0, rear_right_m_s=1.0
    )  # fmt: skip
    monitor.speeds(wheels)
    monitor.speeds(wheels.model_copy(update={"sampled_ns": 61 * NS, "rear_left_m_s": float("nan")}))
    monitor.speeds(wheels.model_copy(update={"sampled_ns": 61 * NS, "rear_left_m_s": 1e9}))
    assert monitor.rejected == {"wheel speeds: stamp is not after the one before": 1, "wheel speeds: implausible": 2}
    assert monitor.verdicts(61 * NS, []) is not None
    assert monitor.rear.track_m == run.monitor.rear.track_m


def test_a_gap_of_the_inertial_samples_begins_the_windows_anew() -> None:
    run = driven(60)
    monitor = run.monitor
    monitor.solution(solution_of(70 * NS, BIAS, stationary=False))
    late = [Increment(70 * NS, 70 * NS + NS // 10, (0.0,) * 6 + (0.1,), 0.0, after_gap=True)]
    assert {verdict.outcome for verdict in monitor.verdicts(71 * NS, late).values()} == {Outcome.NOT_EVALUATED}


def commas(monitor: GyroscopeMonitor, added_deg_s: float, onset_s: float) -> list[set[tuple[str, ...]]]:
    """Names once a second of the recording comma_segment, whose attitude and bias are those of its reference."""
    folder = recording("comma_segment")
    imu, wheels, fixes, truth = (
        np.genfromtxt(folder / name, delimiter=",", skip_header=1)
        for name in ("imu.csv", "can_wheel_speed.csv", "gnss_ublox.csv", "truth.csv")
    )
    start = float(np.floor(imu[0, 0])) + 1.0
    bias = float(np.median(np.interp(truth[:, 0], imu[:, 0], imu[:, 6]) - np.gradient(
        np.unwrap(np.radians(truth[:, 9])), truth[:, 0])))  # fmt: skip
    imu[imu[:, 0] > start + onset_s, 6] += radians(added_deg_s)
    decimator, named = Decimator(80.0, 20.0, Counter()), []
    for second in range(1, 58):
        begin, end = start + second - 1, start + second
        part = imu[(imu[:, 0] >= begin) & (imu[:, 0] < end)]
        stamps = np.round(part[:, 0] * NS).astype(np.int64).tolist()
        decimator.add(stamps, part[:, 1:4].tolist(), part[:, 4:7].tolist())
        roll, pitch = (radians(float(np.interp(end, truth[:, 0], truth[:, k]))) for k in (7, 8))
        solution = solution_of(stamps[-1], bias, stationary=False)
        monitor.solution(solution.model_copy(update={"roll_rad": roll, "pitch_rad": pitch}))
        for t, fl, fr, rl, rr in wheels[(wheels[:, 0] >= begin) & (wheels[:, 0] < end)][::9].tolist():
            monitor.speeds(WheelSpeeds(
                sampled_ns=round(t * NS), received_ns=round(t * NS), source="can", front_left_m_s=fl,
                front_right_m_s=fr, rear_left_m_s=rl, rear_right_m_s=rr,
            ))  # fmt: skip
        for t, _, _, speed, _, _, course in fixes[(fixes[:, 0] >= begin) & (fixes[:, 0] < end)].tolist():
            velocity = (speed * np.cos(radians(course)), speed * np.sin(radians(course)), 0.0)
            stamp_ns = round((t - 0.08) * NS)
            fix = GnssFix(sampled_ns=stamp_ns, received_ns=stamp_ns, source="ublox", fix_type=FixType.THREE_D)
            monitor.fix(fix, velocity, None)
        verdicts = monitor.verdicts(round(end * NS), decimator.take())
        named.append({verdict.accused for verdict in verdicts.values() if verdict.outcome is Outcome.ACCUSES})
    return named


def test_a_recorded_car_passes_and_a_bias_added_to_its_gyroscope_is_found() -> None:
    assert not set().union(*commas(GyroscopeMonitor(INDUSTRIAL, Counter()), 0.0, 40.0))
    named = commas(GyroscopeMonitor(INDUSTRIAL, Counter()), 0.5, 40.0)
    found = [second for second, names in enumerate(named, 1) if names]
    assert found and 40 < found[0] <= 51
    assert set().union(*named) <= {("imu",), ("gnss", "imu"), ("imu", "odometer")} and {("imu",)} <= set().union(*named)
