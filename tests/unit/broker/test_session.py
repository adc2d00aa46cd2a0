"""Sessions, queues, expiry and wills on a clock that the test turns."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from shared.bus.mqtt import packets
from shared.bus.mqtt.framing import Framer
from shared.bus.mqtt.packets import Acknowledge, Connect, Publish, Subscribe, Subscription
from shared.bus.mqtt.properties import NONE, Properties, Property
from shared.bus.mqtt.wire import Reason

from broker.simulated.broker import Broker
from broker.simulated.session import Limits, Session


class Wire:
    """A connection that keeps what is written; `writable` as the test wants it."""

    def __init__(self) -> None:
        self.writable = True
        self.written: list[Publish] = []
        self.ended: Reason | None = None
        self.on_end: Callable[[bool], None] = lambda _will: None

    def write(self, frame: bytes) -> None:
        for first, body in Framer(1 << 20).feed(frame):
            packet = packets.decode(first, body)
            assert isinstance(packet, Publish)
            self.written.append(packet)

    def end(self, reason: Reason, *, will: bool = True) -> None:
        self.ended = reason
        self.on_end(will)

    def payloads(self) -> list[bytes]:
        return [message.payload for message in self.written]


class World:
    """A broker with one client, `sink`, that is subscribed to everything."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.now_s = 1000.0
        self.broker = Broker(limits=limits, now_s=lambda: self.now_s)
        self.sink, self.wire = self.join("sink", expiry_s=100)
        self.broker.subscribe(Subscribe(1, (Subscription("#", 1),), NONE), self.sink)
        self.source, _ = self.join("source")

    def join(self, name: str, *, expiry_s: int = 0, will: Publish | None = None, **more: int) -> tuple[Session, Wire]:
        wire = Wire()
        numbers = {Property.SESSION_EXPIRY_S: expiry_s, **{Property[key]: value for key, value in more.items()}}
        request = Connect(name, False, 0, None, will, Properties(numbers))
        session, _ = self.broker.connect(request, wire)
        wire.on_end = lambda will: self.broker.leave(session, will=will)
        return session, wire

    def say(self, payload: bytes, *, qos: int = 0, retain: bool = False, expiry_s: int | None = None) -> None:
        message = Publish("t", payload, qos, retain, packet_id=qos, expiry_s=expiry_s)
        assert self.broker.receive(message, self.source) == Reason.SUCCESS


def test_a_full_queue_forgets_its_oldest_message_of_qos_0_and_counts_it() -> None:
    world = World(Limits(queue_messages=4))
    world.wire.writable = False
    for payload, qos in ((b"a", 1), (b"b", 0), (b"c", 0), (b"d", 1), (b"e", 0), (b"f", 1)):
        world.say(payload, qos=qos)
    world.wire.writable = True
    world.sink.pump(world.now_s)
    assert world.wire.payloads() == [b"a", b"d", b"e", b"f"]
    assert world.broker.tally.counts["forgotten"] == 2


def test_a_full_queue_of_qos_1_forgets_its_oldest_and_keeps_the_newest() -> None:
    world = World(Limits(queue_messages=3))
    world.broker.leave(world.sink, will=False)
    for number in range(5):
        world.say(b"%d" % number, qos=1)
    assert [waiting.message.payload for waiting in world.sink.queue] == [b"2", b"3", b"4"]


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 60)), max_size=60))
def test_a_queue_never_holds_more_messages_or_bytes_than_its_bounds(said: list[tuple[int, int]]) -> None:
    world = World(Limits(queue_messages=10, queue_bytes=200))
    world.wire.writable = False
    for qos, size in said:
        world.say(bytes(size), qos=qos)
        sizes = [len(waiting.message.payload) for waiting in world.sink.queue]
        assert len(sizes) <= 10
        assert world.sink.queue_bytes == sum(sizes) <= 200


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 1), st.booleans()), max_size=40))
def test_messages_keep_their_order_whatever_waits(steps: list[tuple[bool, int, bool]]) -> None:
    """The client reads now and then, and acknowledges now and then; QoS 0 never overtakes QoS 1."""
    world = World(Limits(in_flight=2))
    for number, (reads, qos, acknowledges) in enumerate(steps):
        world.wire.writable = reads
        world.say(b"%03d" % number, qos=qos)
        if acknowledges and world.sink.in_flight:
            world.sink.acknowledge(next(iter(world.sink.in_flight)), world.now_s)
    world.wire.writable = True
    world.sink.pump(world.now_s)
    while world.sink.in_flight:
        world.sink.acknowledge(next(iter(world.sink.in_flight)), world.now_s)
    assert world.wire.payloads() == [b"%03d" % number for number in range(len(steps))]


def test_packet_identifiers_go_round_and_skip_those_in_flight() -> None:
    world = World()
    world.say(b"never acknowledged", qos=1)
    world.sink._packet_id = 65_534
    for _ in range(3):
        world.say(b"x", qos=1)
    assert [message.packet_id for message in world.wire.written] == [1, 65_535, 2, 3]


def test_an_acknowledgement_that_nobody_waits_for_changes_nothing() -> None:
    world = World()
    world.say(b"x", qos=1)
    acknowledgement = packets.decode(0x40, b"\0\x63")
    assert acknowledgement == Acknowledge(99, 0)
    world.sink.acknowledge(99, world.now_s)
    assert list(world.sink.in_flight) == [1]


def test_a_message_that_waited_says_how_long_it_still_holds_and_one_that_expired_is_not_sent() -> None:
    world = World()
    world.wire.writable = False
    world.say(b"short", qos=1, expiry_s=5)
    world.say(b"long", qos=1, expiry_s=60)
    world.now_s += 20.0
    world.wire.writable = True
    world.sink.pump(world.now_s)
    assert [(message.payload, message.expiry_s) for message in world.wire.written] == [(b"long", 40)]


@pytest.mark.parametrize(("waited_s", "kept"), [(99.0, True), (101.0, False)])
def test_a_session_is_kept_until_its_expiry(waited_s: float, kept: bool) -> None:
    world = World()
    world.broker.leave(world.sink, will=False)
    world.now_s += waited_s
    request = Connect("sink", False, 0, None, None, NONE)
    assert world.broker.connect(request, Wire())[1] is kept


def test_sweeping_forgets_sessions_and_retained_messages_whose_time_is_over() -> None:
    world = World()
    world.say(b"kept", retain=True, expiry_s=50)
    world.broker.leave(world.sink, will=False)
    world.now_s += 49.0
    world.broker.sweep()
    assert (len(world.broker.retained), set(world.broker.sessions)) == (1, {"sink", "source"})
    world.now_s += 52.0
    world.broker.sweep()
    assert (len(world.broker.retained), set(world.broker.sessions)) == (0, {"source"})


def test_take_over_of_a_kept_session_sends_the_will_and_what_was_in_flight() -> None:
    world = World()
    first, old = world.join("worker", expiry_s=60, will=Publish("w", b"lost", 1))
    world.broker.subscribe(Subscribe(1, (Subscription("t", 1),), NONE), first)
    world.say(b"unanswered", qos=1)
    session, new = world.join("worker", expiry_s=60)
    session.resume(world.now_s)
    assert old.ended == Reason.SESSION_TAKEN_OVER
    assert [(message.payload, message.duplicate) for message in new.written] == [(b"unanswered", True)]
    assert world.wire.payloads() == [b"unanswered", b"lost"]


def test_a_packet_that_is_too_large_for_its_client_is_dropped_and_counted() -> None:
    world = World()
    session, wire = world.join("small", MAXIMUM_PACKET_SIZE=50)
    world.broker.subscribe(Subscribe(1, (Subscription("t", 1),), NONE), session)
    world.say(bytes(100), qos=1)
    world.say(b"fits", qos=1)
    assert wire.payloads() == [b"fits"]
    assert world.broker.tally.counts["too large"] == 1
    assert len(session.in_flight) == 1


def test_a_retained_will_without_a_place_is_sent_and_counted_and_not_kept() -> None:
    world = World(Limits(retained=1))
    world.say(b"kept", retain=True)
    doomed, _ = world.join("doomed", will=Publish("w", b"lost", 1, True))
    world.broker.leave(doomed, will=True)
    assert world.wire.payloads() == [b"kept", b"lost"]
    assert len(world.broker.retained) == 1
    assert world.broker.tally.counts["retained full"] == 1
