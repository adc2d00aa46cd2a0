"""The verdict table: one test a row, precedence, and each fact raised alone."""

from dataclasses import replace

import pytest

from services.core.trust.codes import Code
from services.core.trust.facts import (
    REQUIRED,
    SECOND_NS,
    Alternative,
    Facts,
    Limits,
    Monitor,
    Posterior,
    Solution,
    Statement,
)
from services.core.trust.verdict import ENDS_AT_PLACE, HELD_AT_START, ROWS, Explanations, Verdict, verdict
from shared.messages.explanation import Explanation, Reference, ReferenceKind, explain
from shared.messages.trust import Hypothesis, Outcome, TrustLevel
from shared.words.words import words
from tests.support.cases import each

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


def source(name: str) -> Reference:
    return Reference(kind=ReferenceKind.SOURCE, name=name)


def satellite(name: str) -> Reference:
    return Reference(kind=ReferenceKind.SATELLITE, name=name)


def codes(explanations: Explanations) -> list[str]:
    return [explanation.code for explanation in explanations]


def believed(hypothesis: Hypothesis, probability: float, *, acted_on: bool = False) -> Posterior:
    return Posterior(hypothesis, 1e-3, probability, True, acted_on, NOW_NS - 12 * SECOND_NS)


EXCLUDED = replace(SAFE, conflict_open=True, gnss_excluded=True, exclusion_confirmed=True)
OPEN = replace(SAFE, conflict_open=True)
GIVEN_UP = replace(OPEN, exclusion_declined=True, held_m=(6.5, 0.0))
WITHOUT_G05 = replace(SAFE, satellites_left_out=frozenset({"G05"}))
SILENT = replace(says(Monitor.INERTIAL_LONG), stated_ns=NOW_NS - 8 * SECOND_NS)

GNSS_OR_IMU = (believed(Hypothesis.IMU, 0.6), believed(Hypothesis.GNSS, 0.39))
GNSS_ALONE = (believed(Hypothesis.GNSS, 0.999, acted_on=True),)
ODOMETER_ALONE = (believed(Hypothesis.ODOMETER, 0.998, acted_on=True),)
MANY = tuple(believed(hypothesis, 0.3) for hypothesis in (Hypothesis.GNSS, Hypothesis.IMU, Hypothesis.ODOMETER))
ALIKE = (believed(Hypothesis.GNSS_AND_ODOMETER, 0.7), believed(Hypothesis.IMU, 0.3))
KNOWN = {
    Hypothesis.IMU: Alternative(4.0, 3.0, True), Hypothesis.ODOMETER: Alternative(1.0, 2.0, True),
    Hypothesis.GNSS_AND_ODOMETER: Alternative(6.0, 9.0, False),
}  # fmt: skip
BOTH_KNOWN = replace(OPEN, other_distance_m=4.2, other_level_m=5.5, beliefs=GNSS_OR_IMU, alternatives=KNOWN)
AT_PLACE = explain(ENDS_AT_PLACE, distance_m=800.0)
AT_START = explain(HELD_AT_START, horizontal_m=13.0, vertical_m=0.0)
AFTER_LOSS = explain("fusion.held_after_loss", horizontal_m=13.0, vertical_m=0.0, needed_m=500.0, driven_m=0.0)
CASES = [
    pytest.param(replace(SAFE, solution=None), 1, (Code.NO_SOLUTION_YET,), id="1-none"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, sampled_ns=NOW_NS - 4 * SECOND_NS)), 2,
                 (explain(Code.SOLUTION_OLD, age_s=4.0, limit_s=2.0),), id="2-stale"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, navigating=False, phase="waiting_for_gnss")), 2,
                 (explain(Code.SOLUTION_LOST, phase="waiting_for_gnss"),), id="2-lost"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, sampled_ns=NOW_NS + 60 * SECOND_NS)), 2,
                 (explain(Code.SOLUTION_OLD, age_s=-60.0, limit_s=2.0),), id="2-stamp-ahead"),
    pytest.param(levels(10.1, 5.0), 3,
                 (explain(Code.LEVEL_ABOVE_LIMIT, axis="horizontal", level_m=10.1, limit_m=10.0),), id="3-horizontal"),
    pytest.param(levels(3.0, 23.4), 3,
                 (explain(Code.LEVEL_ABOVE_LIMIT, axis="vertical", level_m=23.4, limit_m=20.0),), id="3-vertical"),
    pytest.param(levels(None, 5.0), 3, (explain(Code.LEVEL_MISSING, axis="horizontal"),), id="3-missing"),
    pytest.param(replace(levels(12.0, 5.0), beliefs=GNSS_OR_IMU, alternatives=KNOWN), 3,
                 (explain(Code.UNSAFE_SUSPECTED, suspects=("imu", "gnss")), Code.HYPOTHESIS, Code.LEVEL_ABOVE_LIMIT),
                 id="3-suspected"),
    pytest.param(replace(levels(12.0, 5.0), beliefs=MANY, alternatives=KNOWN), 3,
                 (Code.UNSAFE_MANY_SUSPECTED, Code.LEVEL_ABOVE_LIMIT), id="3-many"),
    pytest.param(replace(levels(12.0, 5.0), conflict_open=True, other_level_m=3.0), 3,
                 (Code.UNSAFE_CONFLICT, Code.LEVEL_ABOVE_LIMIT), id="3-conflict"),
    pytest.param(replace(levels(12.0, 5.0), conflict_open=True, gnss_excluded=True, exclusion_confirmed=True), 3,
                 (Code.UNSAFE_DEAD_RECKONING, Code.LEVEL_ABOVE_LIMIT, Code.GNSS_EXCLUDED), id="3-dead-reckoning"),
    pytest.param(replace(levels(16.0, 5.0), held_m=(13.0, 0.0), held_why=()), 3,
                 (Code.UNSAFE_HELD, Code.LEVEL_ABOVE_LIMIT), id="3-held"),
    pytest.param(replace(levels(16.0, 5.0), held_m=(13.0, 0.0), held_why=(AT_PLACE,)), 3,
                 (Code.UNSAFE_HELD_NEAR_PLACE, Code.LEVEL_ABOVE_LIMIT), id="3-held-near-a-place"),
    pytest.param(replace(levels(16.0, 5.0), held_m=(13.0, 0.0), held_why=(AT_START,)), 3,
                 (Code.UNSAFE_HELD_AT_START, Code.LEVEL_ABOVE_LIMIT), id="3-held-at-start"),
    pytest.param(replace(levels(16.0, 5.0), held_m=(13.0, 0.0), held_why=(AFTER_LOSS,)), 3,
                 (Code.UNSAFE_HELD_AFTER_LOSS, Code.LEVEL_ABOVE_LIMIT), id="3-held-after-loss"),
    pytest.param(replace(levels(16.0, 5.0), held_m=(2.0, 0.0)), 3, (Code.LEVEL_ABOVE_LIMIT,), id="3-held-too"),
    pytest.param(with_(SAFE, accuses(Monitor.INERTIAL_SHORT, "gnss")), 4,
                 (Code.NO_SOLUTION_WITHOUT_GNSS,
                  explain(Code.MONITOR_SUSPECTS, monitor="inertial_short", accused=(source("gnss"),), statistic=31.4,
                          threshold=19.5, since_ns=NOW_NS - 12 * SECOND_NS)), id="4-short"),
    pytest.param(with_(SAFE, replace(accuses(Monitor.INERTIAL_SHORT, "gnss"), statistic=None)), 4,
                 (Code.NO_SOLUTION_WITHOUT_GNSS, Code.MONITOR_SUSPECTS_BY_RULE), id="4-without-statistic"),
    pytest.param(with_(replace(OPEN, gnss_excluded=True), accuses(Monitor.INERTIAL_LONG, "gnss")), 4,
                 (Code.NO_SOLUTION_WITHOUT_GNSS,), id="4-unconfirmed"),
    pytest.param(OPEN, 4, (Code.NO_SOLUTION_WITHOUT_GNSS, Code.GNSS_NOT_AGREED), id="4-healthy-time"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "G05", "E11")), 4,
                 (explain(Code.SATELLITE_IN_USE, satellites=(satellite("G05"), satellite("E11"))),), id="4-satellites"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05", "E11")), 4,
                 (explain(Code.SATELLITE_IN_USE, satellites=(satellite("E11"),)),), id="4-one-of-two"),
    pytest.param(replace(SAFE, beliefs=ALIKE), 4,
                 (explain(Code.UNSAFE_SUSPECTED, suspects=("gnss_and_odometer", "imu")), Code.NO_OTHER_SOLUTION),
                 id="4-alike"),
    pytest.param(replace(SAFE, beliefs=ODOMETER_ALONE, odometer_in_use=True), 4,
                 (Code.UNSAFE_SUSPECTED, explain(Code.NO_OTHER_SOLUTION, hypothesis="odometer")), id="4-odometer"),
    pytest.param(replace(EXCLUDED, beliefs=ALIKE), 4, (Code.NO_OTHER_SOLUTION, Code.GNSS_EXCLUDED), id="4-excluded"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.INERTIAL_LONG, "gnss")), 5,
                 (Code.GNSS_EXCLUDED, Code.MONITOR_SUSPECTS), id="5-accused"),
    pytest.param(EXCLUDED, 5, (Code.GNSS_EXCLUDED, Code.GNSS_NOT_AGREED), id="5-healthy-time"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.SATELLITES, "G05")), 5, (Code.GNSS_EXCLUDED,),
                 id="5-satellite-fault-outside"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=7.5)), 5,
                 (explain(Code.GNSS_MISSING, age_s=7.5, limit_s=3.0),), id="5-coasting"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=None)), 5, (Code.NO_GNSS_YET,), id="5-never"),
    pytest.param(with_(BOTH_KNOWN, accuses(Monitor.INERTIAL_SHORT, "gnss", "imu")), 6,
                 (explain(Code.SUSPECTED, suspects=("imu", "gnss")), explain(Code.DECIDED_BY, means="odometer"),
                  explain(Code.HYPOTHESIS, hypothesis="imu", probability=0.6), Code.MONITOR_SUSPECTS,
                  explain(Code.SOLUTIONS_APART, other="without_gnss", distance_m=4.2, level_m=5.5)), id="6-both"),
    pytest.param(replace(SAFE, beliefs=MANY, alternatives=KNOWN), 6, (Code.MANY_SUSPECTED,), id="6-many"),
    pytest.param(replace(GIVEN_UP, beliefs=()), 6,
                 (Code.CONFLICT, Code.EXCLUSION_DECLINED, explain(Code.LEVEL_HELD, horizontal_m=6.5, vertical_m=0.0)),
                 id="6-left"),
    pytest.param(replace(SAFE, beliefs=ODOMETER_ALONE, odometer_excluded=True), 6,
                 (explain(Code.SOURCE_LEFT_OUT, hypothesis="odometer"),
                  explain(Code.HYPOTHESIS, hypothesis="odometer", probability=0.998)), id="6-odometer"),
    pytest.param(replace(SAFE, imu_excluded=True, imu_exclusion_confirmed=True), 6, (Code.IMU_NOT_AGREED,), id="6-imu"),
    pytest.param(replace(SAFE, beliefs=ALIKE, alternatives=KNOWN), 6,
                 (Code.SUSPECTED, explain(Code.DECIDED_BY, means="bends")), id="6-alike"),
    pytest.param(with_(SAFE, accuses(Monitor.EVIDENCE, "gnss")), 6, (Code.GNSS_DISTURBED, Code.MONITOR_SUSPECTS),
                 id="6-evidence"),
    pytest.param(with_(SAFE, replace(says(Monitor.INERTIAL_LONG), doubtful=True)), 6,
                 (explain(Code.MONITOR_DOUBTFUL, monitor="inertial_long"),), id="6-doubt"),
    pytest.param(with_(SAFE, replace(undecided(Monitor.MOTION), doubtful=True)), 6,
                 (explain(Code.MONITOR_DOUBTFUL, monitor="motion"),), id="6-doubt-without-a-result"),
    pytest.param(with_(SAFE, SILENT), 7,
                 (explain(Code.MONITOR_SILENT, monitor="inertial_long", since_ns=992 * SECOND_NS),), id="7-silent"),
    pytest.param(replace(SAFE, statements={m: s for m, s in SAFE.statements.items() if m is not Monitor.EVIDENCE}), 7,
                 (explain(Code.MONITORS_MISSING, monitors=("evidence",)),), id="7-never"),
    pytest.param(with_(SAFE, *(undecided(monitor) for monitor in
                 (Monitor.SATELLITES, Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG))), 7,
                 (Code.NO_INDEPENDENT_CHECK, Code.NOT_EVALUATED), id="7-none"),
    pytest.param(replace(SAFE, checks_paused=True), 7, (Code.CHECKS_PAUSED,), id="7-paused"),
    pytest.param(replace(OPEN, disturbed_since_ns=1), 6, (Code.GNSS_BACK,), id="6-back"),
    *(
        pytest.param(replace(SAFE, start_unconfirmed=explain(code)), 7, (code,), id=f"7-{code}")
        for code in (Code.START_UNKNOWN, Code.START_IN_MOTION, Code.START_AFTER_CUT)
    ),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_only=True)), 7, (Code.NO_INERTIAL_UNIT,), id="7-no-imu"),
    pytest.param(levels(8.4, 5.0), 8,
                 (explain(Code.LEVEL_NEAR_LIMIT, axis="horizontal", level_m=8.4, limit_m=10.0, share=0.8),),
                 id="8-horizontal"),
    pytest.param(levels(3.0, 16.1), 8, (Code.LEVEL_NEAR_LIMIT,), id="8-vertical"),
    pytest.param(SAFE, 9, (explain(Code.SAFE, horizontal_m=3.1, vertical_m=5.2, horizontal_limit_m=10.0,
                                   vertical_limit_m=20.0),), id="9-safe"),
    pytest.param(replace(WITHOUT_G05, beliefs=(believed(Hypothesis.SATELLITES, 0.999, acted_on=True),)), 9,
                 (Code.SAFE_WITHOUT_SATELLITES,), id="9-satellites-acted-on"),
    pytest.param(with_(SAFE, undecided(Monitor.SATELLITES, "no raw measurements")), 9, (Code.SAFE,),
                 id="9-inertial-windows-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.INERTIAL_SHORT), undecided(Monitor.INERTIAL_LONG)), 9, (Code.SAFE,),
                 id="9-satellites-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.MOTION, "warming up: 12 of 30 moving samples")), 9, (Code.SAFE,),
                 id="9-motion-warms-up"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05")), 9, (Code.SAFE,), id="9-satellite-excluded"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "neighbour 17")), 9, (Code.SAFE,), id="9-neighbour"),
]  # fmt: skip


@each(("facts", "row", "reasons"), CASES)
def test_the_first_row_that_matches_decides(facts: Facts, row: int, reasons: tuple[Code | Explanation, ...]) -> None:
    found = verdict(facts)
    state = ROWS[row - 1][0] if row <= len(ROWS) else TrustLevel.SAFE
    assert (found.row, found.state) == (row, state)
    places = [
        next(place for place, reason in enumerate(found.reasons) if wanted in (reason, reason.code))
        for wanted in reasons
    ]
    assert places[0] == 0 and places == sorted(places)
    assert words().sentence(found.reasons[0]), "what decides has a sentence"
    assert all(words().detail(explanation) for explanation in (*found.reasons, *found.findings)), (
        "values fit their rows"
    )


def test_every_code_is_a_reason_or_a_finding_of_some_case() -> None:
    verdicts = [verdict(facts) for facts, *_ in (case.values for case in CASES) if isinstance(facts, Facts)]
    found = {explanation.code for made in verdicts for explanation in (*made.reasons, *made.findings)}
    # of a monitor or of a hypothesis, in tests of their own
    others = {
        Code.WINDOW_REACHES_BACK, Code.MONITOR_AHEAD, Code.NOT_COMPARABLE, Code.HARDLY_MOVES, Code.SOLUTIONS_COMPARED,
        Code.NO_TWO_AGREE, Code.NO_ACCUSATION, Code.FALSE_ALARMS, Code.NO_EVIDENCE, Code.SUPPORTED, Code.CONTRADICTED,
        Code.DISPUTED, Code.HAS_TO_LAST, Code.LEVEL_HAS_TO_FALL,
    }  # fmt: skip
    facts = replace(with_(SAFE, accuses(Monitor.EVIDENCE, "gnss", "odometer")), odometer_excluded=True)
    found |= {finding.code for finding in verdict(replace(facts, fixes_late_s=0.6)).findings}
    assert set(Code) - found - others == set()


def test_late_fixes_are_waited_for_by_as_much_as_they_are_late() -> None:
    assert SAFE.solution is not None
    old = replace(SAFE, solution=replace(SAFE.solution, gnss_age_s=4.0))
    assert verdict(old).row == 5 and verdict(replace(old, merge_lag_s=1.5)).row == 5
    late = verdict(replace(old, merge_lag_s=2.5, fixes_late_s=1.6))
    assert late.row == 9 and Code.FIXES_LATE in codes(late.findings)


def test_every_row_of_the_table_has_a_case() -> None:
    assert {case.values[1] for case in CASES} == set(range(1, len(ROWS) + 2))


def test_exactly_at_the_alert_limit_and_at_its_share_the_lower_state_is_not_taken() -> None:
    assert verdict(levels(10.0, 20.0)).row == 8
    assert verdict(levels(8.0, 16.0)).row == 9


def test_an_earlier_row_wins_over_every_later_one_and_the_later_reasons_follow() -> None:
    facts = with_(levels(11.0, 5.0), accuses(Monitor.INERTIAL_SHORT, "gnss"), accuses(Monitor.EVIDENCE, "gnss"), SILENT)
    found = verdict(facts)
    assert found.row == 3
    assert codes(found.reasons) == [
        Code.LEVEL_ABOVE_LIMIT, Code.NO_SOLUTION_WITHOUT_GNSS, Code.MONITOR_SUSPECTS, Code.GNSS_DISTURBED,
        Code.MONITOR_SUSPECTS, Code.MONITOR_SILENT,
    ]  # fmt: skip  # of rows 3, 4, 6 and 7


ALONE = [
    (accuses(Monitor.INERTIAL_SHORT, "gnss"), 4, (explain(Code.ACCUSED_IN_USE, source("gnss")),)),
    (accuses(Monitor.INERTIAL_LONG, "gnss", "imu"), 4,
     (explain(Code.ACCUSED_IN_USE, source("gnss")), explain(Code.ACCUSED_IN_USE, source("imu")))),
    (accuses(Monitor.SATELLITES, "G05"), 4, (explain(Code.ACCUSED, satellite("G05")),)),
    (accuses(Monitor.EVIDENCE, "gnss"), 6, (explain(Code.ACCUSED_IN_USE, source("gnss")),)),
]  # fmt: skip


@pytest.mark.parametrize(("raised", "row", "findings"), ALONE, ids=[str(case[0].monitor) for case in ALONE])
def test_each_flag_raised_alone_matches_exactly_its_own_row_and_names_exactly_its_own_finding(
    raised: Statement, row: int, findings: Explanations
) -> None:
    found = verdict(with_(SAFE, raised))
    assert found == Verdict(ROWS[row - 1][0], row, found.reasons, findings)
    suspecting = [reason.values["monitor"] for reason in found.reasons if reason.code == Code.MONITOR_SUSPECTS]
    assert suspecting == [raised.monitor]


@pytest.mark.parametrize("monitor", REQUIRED)
def test_a_monitor_that_dies_makes_the_verdict_caution_within_its_deadline(monitor: Monitor) -> None:
    deadline_s = Limits().silent_after_s[monitor]
    for age_s, state in ((deadline_s - 0.1, TrustLevel.SAFE), (deadline_s + 0.1, TrustLevel.CAUTION)):
        last = replace(says(monitor), stated_ns=NOW_NS - round(age_s * SECOND_NS))
        found = verdict(with_(SAFE, last))
        assert found.state is state
        assert (found.reasons[0].code == Code.MONITOR_SILENT) == (state is TrustLevel.CAUTION)


@pytest.mark.parametrize("monitor", REQUIRED)
def test_a_dead_monitor_neither_accuses_nor_passes(monitor: Monitor) -> None:
    old = replace(accuses(monitor, "gnss"), stated_ns=NOW_NS - 60 * SECOND_NS)
    facts = with_(SAFE, old)
    silent = facts.statement(monitor)
    assert (silent.outcome, silent.accused, silent.statistic) == (Outcome.NOT_EVALUATED, (), None)
    assert not set(codes(verdict(facts).findings)) & {Code.ACCUSED, Code.ACCUSED_IN_USE, Code.ACCUSED_LEFT_OUT}
    assert verdict(facts).state is TrustLevel.CAUTION


def test_a_statement_with_a_stamp_ahead_does_not_stay_fresh_for_ever() -> None:
    facts = with_(SAFE, replace(says(Monitor.SATELLITES), stated_ns=NOW_NS + 100 * SECOND_NS))
    assert verdict(facts).row == 7
    assert verdict(facts).reasons == (explain(Code.MONITOR_AHEAD, monitor="satellites", ahead_s=100.0),)


def test_a_monitor_that_is_not_required_may_be_absent() -> None:
    without: dict[Monitor, Statement] = {
        m: s for m, s in SAFE.statements.items() if m not in (Monitor.MOTION, Monitor.MOTION_FAST)
    }
    limits = Limits(required=frozenset(REQUIRED) - {Monitor.MOTION, Monitor.MOTION_FAST})
    assert verdict(replace(SAFE, statements=without)).row == 7
    assert verdict(replace(SAFE, statements=without, limits=limits)).state is TrustLevel.SAFE


def test_a_neighbour_that_is_accused_is_named_by_its_number() -> None:
    found = verdict(with_(SAFE, accuses(Monitor.SATELLITES, "neighbour 17")))
    assert found.findings == (explain(Code.ACCUSED, Reference(kind=ReferenceKind.NEIGHBOUR, name="17")),)


def test_a_position_is_never_safe_while_checks_are_paused_and_worse_states_stand() -> None:
    slow = verdict(replace(SAFE, checks_paused=True))
    assert (slow.state, slow.row) == (TrustLevel.CAUTION, 7)
    assert codes(slow.findings) == [Code.CHECKS_PAUSED]
    assert verdict(replace(levels(10.1, 5.0), checks_paused=True)).state is TrustLevel.UNSAFE


def test_the_reasons_say_what_is_held_and_what_would_end_it() -> None:
    found = verdict(replace(levels(16.0, 5.0), held_m=(13.0, 0.0), held_why=(AT_PLACE,)))
    assert codes(found.reasons)[-2:] == [Code.LEVEL_HELD, ENDS_AT_PLACE]
