from collections.abc import Iterable

import pytest

from services.core.trust.codes import Code
from services.core.trust.facts import Monitor
from services.core.trust.process import Config, Process
from shared.messages.base import Message, Tick
from shared.messages.navigation import NavigationPhase, NavigationSolution, NavigationState
from shared.messages.trust import (
    Hypothesis,
    MonitorTest,
    Outcome,
    TrustEvent,
    TrustLevel,
    TrustMonitor,
    TrustRecord,
    TrustState,
)
from shared.runtime.config import Vehicle
from shared.words.words import words

SECOND_NS = 1_000_000_000


def solution(time_ns: int, horizontal_m: float = 3.0) -> NavigationSolution:
    return NavigationSolution(
        sampled_ns=time_ns, phase=NavigationPhase.NAVIGATING, latitude_deg=45.0, longitude_deg=9.0,
        height_ellipsoid_m=100.0, velocity_ned_m_s=(10.0, 0.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0,
        position_cov_ned_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0), velocity_cov_ned_m2_s2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01),
        attitude_cov_ned_rad2=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), angular_rate_body_rad_s=(0.0, 0.0, 0.0),
        accelerometer_bias_m_s2=(0.0, 0.0, 0.0), gyroscope_bias_rad_s=(0.0, 0.0, 0.0), stationary=False,
        gnss_age_s=0.5, protection_level_horizontal_m=horizontal_m, protection_level_vertical_m=5.0,
        integrity_risk=1e-3,
    )  # fmt: skip


def navigation_state(time_ns: int, horizontal_m: float) -> NavigationState:
    return NavigationState(
        sampled_ns=time_ns, phase=NavigationPhase.NAVIGATING, since_ns=0, reason="positions are used", fixes_used=1,
        fixes_rejected=0, samples_used=100, samples_rejected=0, imu_gaps=0, resets=0,
        alert_limit_horizontal_m=horizontal_m, alert_limit_vertical_m=20.0, odometer_age_s=0.1,
    )  # fmt: skip


def statement(
    monitor: Monitor, time_ns: int, outcome: Outcome = Outcome.PASS, accused: tuple[str, ...] = ()
) -> TrustMonitor:
    return TrustMonitor(
        sampled_ns=time_ns, monitor=monitor.value, outcome=outcome, reason="test", accused=accused, statistic=1.0,
        threshold=2.0, suspect_since_ns=time_ns - 10 * SECOND_NS if accused else None,
    )  # fmt: skip


def second(process: Process, time_ns: int, messages: Iterable[Message]) -> list[Message]:
    """Feed one second: what is given, a solution, and the tick that ends it."""
    published: list[Message] = []
    for message in (*messages, solution(time_ns), Tick(now_ns=time_ns)):
        published += process.handle(message)  # type: ignore[arg-type]  # the union of what it consumes
    return published


def states(published: Iterable[Message]) -> list[TrustLevel]:
    return [message.state for message in published if isinstance(message, TrustState)]


def passing(time_ns: int) -> list[TrustMonitor]:
    return [statement(monitor, time_ns) for monitor in Monitor]


def test_without_a_solution_the_verdict_is_initialising_once_a_second() -> None:
    process = Process(Config())
    published = [message for k in range(3) for message in process.handle(Tick(now_ns=k * SECOND_NS))]
    assert states(published) == [TrustLevel.INITIALISING] * 3
    assert not any(isinstance(message, TrustEvent) for message in published)


def test_all_monitors_passing_give_safe_and_one_event() -> None:
    process = Process(Config())
    published = [m for k in range(1, 4) for m in second(process, k * SECOND_NS, passing(k * SECOND_NS))]
    assert states(published)[-1] is TrustLevel.SAFE
    events = [message for message in published if isinstance(message, TrustEvent)]
    assert events[-1].after is TrustLevel.SAFE
    assert {monitor.monitor for monitor in events[-1].monitors} == {monitor.value for monitor in Monitor}


def test_an_accusation_of_gnss_is_unsafe_at_once_and_names_the_monitor() -> None:
    process = Process(Config())
    second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *passing(SECOND_NS)])
    accusing = statement(Monitor.INERTIAL_SHORT, 2 * SECOND_NS, Outcome.ACCUSES, ("gnss",))
    published = list(process.handle(accusing))
    assert states(published) == [TrustLevel.UNSAFE]
    state = next(message for message in published if isinstance(message, TrustState))
    assert state.suspect_since_ns == -8 * SECOND_NS
    suspecting = [
        reason_code.values["monitor"] for reason_code in state.reason_codes if reason_code.code == Code.MONITOR_SUSPECTS
    ]
    assert suspecting == ["inertial_short"]
    belief = next(belief for belief in state.beliefs if belief.hypothesis is Hypothesis.GNSS)
    assert belief.survives and belief.reason_code is not None
    assert belief.reason_code.values["supporting"] == ("inertial_short",)
    assert belief.reason.startswith("for it: Short inertial window")


def accused_for(process: Process, seconds: int, accused: tuple[str, ...], **known: object) -> list[TrustState]:
    """Feed seconds in which both inertial windows accuse and all else passes."""
    found: list[TrustState] = []
    for k in range(2, 2 + seconds):
        now_ns = k * SECOND_NS
        state = navigation_state(now_ns, 10.0).model_copy(update=known)
        others = [
            trust_monitor
            for trust_monitor in passing(now_ns)
            if isinstance(trust_monitor, TrustMonitor) and "inertial" not in trust_monitor.monitor
        ]
        accusing = [
            statement(monitor, now_ns, Outcome.ACCUSES, accused)
            for monitor in (Monitor.INERTIAL_SHORT, Monitor.INERTIAL_LONG)
        ]
        found += [
            message
            for message in second(process, now_ns, [state, *others, *accusing])
            if isinstance(message, TrustState)
        ]
    return found


@pytest.mark.parametrize(
    ("accused", "known", "excluded"),
    [
        (("gnss",), {}, True),
        (("gnss", "imu"), {}, False),
        (("gnss",), {"exclusion_declined": "level of 92 m"}, False),
    ],
    ids=["the odometer agrees with the inertial sensors", "they may be wrong", "fusion declines"],
)
def test_gnss_is_excluded_only_if_nothing_else_can_be_wrong_and_there_is_a_good_solution_without_it(
    accused: tuple[str, ...], known: dict[str, object], excluded: bool
) -> None:
    process = Process(Config())
    second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *passing(SECOND_NS)])
    last = accused_for(process, 20, accused, **known)[-1]
    assert last.gnss_excluded is excluded and last.suspect_since_ns is not None
    assert last.state in (TrustLevel.UNSAFE, TrustLevel.CAUTION)


@pytest.mark.parametrize("knocked", [True, False])
def test_an_inertial_unit_is_excluded_only_where_it_contradicts_itself(knocked: bool) -> None:
    """Course and wheels against the gyroscope may be falsified alike; gravity against the gyroscopes may not."""
    process = Process(Config())
    second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *passing(SECOND_NS)])
    name = "gravity" if knocked else "yaw_rate_10"
    tests = (MonitorTest(name=name, outcome=Outcome.ACCUSES),)
    found: list[TrustState] = []
    for k in range(2, 16):
        now_ns = k * SECOND_NS
        accusing = [
            statement(Monitor.INERTIAL_SHORT, now_ns, Outcome.ACCUSES, ("gnss", "imu")),
            statement(Monitor.GYROSCOPE, now_ns, Outcome.ACCUSES, ("imu",)).model_copy(update={"tests": tests}),
        ]
        names = {trust_monitor.monitor for trust_monitor in accusing}
        others = [
            trust_monitor
            for trust_monitor in passing(now_ns)
            if isinstance(trust_monitor, TrustMonitor) and trust_monitor.monitor not in names
        ]
        state = navigation_state(now_ns, 10.0)
        found += [
            message
            for message in second(process, now_ns, [state, *others, *accusing])
            if isinstance(message, TrustState)
        ]
    assert found[-1].imu_excluded is knocked and not found[-1].gnss_excluded
    if not knocked:
        return
    assert found[-1].suspect_since_ns is None, "GNSS is in conflict no more"
    assert "the inertial sensors are wrong" in " ".join(found[-1].reasons)


def test_a_silent_monitor_gives_caution_within_its_deadline_and_is_listed_as_not_evaluated() -> None:
    process = Process(Config(monitor_silent_after_s=5.0))
    for k in range(1, 4):
        second(process, k * SECOND_NS, passing(k * SECOND_NS))
    others = [monitor for monitor in Monitor if monitor is not Monitor.SATELLITES]
    seen = {}
    for k in range(4, 12):
        published = second(process, k * SECOND_NS, [statement(monitor, k * SECOND_NS) for monitor in others])
        seen[k] = next(message for message in published if isinstance(message, TrustState))
    assert next(k for k, state in seen.items() if state.state is TrustLevel.CAUTION) <= 3 + 5 + 1
    listed = {monitor.monitor: monitor.outcome for monitor in seen[11].monitors}
    assert listed["satellites"] is Outcome.NOT_EVALUATED
    assert listed["motion"] is Outcome.PASS


def test_the_alert_limit_is_that_of_the_vehicle() -> None:
    process = Process(Config(vehicle=Vehicle(alert_limit_horizontal_m=2.0)))
    list(process.handle(navigation_state(SECOND_NS, horizontal_m=10.0)))  # of fusion that runs with another file
    published = second(process, SECOND_NS, passing(SECOND_NS))
    state = [message for message in published if isinstance(message, TrustState)][-1]
    assert state.alert_limit_horizontal_m == 2.0
    assert state.state is TrustLevel.UNSAFE, "the protection level is 3 m"


def test_an_unknown_monitor_is_counted_and_rejected() -> None:
    process = Process(Config())
    unknown = statement(Monitor.MOTION, SECOND_NS).model_copy(update={"monitor": "crystal_ball"})
    assert list(process.handle(unknown)) == []
    assert process.rejects["unknown monitor"] == 1


def test_a_restart_goes_on_with_the_exclusion_of_the_process_before_and_not_with_an_old_one() -> None:
    first, known = Process(Config()), navigation_state(SECOND_NS, 10.0)
    second(first, SECOND_NS, [known, *passing(SECOND_NS)])
    saved = accused_for(first, 20, ("gnss",))[-1]
    assert saved.gnss_excluded
    for after_s, excluded in ((23, True), (33, False)):
        restarted = Process(Config())
        assert list(restarted.handle(saved)) == [] and list(restarted.handle(known)) == []
        published = second(restarted, after_s * SECOND_NS, passing(after_s * SECOND_NS))
        found = [message for message in published if isinstance(message, TrustState)]
        assert {trust_state.gnss_excluded for trust_state in found} == {excluded}
        assert found[-1].suspect_since_ns == (saved.suspect_since_ns if excluded else None)


def test_fusion_confirms_by_a_solution_without_gnss_since_the_suspect_time() -> None:
    process = Process(Config())
    second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *passing(SECOND_NS)])
    last = accused_for(process, 20, ("gnss",))[-1]
    assert last.suspect_since_ns is not None
    rows, now_ns = [], 20 * SECOND_NS
    for since_ns in (None, last.suspect_since_ns + 1, last.suspect_since_ns):
        now_ns += SECOND_NS
        free = solution(now_ns).model_copy(update={"gnss_excluded_since_ns": since_ns, "gnss_age_s": 11.0})
        list(process.handle(free))
        published = list(process.handle(Tick(now_ns=now_ns)))
        rows.append(
            next(
                (trust_state.row, trust_state.state) for trust_state in published if isinstance(trust_state, TrustState)
            )
        )
    assert rows == [(4, TrustLevel.UNSAFE), (4, TrustLevel.UNSAFE), (5, TrustLevel.DEAD_RECKONING)]


def test_satellites_that_fusion_leaves_out_are_no_fault_of_the_position() -> None:
    process = Process(Config())
    accusing = statement(Monitor.SATELLITES, SECOND_NS, Outcome.ACCUSES, ("G05",))
    others = [
        trust_monitor
        for trust_monitor in passing(SECOND_NS)
        if isinstance(trust_monitor, TrustMonitor) and trust_monitor.monitor != "satellites"
    ]
    before = second(process, SECOND_NS, [*others, accusing])
    left_out = navigation_state(SECOND_NS, 10.0).model_copy(update={"satellites_left_out": ("G05",)})
    for k in range(2, 6):  # a better verdict has to last
        after = second(process, k * SECOND_NS, [left_out, *others, accusing])
    last = [[message for message in published if isinstance(message, TrustState)][-1] for published in (before, after)]
    assert [trust_state.row for trust_state in last] == [4, 9]
    assert "satellite G05 is excluded" in last[1].findings


def test_reasons_and_findings_are_the_english_details_of_their_codes_one_each() -> None:
    process = Process(Config())
    accusing = statement(Monitor.SATELLITES, SECOND_NS, Outcome.ACCUSES, ("G05",))
    published = second(process, SECOND_NS, [statement(Monitor.MOTION, SECOND_NS), accusing])
    state = [message for message in published if isinstance(message, TrustState)][-1]
    for texts, codes in ((state.reasons, state.reason_codes), (state.findings, state.finding_codes)):
        assert len(texts) == len(codes) > 0
        assert list(texts) == [words().detail(code) for code in codes]
    event = [message for message in published if isinstance(message, TrustEvent)][-1]
    assert event.reason_codes and len(event.reason_codes) == len(event.reasons)
    assert TrustState.model_validate_json(state.model_dump_json(exclude_none=True)) == state
    unheard = next(monitor for monitor in state.monitors if monitor.monitor == "evidence")
    assert unheard.reason == "no message has come yet of Receiver evidence"


def test_a_window_that_reaches_back_into_a_conflict_says_so_as_the_reason_of_its_monitor() -> None:
    process = Process(Config())
    second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *passing(SECOND_NS)])
    process._ended_ns = 2 * SECOND_NS  # a conflict has ended
    now_ns = 3 * SECOND_NS
    long = statement(Monitor.INERTIAL_LONG, now_ns, Outcome.ACCUSES, ("gnss",))
    published = second(process, now_ns, [*passing(now_ns), long.model_copy(update={"window_s": 60.0})])
    state = [message for message in published if isinstance(message, TrustState)][-1]
    assert state.state is TrustLevel.SAFE
    found = next(monitor for monitor in state.monitors if monitor.monitor == "inertial_long")
    assert (found.outcome, found.accused) == (Outcome.NOT_EVALUATED, ())
    assert found.reason == "its window reaches back into a conflict that has ended"


@pytest.mark.parametrize(
    ("record", "code"),
    [
        (None, Code.START_UNKNOWN),
        (TrustRecord(sampled_ns=0, moving=True), Code.START_AFTER_CUT),
        (TrustRecord(sampled_ns=0, moving=True, ended_in_order=True), None),
    ],
)
def test_how_the_process_before_ended_is_said_until_the_position_is_confirmed(
    record: TrustRecord | None, code: Code | None
) -> None:
    process = Process(Config())
    if record is not None:
        list(process.handle(record))
    waiting = [trust_monitor for trust_monitor in passing(SECOND_NS) if trust_monitor.monitor != Monitor.INERTIAL_LONG]
    published = second(process, SECOND_NS, [navigation_state(SECOND_NS, 10.0), *waiting])
    state = [message for message in published if isinstance(message, TrustState)][-1]
    said = {
        explanation.code
        for explanation in (*state.reason_codes, *state.finding_codes)
        if explanation.code.startswith("trust.start_")
    }
    assert said == ({str(code)} if code else set())
