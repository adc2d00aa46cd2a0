"""The client against a broker of bare sockets, which does what a proper one would not."""

import socket
from collections.abc import Iterator

import pytest

from shared.bus.mqtt import packets
from shared.bus.mqtt.client import Client, Lost, Outgoing, Refused
from shared.bus.mqtt.client_packets import Delivery, decode_delivery
from shared.bus.mqtt.framing import Framer
from shared.bus.mqtt.packets import (
    Acknowledge,
    Connect,
    Disconnect,
    Kind,
    Packet,
    Ping,
    Publish,
    Subscribe,
    Subscription,
    encode_connack,
    encode_puback,
    encode_publish,
    encode_suback,
)
from shared.bus.mqtt.properties import Properties, Property
from shared.bus.mqtt.wire import Reason, text

QUEUE, LIMIT = 5, 100_000
KEEP_ALIVE_S = 5


class Far:
    """The other end of a client's connection."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._socket: socket.socket | None = None

    def meet(self, client: Client[Delivery], **numbers: int) -> list[Packet]:
        """Let a client in; what it said first."""
        self.accept(client)
        first = self.hear(1)
        limits = Properties({Property[name]: value for name, value in numbers.items()})
        self.say(encode_connack(Reason.SUCCESS, properties=limits))
        client.exchange(1.0)
        assert client.up
        return first

    def accept(self, client: Client[Delivery]) -> None:
        client.open("127.0.0.1", self.port)
        self.hang_up()
        self._socket, _ = self._listener.accept()
        self._socket.settimeout(2.0)
        self._framer = Framer(LIMIT)
        self._heard: list[Packet] = []
        client.flush()

    def hear(self, count: int) -> list[Packet]:
        """Read this many packets."""
        assert self._socket is not None
        while len(self._heard) < count:
            data = self._socket.recv(65_536)
            assert data, "the client has closed"
            self._heard += [packets.decode(*packet) for packet in self._framer.feed(data)]
        heard, self._heard = self._heard[:count], self._heard[count:]
        return heard

    def hears_nothing(self) -> bool:
        assert self._socket is not None
        self._socket.settimeout(0.05)
        try:
            return not self._heard and self._socket.recv(1) == b""
        except TimeoutError:
            return not self._heard
        finally:
            self._socket.settimeout(2.0)

    def say(self, frame: bytes) -> None:
        assert self._socket is not None
        self._socket.sendall(frame)

    def hang_up(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def close(self) -> None:
        self.hang_up()
        self._listener.close()


@pytest.fixture
def far() -> Iterator[Far]:
    made = Far()
    yield made
    made.close()


@pytest.fixture
def client() -> Iterator[Client[Delivery]]:
    made = make()
    yield made
    made.leave()


def make(filters: tuple[Subscription, ...] = ()) -> Client[Delivery]:
    wish = Connect("me", True, KEEP_ALIVE_S, "me", None, Properties())
    return Client(wish, None, filters, decode_delivery, queue=QUEUE, packet_bytes=LIMIT)


def message(payload: bytes, qos: int = 1) -> Outgoing:
    return Outgoing(text("a/b"), b"\0", payload, qos, retain=False)


def published(heard: list[Packet]) -> list[tuple[bytes, bool]]:
    assert all(isinstance(packet, Publish) for packet in heard)
    return [(packet.payload, packet.duplicate) for packet in heard if isinstance(packet, Publish)]


def ids(heard: list[Packet]) -> list[int]:
    return [packet.packet_id for packet in heard if isinstance(packet, Publish)]


def lose(client: Client[Delivery], far: Far) -> str:
    far.hang_up()
    with pytest.raises(Lost) as caught:
        for _ in range(100):
            client.exchange(0.02)
    return str(caught.value)


def test_it_says_who_it_is_and_subscribes_once_it_is_let_in(far: Far) -> None:
    filters = Subscription("a/#", 1), Subscription("b", 0)
    client = make(filters)
    (first,) = far.meet(client)
    assert isinstance(first, Connect)
    assert (first.client_id, first.user, first.clean_start, first.keep_alive_s) == ("me", "me", True, KEEP_ALIVE_S)
    assert first.properties.numbers == {Property.RECEIVE_MAXIMUM: 100, Property.MAXIMUM_PACKET_SIZE: LIMIT}
    (request,) = far.hear(1)
    assert isinstance(request, Subscribe) and request.subscriptions == filters
    client.leave()


def test_a_refusal_is_told_in_words(far: Far, client: Client[Delivery]) -> None:
    far.accept(client)
    far.say(encode_connack(Reason.NOT_AUTHORIZED))
    with pytest.raises(Refused, match="not authorized"):
        client.exchange(1.0)
    assert not client.is_open


def test_a_broker_without_qos_1_is_of_no_use(far: Far, client: Client[Delivery]) -> None:
    far.accept(client)
    far.say(encode_connack(Reason.SUCCESS, properties=Properties({Property.MAXIMUM_QOS: 0})))
    with pytest.raises(Refused, match="QoS 1"):
        client.exchange(1.0)


def test_a_message_is_acknowledged_when_whoever_called_has_it(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    far.say(encode_publish(Publish("a", b"1", 1, packet_id=7)) + encode_publish(Publish("a", b"2", 0)))
    client.exchange(1.0)
    assert [delivery.payload for delivery in client.inbox] == [b"1", b"2"]
    assert far.hears_nothing()
    client.flush()
    assert far.hear(1) == [Acknowledge(7, 0)]


@pytest.mark.parametrize("cut", range(1, 60))
def test_packets_that_come_in_pieces_are_put_together(far: Far, client: Client[Delivery], cut: int) -> None:
    far.meet(client)
    sent = [Publish("a/topic", b"payload %d" % k, 1, packet_id=k) for k in (1, 2, 3)]
    stream = b"".join(map(encode_publish, sent))
    far.say(stream[:cut])
    client.exchange(1.0)
    far.say(stream[cut:])
    while len(client.inbox) < 3:
        client.exchange(1.0)
    assert [delivery.payload for delivery in client.inbox] == [packet.payload for packet in sent]


def test_the_inbox_forgets_the_oldest_and_counts_it(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    far.say(b"".join(encode_publish(Publish("a", b"%d" % k)) for k in range(QUEUE + 2)))
    while client.dropped < 2:
        client.exchange(1.0)
    assert [delivery.payload for delivery in client.inbox] == [b"2", b"3", b"4", b"5", b"6"]


def test_no_more_is_on_its_way_than_the_broker_takes(far: Far, client: Client[Delivery]) -> None:
    far.meet(client, RECEIVE_MAXIMUM=2)
    for k in range(4):
        client.publish(message(b"%d" % k))
    client.publish(message(b"after", qos=0))
    client.flush()
    heard = far.hear(2)
    assert published(heard) == [(b"0", False), (b"1", False)] and far.hears_nothing()
    far.say(encode_puback(ids(heard)[0], Reason.SUCCESS) + encode_puback(ids(heard)[1], Reason.SUCCESS))
    client.exchange(1.0)
    client.flush()
    heard = far.hear(2)
    assert published(heard) == [(b"2", False), (b"3", False)]
    for packet_id in ids(heard):
        far.say(encode_puback(packet_id, Reason.NO_MATCHING_SUBSCRIBERS))
    while not client.is_idle:
        client.exchange(0.1)
    assert published(far.hear(1)) == [(b"after", False)], "the order is kept"


def test_what_was_not_acknowledged_is_sent_again_before_what_came_later(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    for k in range(3):
        client.publish(message(b"%d" % k))
    client.flush()
    far.say(encode_puback(ids(far.hear(3))[1], Reason.SUCCESS))
    client.exchange(1.0)
    lose(client, far)
    client.publish(message(b"3"))
    client.publish(message(b"lost", qos=0))
    far.meet(client)
    assert published(far.hear(3)) == [(b"0", True), (b"2", True), (b"3", False)]
    assert client.dropped == 1


def test_away_from_the_broker_a_bounded_number_of_messages_waits(far: Far, client: Client[Delivery]) -> None:
    for k in range(QUEUE + 3):
        client.publish(message(b"%d" % k))
    assert client.dropped == 3
    far.meet(client)
    assert published(far.hear(QUEUE)) == [(b"%d" % k, False) for k in range(3, QUEUE + 3)]


def test_a_packet_identifier_in_use_is_passed_over(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    client._packet_id = 65_533
    for k in range(2):
        client.publish(message(b"%d" % k))
    client._packet_id = 65_533
    client.publish(message(b"2"))
    client.flush()
    assert ids(far.hear(3)) == [65_534, 65_535, 1]


def test_a_message_that_is_refused_is_counted_and_not_sent_again(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    client.publish(message(b"x"))
    client.flush()
    far.say(encode_puback(ids(far.hear(1))[0], Reason.QUOTA_EXCEEDED))
    client.exchange(1.0)
    assert (client.refusals, client.is_idle) == (1, True)
    assert client.complaint is not None and "quota exceeded" in client.complaint


def test_a_refused_subscription_is_told(far: Far) -> None:
    client = make((Subscription("a", 1),))
    far.meet(client)
    (request,) = far.hear(1)
    assert isinstance(request, Subscribe)
    far.say(encode_suback(Kind.SUBACK, request.packet_id, [Reason.NOT_AUTHORIZED]))
    client.exchange(1.0)
    assert client.complaint is not None and "not authorized" in client.complaint
    client.leave()


def test_a_message_larger_than_the_broker_takes_is_dropped_and_told(far: Far, client: Client[Delivery]) -> None:
    far.meet(client, MAXIMUM_PACKET_SIZE=50)
    client.publish(message(bytes(60)))
    client.publish(message(b"small"))
    client.flush()
    assert published(far.hear(1)) == [(b"small", False)]
    assert client.dropped == 1 and client.complaint is not None and "bytes" in client.complaint


def test_silence_is_broken_by_a_ping_and_a_mute_broker_is_left(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    assert client._connection is not None
    client._connection.sent_s -= 0.8 * KEEP_ALIVE_S
    client._look_s = 0.0
    client.exchange(0.0)
    assert far.hear(1) == [Ping()]
    client._look_s = 0.0
    client._connection.heard_s -= 1.6 * KEEP_ALIVE_S
    with pytest.raises(Lost, match="does not answer"):
        client.exchange(0.0)


def test_a_broker_that_does_not_read_holds_back_a_bounded_number_of_messages(
    far: Far, client: Client[Delivery]
) -> None:
    far.meet(client)
    sent = 0
    while not client.dropped:
        client.publish(message(bytes(90_000), qos=0))
        client.flush()
        sent += 1
        assert sent < 1000
    assert client.gathered_bytes < 200_000
    heard: list[Packet] = []
    while not client.is_idle:
        heard += far.hear(1)
        client.exchange(0.0)
    assert len(heard) <= sent - 1


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (encode_connack(Reason.SUCCESS), Reason.PROTOCOL_ERROR),
        (bytes((0x34, 5, 0, 1, 97, 0, 1)), Reason.QOS_NOT_SUPPORTED),
        (bytes((0x32, 6, 0, 1, 97, 0, 0, 0)), Reason.PROTOCOL_ERROR),
        (bytes((0x30, 0)), Reason.MALFORMED_PACKET),
        (bytes((0x30, 3, 0, 1, 0xFF)), Reason.MALFORMED_PACKET),
        (bytes((0xD1, 0)), Reason.MALFORMED_PACKET),
        (bytes((0x10, 0)), Reason.PROTOCOL_ERROR),
        (bytes((0x30, 0xFF, 0xFF, 0xFF, 0xFF)), Reason.MALFORMED_PACKET),
        (bytes((0x30, 0xFF, 0xFF, 0xFF, 0x7F)), Reason.PACKET_TOO_LARGE),
    ],
)
def test_a_broker_that_breaks_the_protocol_is_told_so_and_left(
    far: Far, client: Client[Delivery], frame: bytes, reason: Reason
) -> None:
    far.meet(client)
    far.say(encode_publish(Publish("a", b"good")) + frame)
    with pytest.raises(Lost, match="broke the protocol"):
        client.exchange(1.0)
    assert [delivery.payload for delivery in client.inbox] == [b"good"]
    assert far.hear(1) == [Disconnect(reason)]
    assert not client.is_open


def test_nothing_is_taken_before_the_greeting(far: Far, client: Client[Delivery]) -> None:
    far.accept(client)
    far.say(encode_publish(Publish("a", b"x")))
    with pytest.raises(Lost, match="before the greeting"):
        client.exchange(1.0)
    assert not client.inbox


def test_the_broker_says_why_it_ends_the_connection(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    far.say(packets.encode_disconnect(Reason.SERVER_SHUTTING_DOWN))
    with pytest.raises(Lost, match="server shutting down"):
        client.exchange(1.0)


def test_a_connection_that_breaks_is_told(far: Far, client: Client[Delivery]) -> None:
    far.meet(client)
    assert "closed" in lose(client, far)


def test_a_farewell_goes_out_after_what_was_gathered(far: Far) -> None:
    client = make()
    far.meet(client)
    client.publish(message(b"last", qos=0))
    client.leave()
    last, farewell = far.hear(2)
    assert published([last]) == [(b"last", False)]
    assert farewell == Disconnect(Reason.SUCCESS)
