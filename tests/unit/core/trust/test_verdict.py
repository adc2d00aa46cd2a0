"""The verdict table: one test a row, precedence, and each fact raised alone."""

from dataclasses import replace

import pytest

from services.core.trust.facts import SECOND_NS, Facts, Limits, Monitor, Outcome, Solution, Statement
from services.core.trust.readmission import judge_gnss
from services.core.trust.verdict import ROWS, TrustState, Verdict, odometer_accused, verdict

NOW_NS = 1000 * SECOND_NS
SOLUTION = Solution(NOW_NS - SECOND_NS // 10, True, "navigating", 3.1, 5.2, 0.4)


def says(monitor: Monitor, outcome: Outcome = Outcome.PASS, *accused: str, reason: str = "within limits") -> Statement:
    suspect_ns = NOW_NS - 12 * SECOND_NS if outcome is Outcome.ACCUSES else None
    return Statement(
        monitor, outcome, NOW_NS - SECOND_NS // 2, reason, accused, statistic=31.4, threshold=19.5,
        suspect_since_ns=suspect_ns,
    )  # fmt: skip


SAFE = Facts(NOW_NS, SOLUTION, {monitor: says(monitor) for monitor in Monitor})


def with_(facts: Facts, *statements: Statement) -> Facts:
    return replace(facts, statements={**facts.statements, **{new.monitor: new for new in statements}})


def accuses(monitor: Monitor, *accused: str) -> Statement:
    return says(monitor, Outcome.ACCUSES, *accused, reason="difference of velocity 3.2 m/s")


def undecided(monitor: Monitor, reason: str = "below 1 m/s") -> Statement:
    return says(monitor, Outcome.NOT_EVALUATED, reason=reason)


def levels(horizontal: float | None, vertical: float | None) -> Facts:
    solution = replace(SOLUTION, protection_level_horizontal_m=horizontal, protection_level_vertical_m=vertical)
    return replace(SAFE, solution=solution)


EXCLUDED = replace(SAFE, conflict_open=True, gnss_excluded=True, exclusion_confirmed=True)
OPEN = replace(SAFE, conflict_open=True)
BOTH_KNOWN = replace(OPEN, other_distance_m=4.2, other_level_m=5.5)
GIVEN_UP = replace(OPEN, exclusion_declined="without GNSS the level is 31 m", held="positions differ by 6.5 m")
WITHOUT_G05 = replace(SAFE, satellites_left_out=frozenset({"G05"}))
MOTION_CONFLICT = accuses(Monitor.MOTION, "gnss", "odometer")
SILENT = replace(says(Monitor.INERTIAL_LONG), stated_ns=NOW_NS - 8 * SECOND_NS)

CASES = [
    pytest.param(replace(SAFE, solution=None), 1, "initialising", "no navigation solution yet", id="1-none"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, sampled_ns=NOW_NS - 4 * SECOND_NS)), 2, "no_fix",
                 "navigation solution is 4.0 s old, limit 2.0 s", id="2-stale"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, navigating=False, phase="waiting_for_gnss")), 2, "no_fix",
                 "fusion's phase is waiting_for_gnss", id="2-lost"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, sampled_ns=NOW_NS + 60 * SECOND_NS)), 2, "no_fix",
                 "-60.0 s old", id="2-stamp-ahead"),
    pytest.param(levels(10.1, 5.0), 3, "unsafe",
                 "horizontal protection level 10.1 m is above the alert limit of 10.0 m", id="3-horizontal"),
    pytest.param(levels(3.0, 23.4), 3, "unsafe",
                 "vertical protection level 23.4 m is above the alert limit of 20.0 m", id="3-vertical"),
    pytest.param(levels(None, 5.0), 3, "unsafe", "horizontal protection level is missing", id="3-missing"),
    pytest.param(with_(SAFE, accuses(Monitor.INERTIAL_SHORT, "gnss")), 4, "unsafe",
                 "monitor inertial_short suspects gnss: difference of velocity 3.2 m/s (statistic 31.4, threshold 19.5)"
                 ", suspect for 12 s; fusion has not computed", id="4-short"),
    pytest.param(with_(replace(OPEN, gnss_excluded=True), accuses(Monitor.INERTIAL_LONG, "gnss")), 4, "unsafe",
                 "fusion has not computed the solution without GNSS yet", id="4-unconfirmed"),
    pytest.param(OPEN, 4, "unsafe", "GNSS has not agreed for long enough", id="4-healthy-time"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "G05", "E11")), 5, "unsafe",
                 "monitor satellites suspects G05 or E11", id="5-satellites"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05", "E11")), 5, "unsafe",
                 "the position in use contains the fault", id="5-one-of-two"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "gnss")), 5, "unsafe", "suspects gnss", id="5-unidentified"),
    pytest.param(with_(SAFE, MOTION_CONFLICT, undecided(Monitor.INERTIAL_LONG)), 6, "unsafe",
                 "inertial monitors cannot tell (inertial_long: below 1 m/s)", id="6-long"),
    pytest.param(with_(SAFE, accuses(Monitor.MOTION_FAST, "gnss", "odometer"), undecided(Monitor.INERTIAL_SHORT)), 6,
                 "unsafe", "monitor motion_fast suspects gnss or odometer", id="6-fast"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.INERTIAL_LONG, "gnss")), 7, "dead_reckoning",
                 "GNSS is excluded, position by dead reckoning: monitor inertial_long suspects gnss", id="7-accused"),
    pytest.param(EXCLUDED, 7, "dead_reckoning", "until it has agreed", id="7-healthy-time"),
    pytest.param(with_(EXCLUDED, MOTION_CONFLICT, undecided(Monitor.INERTIAL_LONG)), 7, "dead_reckoning",
                 "GNSS is excluded", id="7-motion-conflict-of-an-excluded-gnss"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.SATELLITES, "G05")), 7, "dead_reckoning", "GNSS is excluded",
                 id="7-satellite-fault-outside"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=7.5)), 8, "dead_reckoning",
                 "no GNSS fix used for 7.5 s, limit 3.0 s", id="8-coasting"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=None)), 8, "dead_reckoning", "no GNSS fix",
                 id="8-never"),
    pytest.param(with_(BOTH_KNOWN, accuses(Monitor.INERTIAL_SHORT, "gnss", "imu")), 9, "caution",
                 "the solution with GNSS is 4.2 m from the one without it, whose own level is 5.5 m", id="9-both"),
    pytest.param(GIVEN_UP, 9, "caution",
                 "without GNSS the level is 31 m; the level holds: positions differ by 6.5 m", id="9-left"),
    pytest.param(with_(SAFE, MOTION_CONFLICT), 9, "caution",
                 "inertial monitors agree with GNSS, the odometer is no longer used", id="9-odometer"),
    pytest.param(with_(SAFE, accuses(Monitor.MOTION, "gnss")), 9, "caution",
                 "inertial monitors agree with GNSS, nothing is excluded", id="9-gnss"),
    pytest.param(with_(SAFE, accuses(Monitor.EVIDENCE, "gnss")), 10, "caution", "monitor evidence suspects gnss",
                 id="10-evidence"),
    pytest.param(with_(SAFE, SILENT), 11, "caution",
                 "monitor inertial_long: no message for 8.0 s, not evaluated since 992.0 s", id="11-silent"),
    pytest.param(replace(SAFE, statements={m: s for m, s in SAFE.statements.items() if m is not Monitor.EVIDENCE}), 11,
                 "caution", "monitor evidence: has not published yet", id="11-never"),
    pytest.param(with_(SAFE, *(undecided(monitor) for monitor in
                 (Monitor.SATELLITES, Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG))), 12, "caution",
                 "no independent check of the position is evaluated: inertial_short: below 1 m/s", id="12-none"),
    pytest.param(levels(8.4, 5.0), 13, "caution",
                 "horizontal protection level 8.4 m is above 80 % of the alert limit of 10.0 m", id="13-horizontal"),
    pytest.param(levels(3.0, 16.1), 13, "caution", "vertical protection level 16.1 m", id="13-vertical"),
    pytest.param(SAFE, 14, "safe", "protection levels 3.1 m horizontal and 5.2 m vertical", id="14-safe"),
    pytest.param(with_(SAFE, undecided(Monitor.SATELLITES, "no raw measurements")), 14, "safe",
                 "no monitor suspects GNSS", id="14-inertial-windows-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.INERTIAL_SHORT), undecided(Monitor.INERTIAL_LONG)), 14, "safe",
                 "no monitor suspects GNSS", id="14-satellites-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.MOTION, "warming up: 12 of 30 moving samples")), 14, "safe",
                 "no monitor suspects GNSS", id="14-motion-warms-up"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05")), 14,
                 "safe", "no monitor suspects GNSS", id="14-satellite-excluded"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "neighbour 17")), 14, "safe", "no monitor suspects GNSS",
                 id="14-neighbour"),
]  # fmt: skip


@pytest.mark.parametrize(("facts", "row", "state", "reason"), CASES)
def test_the_first_row_that_matches_decides(facts: Facts, row: int, state: str, reason: str) -> None:
    found = verdict(facts)
    assert (found.row, str(found.state)) == (row, state)
    assert reason in found.reasons[0]


def test_every_row_of_the_table_has_a_case() -> None:
    assert {case.values[1] for case in CASES} == set(range(1, len(ROWS) + 2))


def test_exactly_at_the_alert_limit_and_at_its_share_the_lower_state_is_not_taken() -> None:
    assert verdict(levels(10.0, 20.0)).row == 13
    assert verdict(levels(8.0, 16.0)).row == 14


def test_an_earlier_row_wins_over_every_later_one_and_the_later_reasons_follow() -> None:
    facts = with_(levels(11.0, 5.0), accuses(Monitor.INERTIAL_SHORT, "gnss"), accuses(Monitor.EVIDENCE, "gnss"), SILENT)
    found = verdict(facts)
    assert found.row == 3
    assert len(found.reasons) == 5  # rows 3, 4, 10, 11 and 13
    assert ["suspects gnss" in reason for reason in found.reasons] == [False, True, True, False, False]


ALONE = [
    (
        accuses(Monitor.MOTION, "gnss", "odometer"),
        9,
        ("gnss is suspected, and still used", "odometer is suspected, and not used"),
    ),
    (accuses(Monitor.MOTION_FAST, "odometer"), 9, ("odometer is suspected, and not used",)),
    (accuses(Monitor.INERTIAL_SHORT, "gnss"), 4, ("gnss is suspected, and still used",)),
    (accuses(Monitor.INERTIAL_LONG, "gnss"), 4, ("gnss is suspected, and still used",)),
    (accuses(Monitor.SATELLITES, "G05"), 5, ("G05 is suspected",)),
    (accuses(Monitor.EVIDENCE, "gnss"), 10, ("gnss is suspected, and still used",)),
]


@pytest.mark.parametrize(("raised", "row", "findings"), ALONE, ids=[str(case[0].monitor) for case in ALONE])
def test_each_flag_raised_alone_matches_exactly_its_own_row_and_names_exactly_its_own_finding(
    raised: Statement, row: int, findings: tuple[str, ...]
) -> None:
    found = verdict(with_(SAFE, raised))
    assert found == Verdict(ROWS[row - 1][0], row, found.reasons, findings)
    assert len(found.reasons) == 1
    assert str(raised.monitor) in found.reasons[0]
    assert not any(str(other) + " suspects" in found.reasons[0] for other in Monitor if other is not raised.monitor)


@pytest.mark.parametrize("monitor", Monitor)
def test_a_monitor_that_dies_makes_the_verdict_caution_within_its_deadline(monitor: Monitor) -> None:
    deadline_s = Limits().silent_after_s[monitor]
    for age_s, state in ((deadline_s - 0.1, TrustState.SAFE), (deadline_s + 0.1, TrustState.CAUTION)):
        last = replace(says(monitor), stated_ns=NOW_NS - round(age_s * SECOND_NS))
        found = verdict(with_(SAFE, last))
        assert found.state is state
        assert ("not evaluated since" in found.reasons[0]) == (state is TrustState.CAUTION)


@pytest.mark.parametrize("monitor", Monitor)
def test_a_dead_monitor_neither_accuses_nor_passes(monitor: Monitor) -> None:
    old = replace(accuses(monitor, "gnss"), stated_ns=NOW_NS - 60 * SECOND_NS)
    facts = with_(SAFE, old)
    silent = facts.statement(monitor)
    assert (silent.outcome, silent.accused, silent.statistic) == (Outcome.NOT_EVALUATED, (), None)
    assert not any("accused" in finding for finding in verdict(facts).findings)
    assert verdict(facts).state is TrustState.CAUTION


def test_a_statement_with_a_stamp_ahead_does_not_stay_fresh_for_ever() -> None:
    facts = with_(SAFE, replace(says(Monitor.SATELLITES), stated_ns=NOW_NS + 100 * SECOND_NS))
    assert verdict(facts).row == 11
    assert "stamp is 100.0 s ahead" in verdict(facts).reasons[0]


def test_a_monitor_that_is_not_required_may_be_absent() -> None:
    without: dict[Monitor, Statement] = {
        m: s for m, s in SAFE.statements.items() if m not in (Monitor.MOTION, Monitor.MOTION_FAST)
    }
    limits = Limits(required=frozenset(Monitor) - {Monitor.MOTION, Monitor.MOTION_FAST})
    assert verdict(replace(SAFE, statements=without)).row == 11
    assert verdict(replace(SAFE, statements=without, limits=limits)).state is TrustState.SAFE


def test_the_odometer_is_accused_only_if_both_inertial_windows_pass() -> None:
    assert odometer_accused(with_(SAFE, MOTION_CONFLICT))
    assert not odometer_accused(with_(SAFE, MOTION_CONFLICT, undecided(Monitor.INERTIAL_SHORT)))
    assert not odometer_accused(with_(SAFE, MOTION_CONFLICT, accuses(Monitor.INERTIAL_LONG, "gnss")))
    assert not odometer_accused(SAFE)


def test_states_are_lower_case_words_on_the_wire() -> None:
    assert {str(state) for state in TrustState} == {
        "safe", "caution", "unsafe", "dead_reckoning", "no_fix", "initialising",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("lead_s", "accusing", "expected"),
    [
        (5.0, (Monitor.INERTIAL_LONG,), (True, False)),
        (1.0, (Monitor.INERTIAL_LONG,), (False, True)),
        (None, (Monitor.INERTIAL_LONG,), (False, True)),
        (5.0, (Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG), (True, False)),
    ],
    ids=["odometer first", "at the same time, as in a drag-off", "odometer not accused", "the short window too"],
)
def test_a_long_window_that_accuses_gnss_after_the_odometer_was_excluded_keeps_that_out_and_gnss_in(
    lead_s: float | None, accusing: tuple[Monitor, ...], expected: tuple[bool, bool]
) -> None:
    """The long window uses the odometer. The position stays UNSAFE: one of the two is wrong."""
    since_ns = None if lead_s is None else NOW_NS - round((2.0 + lead_s) * SECOND_NS)
    statements = [replace(accuses(monitor, "gnss"), since_ns=NOW_NS - 2 * SECOND_NS) for monitor in accusing]
    facts = replace(
        with_(SAFE, MOTION_CONFLICT, *statements), odometer_excluded_since_ns=since_ns, odometer_in_use=True
    )
    assert (odometer_accused(facts), judge_gnss(facts).decided) == expected
    assert judge_gnss(facts).accused, "one of the two is wrong: the conflict is open"
    assert verdict(facts).state is TrustState.UNSAFE
