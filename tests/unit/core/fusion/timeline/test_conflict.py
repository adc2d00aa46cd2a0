"""Exclusion of GNSS and odometer: state after a roll-back, estimates meanwhile, and readmission."""

from copy import deepcopy
from functools import cache
from math import hypot

import numpy as np
import pytest

from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.dual_antenna.aid import BaselineHeading
from services.core.fusion.aids.gnss.correlated import position_errors_of
from services.core.fusion.codes import Code
from services.core.fusion.inertial.imu_faults import Sample
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.states import LAYOUT
from services.core.fusion.timeline import conflict as conflicts
from services.core.fusion.timeline.conflict import SAMPLES_PER_STEP
from services.core.fusion.timeline.cursor import Cursor
from services.core.fusion.timeline.engine import Engine
from services.core.fusion.timeline.events import GnssExcluded, GnssReadmitted, OdometerExclusion
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.messages.explanation import explain
from shared.messages.navigation import AidingKind, NavigationPhase

SECOND_NS = 1_000_000_000
SUSPECT_S, VERDICT_S, END_S = 60, 75, 90
STAGES_S = (0, 60, 70, 75, 80)  # times of navigators that several tests continue


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the filter of this short drive count as converged before the suspect time."""
    monkeypatch.setattr(conflicts, "CONVERGED_S", 20.0)
    monkeypatch.setattr(conflicts, "EARLIER_NS", 0)


@cache
def drive() -> Drive:
    return simulate("urban", 1, 120.0)


def navigator() -> Navigator:
    return Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive().lever_arm_b)}))


def run(
    nav: Navigator,
    begin_s: float,
    end_s: float,
    *,
    last_fix_s: float = 1e9,
    moved_m: float = 0.0,
    up_m: float = 0.0,
    odometer: float = 1.0,
) -> list[Outcome]:
    """Feed a part of the drive; fixes moved to the north and up, odometer speeds times a factor."""
    d, outcomes = drive(), []
    first, last = (int(np.searchsorted(d.t_ns, s * SECOND_NS, side="right")) for s in (begin_s, end_s))
    k, j = (int(np.searchsorted(stamps, begin_s * SECOND_NS, side="right")) for stamps in (d.fix_ns, d.odometer_ns))
    for i in range(first, last):
        now_ns = int(d.t_ns[i])
        outcomes += nav.imu(now_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        while j < len(d.odometer_ns) and d.odometer_ns[j] <= now_ns:
            nav.speed(int(d.odometer_ns[j]), odometer * abs(float(d.odometer[j])), received_ns=now_ns)
            j += 1
        while k < len(d.fix_ns) and d.fix_ns[k] <= now_ns:
            if d.fix_ns[k] <= last_fix_s * SECOND_NS and d.fix_valid[k]:
                place = geodetic_from_ned_difference((moved_m, 0.0, -up_m), Geodetic(*d.fix_position[k].tolist()))
                sd, velocity_sd = d.fix_position_sd_n[k].tolist(), d.fix_velocity_sd_n[k].tolist()
                velocity = d.fix_velocity_n[k].tolist()
                nav.fix(
                    int(d.fix_ns[k]), position=place, velocity=velocity, position_sd=sd, velocity_sd=velocity_sd,
                    received_ns=now_ns,
                )  # fmt: skip
            k += 1
    return outcomes


@cache
def stage(end_s: int) -> Navigator:
    """Fault-free navigator at one of the stages."""
    if end_s == 0:
        return navigator()
    begin_s = max(earlier for earlier in STAGES_S if earlier < end_s)
    nav = fault_free(begin_s)
    run(nav, begin_s, end_s)
    return nav


def fault_free(end_s: int) -> Navigator:
    """Copy of a fault-free navigator at one of the stages."""
    return deepcopy(stage(end_s))


@pytest.mark.parametrize(
    ("suspect_s", "started_s", "now_s", "expected_s"),
    [(200, 20, 220, 160), (70, 20, 80, 50), (30, 20, 80, 50), (30, 20, 45, 30), (60, 20, 45, 50)],
    ids=[
        "earlier",
        "not before it has converged",
        "suspect before",
        "nothing has converged",
        "nor at the suspect time",
    ],
)
def test_a_solution_without_gnss_begins_earlier_than_the_suspect_time_and_after_the_filter_has_converged(
    suspect_s: int, started_s: int, now_s: int, expected_s: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conflicts, "CONVERGED_S", 30.0)
    monkeypatch.setattr(conflicts, "EARLIER_NS", 40 * SECOND_NS)
    engine = Engine(Settings())
    engine.started_ns = started_s * SECOND_NS
    engine.last = Sample(now_s * SECOND_NS, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0))
    assert conflicts.start_ns(Cursor(engine), suspect_s * SECOND_NS) == expected_s * SECOND_NS


def excluded_at(verdict_s: int, suspect_s: int, end_s: float, **changes: float) -> tuple[Navigator, list[Outcome]]:
    """A navigator that receives the verdict at a time, with changed fixes from the suspect time on."""
    if changes:
        nav = fault_free(suspect_s)
        run(nav, suspect_s, verdict_s, **changes)
    else:
        nav = fault_free(verdict_s)
    nav.apply_exclusions(round(suspect_s * SECOND_NS), odometer_excluded=False)
    return nav, run(nav, verdict_s, end_s, **changes)


def error_m(nav: Navigator) -> float:
    """Horizontal distance from the truth."""
    solution, d = nav.solution(), drive()
    assert solution is not None
    truth = Geodetic(*d.position[int(np.searchsorted(d.t_ns, solution.time_ns))].tolist())
    north, east, _ = ned_from_geodetic_difference(solution.position, truth)
    return hypot(north, east)


@cache
def without_gnss() -> Navigator:
    """A navigator that has never received a fix after the suspect time."""
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, END_S, last_fix_s=SUSPECT_S)
    return nav


@cache
def rolled_back() -> tuple[Navigator, list[Outcome]]:
    return excluded_at(VERDICT_S, SUSPECT_S, END_S, moved_m=8.0, up_m=5.0)


def test_a_roll_back_results_in_the_state_without_the_suspect_fixes() -> None:
    nav, plain = rolled_back()[0], without_gnss()
    ours, theirs = nav.engine.filter, plain.engine.filter
    assert ours is not None and theirs is not None
    apart = ned_from_geodetic_difference(ours.position, theirs.position)
    assert apart == pytest.approx((0.0, 0.0, 0.0), abs=0.01), "[m] the covariance is propagated at other instants"
    assert ours.velocity == pytest.approx(theirs.velocity, abs=0.005)
    assert ours.P.diagonal() == pytest.approx(theirs.P.diagonal(), rel=0.02)


def test_the_solution_and_the_state_confirm_the_exclusion_and_count_the_fixes() -> None:
    nav, outcomes = rolled_back()
    solution = nav.solution()
    assert solution is not None and solution.gnss_excluded_since_ns == SUSPECT_S * SECOND_NS
    assert solution.gnss_age_s == pytest.approx(END_S - SUSPECT_S, abs=1.01)
    assert nav.phase is NavigationPhase.COASTING and nav.why[0].code == Code.GNSS_EXCLUDED
    assert nav.engine.exclusions.fixes == END_S - SUSPECT_S - 1, "the newest one waits to be merged"
    gnss = [o for o in outcomes if o.kind in (AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY)]
    assert len(gnss) >= 2 * (END_S - VERDICT_S - 1)
    assert {o.reason for o in gnss if o.time_ns > VERDICT_S * SECOND_NS} == {"GNSS is excluded by core.trust"}
    assert len({(o.time_ns, o.kind) for o in gnss}) == len(gnss), "each is reported once"


def test_excluded_gnss_does_not_change_error_model_and_vehicle_parameters() -> None:
    nav, plain = rolled_back()[0].engine, without_gnss().engine
    assert nav.filter is not None and plain.filter is not None
    assert position_errors_of(nav.filter).unit == pytest.approx(position_errors_of(plain.filter).unit)
    for name in ("odometer_scale", "mounting"):
        place = LAYOUT.place(name)
        assert nav.filter.parameters_of(place) == pytest.approx(plain.filter.parameters_of(place), abs=1e-3)
    assert (nav.aids.error_monitor.position, nav.counts.resets) == (
        plain.aids.error_monitor.position,
        plain.counts.resets,
    )
    assert nav.aids.error_monitor.rejection_bound == plain.aids.error_monitor.rejection_bound


def test_excluded_positions_400_m_off_neither_reset_the_filter_nor_change_its_height() -> None:
    nav, _ = excluded_at(61, 60, 80.0, moved_m=400.0, up_m=200.0)
    assert nav.counts.resets == 0 and error_m(nav) < 10.0
    assert nav.engine.filter is not None
    assert nav.engine.filter.position.height == pytest.approx(drive().position[8000, 2], abs=5.0)
    solution = nav.solution()
    assert solution is not None and 390.0 < solution.protection_level_horizontal < 430.0, "it reaches to the other one"


def test_the_state_is_replaced_once_the_roll_back_in_parts_has_reached_the_newest_sample() -> None:
    nav = fault_free(75)
    nav.apply_exclusions(60 * SECOND_NS, odometer_excluded=False)
    samples = np.flatnonzero(drive().t_ns > 75 * SECOND_NS)
    confirmed = None
    for n, i in enumerate(samples[:200]):
        nav.imu(int(drive().t_ns[i]), drive().force_b[i].tolist(), drive().rate_b[i].tolist())
        since_ns = nav.engine.exclusions.gnss_since_ns
        assert since_ns is None or since_ns == 60 * SECOND_NS
        if since_ns == 60 * SECOND_NS:
            confirmed = n + 1
            break
    assert confirmed is not None and 15 * 100 / SAMPLES_PER_STEP <= confirmed <= 20 * 100 / SAMPLES_PER_STEP


def test_an_earlier_suspect_time_rolls_back_further_and_a_later_one_does_not() -> None:
    nav = fault_free(80)
    for since_s, expected_s in ((70, 70), (50, 50), (65, 50)):
        nav.apply_exclusions(since_s * SECOND_NS, odometer_excluded=False)
        begin_s = nav.engine.time_ns / SECOND_NS
        run(nav, begin_s, begin_s + 2.0)
        assert nav.engine.exclusions.gnss_since_ns == expected_s * SECOND_NS


def test_without_a_snapshot_before_the_suspect_time_the_largest_pull_of_gnss_is_added_to_the_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conflicts, "CONVERGED_S", 0.0)
    monkeypatch.setattr(conflicts, "MAX_LIMITS", 1000.0)
    monkeypatch.setattr(conflicts, "LAST_LIMITS", 1000.0)
    levels = {}
    for suspect_s in (60.0, -10.0):  # the oldest snapshot is of the first sample
        saved = stage(70).saved_state()
        assert saved is not None
        later = navigator()
        later.restore(saved, round(70.01 * SECOND_NS))
        run(later, 70.0, 75.0)
        later.apply_exclusions(
            round((70.0 + suspect_s - 60.0 if suspect_s < 0 else 73.0) * SECOND_NS), odometer_excluded=False
        )
        run(later, 75.0, 80.0)
        solution = later.solution()
        assert solution is not None and solution.gnss_excluded_since_ns is not None
        levels[suspect_s] = solution.protection_level_horizontal
    assert levels[-10.0] > levels[60.0] + 10.0


def test_a_state_saved_during_an_exclusion_continues_without_gnss() -> None:
    first, _ = excluded_at(VERDICT_S, SUSPECT_S, 80.0)
    saved, before = first.saved_state(), first.solution()
    assert saved is not None and before is not None and saved.gnss_excluded_since_ns == SUSPECT_S * SECOND_NS
    second = navigator()
    second.restore(saved, round(80.01 * SECOND_NS))
    second.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False)
    run(second, 80.0, 81.0)
    after = second.solution()
    assert after is not None and after.gnss_excluded_since_ns == SUSPECT_S * SECOND_NS
    assert not second.engine.aids.error_monitor.held.is_open, "nothing was contradicted"
    assert after.protection_level_horizontal < before.protection_level_horizontal + 2.0, "no effect of GNSS is added"


def test_a_readmitted_receiver_is_used_at_once_and_the_reason_states_it() -> None:
    nav, _ = excluded_at(VERDICT_S, SUSPECT_S, 85.0)
    nav.apply_exclusions(None, odometer_excluded=False)
    outcomes = run(nav, 85.0, 88.0)
    positions = [o for o in outcomes if o.kind is AidingKind.GNSS_POSITION and o.time_ns > 85.1 * SECOND_NS]
    assert positions and all(o.used for o in positions)
    assert nav.phase is NavigationPhase.NAVIGATING and nav.why[0].code == Code.READMITTED
    assert nav.engine.exclusions.gnss_since_ns is None and nav.counts.resets == 0
    assert error_m(nav) < 3.0


def test_a_readmitted_receiver_that_is_300_m_off_resets_the_filter_after_repeated_rejections_only() -> None:
    nav, _ = excluded_at(VERDICT_S, SUSPECT_S, 80.0)
    nav.apply_exclusions(None, odometer_excluded=False)
    first = run(nav, 80.0, 86.0, moved_m=300.0)
    assert not any(o.used for o in first if o.kind is AidingKind.GNSS_POSITION and o.time_ns > 80.1 * SECOND_NS)
    assert nav.counts.resets == 0
    run(nav, 86.0, 110.0, moved_m=300.0)
    solution = nav.solution()
    assert nav.counts.resets == 1 and solution is not None
    assert solution.protection_level_horizontal > 200.0, "either of the two positions may be wrong, for a minute"


def test_a_conflict_that_is_not_decided_keeps_gnss_and_the_level_reaches_to_the_solution_without_it() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
    run(nav, VERDICT_S, END_S, moved_m=8.0)
    solution, difference = nav.solution(), nav.verdicts.difference()
    assert solution is not None and solution.gnss_excluded_since_ns is None and difference is not None
    apart_m = hypot(*difference[0][:2])
    assert apart_m == pytest.approx(8.0, abs=2.5)
    assert solution.protection_level_horizontal >= apart_m + difference[1][0] - 1e-9
    assert error_m(nav) < solution.protection_level_horizontal
    nn, _, _, ee, _, _ = solution.triangles[0]
    assert nn + ee > apart_m**2, "the ellipse that others read holds both"


def test_a_filter_that_had_not_converged_before_the_suspect_time_declines_to_exclude(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conflicts, "CONVERGED_S", 60.0)
    nav, _ = excluded_at(VERDICT_S, SUSPECT_S, 80.0)
    conflict, solution = nav.verdicts.conflict, nav.solution()
    assert conflict is not None and conflict.declined is not None and conflict.declined.code == Code.NOT_CONVERGED
    assert solution is not None and solution.gnss_excluded_since_ns is None


def without_aiding(alert_limit_m: float) -> Navigator:
    """A navigator on GNSS and inertial sensors alone."""
    return Navigator(Settings().with_values({
        "vehicle.gnss.lever_arm_body_m": tuple(drive().lever_arm_b), "odometer.enabled": False,
        "non_holonomic.enabled": False, "vehicle.alert_limit_horizontal_m": alert_limit_m,
    }))  # fmt: skip


def test_a_solution_without_gnss_that_outgrows_its_bound_is_not_published_and_the_level_still_reaches_to_it() -> None:
    nav = without_aiding(5.0)
    run(nav, 0.0, VERDICT_S)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False)
    run(nav, VERDICT_S, 92.0)
    conflict, difference, solution = nav.verdicts.conflict, nav.verdicts.difference(), nav.solution()
    assert conflict is not None and conflict.declined is not None and difference is not None
    assert conflict.declined.code == Code.WITHOUT_GNSS_UNDECIDED
    assert solution is not None and solution.gnss_excluded_since_ns is None
    assert solution.protection_level_horizontal >= hypot(*difference[0][:2]) + difference[1][0] - 1e-9 > 15.0


def test_a_solution_without_gnss_that_never_contradicted_it_leaves_nothing_to_hold() -> None:
    nav = without_aiding(3.0)
    run(nav, 0.0, VERDICT_S)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False)
    run(nav, VERDICT_S, 110.0)
    assert nav.verdicts.conflict is None and nav.verdicts.unresolved is not None
    assert not nav.verdicts.held.is_open and not nav.engine.aids.error_monitor.held.is_open
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 110.0, 112.0)
    assert not nav.engine.aids.error_monitor.held.is_open


def test_a_solution_without_gnss_of_no_use_is_given_up_and_the_level_holds_their_last_useful_difference() -> None:
    nav = without_aiding(3.0)
    run(nav, 0.0, SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=40.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False)
    run(nav, VERDICT_S, 110.0, moved_m=40.0)
    assert nav.verdicts.conflict is None and nav.verdicts.unresolved is not None
    assert nav.verdicts.unresolved.code == Code.WITHOUT_GNSS_OF_NO_USE
    held_m = nav.engine.aids.error_monitor.held.bound[0]
    solution = nav.solution()
    assert held_m > 40.0 and solution is not None and solution.protection_level_horizontal > held_m
    assert solution.gnss_excluded_since_ns is None and solution.gnss_age_s is not None and solution.gnss_age_s < 2.0
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 110.0, 119.0)
    assert nav.engine.aids.error_monitor.held.bound[0] == held_m, "no time ends it"


def test_an_earlier_suspect_time_keeps_the_published_solution_until_the_new_replay_is_over() -> None:
    nav, _ = excluded_at(VERDICT_S, 70, 80.0, moved_m=8.0)
    assert nav.engine.exclusions.gnss_since_ns == 70 * SECOND_NS
    nav.apply_exclusions(50 * SECOND_NS, odometer_excluded=False)
    assert nav.engine.exclusions.gnss_since_ns == 70 * SECOND_NS, "not GNSS, which is suspect"
    run(nav, 80.0, 83.0, moved_m=8.0)
    assert nav.engine.exclusions.gnss_since_ns == 50 * SECOND_NS


def test_a_gap_of_the_imu_in_a_conflict_keeps_the_last_difference() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
    run(nav, VERDICT_S, 80.0, moved_m=8.0)
    run(nav, 82.0, 100.0, moved_m=8.0)
    assert nav.verdicts.unresolved == explain(Code.WITHOUT_GNSS_LOST)
    assert nav.engine.aids.error_monitor.held.bound[0] > 8.0 and error_m(nav) > 5.0


def test_a_state_saved_in_a_conflict_holds_the_difference_of_both_solutions() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
    run(nav, VERDICT_S, 80.0, moved_m=8.0)
    saved = nav.saved_state()
    assert saved is not None and saved.held.bound[0] > 8.0
    second = navigator()
    second.restore(saved, round(80.01 * SECOND_NS))
    run(second, 80.0, 85.0, moved_m=8.0)
    solution = second.solution()
    assert solution is not None and solution.protection_level_horizontal > max(8.0, error_m(second))


def test_a_second_conflict_after_a_decided_one_has_a_solution_without_gnss() -> None:
    nav, _ = excluded_at(VERDICT_S, SUSPECT_S, 85.0)
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 85.0, 95.0)
    nav.apply_exclusions(88 * SECOND_NS, odometer_excluded=False)
    run(nav, 95.0, 100.0)
    conflict = nav.verdicts.conflict
    assert conflict is not None and conflict.cursor is not None and conflict.levels_m[0] < 20.0
    assert nav.counts.fixes_used > 60, "counts of the drive go on"


def test_a_position_that_comes_back_closes_a_conflict_and_nothing_is_held() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
    run(nav, VERDICT_S, 80.0, moved_m=8.0)
    run(nav, 80.0, 100.0)
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 100.0, 101.0)
    assert nav.verdicts.conflict is None and not nav.engine.aids.error_monitor.held.is_open
    assert error_m(nav) < 3.0


def test_an_excluded_odometer_is_not_used_and_its_scale_covariance_is_reset() -> None:
    nav = fault_free(80)
    assert nav.engine.filter is not None
    known = nav.engine.filter.P[LAYOUT.index("odometer_scale"), LAYOUT.index("odometer_scale")]
    nav.apply_exclusions(None, odometer_excluded=True)
    outcomes = [o for o in run(nav, 80.0, 85.0, odometer=0.5) if o.kind is AidingKind.ODOMETER]
    late = [o for o in outcomes if o.time_ns > 80.1 * SECOND_NS]
    assert late and {(o.used, o.reason) for o in late} == {(False, "odometer is excluded by core.trust")}
    scale = LAYOUT.index("odometer_scale")
    assert nav.engine.filter.P[scale, scale] > max(known, 0.9 * 0.02**2)
    nav.apply_exclusions(None, odometer_excluded=False)
    again = [o for o in run(nav, 85.0, 88.0) if o.kind is AidingKind.ODOMETER and o.time_ns > 85.1 * SECOND_NS]
    assert again and any(o.used for o in again)


def test_an_exclusion_and_wrong_heights_outlive_a_clock_that_goes_back() -> None:
    nav, d = fault_free(70), drive()
    nav.apply_exclusions(None, odometer_excluded=True)
    nav.leave_out_heights(wrong=True)
    late = nav.measurements_late
    for i in range(300):  # stamps of the begin of the drive
        nav.imu(int(d.t_ns[i]), d.force_b[i].tolist(), d.rate_b[i].tolist())
    assert nav.counts.resets == 1 and nav.engine.exclusions.odometer and nav.measurements_late == late
    outcomes = run(nav, d.t_ns[299] / SECOND_NS, 50.0)
    heights = [o for o in outcomes if o.kind is AidingKind.GNSS_POSITION]
    assert heights and all(len(o.innovation) == 2 for o in heights)


def test_a_dual_antenna_heading_is_excluded_with_gnss_and_the_earliest_suspect_time_is_kept() -> None:
    heading, engine = BaselineHeading(10, 10, "gnss", 0.1, 0.01, 0.0), Engine(Settings())
    GnssExcluded(9, 5).apply(engine)
    assert engine.exclusions.reason(heading) == "GNSS is excluded by core.trust"
    for since_ns, kept_ns in ((8, 5), (3, 3)):
        GnssExcluded(20, since_ns).apply(engine)
        assert engine.exclusions.gnss_since_ns == kept_ns
    GnssReadmitted(2 * SECOND_NS + 3).apply(engine)
    assert engine.exclusions.reason(heading) is None and engine.exclusions.readmitted_after_s == 2.0
    OdometerExclusion(9, excluded=True).apply(engine)
    assert engine.exclusions.odometer and engine.exclusions.reason(heading) is None
    OdometerExclusion(9, excluded=False).apply(engine)
    assert not engine.exclusions.odometer


def test_a_held_offset_ends_by_the_operator_and_not_while_gnss_is_contradicted() -> None:
    nav = without_aiding(3.0)
    run(nav, 0.0, SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=40.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False)
    run(nav, VERDICT_S, 110.0, moved_m=40.0)
    assert nav.engine.aids.error_monitor.held.is_open and not nav.confirm_position()
    assert [explanation.code for explanation in nav.what_ends_the_held][-1] == Code.ENDS_BY_OPERATOR
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 110.0, 112.0, moved_m=40.0)
    assert nav.engine.aids.error_monitor.held.is_open and nav.confirm_position()
    run(nav, 112.0, 114.0, moved_m=40.0)
    assert not nav.engine.aids.error_monitor.held.is_open and nav.what_ends_the_held == ()


def test_a_contradiction_of_another_source_holds_nothing_where_that_one_is_wrong() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    nav.believe((), None, of_gnss=0.0)
    nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
    run(nav, VERDICT_S, 85.0, moved_m=8.0)
    nav.apply_exclusions(None, odometer_excluded=False)
    run(nav, 85.0, 86.0, moved_m=8.0)
    assert not nav.engine.aids.error_monitor.held.is_open


def test_an_offset_that_two_conflicts_have_seen_is_held_once() -> None:
    nav = fault_free(SUSPECT_S)
    run(nav, SUSPECT_S, VERDICT_S, moved_m=8.0)
    for begin_s, end_s in ((VERDICT_S, 85.0), (85.5, 95.0)):
        nav.apply_exclusions(SUSPECT_S * SECOND_NS, odometer_excluded=False, exclude=False)
        run(nav, begin_s, end_s, moved_m=8.0)
        nav.apply_exclusions(None, odometer_excluded=False)
        run(nav, end_s, end_s + 0.5, moved_m=8.0)
        held = nav.engine.aids.error_monitor.held
        assert hypot(*held.vector_n[:2]) == pytest.approx(8.0, abs=2.0)
        assert held.bound[0] < 16.0
