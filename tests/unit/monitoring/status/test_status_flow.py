import pytest

from services.monitoring.status.flow import DRAWN, TopicFlow
from services.monitoring.status.series import fields
from services.monitoring.status.series.store import STANDARD
from services.monitoring.status.state import State
from services.monitoring.status.views import reports, snapshot
from shared.errors import BadPayload
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingKind
from shared.messages.operation import Mode, ModeState, Origin, OriginKind, TopicTraffic
from shared.topics import TOPICS
from tests.support.dashboard.status_world import ALL, SECOND_NS, World, aiding, fix, solution


def samples(now_ns: int) -> ImuSamples:
    return ImuSamples(
        received_ns=now_ns,
        source="imu0",
        sampled_ns=(now_ns - 10**7, now_ns),
        specific_force_body_m_s2=((0.0, 0.0, -9.8),) * 2,
        angular_rate_body_rad_s=((0.0, 0.0, 0.0),) * 2,
    )


def flow(world: World, name: str) -> TopicFlow:
    return world.state.topics[name]


def test_the_rate_is_that_of_the_last_ten_seconds() -> None:
    world = World()
    for _ in range(120):
        world.hear(solution(world.now_ns), "core.fusion")
        world.pass_time(0.1)
    assert flow(world, "navigation/solution").rate_hz == pytest.approx(10.0, rel=0.05)
    world.pass_time(11.0)
    assert flow(world, "navigation/solution").rate_hz == 0.0


def test_the_latency_runs_from_when_the_value_was_true() -> None:
    world = World()
    for i in range(200):
        world.hear(solution(world.now_ns), "core.fusion", delay_s=0.2 if i == 50 else 0.004)
        world.pass_time(0.1)
    found = flow(world, "navigation/solution")
    assert found.latency_p50_s == pytest.approx(0.004)
    assert found.latency_p99_s == pytest.approx(0.004)
    assert max(found.latencies_s) == pytest.approx(0.2)


def test_the_latency_of_a_raw_topic_runs_from_the_driver() -> None:
    world = World()
    world.hear(GnssRaw(received_ns=world.now_ns, source="gnss0", data=b"\xb5\x62"), "sensors.gnss", delay_s=0.003)
    assert list(flow(world, "gnss/raw").latencies_s) == [pytest.approx(0.003)]


def test_a_stamp_of_another_time_line_is_no_latency() -> None:
    world = World()
    world.hear(solution(world.now_ns - 3600 * SECOND_NS), "core.fusion")
    world.hear(solution(world.now_ns + SECOND_NS), "core.fusion")
    assert not flow(world, "navigation/solution").latencies_s


def test_a_fast_topic_is_decoded_only_when_somebody_looks() -> None:
    world = World()
    for _ in range(40):
        world.hear(samples(world.now_ns), "parsers.imu")
        world.pass_time(0.01, 0.01)
    found = flow(world, "imu/sample")
    assert found.count == 40
    assert found.message is None
    assert found.decoded() == samples(world.now_ns - 10**7)
    assert found.latencies_s, "but its latency is sampled"


def test_a_message_that_the_broker_kept_is_as_old_as_it_says() -> None:
    world = World()
    said_ns = world.now_ns - 20 * SECOND_NS
    state = ModeState(sampled_ns=said_ns, mode=Mode.MEASURING, since_ns=said_ns, reason="ok")
    world.hear(state, "controller.mode", retained=True)
    assert flow(world, "mode/state").age_s(world.now_ns) == pytest.approx(20.0)
    assert flow(world, "mode/state").freshness(world.now_ns) == "stale"
    assert not flow(world, "mode/state").latencies_s


def test_what_a_broker_that_was_away_has_kept_does_not_replace_what_is_newer() -> None:
    """Mosquitto saves what it keeps every 30 s; after a crash it sends anew what was true at the last time."""
    world = World()
    states = [
        ModeState(sampled_ns=world.now_ns - age * SECOND_NS, mode=Mode.MEASURING, since_ns=0, reason="ok")
        for age in (1, 28)
    ]
    world.hear(states[0], "controller.mode")
    world.hear(states[1], "controller.mode", retained=True)
    assert flow(world, "mode/state").message == states[0]
    assert flow(world, "mode/state").freshness(world.now_ns) == "fresh"


def test_jitter_is_the_deviation_of_the_gaps() -> None:
    world = World()
    for gap_s in (0.1, 0.1, 0.2, 0.1, 0.2):
        world.hear(solution(world.now_ns), "core.fusion")
        world.now_ns += int(gap_s * 1e9)
    assert flow(world, "navigation/solution").jitter_s == pytest.approx(0.05)  # gaps 0.1 0.1 0.2 0.1


def test_a_payload_that_breaks_the_contract_does_not_hide_the_last_good_one() -> None:
    world = World()
    world.hear(fix(world.now_ns), "parsers.gnss")
    with pytest.raises(BadPayload):
        world.hear_bytes("gnss/fix", b'{"fix_type": "lost"}', "parsers.gnss")
    with pytest.raises(BadPayload):
        world.hear_bytes("gnss/raw", b'{"received_ns":"yesterday","source":"gnss0","data":""}', "sensors.gnss")
    assert flow(world, "gnss/fix").message == fix(world.now_ns)
    assert flow(world, "gnss/fix").count == 1
    assert flow(world, "gnss/raw").freshness(world.now_ns) == "never"


def test_a_fast_message_that_cannot_be_read_is_shown_as_such() -> None:
    world = World()
    world.hear(samples(world.now_ns), "parsers.imu")
    world.hear_bytes("imu/sample", b'{"source":"a"}', "parsers.imu")
    shown = reports.topic(flow(world, "imu/sample"), world.now_ns)
    assert shown["message"] is None
    assert "Field required" in str(shown["unreadable"])


def test_topics_of_unknown_processes_do_not_fill_the_memory() -> None:
    world = World()
    before = len(world.state.topics)
    for i in range(50):
        world.hear_bytes(f"health/stranger{i}", b"{}", "stranger")
    assert len(world.state.topics) == before


def test_load_and_rates_of_a_process_come_from_two_heartbeats() -> None:
    world = World()
    world.beat("core.fusion", cpu_s=1.0, messages_in=100, messages_out=10)
    world.pass_time(0.5)
    world.beat("core.fusion", cpu_s=1.2, messages_in=200, messages_out=15)
    process = world.state.processes["core.fusion"]
    assert process.cpu_share == pytest.approx(0.4)
    assert process.in_hz == pytest.approx(200.0)
    assert process.out_hz == pytest.approx(10.0)


def test_every_kind_of_measurement_is_kept_apart() -> None:
    world = World()
    world.hear(aiding(AidingKind.GNSS_POSITION, 0.2), "core.fusion")
    world.hear(aiding(AidingKind.GNSS_VELOCITY, 3.0, used=False), "core.fusion")
    assert {kind: update.test_ratio for kind, (update, _) in world.state.aiding.items()} == {
        AidingKind.GNSS_POSITION: 0.2,
        AidingKind.GNSS_VELOCITY: 3.0,
    }
    assert world.state.rejections == {AidingKind.GNSS_VELOCITY: 1}


def test_the_delay_of_the_bus_is_measured_by_heartbeats() -> None:
    world = World()
    for _ in range(30):
        for name in ALL:
            health = {"sent_ns": world.now_ns - 2_000_000}
            world.beat(name, **health)
        world.hear(Origin(now_ns=world.now_ns, kind=OriginKind.SIMULATED, name="x"), "sensors.simulator")
        world.pass_time(0.5)
    assert world.state.bus_delay_p95_s == pytest.approx(0.002)


class HeartbeatWorld:
    """A world in which heartbeats tell of inertial samples, which come here only while they are followed."""

    def __init__(self) -> None:
        self.world, self.count = World(), 0

    def run(self, seconds: float) -> None:
        for step in range(round(seconds * 10)):
            self.world.pass_time(0.1)
            self.count += 10
            now_ns = self.world.now_ns
            if "imu/sample" in self.world.state.followed:
                self.world.hear(samples(now_ns), "parsers.imu")
            if step % 5 == 0:
                self.beat(now_ns)

    def beat(self, newest_ns: int) -> None:
        carried = TopicTraffic(
            topic="imu/sample", count=self.count, newest_ns=newest_ns, stamp_ns=newest_ns - 3_000_000
        )
        received = carried.model_copy(update={"newest_ns": newest_ns + 1_000_000, "producer": "parsers.imu"})
        self.world.beat("parsers.imu", published=(carried,))
        self.world.beat("core.fusion", received=(received,), sent_ns=newest_ns + 1_000_000)

    @property
    def flow(self) -> TopicFlow:
        return self.world.state.topics["imu/sample"]


@pytest.fixture
def unlooked() -> HeartbeatWorld:
    made = HeartbeatWorld()
    made.run(20)
    return made


def test_a_fast_topic_is_followed_until_heartbeats_tell_of_it() -> None:
    world = HeartbeatWorld()
    assert {"imu/sample", "navigation/solution"} <= world.world.state.followed
    world.run(2)
    assert "imu/sample" not in world.world.state.followed
    assert "imu/raw" in world.world.state.followed, "of which nobody tells"
    assert set(DRAWN) <= world.world.state.followed


def test_rate_age_and_latency_of_a_topic_that_nobody_looks_at_are_told(unlooked: HeartbeatWorld) -> None:
    flow, state, now_ns = unlooked.flow, unlooked.world.state, unlooked.world.now_ns
    assert flow.newest is None
    assert flow.rate_hz == pytest.approx(100.0, rel=0.01)
    assert flow.latency_p50_s == pytest.approx(0.004)
    assert 0.003 <= (state.age_s("imu/sample", now_ns) or 0.0) < 0.204, "of the data, renewed five times a second"
    assert not state.is_earlier("imu/sample")
    assert fields.parse("imu/sample:@latency_s").name in STANDARD
    latencies = state.series.columns(["imu/sample:@latency_s"], now_ns - 10 * SECOND_NS, now_ns, fine=False)
    assert_all_latencies(latencies["values"])
    shown = snapshot.dashboard(state, now_ns)
    assert isinstance(shown["processes"], dict)
    assert shown["processes"]["parsers.imu"]["latency_of"] == "imu/sample"


def assert_all_latencies(values: object) -> None:
    assert isinstance(values, dict)
    assert all(value == pytest.approx(0.004) for value in values["imu/sample:@latency_s"][:-1])


def test_a_topic_that_falls_silent_is_stale_at_most_a_heartbeat_later(unlooked: HeartbeatWorld) -> None:
    end_ns = unlooked.world.now_ns
    unlooked.world.pass_time(0.3)
    assert unlooked.flow.freshness(unlooked.world.now_ns) == "fresh"
    for _ in range(3):
        unlooked.world.pass_time(0.5)
        unlooked.beat(end_ns)
    unlooked.world.pass_time(0.2)
    assert unlooked.flow.freshness(unlooked.world.now_ns) == "stale"
    assert unlooked.world.state.topics["imu/sample"].heard_ns == end_ns


def test_a_look_brings_messages_and_its_end_leaves_what_is_told(unlooked: HeartbeatWorld) -> None:
    state, flow = unlooked.world.state, unlooked.flow
    assert flow.is_coming(unlooked.world.now_ns)
    count = flow.count
    state.look(["imu/sample", "no/topic"], unlooked.world.now_ns)
    assert "imu/sample" in state.followed, "at once"
    unlooked.run(3)
    assert not flow.is_coming(unlooked.world.now_ns)
    assert flow.decoded() == samples(unlooked.world.now_ns)
    assert flow.count == pytest.approx(count + 300, abs=51), "counted once"
    assert flow.jitter_s == pytest.approx(0.0)
    unlooked.run(4)
    assert "imu/sample" not in state.followed
    assert flow.newest is None
    assert flow.freshness(unlooked.world.now_ns) == "fresh"
    shown = reports.topic(flow, unlooked.world.now_ns)
    assert (shown["message"], shown["jitter_s"], shown["producer"]) == (None, None, "parsers.imu")


def test_samples_of_before_a_restart_of_their_producer_are_not_live(unlooked: HeartbeatWorld) -> None:
    unlooked.world.pass_time(0.5)
    unlooked.world.lives["parsers.imu"] = unlooked.world.now_ns
    unlooked.world.beat("parsers.imu")
    assert unlooked.world.state.is_earlier("imu/sample")
    unlooked.count = 0
    unlooked.run(1)
    assert not unlooked.world.state.is_earlier("imu/sample")


def test_a_chart_of_a_fast_topic_follows_it_for_a_minute_and_its_gap_is_read_from_the_recording(
    unlooked: HeartbeatWorld,
) -> None:
    state, name = unlooked.world.state, "imu/sample:specific_force_body_m_s2.0.2"
    state.series.take_wanted()
    state.series.want([name], unlooked.world.now_ns)
    assert state.series.take_wanted() == [name], "its past"
    unlooked.run(30)
    assert "imu/sample" in state.followed
    state.series.want([name], unlooked.world.now_ns)
    assert state.series.take_wanted() == [], "there is no gap"
    unlooked.run(62)
    assert "imu/sample" not in state.followed
    state.series.want([name, "gnss/fix:hdop"], unlooked.world.now_ns)
    assert state.series.take_wanted() == [name]


def test_a_replay_follows_everything_and_counts_what_it_plays() -> None:
    state = State("truck-07", ALL, 0, 900.0, replay=True)
    state.tick(10 * SECOND_NS, broker=True)
    assert state.followed == {topic.name for topic in TOPICS if topic.fast}
