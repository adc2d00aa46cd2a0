from collections.abc import Callable

import pytest

from services.monitoring.health.causes import expected_topics
from services.monitoring.health.watch import Watch
from shared.bus import codec
from shared.messages.imu import ImuSamples
from shared.messages.operation import Freshness, Outage, ProcessHealth, ProcessState, TopicAge

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
    "mode/state": ("controller.mode", 1.0, None),
    "recording/state": ("monitoring.recorder", 1.0, None),
    "deadline/report": ("monitoring.health", 2.0, None),
}
STANDING = (*dict.fromkeys(name for name, _, _ in FLOW.values() if name not in SENSORS), "monitoring.status")
STEP_NS = SECOND // 25


class Unit:
    """A unit in which messages follow from one another, and parts of which can be broken."""

    def __init__(self, processes: tuple[str, ...] = STANDING + SENSORS) -> None:
        self.now_ns = START_NS
        self.watch = Watch(processes, START_NS)
        self.running = list(processes)
        self.hanging: set[str] = set()
        self.mute: set[str] = set()  # topics that their producers do not send
        self.connected = self.delivering = True
        self.lives = dict.fromkeys(processes, 1)
        self.events: list[tuple[float, Outage]] = []
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
        health = ProcessHealth(process=process, state=state, incarnation=life, sent_ns=self.now_ns)
        self.watch.take_health(health, self.now_ns, retained=retained)

    def topic(self, name: str) -> TopicAge:
        return {age.topic: age for age in self.watch.report(self.now_ns).topics}[name]

    def silent(self) -> set[str]:
        return {age.process for age in self.watch.report(self.now_ns).processes if age.silent}

    def _talk(self) -> None:
        speaking = [name for name in self.running if name not in self.hanging]
        for process in speaking:
            if self._is_due(f"health/{process}", 2.0):
                self.watch.take(f"health/{process}", b"{}", {}, producer=process, received_ns=self.now_ns)
                self.say_health(process)
        alive: set[str] = set()
        for name, (producer, rate_hz, need) in FLOW.items():
            if producer not in speaking or name in self.mute or (need and need not in alive):
                continue
            alive.add(name)
            if self._is_due(name, rate_hz):
                payload = b'{"sampled_ns":%d}' % (self.now_ns - 3_000_000)
                properties = {"received_ns": str(self.now_ns - 1_000_000), "source": "a"}
                self.watch.take(name, payload, properties, producer=producer, received_ns=self.now_ns)

    def _is_due(self, what: str, rate_hz: float) -> bool:
        if self.now_ns < self._due.get(what, 0):
            return False
        self._due[what] = self.now_ns + round(SECOND / rate_hz)
        return True


@pytest.fixture
def unit() -> Unit:
    """A unit that has run well for 20 s."""
    made = Unit()
    assert made.run(20) == []
    return made


def causes(events: list[tuple[float, Outage]]) -> dict[str, str]:
    return {event.what: event.cause for _, event in events if event.until_ns is None}


def test_a_healthy_unit_has_no_outage_and_nothing_silent(unit: Unit) -> None:
    assert unit.run(200) == []
    assert unit.silent() == set()


def test_a_killed_process_is_seen_at_once_and_is_the_cause_of_all_that_falls_silent(unit: Unit) -> None:
    unit.kill("sensors.imu")
    events = unit.run(5)

    assert events[0][0] < 0.05
    assert events[0][1].what == "sensors.imu"
    assert events[0][1].since_ns == unit.now_ns - 5 * SECOND
    told = causes(events)
    assert told.pop("sensors.imu") == "sensors.imu was lost: it crashed, was killed, or its connection broke"
    assert told == dict.fromkeys(("imu/raw", "imu/sample", "navigation/solution"), "sensors.imu is lost")
    assert unit.topic("imu/sample").cause == "sensors.imu is lost"
    assert len(events) == 4


def test_an_outage_ends_with_the_first_message_and_tells_its_duration(unit: Unit) -> None:
    unit.kill("sensors.imu")
    unit.run(5)
    unit.revive("sensors.imu")
    ended = {event.what: event for _, event in unit.run(3)}

    assert set(ended) == {"sensors.imu", "imu/raw", "imu/sample", "navigation/solution"}
    for outage in ended.values():
        assert outage.until_ns is not None
        assert outage.until_ns - outage.since_ns == pytest.approx(5 * SECOND, abs=0.2 * SECOND)
    restarts = {age.process: age.restarts for age in unit.watch.report(unit.now_ns).processes}
    assert restarts.pop("sensors.imu") == 1
    assert set(restarts.values()) == {0}
    assert unit.run(20) == []


def test_a_hanging_process_is_silent_and_its_topics_wait_for_that_verdict(unit: Unit) -> None:
    unit.hanging.add("parsers.imu")
    events = unit.run(6)

    assert events[0][1].what == "parsers.imu"
    assert 1.4 < events[0][0] < 2.2
    told = causes(events)
    assert told.pop("parsers.imu") == "parsers.imu is connected but silent: it hangs or is overloaded"
    assert told == dict.fromkeys(("imu/sample", "navigation/solution"), "parsers.imu is silent")


@pytest.mark.parametrize("how", ["hangs", "is killed"])
def test_a_process_that_is_back_is_not_blamed_before_it_had_time_to_speak(unit: Unit, how: str) -> None:
    if how == "hangs":
        unit.hanging.add("parsers.imu")
    else:
        unit.kill("parsers.imu")
    unit.run(10)
    unit.mute.add("imu/sample")
    unit.hanging.discard("parsers.imu")
    unit.revive("parsers.imu")
    waiting = [event for _, event in unit.run(4) if event.what in ("imu/sample", "navigation/solution")]
    unit.mute.discard("imu/sample")
    ended = [event for _, event in unit.run(2) if event.what in ("imu/sample", "navigation/solution")]

    assert waiting == []
    assert len(ended) == 2
    assert all(event.until_ns and "runs" not in event.cause for event in ended)


def test_a_process_that_is_back_and_says_nothing_is_blamed_in_the_end(unit: Unit) -> None:
    unit.kill("parsers.imu")
    unit.run(10)
    unit.mute.add("imu/sample")
    unit.revive("parsers.imu")
    assert causes(unit.run(15))["imu/sample"] == "parsers.imu runs, but says nothing on imu/sample"


def test_a_device_that_sends_nothing_is_the_cause_while_all_processes_run(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    told = causes(unit.run(10))

    assert told == dict.fromkeys(("gnss/raw", "gnss/fix"), "sensors.gnss runs, but its device sends nothing")


def test_a_topic_that_falls_silent_just_before_its_input_waits_for_it(unit: Unit) -> None:
    unit.mute.add("gnss/fix")
    unit.run(1.0)
    unit.mute.add("gnss/raw")
    told = [event for _, event in unit.run(10)]

    assert sorted(event.what for event in told) == ["gnss/fix", "gnss/raw"]
    assert {event.cause for event in told} == {"sensors.gnss runs, but its device sends nothing"}


def test_a_process_that_says_nothing_although_fed_is_itself_the_cause(unit: Unit) -> None:
    unit.mute.add("imu/sample")
    told = causes(unit.run(5))

    cause = "parsers.imu runs, but says nothing on imu/sample"
    assert told == {"imu/sample": cause, "navigation/solution": cause}


def test_an_input_that_was_silent_long_before_is_not_blamed_for_a_later_silence(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    unit.run(30)
    unit.kill("sensors.imu")
    told = causes(unit.run(5))

    assert told["navigation/solution"] == "sensors.imu is lost"


def test_a_process_that_dies_while_its_topic_is_silent_becomes_the_cause(unit: Unit) -> None:
    unit.mute.add("gnss/raw")
    unit.run(10)
    unit.kill("sensors.gnss")
    events = unit.run(1)

    assert causes(events)["gnss/fix"] == "sensors.gnss is lost"
    since = {event.since_ns for _, event in unit.events if event.what == "gnss/fix"}
    assert len(since) == 1


def test_a_lost_broker_is_one_outage_told_when_it_is_over_and_nobody_else_is_accused(unit: Unit) -> None:
    unit.connected = False
    assert unit.run(30) == []
    unit.connected = True
    [(at, outage)] = unit.run(30)

    assert 1.9 < at < 2.1
    assert (outage.what, outage.cause) == ("broker", "the connection to it broke")
    assert outage.until_ns is not None
    assert outage.until_ns - outage.since_ns == pytest.approx(30 * SECOND, abs=0.1 * SECOND)


def test_a_broker_that_hangs_is_told_from_a_unit_that_died(unit: Unit) -> None:
    unit.delivering = False
    assert unit.run(20) == []
    unit.delivering = True
    [(_, outage)] = unit.run(20)

    assert (outage.what, outage.cause) == ("broker", "the broker is connected but delivers nothing")
    assert outage.until_ns is not None
    assert outage.until_ns - outage.since_ns == pytest.approx(20 * SECOND, abs=0.1 * SECOND)


def test_a_process_that_does_not_return_with_the_broker_is_reported(unit: Unit) -> None:
    unit.connected = False
    unit.running.remove("parsers.gnss")
    unit.run(10)
    unit.connected = True
    told = causes(unit.run(15))

    assert set(told) == {"parsers.gnss", "gnss/fix"}  # that of the broker is over
    assert told["gnss/fix"] == "parsers.gnss is silent"


def test_an_outage_from_before_a_broker_loss_stays_open_until_something_is_heard(unit: Unit) -> None:
    unit.kill("sensors.gnss")
    unit.run(10)
    unit.connected = False
    unit.run(5)
    unit.connected = True

    assert [event.what for _, event in unit.run(20)] == ["broker"]
    unit.revive("sensors.gnss")
    assert {event.what for _, event in unit.run(5)} == {"sensors.gnss", "gnss/raw", "gnss/fix"}


def test_an_observer_that_slept_accuses_nobody(unit: Unit) -> None:
    unit.now_ns += 60 * SECOND

    assert unit.run(30) == []


def test_what_was_never_seen_is_missing_only_after_two_minutes() -> None:
    unit = Unit()
    unit.running.remove("sensors.can")
    unit.running.remove("parsers.can")

    assert unit.run(119) == []
    told = causes(unit.run(2))
    assert told["sensors.can"] == "sensors.can should run here but was never seen"
    assert told["can/raw"] == "sensors.can is missing"
    assert told["vehicle/speed"] == "parsers.can is missing"
    assert set(told) == {"sensors.can", "parsers.can", "can/raw", "vehicle/speed", "vehicle/wheel_speed"}


def test_a_topic_whose_device_never_spoke_is_missing_after_two_minutes() -> None:
    unit = Unit()
    unit.mute.add("can/raw")
    told = causes(unit.run(125))

    assert set(told) == {"can/raw", "vehicle/speed", "vehicle/wheel_speed"}
    assert set(told.values()) == {"sensors.can runs, but its device sends nothing"}


def test_a_topic_that_the_vehicle_does_not_have_is_not_missed_beside_one_that_it_has() -> None:
    unit = Unit()

    assert unit.run(150) == []
    assert unit.topic("vehicle/wheel_speed").freshness is Freshness.NEVER


def test_a_vehicle_without_sensors_misses_neither_them_nor_what_follows_from_them() -> None:
    unit = Unit(STANDING)
    told = causes(unit.run(150))

    assert told == {}
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
    assert causes(unit.run(1)) == {
        "sensors.simulator": "sensors.simulator was lost: it crashed, was killed, or its connection broke"
    }
    unit.revive("sensors.simulator")
    assert [event.until_ns is None for _, event in unit.run(5)] == [False]
    unit.running.remove("sensors.simulator")
    unit.say_health("sensors.simulator", ProcessState.DISCONNECTED)
    assert unit.run(60) == []


def test_a_configured_process_that_said_farewell_is_an_outage(unit: Unit) -> None:
    unit.running.remove("core.fusion")
    unit.say_health("core.fusion", ProcessState.DISCONNECTED)
    told = causes(unit.run(6))

    assert told["core.fusion"] == "core.fusion ended as asked"
    assert told["navigation/solution"] == "core.fusion is ended"


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
    unit.watch.take("imu/raw", b"", {}, producer="replay", received_ns=unit.now_ns)
    unit.watch.take("imu/sample", b"", {}, producer="parsers.imu", received_ns=unit.now_ns)
    told = causes(unit.run(5))

    assert told == dict.fromkeys(("imu/raw", "imu/sample"), "replay has stopped")


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


def test_rates_ages_and_latencies_are_measured_without_decoding(unit: Unit) -> None:
    raw, solution = unit.topic("imu/raw"), unit.topic("navigation/solution")

    assert raw.rate_hz == pytest.approx(25.0, rel=0.02)  # as often as this test steps
    assert raw.latency_p50_s == pytest.approx(0.001)
    assert solution.latency_p99_s == pytest.approx(0.003)
    assert unit.topic("gnss/fix").rate_hz == pytest.approx(1.0, rel=0.11)
    unit.mute.add("imu/raw")
    unit.run(0.8)
    assert unit.topic("imu/raw").age_s == pytest.approx(0.8)
    assert unit.topic("imu/raw").freshness is Freshness.LATE
    unit.run(0.4)
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
    payload, _ = codec.encode(samples)
    watch.take("imu/sample", payload, {}, producer="parsers.imu", received_ns=START_NS + 2_000_000)

    age = next(age for age in watch.report(START_NS + SECOND).topics if age.topic == "imu/sample")
    assert age.latency_p50_s == pytest.approx(0.002)


def test_a_retained_message_is_as_old_as_its_own_stamp_and_spoils_no_latency() -> None:
    watch = Watch(STANDING, START_NS)
    payload = b'{"sampled_ns":%d}' % (START_NS - 40 * SECOND)
    watch.take("mode/state", payload, {}, producer="controller.mode", received_ns=START_NS, retained=True)
    age = next(age for age in watch.report(START_NS).topics if age.topic == "mode/state")

    assert age.age_s == pytest.approx(40.0)
    assert age.latency_p50_s is None


@pytest.mark.parametrize(
    "feed",
    [
        lambda watch: watch.take("no/such", b"", {}, producer="x", received_ns=START_NS),
        lambda watch: watch.take("imu/raw", b"", {"received_ns": "-"}, producer="", received_ns=START_NS),
        lambda watch: watch.take("imu/raw", b"", {"received_ns": "9" * 99}, producer="x", received_ns=START_NS),
        lambda watch: watch.take("mode/state", b'{"sampled_ns":1e99}', {}, producer="x", received_ns=START_NS),
        lambda watch: watch.take_health(
            ProcessHealth(process="x", state=ProcessState.LOST, incarnation=1, sent_ns=1), START_NS
        ),
    ],
)
def test_strange_messages_do_no_harm(unit: Unit, feed: Callable[[Watch], None]) -> None:
    feed(unit.watch)

    assert unit.run(1) == []
