import pytest

from shared.bus import codec
from shared.messages.operation import ProcessHealth, ProcessState, TopicTraffic
from shared.runtime.tally import HEARTBEAT_NS, TopicCounters, told
from shared.topics import BY_NAME

SECOND = 1_000_000_000
START_NS = 1_790_000_000 * SECOND
LAG_NS = 4_000_000


class Bus:
    """Heartbeats twice a second of processes that send and receive `imu/sample` a hundred times a second."""

    def __init__(self) -> None:
        self.tally = TopicCounters(BY_NAME["imu/sample"])
        self.now_ns, self.count, self.life = START_NS, 0, 1

    def beat(self, process: str, count: int, *, producer: str | None = None, silent_ns: int = 0) -> None:
        newest_ns = self.now_ns - silent_ns
        carried = TopicTraffic(
            topic="imu/sample", count=count, newest_ns=newest_ns, stamp_ns=newest_ns - LAG_NS, producer=producer
        )
        health = ProcessHealth(
            process=process, state=ProcessState.READY, incarnation=self.life, sent_ns=self.now_ns
        )  # fmt: skip
        self.tally.take(health, carried, published=producer is None, now_ns=self.now_ns)

    def run(self, seconds: float, *tellers: str) -> None:
        for _ in range(round(seconds * 2)):
            self.now_ns += HEARTBEAT_NS
            self.count += 50
            for name in tellers:
                self.beat(name, self.count, producer=None if name == "parsers.imu" else "parsers.imu")


@pytest.fixture
def bus() -> Bus:
    return Bus()


def test_nothing_is_known_before_a_heartbeat_tells(bus: Bus) -> None:
    tally = bus.tally
    assert (tally.count, tally.rate_hz(START_NS), tally.updated_ns(START_NS)) == (0, 0.0, None)
    assert list(tally.deaf()) == []


@pytest.mark.parametrize(
    "tellers", [("parsers.imu",), ("core.fusion",), ("core.fusion", "parsers.imu", "core.spoofing")]
)
def test_the_rate_is_that_of_one_of_those_who_tell(bus: Bus, tellers: tuple[str, ...]) -> None:
    bus.run(30, *tellers)
    assert bus.tally.rate_hz(bus.now_ns + HEARTBEAT_NS // 2) == pytest.approx(100.0)
    assert bus.tally.producer == "parsers.imu"


def test_what_was_sent_before_this_observer_started_is_not_counted(bus: Bus) -> None:
    bus.count = 1_000_000
    bus.run(1.5, "parsers.imu")
    assert bus.tally.count == 101, "one of the first heartbeat, and those since"


def test_a_restart_of_the_producer_goes_on_with_the_count(bus: Bus) -> None:
    bus.run(5, "parsers.imu")
    before, bus.life, bus.count = bus.tally.count, 2, 0
    bus.run(5, "parsers.imu")
    assert bus.tally.count == before + 500
    bus.life = 1
    bus.beat("parsers.imu", 9999)
    assert bus.tally.count == before + 500, "a late word of the life before"


def test_what_flows_is_taken_to_flow_on_until_the_next_heartbeat_is_due(bus: Bus) -> None:
    bus.run(5, "parsers.imu")
    end_ns = bus.now_ns
    assert bus.tally.updated_ns(end_ns + HEARTBEAT_NS // 2) == end_ns + HEARTBEAT_NS // 2
    assert bus.tally.updated_ns(end_ns + 4 * HEARTBEAT_NS) == end_ns + HEARTBEAT_NS


def test_a_silence_is_known_with_the_next_heartbeat(bus: Bus) -> None:
    bus.run(5, "parsers.imu")
    end_ns, count = bus.now_ns, bus.count
    for n in (1, 2, 3):
        bus.now_ns += HEARTBEAT_NS
        bus.beat("parsers.imu", count, silent_ns=n * HEARTBEAT_NS)
        assert bus.tally.updated_ns(bus.now_ns) == end_ns
    assert bus.tally.newest_ns == end_ns


def test_the_latency_is_that_of_a_consumer_that_reads_at_once(bus: Bus) -> None:
    for name, latency_s in (("parsers.imu", None), ("core.spoofing", None), ("core.fusion", 0.004)):
        bus.run(1, name)
        assert bus.tally.latency_s == (latency_s and pytest.approx(latency_s)), name
    bus.beat("core.fusion", bus.count)
    assert bus.tally.latency_s is None, "nothing new"


def test_the_word_of_a_consumer_counts_once_the_producer_has_been_silent_for_long(bus: Bus) -> None:
    bus.run(5, "parsers.imu", "core.fusion")
    told_ns = bus.tally.newest_ns
    bus.run(1.5, "core.fusion")
    assert bus.tally.newest_ns == told_ns, "what a consumer took in late is no sign of life"
    bus.run(5, "core.fusion")
    assert bus.tally.newest_ns == bus.now_ns
    bus.run(5, "parsers.imu")
    assert bus.tally.newest_ns == bus.now_ns


def test_a_consumer_that_receives_nothing_for_ten_heartbeats_is_deaf_until_it_receives(bus: Bus) -> None:
    bus.run(2, "parsers.imu", "core.fusion")
    since_ns, count = bus.now_ns, bus.count
    for _ in range(10):
        assert list(bus.tally.deaf()) == []
        bus.run(0.5, "parsers.imu")
        bus.beat("core.fusion", count, producer="parsers.imu", silent_ns=bus.now_ns - since_ns)
    assert list(bus.tally.deaf()) == [("core.fusion", since_ns)]
    bus.run(0.5, "parsers.imu", "core.fusion")
    assert list(bus.tally.deaf()) == []


def test_a_consumer_is_not_deaf_while_nothing_is_sent(bus: Bus) -> None:
    bus.run(2, "parsers.imu", "core.fusion")
    for _ in range(40):
        bus.now_ns += HEARTBEAT_NS
        for name, producer in (("parsers.imu", None), ("core.fusion", "parsers.imu")):
            bus.beat(name, bus.count, producer=producer)
    assert list(bus.tally.deaf()) == []
    bus.run(0.5, "parsers.imu")  # it is sent again, and the consumer's next heartbeat has not come yet
    assert list(bus.tally.deaf()) == []


def test_a_stamp_ahead_of_its_heartbeat_makes_no_age_negative(bus: Bus) -> None:
    bus.beat("parsers.imu", 1, silent_ns=-60 * SECOND)
    assert bus.tally.newest_ns == bus.now_ns
    assert bus.tally.lag_ns == 0


def test_a_heartbeat_of_a_clock_that_is_ahead_makes_nothing_newer_than_its_arrival(bus: Bus) -> None:
    carried = TopicTraffic(topic="imu/sample", count=1, newest_ns=START_NS + 3600 * SECOND)
    health = ProcessHealth(
        process="parsers.imu", state=ProcessState.READY, incarnation=1, sent_ns=START_NS + 3600 * SECOND
    )
    bus.tally.take(health, carried, published=True, now_ns=START_NS)
    assert bus.tally.newest_ns == START_NS
    assert bus.tally.updated_ns(START_NS + SECOND) == START_NS + HEARTBEAT_NS


def test_only_fast_topics_of_the_contract_are_told() -> None:
    names = ("imu/sample", "gnss/fix", "no/topic")
    carried = tuple(TopicTraffic(topic=name, count=1) for name in names)
    health = ProcessHealth(
        process="x", state=ProcessState.READY, incarnation=1, sent_ns=1, published=carried, received=carried
    )  # fmt: skip
    assert [(carried.topic, published) for carried, published in told(health)] == [
        ("imu/sample", True),
        ("imu/sample", False),
    ]


def test_a_heartbeat_of_a_program_that_does_not_count_is_read_and_tells_nothing() -> None:
    body = b'{"process":"x","state":"ready","incarnation":1,"sent_ns":1}'
    health = codec.decode("health/x", body)
    assert isinstance(health, ProcessHealth)
    assert list(told(health)) == []
