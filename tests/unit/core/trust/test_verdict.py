"""The verdict table: one test a row, precedence, and each fact raised alone."""

from dataclasses import replace

import pytest

from services.core.trust.facts import (
    REQUIRED,
    SECOND_NS,
    Alternative,
    Facts,
    Limits,
    Monitor,
    Outcome,
    Posterior,
    Solution,
    Statement,
)
from services.core.trust.verdict import ROWS, TrustState, Verdict, verdict
from shared.messages.trust import Hypothesis

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


def believed(hypothesis: Hypothesis, probability: float, *, acted_on: bool = False) -> Posterior:
    return Posterior(hypothesis, 1e-3, probability, True, acted_on, "for it: inertial_short", NOW_NS - 12 * SECOND_NS)


EXCLUDED = replace(SAFE, conflict_open=True, gnss_excluded=True, exclusion_confirmed=True)
OPEN = replace(SAFE, conflict_open=True)
GIVEN_UP = replace(OPEN, exclusion_declined="without GNSS the level is 31 m", held="positions differ by 6.5 m")
WITHOUT_G05 = replace(SAFE, satellites_left_out=frozenset({"G05"}))
SILENT = replace(says(Monitor.INERTIAL_LONG), stated_ns=NOW_NS - 8 * SECOND_NS)

GNSS_OR_IMU = (believed(Hypothesis.IMU, 0.6), believed(Hypothesis.GNSS, 0.39))
GNSS_ALONE = (believed(Hypothesis.GNSS, 0.999, acted_on=True),)
ODOMETER_ALONE = (believed(Hypothesis.ODOMETER, 0.998, acted_on=True),)
ALIKE = (believed(Hypothesis.GNSS_AND_ODOMETER, 0.7), believed(Hypothesis.IMU, 0.3))
KNOWN = {
    Hypothesis.IMU: Alternative(4.0, 3.0, True), Hypothesis.ODOMETER: Alternative(1.0, 2.0, True),
    Hypothesis.GNSS_AND_ODOMETER: Alternative(6.0, 9.0, False),
}  # fmt: skip
BOTH_KNOWN = replace(OPEN, other_distance_m=4.2, other_level_m=5.5, beliefs=GNSS_OR_IMU, alternatives=KNOWN)
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
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "G05", "E11")), 4, "unsafe",
                 "monitor satellites suspects G05 or E11", id="4-satellites"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05", "E11")), 4, "unsafe",
                 "the position in use contains the fault", id="4-one-of-two"),
    pytest.param(replace(SAFE, beliefs=ALIKE), 4, "unsafe",
                 "GNSS and odometer are falsified alike, and nothing says where the vehicle is then", id="4-alike"),
    pytest.param(replace(SAFE, beliefs=ODOMETER_ALONE, odometer_in_use=True), 4, "unsafe",
                 "the odometer is wrong, and nothing says where", id="4-odometer"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.INERTIAL_LONG, "gnss")), 5, "dead_reckoning",
                 "GNSS is excluded, position by dead reckoning: monitor inertial_long suspects gnss", id="5-accused"),
    pytest.param(EXCLUDED, 5, "dead_reckoning", "until it has agreed", id="5-healthy-time"),
    pytest.param(with_(EXCLUDED, accuses(Monitor.SATELLITES, "G05")), 5, "dead_reckoning", "GNSS is excluded",
                 id="5-satellite-fault-outside"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=7.5)), 5, "dead_reckoning",
                 "no GNSS fix used for 7.5 s, limit 3.0 s", id="5-coasting"),
    pytest.param(replace(SAFE, solution=replace(SOLUTION, gnss_age_s=None)), 5, "dead_reckoning", "no GNSS fix",
                 id="5-never"),
    pytest.param(with_(BOTH_KNOWN, accuses(Monitor.INERTIAL_SHORT, "gnss", "imu")), 6, "caution",
                 "unresolved: the inertial sensors are wrong (60.0 %), or GNSS is wrong (39.0 %); an odometer or wheel "
                 "speeds would decide", id="6-both"),
    pytest.param(replace(GIVEN_UP, beliefs=()), 6, "caution",
                 "without GNSS the level is 31 m; the level holds: positions differ by 6.5 m", id="6-left"),
    pytest.param(replace(SAFE, beliefs=ODOMETER_ALONE, odometer_excluded=True), 6, "caution",
                 "the odometer is wrong (99.8 %); it is no longer used", id="6-odometer"),
    pytest.param(replace(SAFE, imu_excluded=True, imu_exclusion_confirmed=True), 6, "caution",
                 "the inertial sensors have not agreed for long enough", id="6-imu"),
    pytest.param(replace(SAFE, beliefs=ALIKE, alternatives=KNOWN), 6, "caution", "centripetal speed in further bends",
                 id="6-alike"),
    pytest.param(with_(SAFE, accuses(Monitor.EVIDENCE, "gnss")), 6, "caution", "monitor evidence suspects gnss",
                 id="6-evidence"),
    pytest.param(with_(SAFE, replace(says(Monitor.INERTIAL_LONG), doubtful=True)), 6, "caution",
                 "monitor inertial_long is close to its threshold", id="6-doubt"),
    pytest.param(with_(SAFE, SILENT), 7, "caution",
                 "monitor inertial_long: no message for 8.0 s, not evaluated since 992.0 s", id="7-silent"),
    pytest.param(replace(SAFE, statements={m: s for m, s in SAFE.statements.items() if m is not Monitor.EVIDENCE}), 7,
                 "caution", "monitor evidence: has not published yet", id="7-never"),
    pytest.param(with_(SAFE, *(undecided(monitor) for monitor in
                 (Monitor.SATELLITES, Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG))), 7, "caution",
                 "no independent check of the position is evaluated: inertial_short: below 1 m/s", id="7-none"),
    pytest.param(levels(8.4, 5.0), 8, "caution",
                 "horizontal protection level 8.4 m is above 80 % of the alert limit of 10.0 m", id="8-horizontal"),
    pytest.param(levels(3.0, 16.1), 8, "caution", "vertical protection level 16.1 m", id="8-vertical"),
    pytest.param(SAFE, 9, "safe", "protection levels 3.1 m horizontal and 5.2 m vertical", id="9-safe"),
    pytest.param(with_(SAFE, undecided(Monitor.SATELLITES, "no raw measurements")), 9, "safe",
                 "no monitor suspects GNSS", id="9-inertial-windows-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.INERTIAL_SHORT), undecided(Monitor.INERTIAL_LONG)), 9, "safe",
                 "no monitor suspects GNSS", id="9-satellites-are-enough"),
    pytest.param(with_(SAFE, undecided(Monitor.MOTION, "warming up: 12 of 30 moving samples")), 9, "safe",
                 "no monitor suspects GNSS", id="9-motion-warms-up"),
    pytest.param(with_(WITHOUT_G05, accuses(Monitor.SATELLITES, "G05")), 9,
                 "safe", "no monitor suspects GNSS", id="9-satellite-excluded"),
    pytest.param(with_(SAFE, accuses(Monitor.SATELLITES, "neighbour 17")), 9, "safe", "no monitor suspects GNSS",
                 id="9-neighbour"),
]  # fmt: skip


@pytest.mark.parametrize(("facts", "row", "state", "reason"), CASES)
def test_the_first_row_that_matches_decides(facts: Facts, row: int, state: str, reason: str) -> None:
    found = verdict(facts)
    assert (found.row, str(found.state)) == (row, state)
    assert reason in found.reasons[0]


def test_every_row_of_the_table_has_a_case() -> None:
    assert {case.values[1] for case in CASES} == set(range(1, len(ROWS) + 2))


def test_exactly_at_the_alert_limit_and_at_its_share_the_lower_state_is_not_taken() -> None:
    assert verdict(levels(10.0, 20.0)).row == 8
    assert verdict(levels(8.0, 16.0)).row == 9


def test_an_earlier_row_wins_over_every_later_one_and_the_later_reasons_follow() -> None:
    facts = with_(levels(11.0, 5.0), accuses(Monitor.INERTIAL_SHORT, "gnss"), accuses(Monitor.EVIDENCE, "gnss"), SILENT)
    found = verdict(facts)
    assert found.row == 3
    assert len(found.reasons) == 5  # rows 3, 4, 6, 7 and 8
    assert ["suspects gnss" in reason for reason in found.reasons] == [False, True, True, False, False]


ALONE = [
    (accuses(Monitor.INERTIAL_SHORT, "gnss"), 4, ("gnss is suspected, and still used",)),
    (accuses(Monitor.INERTIAL_LONG, "gnss", "imu"), 4,
     ("gnss is suspected, and still used", "imu is suspected, and still used")),
    (accuses(Monitor.SATELLITES, "G05"), 4, ("G05 is suspected",)),
    (accuses(Monitor.EVIDENCE, "gnss"), 6, ("gnss is suspected, and still used",)),
]  # fmt: skip


@pytest.mark.parametrize(("raised", "row", "findings"), ALONE, ids=[str(case[0].monitor) for case in ALONE])
def test_each_flag_raised_alone_matches_exactly_its_own_row_and_names_exactly_its_own_finding(
    raised: Statement, row: int, findings: tuple[str, ...]
) -> None:
    found = verdict(with_(SAFE, raised))
    assert found == Verdict(ROWS[row - 1][0], row, found.reasons, findings)
    assert str(raised.monitor) in found.reasons[0]
    assert not any(str(other) + " suspects" in found.reasons[0] for other in Monitor if other is not raised.monitor)


@pytest.mark.parametrize("monitor", REQUIRED)
def test_a_monitor_that_dies_makes_the_verdict_caution_within_its_deadline(monitor: Monitor) -> None:
    deadline_s = Limits().silent_after_s[monitor]
    for age_s, state in ((deadline_s - 0.1, TrustState.SAFE), (deadline_s + 0.1, TrustState.CAUTION)):
        last = replace(says(monitor), stated_ns=NOW_NS - round(age_s * SECOND_NS))
        found = verdict(with_(SAFE, last))
        assert found.state is state
        assert ("not evaluated since" in found.reasons[0]) == (state is TrustState.CAUTION)


@pytest.mark.parametrize("monitor", REQUIRED)
def test_a_dead_monitor_neither_accuses_nor_passes(monitor: Monitor) -> None:
    old = replace(accuses(monitor, "gnss"), stated_ns=NOW_NS - 60 * SECOND_NS)
    facts = with_(SAFE, old)
    silent = facts.statement(monitor)
    assert (silent.outcome, silent.accused, silent.statistic) == (Outcome.NOT_EVALUATED, (), None)
    assert not any("accused" in finding for finding in verdict(facts).findings)
    assert verdict(facts).state is TrustState.CAUTION


def test_a_statement_with_a_stamp_ahead_does_not_stay_fresh_for_ever() -> None:
    facts = with_(SAFE, replace(says(Monitor.SATELLITES), stated_ns=NOW_NS + 100 * SECOND_NS))
    assert verdict(facts).row == 7
    assert "stamp is 100.0 s ahead" in verdict(facts).reasons[0]


def test_a_monitor_that_is_not_required_may_be_absent() -> None:
    without: dict[Monitor, Statement] = {
        m: s for m, s in SAFE.statements.items() if m not in (Monitor.MOTION, Monitor.MOTION_FAST)
    }
    limits = Limits(required=frozenset(REQUIRED) - {Monitor.MOTION, Monitor.MOTION_FAST})
    assert verdict(replace(SAFE, statements=without)).row == 7
    assert verdict(replace(SAFE, statements=without, limits=limits)).state is TrustState.SAFE


def test_states_are_lower_case_words_on_the_wire() -> None:
    assert {str(state) for state in TrustState} == {
        "safe", "caution", "unsafe", "dead_reckoning", "no_fix", "initialising",
    }  # fmt: skip


def test_a_position_is_never_safe_while_checks_are_paused_and_worse_states_stand() -> None:
    slow = verdict(replace(SAFE, checks_paused=True))
    assert (slow.state, slow.row) == (TrustState.CAUTION, 7)
    assert "checks are paused: this computer is too slow" in slow.findings
    assert verdict(replace(levels(10.1, 5.0), checks_paused=True)).state is TrustState.UNSAFE
