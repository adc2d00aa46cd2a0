from collections.abc import Callable
from copy import deepcopy
from functools import lru_cache

import pytest

from services.monitoring.health.causes import expected_topics
from services.monitoring.health.codes import Code
from services.monitoring.health.watch import Watch
from shared.bus import codec
from shared.bus.codes import broker_down
from shared.messages.explanation import Explanation, explain, process, topic
from shared.messages.imu import ImuSamples
from shared.messages.operation import (
    Freshness,
    Outage,
    ProcessHealth,
    ProcessState,
    ProcessStatus,
    RecordingState,
    TopicAge,
    TopicTraffic,
)
from shared.topics import BY_NAME

SECOND = 1_000_000_000
START_NS = 1_790_000_000 * SECOND
SENSORS = ("sensors.gnss", "sensors.imu", "sensors.can")
FLOW = {  # topic: (producer, rate, the topic that it needs)
    "gnss/raw": ("sensors.gnss", 1.0, None),
    "imu/raw": ("sensors.imu", 100.0, None),
    "can/raw": ("sensors.can", 10.0, None),
    "gnss/fix": ("parsers.gnss", 1.0, "gnss/raw"),
    "imu/sample": ("parsers.imu", 100.0, "imu/raw"),
    "vehicle/speed": ("parsers.can", 1.0, "can/raw"),
    "navigation/solution": ("core.fusion", 10.0, "imu/sample"),
    "navigation/state": ("core.fusion", 1.0, None),
    "trust/state": ("core.trust", 1.0, None),
    "mode/state": ("controller.mode", 1.0, None),
    "recording/state": ("monitoring.recorder", 1.0, None),
    "deadline/report": ("monitoring.health", 2.0, None),
}
STANDING = (*dict.fromkeys(name for name, _, _ in FLOW.values() if name not in SENSORS), "monitoring.status")
STEP_NS = SECOND // 25
HEARTBEAT_S = 0.5  # by which the end of an outage is noticed later, where heartbeats tell of its topics


class Unit:
    """A unit in which messages follow from one another, and parts of which can be broken."""

    told = False  # heartbeats tell of fast topics, of which no message comes here

    def __init__(self, processes: tuple[str, ...] = STANDING + SENSORS) -> None:
        self.now_ns = START_NS
        self.watch = Watch(processes, START_NS)
        self.running = list(processes)
        self.hanging: set[str] = set()
        self.mute: set[str] = set()  # topics that their producers do not send
        self.connected = self.delivering = True
        self.lives = dict.fromkeys(processes, 1)
        self.events: list[tuple[float, Outage]] = []
        self.deaf: set[str] = set()  # processes that receive nothing
        self.silent_about: set[str] = set()  # processes whose heartbeats do not tell what they published
        self.published: dict[tuple[str, str, int], TopicTraffic] = {}  # by process, topic and life
        self._received: dict[tuple[str, str, int], TopicTraffic] = {}
        self._due: dict[str, int] = {}

    def run(self, duration_s: float) -> list[tuple[float, Outage]]:
        """Let time pass; return the outage events with their time since now."""
        start_ns, first = self.now_ns, len(self.events)
        while self.now_ns < start_ns + duration_s * SECOND:
            self.now_ns += STEP_NS
            if self.connected and self.delivering:
                self._talk()
            for event in self.watch.step(self.now_ns, connected=self.connected):
                self.events.append(((self.now_ns - start_ns) / SECOND, event))
            if self._is_due("report", 2.0):
                self.watch.report(self.now_ns)
        return self.events[first:]

    def kill(self, process: str) -> None:
        self.running.remove(process)
        self.say_health(process, ProcessState.LOST)

    def revive(self, process: str) -> None:
        self.lives[process] = self.lives.get(process, 0) + 1
        self.running.append(process)

    def say_health(self, process: str, state: ProcessState = ProcessState.READY, *, retained: bool = False) -> None:
        life = self.lives.get(process, 1)
        over = state is ProcessState.LOST
        published, received = (
            () if over else tuple(carried for (name, _, of), carried in record.items() if (name, of) == (process, life))
            for record in ({} if process in self.silent_about else self.published, self._received)
        )
        health = ProcessHealth(
            process=process, state=state, incarnation=life, sent_ns=self.now_ns, published=published, received=received
        )
        self.watch.take_health(health, self.now_ns, retained=retained)

    def topic(self, name: str) -> TopicAge:
        return {age.topic: age for age in self.watch.report(self.now_ns).topics}[name]

    def silent(self) -> set[str]:
        return {age.process for age in self.watch.report(self.now_ns).processes if age.status.down}

    def status(self, process: str) -> ProcessStatus:
        return {age.process: age.status for age in self.watch.report(self.now_ns).processes}[process]

    def problems(self) -> list[Explanation | None]:
        return [problem.text_code for problem in self.watch.report(self.now_ns).problems]

    def _talk(self) -> None:
        speaking = [name for name in self.running if name not in self.hanging]
        for name in speaking:
            if self._is_due(f"health/{name}", 2.0):
                self.watch.take(f"health/{name}", b"{}", producer=name, received_ns=self.now_ns)
                self.say_health(name)
        alive: set[str] = set()
        for name, (producer, rate_hz, need) in FLOW.items():
            if producer not in speaking or name in self.mute or (need and need not in alive):
                continue
            alive.add(name)
            if self._is_due(name, rate_hz):
                payload = b'{"received_ns":%d,"sampled_ns":%d}' % (self.now_ns - 1_000_000, self.now_ns - 3_000_000)
                if self.told and BY_NAME[name].fast:
                    self._count(name, producer, codec.stamp_ns(BY_NAME[name], payload))
                    continue
                self.watch.take(name, payload, producer=producer, received_ns=self.now_ns)

    def _count(self, topic: str, producer: str, stamp_ns: int | None) -> None:
        receivers = [name for name in self.running if name in BY_NAME[topic].consumers]
        for counts, processes in ((self.published, [producer]), (self._received, receivers)):
            for name in processes:
                heard = counts is self.published or name not in self.deaf | self.hanging
                key = (name, topic, self.lives.get(name, 1))
                before = counts.get(key, TopicTraffic(topic=topic, count=0))
                counts[key] = TopicTraffic(
                    topic=topic, count=before.count + 1, newest_ns=self.now_ns, stamp_ns=stamp_ns,
                    producer=None if counts is self.published else producer,
                ) if heard else before  # fmt: skip

    def _is_due(self, what: str, rate_hz: float) -> bool:
        if self.now_ns < self._due.get(what, 0):
            return False
        self._due[what] = self.now_ns + round(SECOND / rate_hz)
        return True


@pytest.fixture(autouse=True, params=["messages", "heartbeats"])
def told(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Both ways in which the watchdog learns of fast topics: every judgement must be the same."""
    by_heartbeats: bool = request.param == "heartbeats"
    monkeypatch.setattr(Unit, "told", by_heartbeats)
    return by_heartbeats


@lru_cache
def _run_well(*, told: bool) -> Unit:
    made = Unit()
    assert made.told is told and made.run(20) == []
    return made


@pytest.fixture
def unit(told: bool) -> Unit:
    """A unit that has run well for 20 s: a copy, for each test breaks it in its own way."""
    return deepcopy(_run_well(told=told))


def outages(events: list[tuple[float, Outage]]) -> dict[str, Outage]:
    """Give the newest state of each outage; there must not be two of one root cause."""
    assert len({(event.what, event.since_ns) for _, event in events}) == len({event.what for _, event in events})
    return {event.what: event for _, event in events}


def causes(events: list[tuple[float, Outage]]) -> dict[str, Explanation | None]:
    return {what: outage.cause_code for what, outage in outages(events).items() if outage.until_ns is None}


def duration_s(outage: Outage) -> float:
    assert outage.until_ns is not None
    return (outage.until_ns - outage.since_ns) / SECOND


def test_a_healthy_unit_has_no_outage_and_nothing_silent(unit: Unit) -> None:
    assert unit.run(200) == []
    assert unit.silent() == set()
    assert unit.problems() == []


def test_a_killed_process_is_one_outage_at_once_and_the_cause_of_all_silence(unit: Unit) -> None:
    unit.kill("sensors.imu")
    [(at, begin)] = unit.run(5)

    assert at < 0.05
    assert (begin.what, begin.affected) == ("sensors.imu", ("imu/raw",))
    assert begin.since_ns == unit.now_ns - 5 * SECOND
    assert begin.cause_code == explain(Code.LOST, process("sensors.imu"))
    assert unit.problems() == [begin.cause_code]
    for name in ("imu/raw", "imu/sample", "navigation/solution"):
        assert unit.topic(name).cause_code == begin.cause_code


def test_an_outage_ends_when_all_that_it_affected_is_published_again(unit: Unit) -> None:
    unit.kill("sensors.imu")
    unit.run(5)
    unit.mute.add("navigation/solution")
    unit.revive("sensors.imu")
    assert unit.run(6) == []
    assert unit.status("sensors.imu") is ProcessStatus.RESTARTING
    assert unit.problems() == [
        explain(Code.RESTARTED_WAITING, process("sensors.imu"), topics=(topic("navigation/solution"),))
    ]
    unit.mute.clear()
    [(_, end)] = unit.run(3)

    assert end.affected == ("imu/raw", "imu/sample", "navigation/solution")
    assert duration_s(end) == pytest.approx(11, abs=0.2 + HEARTBEAT_S)
    assert unit.status("sensors.imu") is ProcessStatus.READY
    restarts = {age.process: age.restarts for age in unit.watch.report(unit.now_ns).processes}
    assert restarts.pop("sensors.imu") == 1
    assert set(restarts.values()) == {0}
    assert unit.run(20) == []
    assert unit.problems() == []


def test_a_process_that_starts_again_slowly_is_not_said_to_run_and_say_nothing(unit: Unit) -> None:
    unit.kill("core.fusion")
    unit.run(1.0)
    unit.mute |= {"navigation/solution"}
    unit.revive("core.fusion")
    unit.run(19)
    text = explain(Code.RESTARTED_WAITING, process("core.fusion"), topics=(topic("navigation/solution"),))
    assert unit.problems() == [text]
    assert unit.topic("navigation/solution").cause_code == text
    unit.mute.clear()
    unit.run(1)

    assert set(outages(unit.events)) == {"core.fusion"}
    assert duration_s(unit.events[-1][1]) == pytest.approx(20, abs=0.2)


def test_a_process_restarted_on_request_within_its_deadline_is_the_cause_of_its_silence() -> None:
    unit = Unit()
    unit.lives = dict.fromkeys(unit.lives, START_NS)
    unit.run(20)
    unit.running.remove("core.fusion")
    unit.say_health("core.fusion", ProcessState.DISCONNECTED)
    unit.run(1)
    unit.mute.add("navigation/solution")
    unit.lives["core.fusion"] = unit.now_ns
    unit.running.append("core.fusion")

    assert causes(unit.run(5)) == {"core.fusion": explain(Code.RESTARTED, process("core.fusion"))}


def test_a_relapse_downstream_soon_after_the_end_continues_the_same_outage(unit: Unit) -> None:
    unit.kill("parsers.imu")
    unit.run(1.5)
    unit.revive("parsers.imu")
    unit.run(0.5)
    unit.mute.add("navigation/solution")  # the filter aligns anew after the gap
    unit.run(8)
    assert causes(unit.events) == {"parsers.imu": explain(Code.LOST, process("parsers.imu"))}
    unit.mute.clear()
    unit.run(2)

    [outage] = outages(unit.events).values()
    assert duration_s(outage) == pytest.approx(10, abs=0.3)
    assert outage.affected == ("imu/sample", "navigation/solution")


def test_a_hanging_process_is_stale_and_its_topics_wait_for_that_verdict(unit: Unit) -> None:
    unit.hanging.add("parsers.imu")
    [(at, begin)] = unit.run(6)

    assert 1.4 < at < 2.2
    assert begin.cause_code == explain(Code.STALE, process("parsers.imu"))
    unit.hanging.clear()
    [(_, end)] = unit.run(3)
    assert (end.what, end.affected) == ("parsers.imu", ("imu/sample", "navigation/solution"))


def test_a_device_that_sends_nothing_is_the_cause_while_all_processes_run(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    assert causes(unit.run(10)) == {
        "gnss/raw": explain(Code.DEVICE_SILENT, topic("gnss/raw"), process=process("sensors.gnss"))
    }
    assert unit.topic("gnss/fix").cause_code == explain(
        Code.DEVICE_SILENT, topic("gnss/raw"), process=process("sensors.gnss")
    )


def test_a_topic_that_falls_silent_just_before_its_input_waits_for_it(unit: Unit) -> None:
    unit.mute.add("gnss/fix")
    unit.run(1.0)
    unit.mute.add("gnss/raw")
    assert set(causes(unit.run(10))) == {"gnss/raw"}


def test_a_process_that_is_down_is_the_cause_while_another_input_is_only_late(unit: Unit) -> None:
    unit.hanging |= {"sensors.gnss", "sensors.imu"}
    unit.run(4)
    assert unit.topic("gnss/fix").freshness is Freshness.LATE
    assert unit.topic("navigation/solution").cause_code == explain(Code.STALE, process("sensors.imu"))


def test_a_process_that_publishes_nothing_although_fed_is_itself_the_cause(unit: Unit) -> None:
    unit.mute.add("imu/sample")
    assert causes(unit.run(5)) == {
        "imu/sample": explain(Code.NOT_PUBLISHED, topic("imu/sample"), process=process("parsers.imu"))
    }


def test_an_input_that_was_silent_long_before_is_not_blamed_for_a_later_silence(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    unit.run(30)
    unit.kill("sensors.imu")
    unit.run(5)

    assert unit.topic("navigation/solution").cause_code == explain(Code.LOST, process("sensors.imu"))


def test_a_process_that_dies_while_its_topic_is_silent_becomes_the_cause(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    unit.run(10)
    unit.kill("sensors.gnss")
    events = outages(unit.run(1))

    assert events["gnss/raw"].until_ns is not None
    assert events["sensors.gnss"].until_ns is None
    assert unit.topic("gnss/fix").cause_code == explain(Code.LOST, process("sensors.gnss"))
    assert len(unit.problems()) == 1


def test_a_lost_broker_is_one_outage_published_when_it_is_back(unit: Unit) -> None:
    unit.connected = False
    assert unit.run(30) == []
    unit.connected = True
    outage = outages(unit.run(30))["broker"]

    assert set(outages(unit.events)) == {"broker"}
    assert outage.cause_code == broker_down(connected=False)
    assert duration_s(outage) == pytest.approx(30, abs=1.1)  # gnss/raw comes once a second


def test_a_broker_that_hangs_is_one_outage(unit: Unit) -> None:
    unit.delivering = False
    assert unit.run(20) == []
    unit.delivering = True
    outage = outages(unit.run(20))["broker"]

    assert set(outages(unit.events)) == {"broker"}
    assert outage.cause_code == broker_down(connected=True)
    assert duration_s(outage) == pytest.approx(20, abs=1.1)


def test_wills_for_connections_that_the_broker_dropped_itself_are_no_outage(unit: Unit) -> None:
    unit.delivering = False
    unit.run(8)
    unit.delivering = True
    unit.say_health("sensors.gnss", ProcessState.LOST)
    unit.running.remove("parsers.gnss")
    unit.say_health("parsers.gnss", ProcessState.LOST)
    unit.run(1)
    unit.say_health("core.fusion", ProcessState.LOST)
    unit.running.append("parsers.gnss")
    unit.run(20)

    assert set(outages(unit.events)) == {"broker"}
    assert unit.silent() == set()


def test_wills_that_a_broker_sends_while_it_shuts_down_are_no_outage(unit: Unit) -> None:
    unit.delivering = False
    unit.say_health("monitoring.health", ProcessState.LOST)
    unit.say_health("sensors.gnss", ProcessState.LOST)
    unit.run(0.2)
    unit.connected = False
    unit.run(5)
    unit.connected = unit.delivering = True
    unit.run(20)

    assert set(outages(unit.events)) == {"broker"}
    assert unit.silent() == set()


def test_a_filter_that_aligns_anew_after_a_loss_of_the_broker_belongs_to_that_outage(unit: Unit) -> None:
    unit.connected = False
    unit.run(8)
    unit.connected = True
    unit.run(1)
    unit.mute.add("navigation/solution")
    unit.run(15)
    assert unit.problems() == [explain(Code.BROKER_BACK_WAITING, topics=(topic("navigation/solution"),))]
    unit.mute.clear()
    unit.run(5)

    [outage] = outages(unit.events).values()
    assert outage.what == "broker"
    assert duration_s(outage) == pytest.approx(24, abs=0.3 + HEARTBEAT_S)


def test_what_is_silent_long_after_a_loss_of_the_broker_has_a_cause_of_its_own(unit: Unit) -> None:
    unit.connected = False
    unit.mute.add("gnss/raw")
    unit.run(10)
    unit.connected = True
    unit.run(70)

    assert causes(unit.events) == {
        "gnss/raw": explain(Code.DEVICE_SILENT, topic("gnss/raw"), process=process("sensors.gnss"))
    }


def test_a_process_that_does_not_return_with_the_broker_is_reported(unit: Unit) -> None:
    unit.connected = False
    unit.running.remove("parsers.gnss")
    unit.run(10)
    unit.connected = True
    unit.run(15)

    assert set(causes(unit.events)) == {"parsers.gnss"}
    assert set(outages(unit.events)) == {"parsers.gnss", "broker"}


def test_an_outage_from_before_a_broker_loss_stays_open_until_it_is_over(unit: Unit) -> None:
    unit.kill("sensors.gnss")
    unit.run(10)
    unit.connected = False
    unit.run(5)
    unit.connected = True

    assert set(outages(unit.run(20))) == {"broker"}
    unit.revive("sensors.gnss")
    [(_, end)] = unit.run(5)
    assert (end.what, end.affected) == ("sensors.gnss", ("gnss/raw", "gnss/fix"))


def test_a_process_killed_while_the_observer_slept_was_lost_and_does_not_hang(unit: Unit) -> None:
    unit.run(20.0)
    unit.now_ns += 3 * SECOND
    unit.watch.step(unit.now_ns, connected=True)
    unit.kill("core.fusion")
    events = unit.run(8.0)
    assert [outage.what for _, outage in events] == ["core.fusion"]
    assert (events[0][1].cause_code or broker_down(connected=True)).code == Code.LOST


def test_an_observer_that_slept_accuses_nobody(unit: Unit) -> None:
    unit.now_ns += 60 * SECOND

    assert unit.run(30) == []


def test_a_restarted_watchdog_continues_and_ends_the_outages_of_its_former_life(unit: Unit) -> None:
    unit.kill("parsers.imu")
    unit.run(5)
    report = unit.watch.report(unit.now_ns)
    died_ns, since_ns = unit.now_ns, unit.events[0][1].since_ns
    unit.now_ns += 4 * SECOND
    unit.watch = Watch(STANDING + SENSORS, unit.now_ns)
    unit.watch.resume(report)
    unit.watch.resume(unit.watch.report(unit.now_ns + SECOND))  # a report of this life is nothing to continue
    [(_, own)] = unit.run(3)

    assert (own.what, own.since_ns, own.until_ns) == ("monitoring.health", died_ns, died_ns + 4 * SECOND)
    assert own.cause_code == explain(Code.NOT_MONITORED, process("monitoring.health"))
    assert len(unit.problems()) == 1
    unit.revive("parsers.imu")
    [(_, end)] = unit.run(12)
    assert (end.what, end.since_ns) == ("parsers.imu", since_ns)
    assert duration_s(end) == pytest.approx(12, abs=0.5)
    assert end.affected == ("imu/sample", "navigation/solution")
    assert unit.problems() == []


def test_a_report_of_long_ago_is_not_continued(unit: Unit) -> None:
    unit.kill("parsers.imu")
    unit.run(5)
    report = unit.watch.report(unit.now_ns)
    unit.now_ns += 3600 * SECOND
    unit.revive("parsers.imu")
    unit.watch = Watch(STANDING + SENSORS, unit.now_ns)
    unit.watch.resume(report)

    assert unit.run(20) == []


@pytest.mark.parametrize(
    ("recording", "reason_code", "free_bytes", "why"),
    [
        (False, explain("recorder.disk_full"), 0, explain("recorder.disk_full")),
        (False, None, 0, None),  # of a recorder of an earlier release
        (True, None, 300_000_000, explain(Code.DISK_LOW, free_bytes=300_000_000)),
    ],
)
def test_trouble_of_the_recorder_is_a_problem_but_no_outage(
    unit: Unit, recording: bool, reason_code: Explanation | None, free_bytes: int, why: Explanation | None
) -> None:
    state = RecordingState(
        now_ns=unit.now_ns, recording=recording, bytes_written=0, messages=0, dropped=0,
        free_bytes=free_bytes, reason=None if recording else "x", reason_code=reason_code,
    )  # fmt: skip
    unit.watch.take_recording(state)

    assert unit.run(1) == []
    assert unit.problems() == [why]
    [problem] = unit.watch.report(unit.now_ns).problems
    assert why in (None, problem.text_code) and (recording or problem.text == "x")


def test_what_was_never_seen_is_missing_only_after_two_minutes() -> None:
    unit = Unit()
    unit.running.remove("sensors.can")
    unit.running.remove("parsers.can")

    assert unit.run(119) == []
    assert causes(unit.run(2)) == {
        name: explain(Code.MISSING, process(name)) for name in ("sensors.can", "parsers.can")
    }
    assert unit.topic("can/raw").cause_code == explain(Code.MISSING, process("sensors.can"))
    assert unit.topic("vehicle/speed").cause_code == explain(Code.MISSING, process("parsers.can"))


def test_a_topic_whose_device_never_spoke_is_missing_after_two_minutes() -> None:
    unit = Unit()
    unit.mute.add("can/raw")
    named = causes(unit.run(125))

    assert named == {"can/raw": explain(Code.DEVICE_SILENT, topic("can/raw"), process=process("sensors.can"))}
    assert {"can/raw", "vehicle/speed", "vehicle/wheel_speed"} == set(
        unit.watch.report(unit.now_ns).problems[0].affected
    )


def test_a_topic_that_the_vehicle_does_not_have_is_not_missed_beside_one_that_it_has() -> None:
    unit = Unit()

    assert unit.run(150) == []
    assert unit.topic("vehicle/wheel_speed").freshness is Freshness.NEVER


def test_a_vehicle_without_sensors_misses_neither_them_nor_what_follows_from_them() -> None:
    unit = Unit(STANDING)
    named = causes(unit.run(150))

    assert named == {}
    assert {age.topic for age in unit.watch.report(unit.now_ns).topics}.isdisjoint({"gnss/raw", "can/raw"})


def test_expected_topics_follow_from_the_sensors() -> None:
    only_gnss = expected_topics({*STANDING, "sensors.gnss"})

    assert {"gnss/raw", "gnss/fix", "navigation/solution", "origin/state"} <= only_gnss
    assert only_gnss.isdisjoint({"imu/raw", "imu/sample", "can/raw", "vehicle/speed", "truth/state"})


def test_a_guest_is_watched_from_its_birth_to_its_farewell() -> None:
    unit = Unit(STANDING)
    unit.run(15)
    unit.revive("sensors.simulator")
    unit.run(5)
    unit.kill("sensors.simulator")
    assert causes(unit.run(1)) == {"sensors.simulator": explain(Code.LOST, process("sensors.simulator"))}
    unit.revive("sensors.simulator")
    assert [event.until_ns is None for _, event in unit.run(5)] == [False]
    unit.running.remove("sensors.simulator")
    unit.say_health("sensors.simulator", ProcessState.DISCONNECTED)
    assert unit.run(60) == []


def test_a_configured_process_that_said_farewell_is_an_outage(unit: Unit) -> None:
    unit.running.remove("core.fusion")
    unit.say_health("core.fusion", ProcessState.DISCONNECTED)

    assert causes(unit.run(6)) == {"core.fusion": explain(Code.ENDED, process("core.fusion"))}


def test_the_will_of_a_former_life_says_nothing_of_this_one(unit: Unit) -> None:
    unit.revive("core.fusion")
    unit.running.remove("core.fusion")
    unit.run(1)
    old = ProcessHealth(process="core.fusion", state=ProcessState.LOST, incarnation=1, sent_ns=START_NS)
    unit.watch.take_health(old, unit.now_ns)

    assert unit.run(5) == []


def test_a_replay_that_ends_is_the_cause_of_the_silence_after_it() -> None:
    unit = Unit(STANDING)
    unit.run(15)
    unit.watch.take("imu/raw", b"", producer="replay", received_ns=unit.now_ns)
    unit.watch.take("imu/sample", b"", producer="parsers.imu", received_ns=unit.now_ns)

    assert causes(unit.run(5)) == {"imu/raw": explain(Code.PRODUCER_ENDED, topic("imu/raw"), process=process("replay"))}
    assert unit.topic("imu/sample").cause_code == explain(
        Code.PRODUCER_ENDED, topic("imu/raw"), process=process("replay")
    )


@pytest.mark.parametrize("state", [ProcessState.LOST, ProcessState.DISCONNECTED, ProcessState.READY])
def test_what_the_broker_kept_from_a_former_life_is_no_outage_while_the_unit_starts(state: ProcessState) -> None:
    unit = Unit()
    unit.running.remove("core.fusion")
    unit.lives["core.fusion"] = 0
    unit.say_health("core.fusion", state, retained=True)
    assert unit.run(8) == []
    unit.revive("core.fusion")
    assert unit.run(20) == []


def test_what_the_broker_kept_counts_when_nothing_follows() -> None:
    unit = Unit()
    unit.running.remove("core.fusion")
    unit.say_health("core.fusion", ProcessState.LOST, retained=True)

    assert "core.fusion" in causes(unit.run(15))


def test_rates_ages_and_latencies_are_measured_without_decoding(unit: Unit, told: bool) -> None:
    raw, solution = unit.topic("imu/raw"), unit.topic("navigation/solution")

    assert raw.rate_hz == pytest.approx(25.0, rel=0.02)  # as often as this test steps
    assert raw.latency_p50_s == pytest.approx(0.001)
    assert solution.latency_p99_s == pytest.approx(0.003)
    assert unit.topic("gnss/fix").rate_hz == pytest.approx(1.0, rel=0.11)
    unit.mute.add("imu/raw")
    unit.run(0.8)
    assert unit.topic("imu/raw").age_s == pytest.approx(0.8 - 0.48 * told), "as the last heartbeat said"
    assert unit.topic("imu/raw").freshness is (Freshness.FRESH if told else Freshness.LATE)
    unit.run(0.4 + HEARTBEAT_S * told)
    assert unit.topic("imu/raw").freshness is Freshness.STALE
    unit.run(15)
    assert unit.topic("imu/raw").rate_hz == 0.0


def test_the_stamp_is_found_in_a_message_as_it_is_encoded() -> None:
    samples = ImuSamples(
        received_ns=START_NS,
        source="imu0",
        sampled_ns=(START_NS - SECOND,),
        specific_force_body_m_s2=((0.0, 0.0, -9.8),),
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),),
    )
    watch = Watch(STANDING, START_NS)
    watch.take("imu/sample", codec.encode(samples), producer="parsers.imu", received_ns=START_NS + 2_000_000)

    age = next(age for age in watch.report(START_NS + SECOND).topics if age.topic == "imu/sample")
    assert age.latency_p50_s == pytest.approx(0.002)


def test_a_retained_message_is_as_old_as_its_own_stamp_and_spoils_no_latency() -> None:
    watch = Watch(STANDING, START_NS)
    payload = b'{"sampled_ns":%d}' % (START_NS - 40 * SECOND)
    watch.take("mode/state", payload, producer="controller.mode", received_ns=START_NS, retained=True)
    age = next(age for age in watch.report(START_NS).topics if age.topic == "mode/state")

    assert age.age_s == pytest.approx(40.0)
    assert age.latency_p50_s is None


@pytest.mark.parametrize(
    "feed",
    [
        lambda watch: watch.take("no/such", b"", producer="x", received_ns=START_NS),
        lambda watch: watch.take("imu/raw", b'{"received_ns":-}', producer="", received_ns=START_NS),
        lambda watch: watch.take("imu/raw", b'{"received_ns":%s}' % (b"9" * 99), producer="x", received_ns=START_NS),
        lambda watch: watch.take("mode/state", b'{"sampled_ns":1e99}', producer="x", received_ns=START_NS),
        lambda watch: watch.take_health(
            ProcessHealth(process="x", state=ProcessState.LOST, incarnation=1, sent_ns=1), START_NS
        ),
    ],
)
def test_strange_messages_do_no_harm(unit: Unit, feed: Callable[[Watch], None]) -> None:
    feed(unit.watch)

    assert unit.run(1) == []


def test_a_process_that_receives_nothing_of_what_is_sent_is_named(unit: Unit, told: bool) -> None:
    unit.deaf.add("parsers.imu")
    unit.mute.add("imu/sample")
    unit.run(4)
    text = explain(Code.NOT_RECEIVED, process("parsers.imu"), topic=topic("imu/raw"), producer=process("sensors.imu"))
    assert text not in unit.problems(), "not within five seconds"
    unit.run(3)
    assert (text in unit.problems()) is told
    unit.deaf.clear()
    unit.mute.clear()
    unit.run(2)
    assert unit.problems() == []


def test_a_process_that_starts_again_or_has_ended_is_not_deaf(unit: Unit) -> None:
    unit.deaf.add("parsers.imu")
    unit.kill("parsers.imu")
    unit.run(20)
    assert not [why for why in unit.problems() if why and why.code == Code.NOT_RECEIVED]


def test_messages_of_a_program_that_does_not_count_are_told_by_its_consumers() -> None:
    unit = Unit()
    unit.silent_about.add("sensors.imu")
    assert unit.run(20) == []
    assert unit.topic("imu/raw").rate_hz == pytest.approx(25.0, rel=0.05)
    unit.kill("sensors.imu")
    assert causes(unit.run(5)).keys() == {"sensors.imu"}


def test_fast_topics_of_which_no_heartbeat_tells_are_named(unit: Unit, told: bool) -> None:
    assert "v2x/cam" in unit.watch.untold
    assert ("imu/sample" in unit.watch.untold) is not told
    assert "gnss/fix" not in unit.watch.untold


def test_a_flood_that_is_not_recorded_is_a_problem(unit: Unit) -> None:
    state = RecordingState(
        now_ns=unit.now_ns, recording=True, bytes_written=0, messages=0, dropped=0, free_bytes=10**12, left_out=9,
        flood="x", flood_code=explain("recorder.flood", left_out_count=9),
    )  # fmt: skip
    unit.watch.take_recording(state)
    assert unit.run(1) == []
    assert unit.problems() == [state.flood_code]


@pytest.mark.parametrize("slow_s", [1.9, 2.1, 3.0, 5.0])
@pytest.mark.parametrize("killed", ["parsers.can", "parsers.gnss", "sensors.gnss", "monitoring.status"])
def test_a_slow_step_of_the_filter_while_another_process_is_lost_accuses_that_one_alone(
    unit: Unit, killed: str, slow_s: float
) -> None:
    """As on a loaded machine: the start of the lost process takes the processor, and the filter has a long step."""
    unit.kill(killed)
    events = unit.run(0.3)
    unit.hanging.add("core.fusion")
    events += unit.run(slow_s / 2)
    unit.revive(killed)
    events += unit.run(slow_s / 2)
    unit.hanging.clear()
    unit.mute.add("navigation/solution")  # the first heartbeat comes before what the step has made
    events += unit.run(0.6)
    unit.mute.clear()
    events += unit.run(20)
    assert {outage.what for _, outage in events} == {killed}
    assert unit.problems() == []


def test_a_filter_that_hangs_while_another_process_is_lost_is_named_later(unit: Unit) -> None:
    unit.kill("parsers.can")
    unit.hanging.add("core.fusion")
    assert {outage.what for _, outage in unit.run(7.4)} == {"parsers.can"}
    assert [(outage.what, outage.cause_code) for _, outage in unit.run(2)] == [
        ("core.fusion", explain(Code.STALE, process("core.fusion")))
    ]
    unit.revive("parsers.can")
    unit.hanging.clear()
    assert {outage.what for _, outage in unit.run(20) if outage.until_ns} == {"parsers.can", "core.fusion"}


def test_two_processes_killed_at_once_are_both_named_at_once(unit: Unit) -> None:
    unit.kill("parsers.can")
    unit.kill("core.fusion")
    assert {outage.what for _, outage in unit.run(0.2)} == {"parsers.can", "core.fusion"}


def test_a_filter_that_is_killed_in_its_slow_step_is_named(unit: Unit) -> None:
    unit.kill("parsers.can")
    unit.hanging.add("core.fusion")
    unit.run(3)
    unit.kill("core.fusion")
    assert {outage.what for _, outage in unit.run(0.2)} == {"core.fusion"}


def test_a_topic_that_a_loaded_machine_delays_while_a_process_starts_again_is_not_named(unit: Unit) -> None:
    unit.kill("parsers.can")
    events = unit.run(1)
    unit.revive("parsers.can")
    unit.mute |= {"imu/raw", "gnss/raw"}
    events += unit.run(6)
    unit.mute.clear()
    events += unit.run(20)
    assert {outage.what for _, outage in events} == {"parsers.can"}
