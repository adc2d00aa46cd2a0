"""What the banner says, and that it never says more than is known."""

import dataclasses
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.status.views.banner import (
    OF_STATE,
    WORDS,
    Check,
    Evidence,
    Kind,
    Trust,
    Verdict,
    ratio_of,
    show,
)
from services.monitoring.status.views.codes import Code
from shared.bus import codec
from shared.bus.codes import broker_down
from shared.messages.explanation import Explanation, explain, process
from shared.messages.gnss import FixType
from shared.messages.navigation import AidingKind, NavigationPhase
from shared.messages.operation import ProcessLoad, Work
from shared.messages.trust import Outcome, TrustLevel, TrustState
from shared.words.words import CodedText, stated, words
from tests.support.cases import each
from tests.support.dashboard.status_world import START_NS, aiding, fix, monitor, solution, trust
from tests.support.words import longest

LEVELS = {"protection_level_horizontal_m": 3.14, "protection_level_vertical_m": 4.2, "integrity_risk": 1e-3}
LOST = stated(explain("health.lost", process("core.fusion")))
AWAITED = stated(explain("banner.first_verdict", process("core.trust")))
GOOD = Evidence(
    broker=True,
    trust=trust(START_NS),
    trust_age_s=0.6,
    solution=solution(START_NS, **LEVELS),
    solution_age_s=0.05,
    phase=NavigationPhase.NAVIGATING,
    fix=fix(START_NS),
    fix_age_s=0.4,
    imu_age_s=0.01,
    odometer_age_s=0.1,
    aiding={AidingKind.GNSS_POSITION: (aiding(AidingKind.GNSS_POSITION, 0.3), 0.4)},
    alert_limit_horizontal_m=10.0,
    alert_limit_vertical_m=20.0,
)


def changed(**changes: object) -> Evidence:
    return dataclasses.replace(GOOD, **changes)  # type: ignore[arg-type]  # the test's own keys


def by_name(shown: Verdict) -> list[tuple[str, Check]]:
    return [(check.name, check) for check in shown.checks]


def check(evidence: Evidence, name: str) -> tuple[Trust, str]:
    found = next(c for c in show(evidence).checks if c.name == name)
    return found.state, found.text


@pytest.mark.parametrize("level", TrustLevel)
def test_each_state_of_core_trust_has_its_own_word_sentence_and_action(level: TrustLevel) -> None:
    shown = show(changed(trust=trust(START_NS, level, reasons=()), phase=None))
    assert (shown.state, shown.since_ns) == (Trust(level.value), START_NS)
    assert WORDS[shown.state] == (
        "NO POSITION" if level is TrustLevel.NO_FIX else level.value.upper().replace("_", " ")
    )
    general = explain(OF_STATE[level])
    assert (shown.sentence, shown.action) == (words().sentence(general), words().action(general))


DECIDING = sorted(code for code, row in words().rows.items() if code.startswith("trust.") and row.sentence)


@each("code", DECIDING)
def test_a_code_is_one_plain_sentence_and_its_figures_are_for_those_who_ask(code: str) -> None:
    level = TrustLevel.CAUTION
    why = longest(code, words())
    shown = show(changed(trust=trust(START_NS, level, why, explain("trust.gnss_not_agreed"), row=99), phase=None))
    assert shown.sentence == words().sentence(why)
    assert not re.search(r"\d|statistic|threshold|;|\(", shown.sentence) and shown.sentence.count(".") == 1
    assert shown.action == (words().action(why) or words().action(explain("banner.caution")))
    assert shown.reasons == (words().detail(why), "GNSS has not agreed for long enough")
    assert shown.row == 99, "which is shown, and decides nothing"


def test_the_banner_speaks_every_language() -> None:
    shown = show(
        changed(trust=trust(START_NS, TrustLevel.CAUTION, explain("trust.suspected", suspects=("gnss", "imu"))))
    )
    assert {name: line.sentence for name, line in shown.lines.items()} == {
        "de": "Position mit Vorsicht verwenden, möglicher Fehler: GNSS oder Inertialsensoren.",
        "fr": "Position à utiliser avec prudence, erreur possible : GNSS ou capteurs inertiels.",
    }
    assert all(line.action for line in shown.lines.values())


@each(
    "why",
    [(), (explain("trust.of_a_newer_release", a=1),), (explain("trust.suspected"),)],
)
@each("level", TrustLevel)
def test_a_message_without_codes_or_with_unknown_ones_is_shown_by_its_reason_as_it_is(
    level: TrustLevel, why: tuple[Explanation, ...]
) -> None:
    reasons = ("monitor inertial_short suspects gnss: " + "far too long " * 20, "second reason since 1795000000.5 s")
    state = trust(START_NS, level, *why, reasons=reasons)
    shown = show(changed(trust=state, phase=None))
    assert shown.sentence == reasons[0]
    assert {line.sentence for line in shown.lines.values()} == {reasons[0]}
    assert shown.reasons == reasons
    assert (shown.state, shown.action) == (Trust(level.value), words().action(explain(OF_STATE[level])))


@each("code", [*DECIDING, "trust.of_a_newer_release"])
def test_with_every_text_replaced_by_x_the_state_and_what_is_to_be_done_are_the_same(code: str) -> None:
    why = longest(code, words()) if code in words().rows else explain(code)
    for level in TrustLevel:
        state = trust(START_NS, level, why)
        states = [state, state.model_copy(update={"reasons": ("x",), "monitors": (monitor(START_NS, reason="x"),)})]
        before, after = (show(changed(trust=state)) for state in states)
        assert (before.state, before.action, before.row) == (after.state, after.action, after.row)
        assert {name: (c.state, c.ratio) for name, c in by_name(before)} == {
            n: (c.state, c.ratio) for n, c in by_name(after)
        }


@given(
    broker=st.booleans(),
    level=st.none() | st.sampled_from(TrustLevel),
    trust_age_s=st.floats(0.0, 100.0),
    age_s=st.none() | st.floats(0.0, 100.0),
    phase=st.sampled_from(NavigationPhase),
    ratio=st.floats(0.0, 20.0),
)
def test_it_is_safe_when_and_only_when_a_verdict_within_its_deadline_says_so(
    broker: bool,
    level: TrustLevel | None,
    trust_age_s: float,
    age_s: float | None,
    phase: NavigationPhase,
    ratio: float,
) -> None:
    evidence = changed(
        broker=broker,
        trust=None if level is None else trust(START_NS, level),
        trust_age_s=None if level is None else trust_age_s,
        solution=None if age_s is None else solution(START_NS, phase=phase),
        solution_age_s=age_s,
        phase=phase,
        aiding={AidingKind.GNSS_POSITION: (aiding(AidingKind.GNSS_POSITION, ratio, used=ratio <= 1), 0.1)},
    )
    shown = show(evidence)
    valid = broker and level is not None and trust_age_s < 5.0
    assert (shown.state is Trust.SAFE) == (valid and level is TrustLevel.SAFE)
    assert (shown.state is Trust.BROKER_LOST) == (not broker)
    assert (shown.state is Trust.STALE) == (broker and not valid)
    assert shown.sentence.endswith(".")


def test_an_exceeded_alert_limit_differs_from_an_accusation_in_state_word_and_advice() -> None:
    why = explain("trust.level_above_limit", axis="horizontal", level_m=25.0, limit_m=10.0)
    above = show(changed(trust=trust(START_NS, TrustLevel.UNSAFE, why)))
    accused = show(changed(trust=trust(START_NS, TrustLevel.UNSAFE, explain("trust.unsafe_conflict"), why)))
    assert (above.state, WORDS[above.state]) == (Trust.ABOVE_LIMIT, "ABOVE LIMIT")
    assert above.sentence == "The position must not be used: its error may be above the alert limit."
    assert above.reasons == ("horizontal protection level 25.0 m is above the alert limit of 10.0 m",)
    assert accused.state is Trust.UNSAFE
    assert above.action != accused.action


def test_every_level_of_a_row_is_a_state_and_every_code_of_the_banner_has_a_row() -> None:
    assert {row.level for row in words().rows.values() if row.level} <= {state.value for state in Trust}
    assert {code for code in words().rows if code.startswith("banner.")} == {str(code) for code in Code}


@pytest.mark.parametrize(
    ("level", "why", "sentence"),
    [
        (TrustLevel.NO_FIX, "trust.solution_old",
         "No position: this computer is too slow, and 6 s behind the sensors."),
        (TrustLevel.CAUTION, "trust.checks_paused",
         "Use the position with caution: checks are paused, because this computer is too slow."),
    ],
)  # fmt: skip
def test_a_computer_that_is_too_slow_is_named_with_its_remedy_although_the_inputs_are_there(
    level: TrustLevel, why: str, sentence: str
) -> None:
    load = ProcessLoad(sampled_ns=START_NS, process="core.fusion", lag_s=6.2, paused=tuple(Work))
    shown = show(changed(trust=trust(START_NS, level, explain(why)), load=load, cause=LOST))
    assert shown.sentence == sentence and shown.action.startswith("End other programs on this computer")
    assert WORDS[Trust.NO_FIX] == "NO POSITION", "the receiver has a fix"
    other = trust(START_NS, level, explain("trust.solution_old"))
    for calm in (None, load.model_copy(update={"paused": ()})):
        assert "too slow" not in show(changed(trust=other, load=calm)).sentence
    unsafe = show(changed(trust=trust(START_NS, TrustLevel.UNSAFE, explain("trust.unsafe_conflict")), load=load))
    assert "too slow" not in unsafe.sentence, "another cause stays"


def test_before_the_first_verdict_after_a_start_the_banner_says_what_it_waits_for() -> None:
    shown = show(changed(trust=None, trust_age_s=None, awaited=AWAITED))
    assert shown.state is Trust.STARTING
    assert shown.sentence == "Nothing is known yet: waiting for the first verdict of core.trust."


def test_every_state_has_its_own_word() -> None:
    assert len(set(WORDS.values())) == len(Trust) == len(WORDS)


def test_a_monitor_whose_process_was_restarted_has_no_outcome_until_it_states_one() -> None:
    evidence = changed(earlier_monitors=frozenset({"inertial_short"}))
    state, text = check(evidence, "inertial_short")
    assert (state, text) == (Trust.STALE, "no statement since its process was restarted")


def test_an_old_verdict_is_said_with_its_age_and_root_cause() -> None:
    shown = show(changed(trust_age_s=6.2, trust_cause=LOST))
    assert shown.sentence == "Trust is not evaluated for 6 s: core.fusion was lost."
    assert shown.lines["de"].sentence == "Vertrauen seit 6 s ungeprüft: core.fusion ist ausgefallen."
    assert check(changed(trust_age_s=6.2), "inertial_short") == (Trust.STALE, "no verdict for 6 s")


def test_a_verdict_that_never_came_is_said() -> None:
    shown = show(changed(trust=None, trust_age_s=None))
    assert shown.sentence == "Trust is not evaluated: no verdict of core.trust."
    assert not [c for c in shown.checks if c.kind is Kind.MONITOR]


def test_a_lost_broker_leaves_nothing_known() -> None:
    assert show(changed(broker=False)).state is Trust.BROKER_LOST
    assert {c.state for c in show(changed(broker=False)).checks} == {Trust.STALE}, "no row is green"
    sentence = show(changed(broker=False, cause=stated(broker_down(connected=True)))).sentence
    assert sentence == "Nothing is known: the broker delivers nothing."


def test_a_lost_position_is_explained_by_its_root_cause_and_a_missing_one_by_what_the_filter_waits_for() -> None:
    cause = "a cause without a code"
    evidence = changed(phase=NavigationPhase.WAITING_FOR_GNSS, cause=CodedText(cause))
    lost = dataclasses.replace(evidence, trust=trust(START_NS, TrustLevel.NO_FIX, reasons=("solution is old",)))
    assert show(lost).sentence == f"No position: {cause}."
    missing = dataclasses.replace(evidence, trust=trust(START_NS, TrustLevel.INITIALISING, reasons=("none yet",)))
    assert show(missing).sentence == "No position yet: no usable GNSS fix is received."


def test_without_a_position_no_monitor_is_green_for_there_is_nothing_to_judge() -> None:
    monitors = (monitor(START_NS, "motion"), monitor(START_NS, "evidence", outcome=Outcome.ACCUSES))
    evidence = changed(trust=trust(START_NS, TrustLevel.NO_FIX, monitors=monitors, reasons=("solution is old",)))
    for name in ("motion", "evidence"):
        assert check(evidence, name) == (Trust.STALE, "there is no position to judge")


def test_each_outcome_of_a_monitor_is_a_state_of_its_own() -> None:
    monitors = (
        monitor(START_NS, "motion"),
        monitor(START_NS, "inertial_short", outcome=Outcome.ACCUSES, accused=("gnss",), statistic=9.0),
        monitor(START_NS, "satellites", outcome=Outcome.NOT_EVALUATED, reason="4 satellites"),
    )
    evidence = changed(trust=trust(START_NS, TrustLevel.UNSAFE, monitors=monitors))
    assert check(evidence, "motion") == (Trust.SAFE, "50 % of threshold")
    assert check(evidence, "inertial_short") == (Trust.UNSAFE, "suspects GNSS; statistic below the threshold")
    assert check(evidence, "satellites") == (Trust.OFF, "4 satellites")
    ratios = {c.name: c.ratio for c in show(evidence).checks if c.kind is Kind.MONITOR}
    assert ratios == {"motion": 0.5, "inertial_short": 1.125, "satellites": None}


@pytest.mark.parametrize(
    ("outcome", "statistic", "threshold", "ratio"),
    [
        (Outcome.PASS, 2.0, 8.0, 0.25),
        (Outcome.ACCUSES, 16.0, 8.0, 2.0),
        (Outcome.NOT_EVALUATED, 2.0, 8.0, None),
        (Outcome.PASS, None, 8.0, None),
        (Outcome.PASS, 2.0, None, None),
        (Outcome.PASS, 2.0, 0.0, None),
    ],
)
def test_a_ratio_is_statistic_over_threshold_and_none_where_nothing_was_evaluated(
    outcome: Outcome, statistic: float | None, threshold: float | None, ratio: float | None
) -> None:
    assert ratio_of(outcome, statistic, threshold) == ratio


def test_a_rejected_measurement_and_the_state_of_the_filter_are_shown_as_inputs() -> None:
    kind = AidingKind.GNSS_VELOCITY
    evidence = changed(
        aiding={kind: (aiding(kind, 4.7, used=False), 0.5)},
        phase=NavigationPhase.WAITING_FOR_GNSS,
        filter_says="17 fixes without a position",
    )
    assert check(evidence, f"gate {kind}") == (Trust.CAUTION, "470 % of limit, discarded")
    by_phases = {AidingKind.CARRIER_DISPLACEMENT: (aiding(AidingKind.CARRIER_DISPLACEMENT, 0.2), 0.5)}
    carried = changed(aiding={kind: (aiding(kind, 0.3, used=False), 0.5), **by_phases})
    assert check(carried, f"gate {kind}")[0] is Trust.SAFE, "displacements stand in for it"
    assert check(evidence, "phase") == (Trust.CAUTION, "waiting for GNSS; 17 fixes without a position")
    coded = dataclasses.replace(evidence, filter_codes=(explain("fusion.no_position_yet"),))
    assert check(coded, "phase") == (Trust.CAUTION, "waiting for GNSS; level, no position yet")
    assert show(evidence).state is Trust.SAFE, "inputs do not make the verdict"


def test_a_badly_known_heading_is_shown() -> None:
    covariance = (1e-4, 0.0, 0.0, 1e-4, 0.0, 0.04)  # 0.2 rad = 11.5 degrees
    evidence = changed(solution=solution(START_NS, attitude_cov_ned_rad2=covariance))
    assert check(evidence, "heading") == (Trust.CAUTION, "± 11.5° (1 σ), limit 3.0°")
    assert check(changed(solution_age_s=9.0), "heading") == (Trust.STALE, "not known")


@pytest.mark.parametrize(
    ("fix_type", "age_s", "state"),
    [
        (FixType.THREE_D, 0.4, Trust.SAFE),
        (FixType.NONE, 0.4, Trust.CAUTION),
        (FixType.TIME_ONLY, 0.4, Trust.CAUTION),
        (FixType.THREE_D, 5.0, Trust.STALE),
    ],
)
def test_a_fix_passes_only_with_a_position_and_in_time(fix_type: FixType, age_s: float, state: Trust) -> None:
    assert check(changed(fix=fix(START_NS, fix_type=fix_type), fix_age_s=age_s), "fix")[0] is state


def test_sensors_that_never_spoke_are_not_green() -> None:
    evidence = changed(imu_age_s=None, odometer_age_s=None, fix=None, fix_age_s=None, aiding={})
    assert {name: check(evidence, name)[0] for name in ("imu", "odometer", "fix", "gate")} == {
        "imu": Trust.STALE,
        "odometer": Trust.OFF,
        "fix": Trust.STALE,
        "gate": Trust.STALE,
    }


def test_protection_levels_are_compared_with_the_configured_alert_limits() -> None:
    assert check(GOOD, "protection") == (Trust.SAFE, "3.1 m horizontal (limit 10.0 m); 4.2 m vertical (limit 20.0 m)")
    assert check(changed(alert_limit_horizontal_m=3.0), "protection")[0] is Trust.ABOVE_LIMIT
    assert check(changed(alert_limit_vertical_m=4.0), "protection")[0] is Trust.ABOVE_LIMIT
    unknown = changed(alert_limit_horizontal_m=None, alert_limit_vertical_m=None)
    assert check(unknown, "protection") == (
        Trust.STALE, "3.1 m horizontal; 4.2 m vertical; alert limits not received",
    )  # fmt: skip
    assert check(changed(solution=solution(START_NS)), "protection") == (Trust.OFF, "not published by the filter")
    assert check(changed(solution_age_s=60.0), "protection") == (Trust.STALE, "not known")


def test_a_verdict_of_release_0_1_0_decodes_and_is_shown_by_its_own_reasons() -> None:
    payload = (
        b'{"sender":{"process":"core.trust","incarnation":1,"sequence":7},"sampled_ns":1795000000000000000,'
        b'"state":"caution","since_ns":1795000000000000000,"row":12,"reasons":["neither inertial nor motion monitors '
        b'evaluated: inertial_short: no samples"],"findings":["satellites not evaluated: no raw measurements"],'
        b'"gnss_excluded":false,"alert_limit_horizontal_m":10.0,"alert_limit_vertical_m":20.0,"monitors":[]}'
    )
    state = codec.decode("trust/state", payload)
    assert isinstance(state, TrustState) and state.reason_codes == state.finding_codes == ()
    shown = show(changed(trust=state))
    assert (shown.state, shown.sentence) == (Trust.CAUTION, state.reasons[0])
    assert shown.action == words().action(explain("banner.caution"))
