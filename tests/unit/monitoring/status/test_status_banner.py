"""What the banner says, and that it never says more than is known."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.status.views.banner import NOT_MONITORED, Evidence, Trust, judge
from shared.messages.gnss import FixType
from shared.messages.navigation import AidingKind, NavigationPhase
from tests.support.status_world import START_NS, aiding, fix, solution

LEVELS = {"protection_level_horizontal_m": 3.14, "protection_level_vertical_m": 4.2, "integrity_risk": 1e-3}
GOOD = Evidence(
    broker=True,
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


def check(evidence: Evidence, name: str) -> tuple[Trust, str]:
    found = next(c for c in judge(evidence).checks if c.name == name)
    return found.state, found.text


def test_the_best_answer_without_an_integrity_monitor_is_caution() -> None:
    verdict = judge(GOOD)
    assert verdict.state is Trust.CAUTION
    assert verdict.sentence.startswith("Position not monitored")


@given(
    broker=st.booleans(),
    age_s=st.none() | st.floats(0.0, 100.0),
    phase=st.sampled_from(NavigationPhase),
    fix_age_s=st.none() | st.floats(0.0, 100.0),
    ratio=st.floats(0.0, 20.0),
    down=st.sampled_from([(), ("core.fusion",)]),
)
def test_nothing_that_can_be_known_here_makes_it_safe(
    broker: bool,
    age_s: float | None,
    phase: NavigationPhase,
    fix_age_s: float | None,
    ratio: float,
    down: tuple[str, ...],
) -> None:
    evidence = changed(
        broker=broker,
        solution=None if age_s is None else solution(START_NS, phase=phase),
        solution_age_s=age_s,
        phase=phase,
        fix_age_s=fix_age_s,
        aiding={AidingKind.GNSS_POSITION: (aiding(AidingKind.GNSS_POSITION, ratio, used=ratio <= 1), 0.1)},
        down=down,
    )
    verdict = judge(evidence)
    assert verdict.state in (Trust.CAUTION, Trust.STALE)
    assert verdict.sentence.endswith(".") and verdict.action.endswith(".")
    if not broker or age_s is None or age_s >= 2.0:
        assert verdict.state is Trust.STALE


def test_a_lost_broker_leaves_nothing_known() -> None:
    assert judge(changed(broker=False)).state is Trust.STALE
    sentence = judge(changed(broker=False, cause="the broker hangs: it is connected, but delivers nothing")).sentence
    assert sentence == "Nothing is known: the broker hangs: it is connected, but delivers nothing."


def test_a_watchdog_that_does_not_report_leaves_the_position_but_says_so() -> None:
    verdict = judge(changed(monitored=False))
    assert (verdict.state, verdict.code) == (Trust.CAUTION, "unwatched")
    assert "monitoring.health does not report" in verdict.sentence


def test_a_stale_position_of_a_filter_that_starts_again_says_what_it_waits_for() -> None:
    cause = "core.fusion was restarted and is starting again; not yet published again: navigation/solution"
    verdict = judge(changed(solution_age_s=9.0, cause=cause, phase=NavigationPhase.WAITING_FOR_GNSS))
    assert verdict.sentence == f"The position is stale: {cause} (no usable GNSS fix is received)."


def test_what_the_filter_waits_for_is_said_before_what_is_seen_from_outside() -> None:
    evidence = changed(
        solution=None,
        phase=NavigationPhase.WAITING_FOR_GNSS,
        filter_says="17 fixes without a position",
        cause="core.fusion runs, but says nothing on navigation/solution",
    )
    assert judge(evidence).sentence == "No position yet: no usable GNSS fix is received."
    assert check(evidence, "phase") == (Trust.CAUTION, "waiting for GNSS: 17 fixes without a position")


def test_a_filter_that_says_nothing_is_explained_from_outside() -> None:
    evidence = changed(solution=None, phase=None, cause="core.fusion is lost")
    assert judge(evidence).sentence == "No position yet: core.fusion is lost."


@pytest.mark.parametrize(("age_s", "state"), [(1.9, Trust.CAUTION), (2.0, Trust.STALE)])
def test_a_position_is_no_data_from_its_deadline_on(age_s: float, state: Trust) -> None:
    assert judge(changed(solution_age_s=age_s, cause="core.fusion is silent")).state is state


def test_an_old_position_is_explained_by_its_root_cause() -> None:
    verdict = judge(changed(solution_age_s=9.0, cause="sensors.imu is silent"))
    assert verdict.sentence == "The position is stale: sensors.imu is silent."


def test_dead_reckoning_is_said_before_anything_else() -> None:
    evidence = changed(solution=solution(START_NS, phase=NavigationPhase.COASTING), down=("parsers.can",))
    assert "dead reckoning" in judge(evidence).sentence


def test_refused_measurements_are_named() -> None:
    kind = AidingKind.GNSS_VELOCITY
    evidence = changed(aiding={kind: (aiding(kind, 4.7, used=False), 0.5)})
    assert "rejects its GNSS velocity measurements" in judge(evidence).sentence
    assert check(evidence, f"gate {kind}") == (Trust.CAUTION, "4.70 of the limit, rejected")


def test_a_refusal_of_long_ago_is_not_held_against_the_position() -> None:
    kind = AidingKind.GNSS_VELOCITY
    evidence = changed(aiding={kind: (aiding(kind, 4.7, used=False), 60.0)})
    assert judge(evidence).code == "unmonitored"


def test_a_badly_known_heading_is_said() -> None:
    covariance = (1e-4, 0.0, 0.0, 1e-4, 0.0, 0.04)  # 0.2 rad = 11.5 degrees
    evidence = changed(solution=solution(START_NS, attitude_cov_ned_rad2=covariance))
    assert "heading" in judge(evidence).sentence
    assert check(evidence, "heading") == (Trust.CAUTION, "± 11.5° (1 σ), limit 3°")


def test_the_heading_of_an_old_position_is_unknown() -> None:
    assert check(changed(solution_age_s=9.0), "heading") == (Trust.STALE, "unknown")


def test_processes_that_are_down_are_named() -> None:
    assert "parsers.can is not running" in judge(changed(down=("parsers.can",))).sentence
    two = judge(changed(down=("parsers.can", "monitoring.recorder"))).sentence
    assert "parsers.can and monitoring.recorder are not running" in two


def test_the_code_changes_with_the_sentence_and_not_with_the_numbers() -> None:
    assert judge(GOOD).code == judge(changed(fix_age_s=2.9, imu_age_s=0.4)).code
    assert judge(GOOD).code != judge(changed(down=("parsers.can",))).code


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
    assert check(GOOD, "protection") == (Trust.SAFE, "3.1 m horizontal (limit 10 m), 4.2 m vertical (limit 20 m)")
    assert check(changed(alert_limit_horizontal_m=3.0), "protection")[0] is Trust.CAUTION
    assert check(changed(alert_limit_vertical_m=4.0), "protection")[0] is Trust.CAUTION
    unknown = changed(alert_limit_horizontal_m=None, alert_limit_vertical_m=None)
    assert check(unknown, "protection") == (
        Trust.STALE, "3.1 m horizontal, 4.2 m vertical; alert limits not received",
    )  # fmt: skip
    assert check(changed(solution=solution(START_NS)), "protection") == (Trust.OFF, "not published by the filter")
    assert check(changed(solution_age_s=60.0), "protection") == (Trust.STALE, "unknown")


def test_monitors_that_do_not_exist_are_listed_as_not_monitored() -> None:
    missing = [c for c in judge(GOOD).checks if not c.fitted]
    assert [c.name for c in missing] == [name for name, _, _ in NOT_MONITORED]
    assert all(c.state is Trust.OFF for c in missing)
