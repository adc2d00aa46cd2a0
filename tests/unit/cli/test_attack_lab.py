"""The attack laboratory: its plan, attacks on recorded messages, and its rates."""

import os
import signal
import threading
import time
from math import hypot, radians
from pathlib import Path

import numpy as np
import pytest

from cli.attack_lab import attack_lab
from cli.attack_lab.attack_lab import run_all
from cli.attack_lab.cases import AFTER_S, ATTACKS, Case, labels, plan
from cli.attack_lab.outcome import answers, outcome
from cli.attack_lab.recorded import POSSIBLE, attacked, displacement, moved
from cli.attack_lab.report import answer_rows, document, page
from cli.attack_lab.run import NEIGHBOURS, run
from cli.attack_lab.score import (
    binomial_interval,
    detected_after_s,
    detections,
    false_alarms,
    harms,
    poisson_interval,
    safe_share,
)
from cli.attack_lab.timeline import Collector, Interval, Timeline
from services.sensors.simulator.world import DEFAULT_START_NS
from shared.attacks import BY_NAME, ScheduledAttack, schedule
from shared.errors import UserError
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Message
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import LastPosition, TruthState
from shared.messages.neighbours import NeighbourStates
from shared.messages.simulation import AttackName
from shared.messages.trust import Outcome, TrustLevel, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed
from tests.support.cases import each

NS = 1_000_000_000
SAFE, UNSAFE = TrustLevel.SAFE, TrustLevel.UNSAFE


def fixes(seconds: int, speed: float = 10.0) -> list[GnssFix]:
    """Fixes of a drive to the east, one a second."""
    return [
        GnssFix(
            sampled_ns=k * NS, received_ns=k * NS, source="gnss0", fix_type=FixType.THREE_D, utc_ns=k * NS,
            latitude_deg=45.0, longitude_deg=10.0 + 1e-4 * k, height_ellipsoid_m=100.0,
            velocity_ned_m_s=(0.0, speed, 0.0), ground_speed_m_s=speed, course_rad=np.pi / 2,
        )
        for k in range(seconds)
    ]  # fmt: skip


def offset_n(attack: str, at_s: int) -> tuple[float, float, float]:
    """Position under an attack minus position without it [m, NED]."""
    clean = fixes(60)
    found = [m for m in attacked(clean, schedule(attack), 0) if isinstance(m, GnssFix)][at_s]
    there, here = (
        Geodetic(radians(f.latitude_deg or 0.0), radians(f.longitude_deg or 0.0), f.height_ellipsoid_m or 0.0)
        for f in (found, clean[at_s])
    )
    north, east, down = ned_from_geodetic_difference(there, here)
    return north, east, down


def timeline(
    verdicts: list[tuple[float, TrustLevel]],
    accused: dict[str, list[tuple[float, float]]],
    error_m: float = 0.5,
    duration_s: float = 300.0,
    *,
    named: dict[str, list[Interval]] | None = None,
    excluded: dict[str, list[Interval]] | None = None,
) -> Timeline:
    """Errors every second, levels of 3 m, alert limits of 10 and 20 m."""
    times = np.arange(0.0, duration_s)
    return Timeline(
        duration_s, np.array([at for at, _ in verdicts]), [level for _, level in verdicts], accused,
        dict.fromkeys(accused, duration_s), times, np.full((len(times), 2), error_m), np.full((len(times), 2), 3.0),
        (10.0, 20.0), named or {}, excluded or {},
    )  # fmt: skip


def test_every_attack_of_the_simulator_is_in_the_plan() -> None:
    planned = {case.attack.attack for case in plan(ATTACKS, ["urban"], 1, [], 600.0) if case.attack}
    assert planned == set(AttackName)


def test_no_two_attacks_of_the_plan_have_the_same_label() -> None:
    assert len(set(labels(ATTACKS))) == len(ATTACKS)


def test_a_plan_has_a_clean_drive_of_each_seed_and_gives_each_attack_90_s() -> None:
    cases = list(plan(["jam"], ["urban", "highway"], 2, [], 600.0))
    assert [case.attack is None for case in cases] == [True, False] * 4
    assert {case.interval_s for case in cases if case.attack} == {(100.0, 190.0)}
    assert {case.duration_s for case in cases if case.attack} == {360.0}, "six minutes driven"


@pytest.mark.parametrize("after_s", [AFTER_S, 300.0])
def test_a_cold_start_begins_with_the_drive_and_every_drive_goes_on_after_its_attack(after_s: float) -> None:
    _, cold, jump = plan(["cold_start", "position_jump@50:20"], ["urban"], 1, [], 600.0, after_s)
    assert (cold.interval_s, jump.interval_s) == ((0.0, 120.0), (50.0, 70.0))
    assert (cold.duration_s, jump.duration_s) == (120.0 + after_s, 70.0 + after_s)


@pytest.mark.parametrize("text", ["jamm", "jam(loud=1)", "jam@-1"])
def test_an_attack_that_cannot_be_read_is_an_error_with_an_example(text: str) -> None:
    with pytest.raises(UserError, match="example: obu attack-lab"):
        list(plan([text], ["urban"], 1, [], 600.0))


def test_the_interval_of_an_attack_ends_with_a_simulated_drive_and_a_recording_runs_to_its_end() -> None:
    attack = schedule("jam@100:60")
    assert Case("urban", 1, 130.0, attack).interval_s == (100.0, 130.0)
    assert Case("drive.mcap", 0, 0.0, attack, recorded=True).interval_s == (100.0, 160.0)


def test_labels_name_only_parameters_that_differ_from_their_defaults() -> None:
    assert Case("urban", 1, 300.0, schedule("drag_off(speed=1)@10")).label == "drag_off(speed=1)"
    assert Case("urban", 1, 300.0, schedule("drag_off(speed=3)@10")).label == "drag_off"


def test_a_drag_off_along_the_track_moves_position_by_the_integral_of_its_velocity() -> None:
    north, east, _ = offset_n("drag_off(acceleration=0.5,speed=2)@10", 20)
    assert (north, east) == pytest.approx((0.0, 0.5 * 0.5 * 4.0**2 + 2.0 * 6.0), abs=0.02)
    rows = BY_NAME[AttackName.DRAG_OFF].complete({"acceleration": 0.5, "speed": 2.0})
    steps = np.arange(0.0, 10.0, 0.01)
    position, velocity = (
        np.array([displacement(AttackName.DRAG_OFF, rows, 0.0, float(t))[k] for t in steps]) for k in (0, 1)
    )
    np.testing.assert_allclose(np.gradient(position, steps, axis=0)[2:-2], velocity[2:-2], atol=0.01)


def test_a_jump_is_lateral_by_its_distance_and_keeps_the_velocity() -> None:
    north, east, _ = offset_n("position_jump(distance=100)@10", 20)
    assert (north, east) == pytest.approx((-100.0, 0.0), abs=0.05)
    after = [m for m in attacked(fixes(30), schedule("position_jump@10"), 0) if isinstance(m, GnssFix)][20]
    assert after.velocity_ned_m_s == (0.0, 10.0, 0.0)


def test_a_climb_rises_and_a_static_replay_stays() -> None:
    assert offset_n("climb@10", 30)[2] < -20.0
    found = [m for m in attacked(fixes(60), schedule("static_replay@10:20"), 0) if isinstance(m, GnssFix)]
    assert {f.longitude_deg for f in found[10:30]} == {found[9].longitude_deg}
    assert {f.velocity_ned_m_s for f in found[10:30]} == {(0.0, 0.0, 0.0)}
    assert found[30] == fixes(60)[30], "the attack has ended"


def test_a_staircase_an_interrupted_offset_and_a_held_drag_move_recorded_fixes_as_simulated_ones() -> None:
    assert offset_n("staircase(distance=8,period=5)@10", 21)[0] == pytest.approx(-24.0, abs=0.05)
    assert offset_n("intermittent(distance=12,on=2,off=3)@10", 16)[0] == pytest.approx(-12.0, abs=0.05)
    assert offset_n("intermittent(distance=12,on=2,off=3)@10", 19)[0] == pytest.approx(0.0, abs=0.05)
    assert offset_n("drag_hold(speed=2,share=0.25)@10", 20)[0] == pytest.approx(-20.0, abs=0.05)
    held = [m for m in attacked(fixes(30), schedule("drag_hold(speed=2,share=0.25)@10"), 0) if isinstance(m, GnssFix)]
    assert held[20].velocity_ned_m_s == pytest.approx((-0.5, 10.0, 0.0))


def test_a_tunnel_removes_position_and_velocity_and_keeps_the_stamps() -> None:
    found = [m for m in attacked(fixes(30), schedule("tunnel@10"), 0) if isinstance(m, GnssFix)][15]
    assert (found.fix_type, found.latitude_deg, found.velocity_ned_m_s) == (FixType.NONE, None, None)
    assert found.sampled_ns == 15 * NS


def test_attacks_on_the_odometer_scale_and_hold_the_speed() -> None:
    speeds = [VehicleSpeed(sampled_ns=k * NS, received_ns=k * NS, source="can0", speed_m_s=float(k)) for k in range(20)]
    scaled = list(attacked(speeds, schedule("odometer_scale(factor=2)@10"), 0))
    held = list(attacked(speeds, schedule("odometer_freeze@10:5"), 0))
    assert [m.speed_m_s for m in scaled if isinstance(m, VehicleSpeed)][9:12] == [9.0, 20.0, 22.0]
    assert [m.speed_m_s for m in held if isinstance(m, VehicleSpeed)][9:17] == [9.0] * 6 + [15.0, 16.0]


def test_inertial_samples_which_have_a_stamp_each_stay_as_they_are() -> None:
    one = ImuSamples(
        received_ns=12 * NS, source="imu0", sampled_ns=(11 * NS, 12 * NS),
        specific_force_body_m_s2=((0.0, 0.0, -9.8),) * 2, angular_rate_body_rad_s=((0.0, 0.0, 0.0),) * 2,
    )  # fmt: skip
    assert list(attacked([one], schedule("position_jump@10"), 0)) == [one]
    assert list(attacked([one], schedule("odometer_scale@10"), 0)) == [one]


def test_satellite_faults_on_recordings_are_an_error_that_lists_the_possible_attacks() -> None:
    assert AttackName.SATELLITE_STEP not in POSSIBLE
    with pytest.raises(UserError, match="on recordings: tunnel"):
        list(attacked(fixes(5), schedule("satellite_step@1"), 0))


def test_a_moved_fix_without_a_position_has_none() -> None:
    bare = GnssFix(sampled_ns=0, received_ns=0, source="gnss0", fix_type=FixType.NONE)
    assert moved(bare, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0)) == bare


def test_detection_counts_from_the_start_of_the_attack_and_only_within_it() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    seen = timeline([(0.0, SAFE), (107.0, UNSAFE)], {"a": [(90.0, 120.0)], "b": [(50.0, 60.0), (105.0, 130.0)]})
    assert detected_after_s(case, seen, "a") is None, "it accused before"
    assert detected_after_s(case, seen, "b") == pytest.approx(5.0)
    assert detected_after_s(case, seen, "verdict") == pytest.approx(7.0)
    rows = {row.monitor: row for row in detections([(case, seen)])}
    assert (rows["a"].detected, rows["b"].detected) == (0, 1)
    assert rows["b"].delay_median_s == pytest.approx(5.0)


def test_false_alarms_are_counted_outside_the_attack_and_its_recovery() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    seen = timeline([(0.0, SAFE)], {"a": [(50.0, 51.0), (80.0, 81.0), (110.0, 111.0), (170.0, 171.0), (260.0, 261.0)]})
    (row, _) = false_alarms([(case, seen)])
    assert row.episodes == 2, "those at 80 and 260 s: not the warm-up, the attack and the 70 s after it"
    assert row.hours == pytest.approx((40.0 + 70.0) / 3600.0)


def test_time_that_is_safe_with_an_error_above_the_alert_limit_is_counted() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100"))
    (row,) = harms([(case, timeline([(0.0, SAFE), (200.0, UNSAFE)], {}, error_m=11.0))])
    assert row.hazardous_s == pytest.approx(100.0)
    assert row.largest_undetected_error_m == 11.0 and row.above_level_fraction == 1.0
    (calm,) = harms([(case, timeline([(0.0, SAFE)], {}, error_m=0.5))])
    assert calm.hazardous_s == 0.0 and calm.above_level_fraction == 0.0


def test_a_run_has_recovered_when_its_verdict_stays_safe_after_the_attack() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    lasting = timeline([(0.0, SAFE), (110.0, UNSAFE)], {})
    back = timeline([(0.0, SAFE), (110.0, UNSAFE), (165.0, SAFE), (170.0, UNSAFE), (190.0, SAFE), (220.0, SAFE)], {})
    unmoved = timeline([(0.0, UNSAFE), (50.0, SAFE)], {})
    (row,) = harms([(case, lasting), (case, back), (case, unmoved)])
    assert row.recovered == 2 and row.safe_again_s == pytest.approx(30.0)
    (never,) = harms([(case, lasting)])
    assert never.recovered == 0 and never.safe_again_s is None


def test_the_share_of_safe_is_that_of_clean_drives_after_a_minute() -> None:
    clean = timeline([(0.0, TrustLevel.INITIALISING), (120.0, SAFE)], {})
    assert safe_share([(Case("urban", 1, 300.0), clean)]) == pytest.approx(180.0 / 240.0)
    assert safe_share([(Case("urban", 1, 300.0, schedule("jam@1")), clean)]) is None


def answer_to(attack: str, **changes: object) -> tuple[bool, tuple[str, ...]]:
    """Whether the accusations of a run are right, and what healthy sources it excluded."""
    found = outcome(Case("urban", 1, 300.0, schedule(f"{attack}@100:60")), timeline([(0.0, SAFE)], {}, **changes))  # type: ignore[arg-type]
    return found.right, found.healthy_excluded


IN_TIME: list[Interval] = [(105.0, 130.0)]


@each(
    ("attack", "named", "right"),
    [
        ("drag_off", "gnss", True),
        ("drag_off", "odometer", False),
        ("drag_off", "", False),
        ("coherent_scale", "gnss", True),
        ("coherent_scale", "odometer", True),
        ("odometer_scale", "odometer", True),
        ("odometer_scale", "gnss", False),
        ("gyroscope_bias", "imu", True),
        ("gyroscope_bias", "gnss", False),
        ("satellite_step", "G05", True),
        ("satellite_step", "neighbour 1", False),
        ("satellite_step", "gnss", False),
        ("neighbour_lie", "neighbour 1", True),
        ("neighbour_lie", "E11", False),
        ("tunnel", "", True),
        ("tunnel", "gnss", True),
        ("tunnel", "odometer", False),
    ],
)
def test_an_accusation_is_right_if_it_names_the_source_at_fault(attack: str, named: str, right: bool) -> None:
    assert answer_to(attack, named={named: IN_TIME} if named else {}) == (right, ())


def test_a_statement_that_names_one_of_two_sources_is_right_if_either_is_at_fault() -> None:
    both: dict[str, list[Interval]] = {"gnss": IN_TIME, "imu": IN_TIME}
    assert answer_to("gyroscope_bias", named=both)[0]
    assert answer_to("drag_off", named=both)[0]
    assert not answer_to("odometer_scale", named=both)[0]


@pytest.mark.parametrize("interval", [(80.0, 140.0), (170.0, 180.0)])
def test_an_accusation_counts_only_if_it_begins_during_the_attack(interval: Interval) -> None:
    assert not answer_to("drag_off", named={"gnss": [interval]})[0]


def test_a_source_that_is_accused_after_the_attack_is_told_apart() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    found = outcome(
        case, timeline([(0.0, SAFE)], {}, named={"gnss": [(160.0, 161.0), (170.0, 180.0)], "imu": [(90.0, 200.0)]})
    )
    assert (found.accused, found.accused_after) == (("gnss",), ("gnss",))
    late = outcome(case, timeline([(0.0, SAFE)], {}, named={"gnss": [(160.1, 180.0)]}))
    assert (late.accused, late.accused_after, late.right) == ((), ("gnss",), False)


def test_a_healthy_source_that_is_excluded_makes_the_answer_wrong() -> None:
    named: dict[str, list[Interval]] = {"imu": IN_TIME, "gnss": IN_TIME, "odometer": IN_TIME}
    gnss: dict[str, list[Interval]] = {"gnss": [(110.0, 120.0), (150.0, 290.0)]}
    assert answer_to("gyroscope_bias", named=named, excluded=gnss) == (False, ("gnss",))
    assert answer_to("drag_off", named=named, excluded=gnss) == (True, ()), "GNSS is attacked"
    assert answer_to("satellite_step", named={"G05": IN_TIME}, excluded=gnss) == (True, ()), "its fix is wrong too"
    assert answer_to("coherent_scale", named=named, excluded={"odometer": IN_TIME}) == (True, ())
    assert answer_to("drag_off", named=named, excluded={"odometer": [(10.0, 90.0)]}) == (True, ()), "before the attack"
    assert answer_to("drag_off", named=named, excluded={"odometer": [(200.0, 201.0)]}) == (False, ("odometer",))


def test_the_longest_exclusion_of_a_healthy_source_and_of_the_attacked_one_after_its_end() -> None:
    excluded: dict[str, list[Interval]] = {"gnss": [(110.0, 120.0), (150.0, 290.0)], "odometer": [(90.0, 112.0)]}
    seen = timeline([(0.0, SAFE)], {}, excluded=excluded)
    spoofed = outcome(Case("urban", 1, 300.0, schedule("drag_off@100:60")), seen)
    assert (spoofed.healthy_excluded_s, spoofed.excluded_after_s) == (12.0, 130.0)
    shaken = outcome(Case("urban", 1, 300.0, schedule("gyroscope_bias@100:60")), seen)
    assert (shaken.healthy_excluded_s, shaken.excluded_after_s) == (140.0, 0.0)


def test_safe_with_an_error_above_level_or_limit_is_counted_to_the_end_of_the_run() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    verdicts = [(0.0, SAFE), (150.0, UNSAFE), (250.0, SAFE)]
    above_level = outcome(case, timeline(verdicts, {}, error_m=5.0))
    assert (above_level.safe_above_level_s, above_level.safe_above_limit_s) == (100.0, 0.0)
    assert above_level.above_level_fraction == 1.0 and above_level.safe_error_m == (5.0, 5.0)
    above_limit = outcome(case, timeline(verdicts, {}, error_m=11.0))
    assert (above_limit.safe_above_level_s, above_limit.safe_above_limit_s) == (100.0, 100.0)
    within = outcome(case, timeline(verdicts, {}, error_m=2.0))
    assert (within.safe_above_level_s, within.above_level_fraction) == (0.0, 0.0)


def test_an_error_before_the_attack_or_without_a_level_is_not_counted() -> None:
    seen = timeline([(0.0, SAFE)], {})
    seen.error_m[:100, 1] = 50.0
    seen.level_m[200:] = np.nan
    seen.error_m[200:] = 9.0
    found = outcome(Case("urban", 1, 300.0, schedule("drag_off@100:60")), seen)
    assert (found.safe_above_level_s, found.safe_above_limit_s, found.above_level_fraction) == (0.0, 0.0, 0.0)
    assert found.safe_error_m == (9.0, 9.0)
    assert found.end is not None and found.end.level_m == (None, None)


def test_the_times_until_the_verdict_leaves_safe_and_until_it_is_usable_again() -> None:
    case, caution = Case("urban", 1, 300.0, schedule("drag_off@100:60")), TrustLevel.CAUTION
    verdicts = [(0.0, SAFE), (110.0, caution), (115.0, UNSAFE), (165.0, SAFE), (170.0, UNSAFE), (190.0, caution)]
    found = outcome(case, timeline([*verdicts, (220.0, SAFE)], {}))
    assert (found.not_safe_after_s, found.usable_again_s, found.safe_again_s) == (10.0, 30.0, 60.0)
    cautious = outcome(case, timeline(verdicts, {}))
    assert (cautious.usable_again_s, cautious.safe_again_s) == (30.0, None)
    lost = outcome(case, timeline(verdicts[:3], {}))
    assert (lost.usable_again_s, lost.safe_again_s) == (None, None)
    unmoved = outcome(case, timeline([(0.0, SAFE)], {}))
    assert (unmoved.not_safe_after_s, unmoved.usable_again_s) == (None, 0.0)
    assert outcome(case, timeline([(0.0, UNSAFE), (130.0, SAFE)], {})).not_safe_after_s == 0.0, "at its start already"


def test_error_and_level_are_kept_every_ten_seconds_and_at_the_end() -> None:
    found = outcome(Case("urban", 1, 300.0, schedule("drag_off@100:60")), timeline([(0.0, SAFE), (150.0, UNSAFE)], {}))
    assert [point.after_s for point in found.track] == [10.0 * k for k in range(20)]
    assert [point.verdict for point in found.track[4:6]] == [SAFE, UNSAFE]
    assert found.end is not None
    assert (found.end.after_s, found.end.error_m, found.end.level_m) == (199.0, (0.5, 0.5), (3.0, 3.0))


def test_a_run_without_a_truth_has_unknown_errors_and_a_known_answer() -> None:
    seen = timeline([(0.0, SAFE)], {}, named={"gnss": IN_TIME})
    bare = Timeline(
        seen.duration_s, seen.verdict_s, seen.verdicts, {}, {}, np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)),
        seen.alert_limits_m, seen.named_s,
    )  # fmt: skip
    case = Case("drive.mcap", 0, 0.0, schedule("drag_off@100:60"), recorded=True)
    found = outcome(case, bare)
    assert (found.right, found.above_level_fraction, found.safe_error_m) == (True, None, (None, None))
    head, (row,) = answer_rows([(case, bare)])
    assert dict(zip(head, row, strict=True))["SAFE above level"] == "unknown"


def test_the_answers_of_an_attack_have_intervals_and_the_figures_of_the_worst_run() -> None:
    case = Case("urban", 1, 300.0, schedule("drag_off@100:60"))
    right = timeline([(0.0, SAFE), (110.0, UNSAFE)], {"a": IN_TIME}, named={"gnss": IN_TIME})
    wrong = timeline([(0.0, SAFE)], {}, 12.0, excluded={"odometer": [(200.0, 230.0)]})
    (row,) = answers([(case, right), (case, right), (case, wrong)])
    assert (row.runs, row.detected, row.right, row.expected) == (3, 2, 2, "gnss")
    assert row.detected_interval == row.right_interval == pytest.approx((0.09430, 0.99160), abs=1e-5)
    assert (row.accused, row.healthy_excluded, row.healthy_excluded_s) == (("gnss",), ("odometer",), 30.0)
    assert (row.safe_above_level_s, row.safe_above_limit_s) == (200.0, 200.0)
    assert (row.not_safe, row.not_safe_after_s, row.usable_again, row.usable_again_s) == (2, 10.0, 1, 0.0)
    assert (row.end_error_m, row.end_level_m, row.safe_error_m) == ((12.0, 12.0), (3.0, 3.0), (12.0, 12.0))


def test_a_clean_drive_is_no_answer() -> None:
    assert answers([(Case("urban", 1, 300.0), timeline([(0.0, SAFE)], {}))]) == []
    with pytest.raises(ValueError, match="no outcome"):
        outcome(Case("urban", 1, 300.0), timeline([(0.0, SAFE)], {}))


def trust_state(at_s: int, accused: tuple[str, ...], *, gnss: bool = False, odometer: bool = False) -> TrustState:
    outcomes = {True: Outcome.ACCUSES, False: Outcome.PASS}
    monitor = TrustMonitor(
        sampled_ns=at_s * NS, monitor="motion", outcome=outcomes[bool(accused)], reason="-", accused=accused
    )
    return TrustState(
        sampled_ns=at_s * NS, state=SAFE, since_ns=0, row=8, reasons=(), gnss_excluded=gnss,
        odometer_excluded=odometer, alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0, monitors=(monitor,),
    )  # fmt: skip


def test_accused_and_excluded_sources_are_those_of_the_verdicts() -> None:
    collector = Collector()
    for state in (
        trust_state(0, ()), trust_state(1, ("gnss", "imu")), trust_state(2, ("gnss",), gnss=True),
        trust_state(3, (), gnss=True, odometer=True), trust_state(4, ("gnss",)),
    ):  # fmt: skip
        collector.add(state)
    found = collector.timeline((0, 6 * NS), (0.0, 0.0, 0.0), None)
    assert found.named_s == {"gnss": [(1.0, 3.0), (4.0, 6.0)], "imu": [(1.0, 2.0)]}
    assert found.excluded_s == {"gnss": [(2.0, 4.0)], "odometer": [(3.0, 4.0)]}


def test_intervals_are_those_of_clopper_and_pearson_and_of_poisson() -> None:
    assert binomial_interval(0, 10) == pytest.approx((0.0, 0.30850), abs=1e-5)  # 1 - 0.025^(1/10)
    assert binomial_interval(10, 10)[0] == pytest.approx(0.69150, abs=1e-5)
    assert poisson_interval(0, 1.0) == pytest.approx((0.0, 3.68888), abs=1e-5)  # -ln 0.025
    assert poisson_interval(1, 2.0) == pytest.approx((0.0253178 / 2, 5.571643 / 2), abs=1e-5)


def test_the_report_has_every_attack_and_no_external_resources() -> None:
    case = Case("urban", 1, 300.0, ScheduledAttack(AttackName.JAM, 100.0, 60.0, {"power": 30.0, "rise": 6.0}))
    runs = [(case, timeline([(0.0, SAFE), (107.0, UNSAFE)], {"motion": [(105.0, 130.0)]}))]
    card = document(runs)
    text = " ".join(page(card, runs).split())
    assert ">jam<" in text and "Stanford diagram, horizontal" in text
    assert "1 of 1 (3 to 100 %)" in text and "95 % interval of the rate, of Clopper and Pearson" in text
    assert "Attacks of the default campaign that were not run" in text and "gyroscope_bias(bias=0.1)" in text
    left_out = card["attacks_not_run"]
    assert isinstance(left_out, list) and "jam" not in left_out and card["unfinished"] == []
    assert "http://" not in text.replace("http://www.w3.org", "") and "https://" not in text
    assert hypot(*poisson_interval(0, 0.0)) == np.inf


def first_seed_alone(case: Case) -> Timeline:
    """Finish the runs of seed 1 at once, and no other."""
    if case.seed > 1:
        time.sleep(60.0)
    return timeline([(0.0, SAFE)], {"motion": []})


def interrupt_after(folder: Path, finished: int) -> None:
    """Press Ctrl-C once so many runs are kept."""
    while len(list(folder.glob("*.json"))) < finished:
        time.sleep(0.02)
    os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupted_campaign_reports_what_is_finished_first_all_cases_of_seed_1(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(attack_lab, "run", first_seed_alone)
    cases = list(plan(["jam", "freeze"], ["urban", "highway"], 2, [], 300.0))
    assert [case.seed for case in cases] == [1] * 6 + [2] * 6
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    threading.Thread(target=interrupt_after, args=(tmp_path / "campaigns" / "attack-lab", 6), daemon=True).start()
    runs = run_all(cases, 2)
    assert [case for case, _ in runs] == cases[:6], "nobody waited for the others"
    card = document(runs, planned=cases)
    assert card["planned"] == 12
    assert card["unfinished"] == [f"{case.label} on {case.drive}, seed 2" for case in cases[6:]]
    text = page(card, runs)
    assert "Interrupted: 6 of 12 runs." in text and "Planned runs that were not finished: 6" in text


@pytest.mark.slow
def test_runs_are_in_the_order_of_the_plan_with_verdicts_and_true_errors(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    cases = [Case("urban", seed, 30.0, schedule("jam@25:2")) for seed in (1, 2)]
    runs = run_all(cases, 2)
    assert [case for case, _ in runs] == cases
    for _, timeline in runs:
        assert timeline.verdicts and len(timeline.error_s) > 50
        assert timeline.error_m[-1, 0] < 5.0


def given(monkeypatch: pytest.MonkeyPatch, attack: str) -> list[Message]:
    """What the unit receives in the first seconds of a run of the laboratory."""
    seen: list[Message] = []
    monkeypatch.setattr(Collector, "add", lambda _, message: seen.append(message))
    run(Case("urban", 1, 4.0, schedule(attack)))
    return seen


@pytest.mark.parametrize(("attack", "neighbours"), [("jam@3:1", 0), ("neighbour_lie@3:1", NEIGHBOURS)])
def test_only_attacks_by_neighbours_have_neighbours(
    monkeypatch: pytest.MonkeyPatch, attack: str, neighbours: int
) -> None:
    states = [m for m in given(monkeypatch, attack) if isinstance(m, NeighbourStates)]
    assert states and {len(m.neighbours) for m in states} == {neighbours}


def test_a_cold_start_begins_with_the_saved_position_of_the_true_place(monkeypatch: pytest.MonkeyPatch) -> None:
    first, *rest = given(monkeypatch, "cold_start@0:4")
    truth = next(m for m in rest if isinstance(m, TruthState))
    fix = next(m for m in rest if isinstance(m, GnssFix) and m.latitude_deg is not None)
    assert isinstance(first, LastPosition) and first.sampled_ns < DEFAULT_START_NS
    assert (first.latitude_deg, first.longitude_deg) == (truth.latitude_deg, truth.longitude_deg)
    assert fix.latitude_deg is not None and fix.longitude_deg is not None
    way = ned_from_geodetic_difference(
        Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), 0.0),
        Geodetic(radians(first.latitude_deg), radians(first.longitude_deg), 0.0),
    )
    assert hypot(*way[:2]) == pytest.approx(50.0, abs=5.0)
    assert not any(isinstance(m, LastPosition) for m in given(monkeypatch, "position_jump@0:4"))
