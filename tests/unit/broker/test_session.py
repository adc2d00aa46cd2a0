"""Sessions, queues and wills without a network."""

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from broker.simulated import packets
from broker.simulated.broker import Broker
from broker.simulated.packets import Acknowledge, Connect, Framer, Publish, Subscribe
from broker.simulated.session import Limits, Session


class Wire:
    """A connection that stores what is written; the test sets `writable`."""

    def __init__(self) -> None:
        self.writable = True
        self.written: list[Publish] = []
        self.ended = False
        self.on_end: Callable[[bool], None] = lambda _will: None

    def write(self, frame: bytes) -> None:
        for first, body in Framer(1 << 20).feed(frame):
            packet = packets.decode(first, body)
            assert isinstance(packet, Publish)
            self.written.append(packet)

    def end(self, *, will: bool = True) -> None:
        self.ended = True
        self.on_end(will)

    def payloads(self) -> list[bytes]:
        return [message.payload for message in self.written]


class World:
    """A broker with one client, `sink`, that is subscribed to everything."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.broker = Broker(limits=limits)
        self.sink, self.wire = self.join("sink")
        self.broker.subscribe(Subscribe(1, (("#", 1),)), self.sink)
        self.source, _ = self.join("source")

    def join(self, name: str, *, will: Publish | None = None) -> tuple[Session, Wire]:
        wire = Wire()
        session = self.broker.connect(Connect(name, True, 0, None, will), wire)
        wire.on_end = lambda will: self.broker.leave(session, will=will)
        return session, wire

    def say(self, payload: bytes, *, qos: int = 0, retain: bool = False) -> None:
        self.broker.receive(Publish("t", payload, qos, retain, packet_id=qos), self.source)


def test_a_full_queue_drops_and_counts_its_oldest_message_of_qos_0() -> None:
    world = World(Limits(queue_messages=4))
    world.wire.writable = False
    for payload, qos in ((b"a", 1), (b"b", 0), (b"c", 0), (b"d", 1), (b"e", 0), (b"f", 1)):
        world.say(payload, qos=qos)
    world.wire.writable = True
    world.sink.pump()
    assert world.wire.payloads() == [b"a", b"d", b"e", b"f"]
    assert world.broker.counters.counts["dropped"] == 2


def test_a_full_queue_of_qos_1_drops_its_oldest_and_keeps_the_newest() -> None:
    world = World(Limits(queue_messages=3))
    world.wire.writable = False
    for number in range(5):
        world.say(b"%d" % number, qos=1)
    assert [waiting.payload for waiting in world.sink.queue] == [b"2", b"3", b"4"]


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 60)), max_size=60))
def test_a_queue_never_holds_more_messages_or_bytes_than_its_bounds(published: list[tuple[int, int]]) -> None:
    world = World(Limits(queue_messages=10, queue_bytes=200))
    world.wire.writable = False
    for qos, size in published:
        world.say(bytes(size), qos=qos)
        sizes = [len(waiting.payload) for waiting in world.sink.queue]
        assert len(sizes) <= 10
        assert world.sink.queue_bytes == sum(sizes) <= 200


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 1), st.booleans()), max_size=40))
def test_messages_are_sent_in_order_after_any_wait(steps: list[tuple[bool, int, bool]]) -> None:
    """The client reads and acknowledges at random; QoS 0 never overtakes QoS 1."""
    world = World(Limits(in_flight=2))
    for number, (reads, qos, acknowledges) in enumerate(steps):
        world.wire.writable = reads
        world.say(b"%03d" % number, qos=qos)
        if acknowledges and world.sink.in_flight:
            world.sink.acknowledge(next(iter(world.sink.in_flight)))
    world.wire.writable = True
    world.sink.pump()
    while world.sink.in_flight:
        world.sink.acknowledge(next(iter(world.sink.in_flight)))
    assert world.wire.payloads() == [b"%03d" % number for number in range(len(steps))]


def test_packet_identifiers_wrap_and_skip_those_in_flight() -> None:
    world = World()
    world.say(b"never acknowledged", qos=1)
    world.sink.packet_id = 65_534
    for _ in range(3):
        world.say(b"x", qos=1)
    assert [message.packet_id for message in world.wire.written] == [1, 65_535, 2, 3]


def test_an_unexpected_acknowledgement_changes_nothing() -> None:
    world = World()
    world.say(b"x", qos=1)
    acknowledgement = packets.decode(0x40, b"\0\x63")
    assert acknowledgement == Acknowledge(99)
    world.sink.acknowledge(99)
    assert world.sink.in_flight == {1}


def test_a_session_of_the_same_name_takes_over_and_the_will_of_the_old_one_is_sent() -> None:
    world = World()
    first, old = world.join("worker", will=Publish("w", b"lost", 1))
    world.broker.subscribe(Subscribe(1, (("t", 1),)), first)
    second, new = world.join("worker")
    world.say(b"for nobody", qos=1)
    assert old.ended and not new.ended and world.broker.sessions["worker"] is second
    assert (old.written, new.written) == ([], [])
    assert world.wire.payloads() == [b"lost", b"for nobody"]


def test_a_retained_will_beyond_the_limit_is_sent_and_counted_and_not_stored() -> None:
    world = World(Limits(retained=1))
    world.say(b"kept", retain=True)
    doomed, _ = world.join("doomed", will=Publish("w", b"lost", 1, True))
    world.broker.leave(doomed, will=True)
    assert world.wire.payloads() == [b"kept", b"lost"]
    assert len(world.broker.retained) == 1
    assert world.broker.counters.counts["retained full"] == 1
