"""What the status process makes of the messages of a whole unit."""

from pathlib import Path
from typing import Any

import pytest

from services.monitoring.status.flow import TopicFlow
from services.monitoring.status.history import history_file
from services.monitoring.status.history.history_file import HistoryFile
from services.monitoring.status.state import State
from services.monitoring.status.views import position, reports, snapshot
from services.monitoring.status.views.banner import Trust
from shared.bus.codec import encode
from shared.bus.codes import broker_down
from shared.errors import BadPayload
from shared.messages.explanation import Explanation, explain, process, topic
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.navigation import AidingKind, NavigationPhase, TruthState
from shared.messages.operation import (
    DeadlineReport,
    Freshness,
    Origin,
    OriginKind,
    Outage,
    Problem,
    ProcessAge,
    ProcessHealth,
    ProcessState,
    ProcessStatus,
    TopicAge,
)
from shared.messages.trust import Outcome, TrustEvent, TrustLevel
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.topics import BY_NAME
from shared.words.words import stated
from tests.support.bus.envelopes import sent
from tests.support.dashboard.status_world import (
    ALL,
    SECOND_NS,
    START_NS,
    World,
    aiding,
    fix,
    monitor,
    navigation,
    solution,
    trust,
)


def drive(world: World, seconds: float, *, without: tuple[str, ...] = (), level: TrustLevel = TrustLevel.SAFE) -> None:
    """Let the unit run, but for some processes or topics."""
    for i in range(round(seconds * 10)):
        now_ns = world.now_ns
        said = [
            ("sensors.simulator", ImuRaw(received_ns=now_ns, source="imu0", data=b"\xfa")),
            ("core.fusion", solution(now_ns)),
        ]
        if i % 10 == 0:
            said += [
                ("sensors.simulator", GnssRaw(received_ns=now_ns, source="gnss0", data=b"\xb5")),
                ("parsers.gnss", fix(now_ns)),
                ("core.fusion", navigation(now_ns, NavigationPhase.NAVIGATING, "all known")),
                ("core.trust", trust(now_ns, level)),
                ("sensors.simulator", Origin(now_ns=now_ns, kind=OriginKind.SIMULATED, name="urban")),
            ]
        for producer, message in said:
            if producer not in without and type(message).__name__ not in without:
                world.hear(message, producer)
        if i % 5 == 0:
            world.beat(*(name for name in ALL if name not in (*without, "monitoring.health", "monitoring.status")))
        world.pass_time(0.1)


@pytest.fixture
def driving() -> World:
    world = World()
    drive(world, 3.0)
    return world


def status(world: World, process: str) -> ProcessStatus:
    return world.state.judgement.statuses[process]


def rows(found: object) -> list[dict[str, Any]]:
    assert isinstance(found, list)
    return found


def fields(found: object) -> dict[str, Any]:
    assert isinstance(found, dict)
    return found


def problems(world: World) -> list[Explanation | None]:
    return [problem.text_code for problem in world.state.judgement.problems]


AWAITS_TRUST = "Nothing is known yet: waiting for the first verdict of core.trust."
STALE = explain("health.stale", process("core.fusion"))


def test_a_unit_that_works_has_no_problems(driving: World) -> None:
    assert problems(driving) == []
    assert driving.state.verdict.state is Trust.SAFE
    assert reports.health(driving.state, driving.now_ns)["state"] == "ok"


def test_a_stopped_process_is_stale_within_its_deadline_of_two_seconds(driving: World) -> None:
    stopped_ns = driving.now_ns
    while status(driving, "core.fusion") is not ProcessStatus.STALE:
        drive(driving, 0.1, without=("core.fusion",))
        assert driving.now_ns - stopped_ns < 3.0 * SECOND_NS, "deadline, heartbeat, report and the period of judging"
    drive(driving, 0.7, without=("core.fusion",), level=TrustLevel.NO_FIX)
    assert driving.state.verdict.sentence == "No position: core.fusion does not answer."


def test_every_age_is_that_of_the_data_however_promptly_it_arrives(driving: World) -> None:
    """An overloaded unit: each message comes in time, and is of 13.7 seconds ago."""
    late_ns = round(13.7 * SECOND_NS)
    for _ in range(20):
        driving.hear(solution(driving.now_ns - late_ns), "core.fusion")
        driving.hear(fix(driving.now_ns - late_ns), "parsers.gnss")
        driving.pass_time(0.1)
    state, now_ns = driving.state, driving.now_ns
    assert position.solution(state, now_ns)["age_s"] == pytest.approx(13.8, abs=0.11)
    shown = snapshot.dashboard(state, now_ns)
    for part in ("solution", "fix"):
        assert now_ns - fields(shown[part])["updated_ns"] == pytest.approx(13.8 * SECOND_NS, abs=0.11 * SECOND_NS)
    assert state.topics["navigation/solution"].freshness(now_ns) == "stale"
    assert not position.solution(state, now_ns)["live"]
    checks = {check.name: check.state for check in state.verdict.checks}
    assert checks["protection"] is checks["heading"] is checks["fix"] is Trust.STALE


def test_a_stamp_of_a_topic_that_is_decoded_now_and_then_ages_with_the_lag_of_the_last_one() -> None:
    flow = TopicFlow("imu/sample", BY_NAME["imu/sample"])
    for i in range(40):
        now_ns = START_NS + i * SECOND_NS // 100
        samples = ImuSamples(
            received_ns=now_ns, source="imu0", sampled_ns=(now_ns - 5 * SECOND_NS,),
            specific_force_body_m_s2=((0.0, 0.0, -9.8),), angular_rate_body_rad_s=((0.0, 0.0, 0.0),),
        )  # fmt: skip
        flow.note(sent(samples, now_ns))
    assert flow.age_s(now_ns) == pytest.approx(5.0, abs=1e-6)


def test_everything_that_fell_silent_with_a_process_is_one_problem(driving: World) -> None:
    drive(driving, 8.0, without=("core.fusion",))
    assert problems(driving) == [STALE]
    [shown] = rows(reports.health(driving.state, driving.now_ns)["problems"])
    assert shown["affected"] == ["navigation/solution", "navigation/state"]


def test_a_last_will_shows_a_process_as_lost_with_the_next_report(driving: World) -> None:
    will = ProcessHealth(process="parsers.gnss", state=ProcessState.LOST, incarnation=START_NS, sent_ns=driving.now_ns)
    driving.hear(will, "parsers.gnss")
    driving.pass_time(0.8)
    assert status(driving, "parsers.gnss") is ProcessStatus.LOST


def test_what_was_known_of_a_process_outlives_its_will(driving: World) -> None:
    driving.beat("parsers.gnss", last_error="checksum of UBX-NAV-PVT", rss_bytes=31_000_000)
    will = ProcessHealth(process="parsers.gnss", state=ProcessState.LOST, incarnation=START_NS, sent_ns=driving.now_ns)
    driving.hear(will, "parsers.gnss")
    driving.pass_time(0.3)
    row = snapshot.processes(driving.state, driving.now_ns)["parsers.gnss"]
    assert isinstance(row, dict)
    assert (row["last_error"], row["memory_bytes"]) == ("checksum of UBX-NAV-PVT", 31_000_000)


def test_a_process_that_ended_as_asked_is_ended_and_not_stale(driving: World) -> None:
    farewell = ProcessHealth(
        process="parsers.can", state=ProcessState.DISCONNECTED, incarnation=START_NS, sent_ns=driving.now_ns
    )
    driving.hear(farewell, "parsers.can")
    drive(driving, 5.0, without=("parsers.can",))
    assert status(driving, "parsers.can") is ProcessStatus.ENDED


def test_a_sensor_that_falls_silent_is_named_while_its_driver_runs(driving: World) -> None:
    drive(driving, 3.0, without=("ImuRaw",))
    assert problems(driving) == [
        explain("health.device_silent", topic("imu/raw"), process=process("sensors.simulator"))
    ]


def test_a_unit_that_has_just_started_has_no_root_cause_yet() -> None:
    starting = World()
    starting.beat(*ALL)
    starting.pass_time(0.8)
    assert starting.state.verdict.sentence == AWAITS_TRUST


def test_an_outage_lasts_from_the_last_message_to_the_first_after_it(driving: World) -> None:
    lost_ns = driving.now_ns
    drive(driving, 6.0, without=("core.fusion",))
    (open_,) = rows(reports.outages(driving.state)["open"])
    assert open_["what"] == "core.fusion"
    assert abs(open_["since_ns"] - lost_ns) < 0.6 * SECOND_NS
    assert reports.outages(driving.state)["closed"] == []
    drive(driving, 2.0)
    (closed,) = rows(reports.outages(driving.state)["closed"])
    assert (closed["until_ns"] - closed["since_ns"]) * 1e-9 == pytest.approx(6.2, abs=0.6)
    assert reports.outages(driving.state)["open"] == []


def test_an_outage_that_goes_on_is_open_again_and_not_a_second_one(driving: World) -> None:
    over = Outage(what="gnss/raw", since_ns=driving.now_ns, until_ns=driving.now_ns + SECOND_NS, cause="unplugged")
    driving.hear(over, "monitoring.health")
    assert reports.outages(driving.state)["closed"] == [{**over.model_dump(mode="json"), "languages": {}}]
    driving.hear(over.model_copy(update={"until_ns": None}), "monitoring.health")
    assert reports.outages(driving.state)["closed"] == []


def test_processes_are_waited_for_and_after_two_minutes_missing() -> None:
    world = World()
    world.pass_time(119.0, 0.5)
    assert status(world, "core.fusion") is ProcessStatus.WAITING
    world.pass_time(2.0, 0.5)
    assert status(world, "core.fusion") is ProcessStatus.MISSING
    cause = stated(explain("health.missing", process("core.fusion")))
    assert world.state.judgement.cause("navigation/solution") == cause
    assert "core.trust is missing" in world.state.verdict.sentence


def test_a_process_that_the_vehicle_does_not_have_is_absent_and_no_problem(driving: World) -> None:
    assert status(driving, "sensors.gnss") is ProcessStatus.ABSENT
    assert status(driving, "sensors.simulator") is ProcessStatus.READY


def test_a_health_message_in_the_name_of_a_stranger_is_rejected(driving: World) -> None:
    forged = ProcessHealth(process="stranger", state=ProcessState.LOST, incarnation=START_NS, sent_ns=driving.now_ns)
    payload = encode(forged)
    with pytest.raises(BadPayload):
        driving.hear_bytes("health/core.fusion", payload, "core.fusion")
    driving.pass_time(0.3)
    assert problems(driving) == []


@pytest.mark.parametrize(
    ("connected", "text"),
    [(False, "the broker is not reachable"), (True, "the broker delivers nothing")],
)
def test_a_lost_or_hung_broker_is_the_only_problem_and_all_else_is_unknown(
    driving: World, connected: bool, text: str
) -> None:
    for _ in range(60):
        driving.now_ns += SECOND_NS // 10
        driving.state.tick(driving.now_ns, broker=connected)
        assert problems(driving) in ([], [broker_down(connected=connected)])
    assert status(driving, "core.fusion") is ProcessStatus.UNKNOWN
    assert driving.state.verdict.state is Trust.BROKER_LOST
    assert driving.state.verdict.sentence == f"Nothing is known: {text}."
    assert reports.health(driving.state, driving.now_ns)["state"] == "failed"
    [outage] = rows(reports.outages(driving.state)["open"])
    assert outage["what"] == "broker"
    [problem] = snapshot.problems(driving.state)
    for row in (outage, problem):
        told = row["languages"]
        assert isinstance(told, dict) and told["de"].startswith("der Broker ") and told["fr"].startswith("le broker ")
    assert driving.state.verdict.lines["de"].sentence.startswith("Nichts ist bekannt: der Broker ")
    assert outage["cause_code"] == broker_down(connected=connected).model_dump(mode="json")


def test_a_broker_that_is_back_accuses_nobody(driving: World) -> None:
    driving.broker = False
    driving.pass_time(6.0)
    driving.broker = True
    seen = set()
    for _ in range(80):
        drive(driving, 0.1)
        seen |= {problem.what for problem in driving.state.judgement.problems}
    assert seen == {"broker"}
    assert [outage.what for outage in snapshot.outages(driving.state)] == ["broker"]
    assert reports.health(driving.state, driving.now_ns)["state"] == "ok"


def test_a_stall_of_the_status_process_itself_is_no_loss_of_the_broker(driving: World) -> None:
    driving.now_ns += 4 * SECOND_NS
    driving.state.tick(driving.now_ns, broker=True)
    assert problems(driving) == []
    drive(driving, 3.0)
    assert problems(driving) == []


def test_a_short_break_of_the_broker_is_one_outage_of_its_duration(driving: World) -> None:
    driving.broker = False
    driving.pass_time(1.0)
    assert reports.health(driving.state, driving.now_ns)["broker"] is False
    driving.broker = True
    drive(driving, 5.0)
    [outage] = snapshot.outages(driving.state)
    assert outage.until_ns is not None
    assert (outage.until_ns - outage.since_ns) * 1e-9 == pytest.approx(1.0, abs=0.5)
    assert reports.health(driving.state, driving.now_ns)["state"] == "ok"


def test_a_silent_watchdog_is_the_only_problem_and_all_else_is_unknown(driving: World) -> None:
    before, driving.watchdog = driving.watchdog, None
    drive(driving, 1.5)
    assert problems(driving) == []
    drive(driving, 1.5)
    assert problems(driving) == [explain("banner.not_reported", process("monitoring.health"))]
    assert {status(driving, name) for name in ALL} == {ProcessStatus.UNKNOWN}
    assert driving.state.verdict.state is Trust.SAFE, "the verdict does not depend on the watchdog"
    assert reports.health(driving.state, driving.now_ns)["topics"] == {}
    driving.watchdog = before
    drive(driving, 5.0)
    assert problems(driving) == []


def test_the_report_that_the_broker_retained_of_a_former_life_says_nothing_of_now() -> None:
    world = World()
    row = ProcessAge(process="core.fusion", status=ProcessStatus.LOST, restarts=9)
    old = DeadlineReport(now_ns=world.now_ns - 3600 * SECOND_NS, topics=(), processes=(row,))
    world.watchdog = None
    world.hear(old, "monitoring.health", retained=True)
    world.pass_time(5.0)
    assert status(world, "core.fusion") is ProcessStatus.WAITING
    world.pass_time(120.0, 0.5)
    assert status(world, "core.fusion") is ProcessStatus.UNKNOWN


def test_the_banner_holds_since_core_trust_says_and_the_timeline_keeps_each_change(driving: World) -> None:
    drive(driving, 2.0)
    assert driving.state.verdict.since_ns == START_NS
    drive(driving, 4.0, level=TrustLevel.UNSAFE)
    drive(driving, 6.0, without=("core.trust",))
    shown = [state for _, state in driving.state.trust_history.changes]
    assert shown == [Trust.SAFE, Trust.UNSAFE, Trust.STALE]


def test_the_verdict_ends_at_the_deadline_of_trust_state_and_is_never_safe_after_it(driving: World) -> None:
    drive(driving, 4.9, without=("core.trust",))
    said_ns = driving.state.topics["trust/state"].updated_ns or 0
    for _ in range(30):
        drive(driving, 0.1, without=("core.trust",))
        age_s = (driving.now_ns - said_ns) / SECOND_NS
        assert (driving.state.verdict.state is Trust.STALE) == (age_s >= 5.0) or abs(age_s - 5.0) < 0.3
    verdict = driving.state.verdict
    assert verdict.sentence.startswith("Trust is not evaluated for 9 s")
    assert all(check.state is Trust.STALE for check in verdict.checks if check.kind == "monitor")
    health = reports.health(driving.state, driving.now_ns)
    position = health["position"]
    assert isinstance(position, dict)
    assert (position["state"], position["word"], position["sentence"]) == ("stale", "NO DATA", verdict.sentence)
    assert position["since_ns"] == pytest.approx(said_ns + 5 * SECOND_NS, abs=0.3 * SECOND_NS)
    assert health["state"] == "degraded"


def test_a_retained_verdict_of_a_former_life_is_no_verdict() -> None:
    world = World()
    world.hear(trust(world.now_ns - 3600 * SECOND_NS), "core.trust", retained=True)
    world.pass_time(0.5)
    assert (world.state.verdict.state, world.state.verdict.sentence) == (Trust.STARTING, AWAITS_TRUST)
    world.beat("core.trust")
    world.pass_time(125.0, step_s=0.5)
    assert world.state.verdict.state is Trust.STALE, "what has not come within the time for a start is missing"


def test_no_verdict_is_shown_after_a_start_before_one_newer_than_the_start() -> None:
    world = World()
    world.hear(trust(world.now_ns - SECOND_NS // 2), "core.trust", retained=True)
    world.hear(solution(world.now_ns - SECOND_NS // 10), "core.fusion", retained=True)
    world.pass_time(0.5)
    assert shown_state(world) == "starting"
    assert not [check.name for check in world.state.verdict.checks if check.state is Trust.SAFE]
    drive(world, 0.3)
    assert shown_state(world) == "safe"


def shown_state(world: World) -> str:
    return world.state.verdict.state.value


def restart(world: World, process: str) -> None:
    """Kill a process, and let it come back a moment later, without a message but its heartbeat."""
    life = world.lives.get(process, START_NS)
    will = ProcessHealth(process=process, state=ProcessState.LOST, incarnation=life, sent_ns=world.now_ns)
    world.hear(will, process)
    drive(world, 0.3, without=(process,))
    world.lives[process] = world.now_ns
    world.beat(process)


def test_the_verdict_of_a_process_that_has_ended_is_withdrawn_at_once(driving: World) -> None:
    will = ProcessHealth(process="core.trust", state=ProcessState.LOST, incarnation=START_NS, sent_ns=driving.now_ns)
    driving.hear(will, "core.trust")
    drive(driving, 0.3, without=("core.trust",))
    assert driving.state.verdict.state is Trust.STALE
    assert driving.state.verdict.sentence == "Trust is not evaluated: core.trust was lost."


def test_a_verdict_of_before_the_restart_of_core_trust_is_not_shown_any_more(driving: World) -> None:
    restart(driving, "core.trust")
    drive(driving, 0.3, without=("core.trust",))
    assert (driving.state.verdict.state, driving.state.verdict.sentence) == (Trust.STARTING, AWAITS_TRUST)
    drive(driving, 1.2)
    assert driving.state.verdict.state is Trust.SAFE


def test_a_verdict_on_a_solution_of_before_the_restart_of_core_fusion_is_not_shown(driving: World) -> None:
    restart(driving, "core.fusion")
    drive(driving, 1.2, without=("core.fusion",))
    verdict = driving.state.verdict
    assert verdict.state is Trust.STARTING
    assert "the first position of core.fusion" in verdict.sentence
    green = {check.name for check in verdict.checks if check.state is Trust.SAFE}
    assert not green & {"phase", "heading", "protection", "gate"}
    drive(driving, 0.3, without=("core.fusion",), level=TrustLevel.NO_FIX)
    drive(driving, 1.0, without=("core.fusion",), level=TrustLevel.NO_FIX)
    assert shown_state(driving) == "no_fix", "that there is no solution is known without one"
    drive(driving, 1.2)
    assert shown_state(driving) == "safe"


def test_a_value_of_before_the_restart_of_its_producer_is_no_live_value(driving: World) -> None:
    restart(driving, "parsers.gnss")
    drive(driving, 0.3, without=("parsers.gnss",))
    assert driving.state.is_earlier("gnss/fix")
    assert driving.state.evidence(driving.now_ns).fix_age_s is None
    shown = snapshot.dashboard(driving.state, driving.now_ns)["topics"]
    assert isinstance(shown, dict)
    assert shown["gnss/fix"]["earlier"] and "earlier" not in shown["imu/raw"]
    drive(driving, 1.2)
    assert not driving.state.is_earlier("gnss/fix")


def test_no_process_is_ready_after_the_restart_of_the_watchdog_before_its_first_report(driving: World) -> None:
    assert status(driving, "core.fusion") is ProcessStatus.READY
    watchdog, driving.watchdog = driving.watchdog, None
    driving.lives["monitoring.health"] = driving.now_ns
    driving.beat("monitoring.health")
    drive(driving, 0.5)
    assert ProcessStatus.READY not in driving.state.judgement.statuses.values()
    driving.watchdog = watchdog
    drive(driving, 0.7)
    assert status(driving, "core.fusion") is ProcessStatus.READY


def test_an_exceeded_alert_limit_degrades_the_health_and_is_a_state_of_its_own(driving: World) -> None:
    why = explain("trust.level_above_limit", axis="horizontal", level_m=25.0, limit_m=10.0)
    driving.hear(trust(driving.now_ns, TrustLevel.UNSAFE, why), "core.trust")
    driving.pass_time(0.3)
    health = reports.health(driving.state, driving.now_ns)
    assert health["state"] == "degraded"
    position = health["position"]
    assert isinstance(position, dict)
    assert (position["state"], position["word"]) == ("above_limit", "ABOVE LIMIT")
    assert driving.state.trust_history.changes[-1][1] == "above_limit"


def test_the_page_trust_has_the_verdict_every_monitor_and_its_tests(driving: World) -> None:
    silent = monitor(driving.now_ns, "satellites", outcome=Outcome.NOT_EVALUATED, reason="4 satellites")
    state = trust(driving.now_ns, TrustLevel.CAUTION, monitors=(monitor(driving.now_ns), silent))
    driving.hear(state, "core.trust")
    driving.pass_time(1.2)
    shown = reports.trust(driving.state, driving.now_ns, 900.0)
    assert shown["state"] == "caution"
    monitors, history = shown["monitors"], shown["history"]
    assert isinstance(monitors, dict) and isinstance(history, dict)
    assert monitors["inertial_short"]["ratio"] == 0.5
    assert (monitors["satellites"]["outcome"], monitors["satellites"]["ratio"]) == ("not_evaluated", None)
    assert history["ratios"]["inertial_short"][-1] == 0.5
    assert "satellites" not in history["ratios"], "what was not evaluated has no statistic"


def test_trust_events_are_listed_newest_first_with_who_accused_and_are_bounded(driving: World) -> None:
    accusing = monitor(driving.now_ns, outcome=Outcome.ACCUSES, accused=("gnss",), statistic=9.0)
    for k in range(60):
        driving.hear(
            TrustEvent(
                sampled_ns=driving.now_ns + k, before=TrustLevel.SAFE, after=TrustLevel.UNSAFE,
                reasons=("x", "of another release"), reason_codes=(explain("trust.gnss_not_agreed"),),
                monitors=(accusing, monitor(driving.now_ns, "motion")),
            ),
            "core.trust",
        )  # fmt: skip
    events = snapshot.trust(driving.state, driving.now_ns)["events"]
    assert isinstance(events, list) and len(events) == 50
    assert [event["sampled_ns"] - driving.now_ns for event in events[:2]] == [59, 58]
    assert events[0]["reasons"] == ["GNSS has not agreed for long enough", "of another release"]
    assert [who["monitor"] for who in events[0]["accusing"]] == ["Short inertial window"]


def test_what_the_watchdog_reports_is_shown_as_it_is(driving: World) -> None:
    drive(driving, 3.0, without=("NavigationSolution",))
    row = TopicAge(
        topic="navigation/solution", freshness=Freshness.STALE, age_s=3.0, rate_hz=0.0, count=30, cause="unplugged"
    )
    row_of = ProcessAge(process="core.fusion", status=ProcessStatus.RESTARTING, heartbeat_age_s=0.1, restarts=4)
    problem = Problem(what="imu/raw", text="the IMU is unplugged", since_ns=START_NS, affected=("imu/raw",))
    driving.watchdog = None
    report = DeadlineReport(now_ns=driving.now_ns, topics=(row,), processes=(row_of,), problems=(problem,))
    driving.hear(report, "monitoring.health")
    driving.hear(trust(driving.now_ns, TrustLevel.NO_FIX, reasons=("solution is old",)), "core.trust")
    driving.pass_time(0.3)
    assert driving.state.verdict.sentence == "No position: unplugged."
    health = reports.health(driving.state, driving.now_ns)
    assert health["topics"] == {"navigation/solution": {"freshness": "stale", "age_s": 3.0, "cause": "unplugged"}}
    assert health["problems"] == [
        {
            "what": "imu/raw",
            "text": "the IMU is unplugged",
            "since_ns": START_NS,
            "affected": ["imu/raw"],
            "text_code": None,
            "languages": {},
        }
    ]
    shown = snapshot.processes(driving.state, driving.now_ns)["core.fusion"]
    assert isinstance(shown, dict)
    assert (shown["status"], shown["restarts"]) == ("restarting", 4)


def test_one_simulated_source_among_live_ones_makes_the_whole_simulated(driving: World) -> None:
    driving.hear(Origin(now_ns=driving.now_ns, kind=OriginKind.LIVE, name="truck"), "sensors.gnss")
    assert snapshot.origin(driving.state, driving.now_ns) == {
        "kind": "simulated",
        "name": "urban",
        "seed": None,
        "speed": 1.0,
    }


def test_an_origin_that_is_no_longer_repeated_is_not_shown(driving: World) -> None:
    driving.pass_time(11.0)
    assert snapshot.origin(driving.state, driving.now_ns) is None


def test_the_odometer_is_the_mean_of_the_wheels_and_else_the_vehicle(driving: World) -> None:
    speed = VehicleSpeed(sampled_ns=driving.now_ns, received_ns=driving.now_ns, source="can0", speed_m_s=7.0)
    driving.hear(speed, "parsers.can")
    assert driving.state.odometer(driving.now_ns) == (7.0, "vehicle/speed")
    wheels = WheelSpeeds(
        sampled_ns=driving.now_ns, received_ns=driving.now_ns, source="can0", rear_left_m_s=4.0, rear_right_m_s=6.0
    )
    driving.hear(wheels, "parsers.can")
    assert driving.state.odometer(driving.now_ns) == (5.0, "vehicle/wheel_speed")
    driving.pass_time(6.0)
    assert driving.state.odometer(driving.now_ns) is None


def test_the_history_breaks_where_the_solution_was_stale(driving: World) -> None:
    drive(driving, 4.0, without=("core.fusion",))
    columns = driving.state.history.columns(driving.now_ns, 60.0, ["speed_fused_m_s"])
    speeds = columns["fields"]["speed_fused_m_s"]
    assert speeds[5] == pytest.approx(5.0)
    assert speeds[-1] is None


def test_the_true_error_of_a_simulation_is_in_the_history(driving: World) -> None:
    truth = TruthState(
        sampled_ns=driving.now_ns, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0,
        velocity_ned_m_s=(3.0, 4.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0,
        angular_rate_body_rad_s=(0.0, 0.0, 0.0),
    )  # fmt: skip
    driving.hear(truth, "sensors.simulator")
    driving.hear(solution(driving.now_ns, latitude_deg=48.00001), "core.fusion")
    driving.pass_time(0.3)
    columns = driving.state.history.columns(driving.now_ns, 1.0, ["position_error_m"])
    assert columns["fields"]["position_error_m"][-1] == pytest.approx(1.112, abs=0.01)


def test_the_chain_names_how_many_links_work(driving: World) -> None:
    drive(driving, 6.0, without=("parsers.can", "GnssRaw"))
    chain = snapshot.chain(driving.state, driving.now_ns)
    assert chain["services"] == {"ok": False, "up": len(ALL) - 1, "of": len(ALL), "worst": "parsers.can"}
    assert chain["sensors"] == {"ok": False, "up": 1, "of": 2, "worst": "gnss"}


def test_a_snapshot_shows_every_topic_with_its_newest_message(driving: World) -> None:
    snapshot = reports.snapshot(driving.state, driving.now_ns)
    topics = snapshot["topics"]
    fix, sample = topics["gnss/fix"]["message"], topics["imu/raw"]["message"]
    assert fix and fix["satellites_used"] == 14
    assert topics["gnss/fix"]["freshness"] == "fresh"
    assert sample and sample["hexadecimal"] == "fa"
    assert topics["vehicle/speed"] | {"purpose": ""} == {
        "topic": "vehicle/speed", "type": "VehicleSpeed", "purpose": "", "producer": None, "freshness": "never",
        "age_s": None, "updated_ns": None, "rate_hz": 0.0, "latency_p50_s": None, "latency_p99_s": None,
        "jitter_s": None, "bytes": None, "sequence": None, "retained": False, "qos": 0, "unreadable": None,
        "message": None,
    }  # fmt: skip


def test_the_latency_of_a_process_is_that_of_what_it_says_regularly(driving: World) -> None:
    for _ in range(3):
        driving.hear(solution(driving.now_ns), "core.fusion", delay_s=0.002)
        for _ in range(40):
            late = aiding(AidingKind.ODOMETER, 0.5).model_copy(update={"sampled_ns": driving.now_ns - SECOND_NS})
            driving.hear(late, "core.fusion")
        driving.pass_time(1.0)
    shown = snapshot.processes(driving.state, driving.now_ns)["core.fusion"]
    assert shown["latency_of"] == "navigation/solution"
    assert shown["latency_p99_s"] is not None and shown["latency_p99_s"] < 0.5, (
        "and not that of measurements that waited"
    )


def test_the_dashboard_has_the_same_keys_with_and_without_data(driving: World) -> None:
    empty = World()
    empty.pass_time(0.3)
    assert (
        snapshot.dashboard(empty.state, empty.now_ns).keys() == snapshot.dashboard(driving.state, driving.now_ns).keys()
    )


def test_a_restart_keeps_the_verdicts_their_changes_and_the_outages(driving: World, tmp_path: Path) -> None:
    accusing = monitor(driving.now_ns, outcome=Outcome.ACCUSES, accused=("gnss",), statistic=9.0)
    change = TrustEvent(
        sampled_ns=driving.now_ns, before=TrustLevel.SAFE, after=TrustLevel.UNSAFE, reasons=("GNSS is accused",),
        monitors=(accusing,),
    )  # fmt: skip
    driving.hear(change, "core.trust")
    drive(driving, 6.0, without=("core.fusion",), level=TrustLevel.NO_FIX)
    drive(driving, 2.0)
    before = driving.state
    file = HistoryFile(tmp_path / "kept.jsonl")
    file.append(before.unsaved())
    assert not before.unsaved(), "every record is handed over once"
    with (tmp_path / "kept.jsonl").open("ab") as cut:
        cut.write(b'{"kind":"verdict","ns":17950')
    started_ns = driving.now_ns + 20 * SECOND_NS
    after = State("truck-07", ALL, started_ns, 900.0)
    assert after.restore(file.read()) == 1, "the line that was cut short"
    assert list(after.trust_history.changes) == list(before.trust_history.changes)
    assert list(after.trust_events) == [change]
    assert after.outages.closed() == before.outages.closed() and len(after.outages.closed()) == 1
    kept, shown = (s.trust_history.columns(started_ns, 900.0)["ratios"] for s in (before, after))
    assert kept == shown
    after.tick(started_ns, broker=True)
    states = [(ns, state) for ns, state in after.trust_history.changes][-2:]
    assert [state for _, state in states] == ["gap", "starting"], "nobody knows the verdict of the time in between"
    assert states[0][0] < driving.now_ns + SECOND_NS and states[1][0] == started_ns
    later = State("truck-07", ALL, started_ns + 3600 * SECOND_NS, 900.0)
    later.restore(file.read())
    assert not later.trust_history.changes and not later.outages.closed(), "that was another drive"


def test_the_history_of_earlier_lives_is_bounded_and_a_full_disk_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(history_file, "FILE_BYTES", 1000)
    file = HistoryFile(tmp_path / "kept.jsonl")
    for k in range(200):
        file.append([{"kind": "verdict", "ns": k}])
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 2200
    assert list(file.read())[-1] == b'{"kind":"verdict","ns":199}'
    lost = HistoryFile(tmp_path / "absent" / "kept.jsonl")
    for _ in range(3):
        lost.append([{"kind": "verdict", "ns": 1}])
    assert [record.message for record in caplog.records if "does not outlive" in record.message][1:] == []
