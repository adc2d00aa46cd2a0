"""Our client and paho, which we did not write, understand each other through both brokers."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shared.bus.mqtt.client import Client, Lost, Outgoing
from shared.bus.mqtt.client_packets import Delivery, decode_delivery, user_property
from shared.bus.mqtt.packets import Connect, Publish, Subscription
from shared.bus.mqtt.properties import Properties, Property
from shared.bus.mqtt.wire import text, varint
from tests.support import brokers, mqtt

ACL = "user tester\ntopic readwrite #\n\nuser ours\ntopic readwrite #\n\nuser reader\ntopic read #\n"
USER = [("from", "ours"), ("Ümlaut", "ä"), ("seq", "7")]
LIMIT = 100_000


@pytest.fixture(params=brokers.KINDS)
def broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[brokers.RunningBroker]:
    running = brokers.start(request.param, tmp_path, ACL)
    yield running
    running.stop()


@pytest.fixture
def paho(broker: brokers.RunningBroker) -> Iterator[mqtt.Client]:
    with mqtt.Client(broker.port, "paho") as client:
        client.connect()
        yield client


@pytest.fixture
def make(broker: brokers.RunningBroker) -> Iterator[Callable[..., Client[Delivery]]]:
    made: list[Client[Delivery]] = []

    def connected(*patterns: str, will: Publish | None = None, user: str = "ours") -> Client[Delivery]:
        wish = Connect("ours", True, 5, user, will, Properties())
        filters = [Subscription(pattern, 1) for pattern in patterns]
        client = Client(wish, None, filters, decode_delivery, queue=1000, packet_bytes=LIMIT)
        made.append(client)
        client.open("127.0.0.1", broker.port)
        run(client, lambda: client.up)
        run(client, lambda: False, 0.1)  # the broker has taken the subscriptions
        return client

    yield connected
    for client in made:
        client.leave()


def run(client: Client[Delivery], happened: Callable[[], bool], within_s: float = 5.0) -> None:
    deadline = time.monotonic() + within_s
    while not happened() and time.monotonic() < deadline:
        client.exchange(0.02)


def message(payload: bytes, qos: int, *, retain: bool = False, expiry_s: int = 0) -> Outgoing:
    packed = b"".join(user_property(key, value) for key, value in USER)
    if expiry_s:
        packed += bytes((Property.MESSAGE_EXPIRY_S,)) + expiry_s.to_bytes(4)
    return Outgoing(text("t/ü"), varint(len(packed)) + packed, payload, qos, retain)


@pytest.mark.parametrize("size", [0, 1, 100, 127, 128, 16_383, 16_384, 70_000])
@pytest.mark.parametrize("qos", [0, 1])
def test_paho_hears_what_we_say(paho: mqtt.Client, make: Callable[..., Client[Delivery]], qos: int, size: int) -> None:
    paho.subscribe("t/#", qos=1)
    ours = make()
    ours.publish(message(bytes(size), qos, expiry_s=60))
    run(ours, lambda: ours.is_idle)
    (heard,) = paho.take()
    assert (heard.topic, heard.payload, heard.qos, heard.retain) == ("t/ü", bytes(size), qos, False)
    assert mqtt.user_properties(heard) == USER
    assert (mqtt.expiry_s(heard) or 0) in (59, 60)
    assert ours.refusals == ours.dropped == 0


@pytest.mark.parametrize("size", [0, 1, 100, 127, 128, 16_383, 16_384, 70_000])
@pytest.mark.parametrize("qos", [0, 1])
def test_we_hear_what_paho_says(paho: mqtt.Client, make: Callable[..., Client[Delivery]], qos: int, size: int) -> None:
    ours = make("t/#")
    paho.publish("t/ü", bytes(size), qos=qos, user=USER, MessageExpiryInterval=60, PayloadFormatIndicator=0)
    run(ours, lambda: bool(ours.inbox))
    (heard,) = ours.inbox
    assert (heard.topic, heard.payload, heard.user, heard.qos) == ("t/ü", bytes(size), dict(USER), qos)


def test_a_retained_message_of_ours_waits_for_paho(paho: mqtt.Client, make: Callable[..., Client[Delivery]]) -> None:
    ours = make()
    ours.publish(message(b"kept", 1, retain=True))
    run(ours, lambda: ours.is_idle)
    paho.subscribe("t/#")
    (heard,) = paho.take()
    assert heard.retain and heard.payload == b"kept"


def test_a_thousand_messages_both_ways_keep_their_order(
    paho: mqtt.Client, make: Callable[..., Client[Delivery]]
) -> None:
    ours = make("t/#")
    for k in range(1000):
        ours.publish(message(b"%d" % k, 1))
    run(ours, lambda: len(ours.inbox) == 1000 and ours.is_idle, 10.0)
    assert [int(delivery.payload) for delivery in ours.inbox] == list(range(1000))


def test_our_will_is_said_when_the_connection_breaks_and_not_after_a_farewell(
    paho: mqtt.Client, make: Callable[..., Client[Delivery]]
) -> None:
    paho.subscribe("will/#")
    will = Publish("will/ours", b"gone", 1, properties=user_property("from", "ours"))
    ours = make(will=will)
    ours.leave()
    assert paho.hears_nothing()
    ours = make(will=will)
    assert ours._connection is not None
    ours._connection.close()  # without a word
    (heard,) = paho.take()
    assert (heard.payload, mqtt.user_properties(heard)) == (b"gone", [("from", "ours")])


def test_what_the_broker_did_not_acknowledge_comes_after_its_restart(
    broker: brokers.RunningBroker, make: Callable[..., Client[Delivery]]
) -> None:
    ours = make("t/#")
    broker.stop()
    for k in range(3):
        ours.publish(message(b"%d" % k, 1))
    with pytest.raises(Lost):
        run(ours, lambda: False)
    broker.restart()
    ours.open("127.0.0.1", broker.port)
    run(ours, lambda: len(ours.inbox) == 3)
    assert [delivery.payload for delivery in ours.inbox] == [b"0", b"1", b"2"]
    assert ours.dropped == 0


def test_a_message_that_we_may_not_send_is_refused_and_told(make: Callable[..., Client[Delivery]]) -> None:
    reader = make(user="reader")
    reader.publish(message(b"x", 1))
    run(reader, lambda: reader.refusals > 0)
    assert reader.complaint == "the broker refuses a message: not authorized"


def test_who_connects_with_our_name_takes_our_place(
    broker: brokers.RunningBroker, make: Callable[..., Client[Delivery]]
) -> None:
    ours = make()
    with mqtt.Client(broker.port, "ours") as other:
        other.connect()
        with pytest.raises(Lost, match=r"session taken over|closed"):
            run(ours, lambda: False)
