"""What the unit requires of a broker, tested with Mosquitto and the simulated one; differences are stated."""

import contextlib
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from broker.simulated import Limits
from shared.topics import MANY_BYTES
from tests.support.bus import brokers, raw_mqtt
from tests.support.bus.brokers import MOSQUITTO, SIMULATED, RunningBroker
from tests.support.bus.mqtt import KEEP_ALIVE_S, Client
from tests.support.patience import HANGS_S

REFUSED = 0x80  # in the answer to a subscription
ACL = """\
topic read open/#

user tester
topic readwrite #

user writer
topic write open/temperature
topic write open/health/writer

user reader
topic read open/+
topic read obu/+/gnss/fix
"""


@pytest.fixture(scope="module", params=brokers.KINDS)
def broker(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningBroker]:
    running = brokers.start(request.param, tmp_path_factory.mktemp("broker"), ACL)
    yield running
    running.stop()


@pytest.fixture
def own_broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningBroker]:
    """A broker for one test alone, which may stop it."""
    running = brokers.start(request.param, tmp_path, ACL)
    yield running
    running.stop()


on_a_broker_of_its_own = pytest.mark.parametrize("own_broker", brokers.KINDS, indirect=True)


@pytest.fixture
def topic(request: pytest.FixtureRequest) -> str:
    """A topic that no other test uses."""
    return "test/" + re.sub(r"\W", "_", request.node.name)


@pytest.fixture
def alice(broker: RunningBroker) -> Iterator[Client]:
    with Client(broker.port) as client:
        assert client.connect() == 0
        yield client


@pytest.fixture
def bob(broker: RunningBroker) -> Iterator[Client]:
    with Client(broker.port) as client:
        assert client.connect() == 0
        yield client


# Messages


@pytest.mark.parametrize("qos", [0, 1])
def test_a_message_arrives_as_it_was_sent(alice: Client, bob: Client, topic: str, qos: int) -> None:
    assert bob.subscribe(topic, qos=qos) == [qos]
    alice.publish(topic, bytes(range(256)), qos=qos)
    (message,) = bob.take()
    assert (message.topic, message.payload, message.qos, message.retain) == (topic, bytes(range(256)), qos, False)


@pytest.mark.parametrize(("sent", "granted", "arrives"), [(0, 1, 0), (1, 0, 0), (1, 1, 1)])
def test_a_message_is_delivered_with_the_lower_qos_of_message_and_subscription(
    alice: Client, bob: Client, topic: str, sent: int, granted: int, arrives: int
) -> None:
    bob.subscribe(topic, qos=granted)
    alice.publish(topic, "x", qos=sent)
    assert bob.take()[0].qos == arrives


def test_a_thousand_messages_at_once_arrive_complete_and_in_order(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe(topic, qos=0)
    for number in range(1000):
        alice.paho.publish(topic, str(number), qos=0)
    alice.until(lambda: not alice.paho.want_write())
    assert bob.payloads(1000) == [str(number) for number in range(1000)]


def test_a_thousand_messages_of_qos_1_arrive_complete_and_in_order(alice: Client, bob: Client, topic: str) -> None:
    sent = 0

    def all_have_arrived() -> bool:
        alice.exchange(0)
        return len(bob.messages) == sent

    bob.subscribe(topic)
    for _ in range(20):
        for _ in range(50):  # within the queue of Mosquitto for a client that has not acknowledged yet
            alice.paho.publish(topic, str(sent), qos=1)
            sent += 1
        bob.until(all_have_arrived)
    assert bob.payloads(1000) == [str(number) for number in range(1000)]


def test_all_subscribers_receive_the_messages_of_all_publishers_in_one_order(broker: RunningBroker, topic: str) -> None:
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(Client(broker.port)) for _ in range(6)]
        publishers, subscribers = clients[:3], clients[3:]
        for client in clients:
            client.connect()
        for client in subscribers:
            client.subscribe(f"{topic}/+", qos=0)
        for number in range(100):
            for name, client in enumerate(publishers):
                client.paho.publish(f"{topic}/{name}", f"{name}:{number}", qos=0)
        seen = [client.payloads(300) for client in subscribers]
    assert seen[0] == seen[1] == seen[2]
    assert len(set(seen[0])) == 300


def test_the_largest_payload_is_delivered_complete(alice: Client, bob: Client, topic: str) -> None:
    payload = bytes(range(256)) * (MANY_BYTES // 256)
    bob.subscribe(topic)
    alice.publish(topic, payload)
    assert bob.take()[0].payload == payload


def test_a_packet_beyond_the_limit_ends_the_connection(broker: RunningBroker, alice: Client, topic: str) -> None:
    with Client(broker.port) as client:
        client.connect()
        client.paho.publish(topic, bytes(Limits().packet_bytes), qos=0)
        client.ends()
    alice.publish(topic, "others go on")


def test_bursts_of_small_messages_do_not_wait_for_each_other(alice: Client, bob: Client, topic: str) -> None:
    """Without TCP_NODELAY a burst to a client that also sends takes a delayed acknowledgement, about 40 ms."""
    bob.subscribe(topic, qos=0)
    durations = []
    for _ in range(15):
        started = time.monotonic()
        for _ in range(5):
            alice.paho.publish(topic, "x" * 100, qos=0)
        bob.take(5)
        durations.append(time.monotonic() - started)
        bob.publish(f"{topic}/answer", "x", qos=0)
        time.sleep(0.005)
    assert sorted(durations)[7] < 0.02


def test_a_client_that_does_not_read_has_a_bounded_queue_and_delays_no_other(
    broker: RunningBroker, alice: Client, bob: Client, topic: str
) -> None:
    """The simulated broker drops the oldest messages and delivers the last one; Mosquitto drops the newest."""
    bob.subscribe(topic, qos=0)
    with raw_mqtt.connect(broker.port, "slow", user="tester") as slow:
        slow.sendall(raw_mqtt.subscribe(topic))
        for _ in range(40):
            for _ in range(50):
                alice.paho.publish(topic, bytes(8000), qos=0)
            bob.take(50)
        alice.publish(topic, "last", qos=0)
        assert bob.payloads() == ["last"]
        read = raw_mqtt.read_all(slow)
    assert len(read) < 2000 * 8000
    assert read.endswith(b"last") is (broker.kind == SIMULATED)


# Subscriptions


@pytest.mark.parametrize(
    ("pattern", "taken"),
    [
        ("{}/a/b", ["a/b"]),
        ("{}/+/b", ["a/b", "c/b"]),
        ("{}/#", ["", "a", "a/", "a/b", "a/b/c", "c/b"]),
        ("{}/a/#", ["a", "a/", "a/b", "a/b/c"]),
        ("{}/a/+", ["a/", "a/b"]),
        ("{}/+/+/c", ["a/b/c"]),
    ],
)
def test_wildcards_match_by_the_standard(
    alice: Client, bob: Client, topic: str, pattern: str, taken: list[str]
) -> None:
    bob.subscribe(pattern.format(topic))
    for tail in ("", "a", "a/", "a/b", "a/b/c", "c/b"):
        alice.publish(f"{topic}/{tail}" if tail else topic, tail)
    assert sorted(bob.payloads(len(taken))) == sorted(taken)
    assert bob.receives_nothing()


def test_a_bare_hash_does_not_match_topics_that_begin_with_a_dollar(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe("#", qos=0)
    alice.publish(f"$other/{topic}", "hidden")
    alice.publish(topic, "seen")
    assert bob.payloads() == ["seen"]


@pytest.mark.parametrize("pattern", ["a/#/b", "a/b#", "a+/b"])
def test_an_invalid_filter_is_rejected(broker: RunningBroker, pattern: str) -> None:
    """The simulated broker rejects the filter; Mosquitto ends the connection. (paho would not send it.)"""
    with raw_mqtt.connect(broker.port, "careless", user="tester") as raw:
        raw.sendall(raw_mqtt.subscribe(pattern))
        assert raw.recv(100) == (b"\x90\x03\0\1\x80" if broker.kind == SIMULATED else b"")


def test_overlapping_subscriptions_deliver_a_message_once(
    broker: RunningBroker, alice: Client, bob: Client, topic: str
) -> None:
    """The simulated broker sends it with the highest QoS of them; Mosquitto with that of the one it finds first."""
    bob.subscribe(f"{topic}/#", qos=0)
    bob.subscribe(f"{topic}/+", qos=1)
    alice.publish(f"{topic}/a", "once")
    assert bob.take()[0].qos in ((1,) if broker.kind == SIMULATED else (0, 1))
    assert bob.receives_nothing()


def test_unsubscribing_ends_the_messages(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    bob.unsubscribe(topic)
    bob.unsubscribe(topic)
    alice.publish(topic, "x")
    assert bob.receives_nothing()


def test_a_client_receives_its_own_messages_on_a_subscribed_topic(alice: Client, topic: str) -> None:
    alice.subscribe(topic)
    alice.publish(topic, "own")
    assert alice.payloads() == ["own"]


# Retained messages


def test_a_retained_message_is_delivered_to_new_subscribers_until_an_empty_one_clears_it(
    alice: Client, bob: Client, topic: str
) -> None:
    alice.publish(topic, "old", retain=True)
    alice.publish(topic, "new", retain=True)
    bob.subscribe(topic)
    (message,) = bob.take()
    assert (message.payload, message.retain, message.qos) == (b"new", True, 1)
    alice.publish(topic, "newest", retain=True)
    assert bob.take()[0].retain is False
    alice.publish(topic, "", retain=True)
    assert bob.payloads() == [""]
    bob.unsubscribe(topic)
    bob.subscribe(topic)
    assert bob.receives_nothing()


# Wills, keep-alive, take-over


def test_the_will_of_a_killed_client_is_published_at_once(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as client:
        client.will(topic, "lost", retain=True)
        client.connect()
        started = time.monotonic()
        client.kill()
        (message,) = bob.take()
    assert time.monotonic() - started < KEEP_ALIVE_S, "by the end of its connection, and not by its silence"
    assert (message.payload, message.qos) == (b"lost", 1)
    bob.unsubscribe(topic)
    bob.subscribe(topic)
    assert bob.take()[0].retain
    bob.publish(topic, "", retain=True)


def test_the_will_of_a_client_that_disconnects_is_not_published(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as client:
        client.will(topic, "lost")
        client.connect()
        client.leave()
    assert bob.receives_nothing()


def test_a_hung_client_is_disconnected_after_its_keep_alive(broker: RunningBroker, bob: Client, topic: str) -> None:
    """After 1.5 times the keep-alive; Mosquitto 2.0.11 checks every 5 s."""
    bob.subscribe(topic)
    with Client(broker.port) as hung:
        hung.will(topic, "lost")
        started = time.monotonic()
        hung.connect(keep_alive_s=1)
        assert bob.payloads(within_s=HANGS_S) == ["lost"]
        assert time.monotonic() - started > 1.4
        hung.ends()


def test_a_client_that_only_pings_stays_connected(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as quiet:
        quiet.will(topic, "lost")
        quiet.connect(keep_alive_s=1)
        quiet.spin(1.8)
        assert not quiet.ended
    assert bob.receives_nothing()


def test_a_second_client_of_the_same_name_takes_over(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port, "process") as old, Client(broker.port, "process") as new:
        old.will(topic, "lost")
        old.connect()
        new.connect()
        old.ends()
        assert bob.payloads() == ["lost"]
        new.publish(topic, "back")
        assert bob.payloads() == ["back"]


# Access


def test_a_message_that_is_not_allowed_is_not_delivered(broker: RunningBroker, bob: Client) -> None:
    bob.subscribe("open/#", "closed/#")
    with Client(broker.port, user="writer") as writer:
        writer.connect()
        writer.publish("open/temperature", "20")
        writer.publish("open/health/writer", "ready")
        writer.publish("open/health/reader", "forged")
        writer.publish("closed/door", "forged")
        writer.publish("closed/door", "forged", qos=0)
        assert bob.payloads(2) == ["20", "ready"]
        assert bob.receives_nothing()
        assert not writer.ended


def test_a_message_is_delivered_only_to_clients_that_may_read_it(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user="reader") as reader:
        reader.connect()
        reader.subscribe("open/#", "obu/+/gnss/fix")
        for topic in ("open/a/b", "obu/x/gnss/raw", "open/a", "obu/x/gnss/fix"):
            alice.publish(topic, topic)
        assert reader.payloads(2) == ["open/a", "obu/x/gnss/fix"]
        assert reader.receives_nothing()


@pytest.mark.parametrize("user", ["reader", "writer", "unknown"])
def test_a_subscription_without_a_readable_topic_is_rejected(broker: RunningBroker, user: str) -> None:
    """Mosquitto 2.0.11 grants every subscription and filters messages; the simulated broker rejects them."""
    with Client(broker.port, user=user) as client:
        client.connect()
        assert client.subscribe("closed/#") == [REFUSED if broker.kind == SIMULATED else 1]


def test_an_unknown_client_neither_receives_nor_publishes(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user="unknown") as unknown:
        unknown.connect()
        unknown.subscribe("#")
        alice.publish("open/a", "x", retain=True)
        unknown.publish("open/a", "forged")
        assert unknown.receives_nothing()
        alice.subscribe("open/a")
        assert alice.payloads() == ["x"]
    alice.publish("open/a", "", retain=True)


def test_a_client_without_a_name_has_the_rules_before_the_first_user(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user=None) as nameless:
        nameless.connect()
        nameless.subscribe("#")
        alice.publish("closed/a", "hidden")
        alice.publish("open/a", "seen")
        assert nameless.payloads() == ["seen"]
        nameless.publish("open/a", "forged")
        assert nameless.receives_nothing()


def test_a_will_that_is_not_allowed_is_not_delivered(broker: RunningBroker, bob: Client) -> None:
    """The simulated broker rejects the client; Mosquitto accepts it and drops the will."""
    bob.subscribe("closed/#")
    with Client(broker.port, user="writer") as writer:
        writer.will("closed/door", "forged")
        answer = writer.connect()
        assert answer == ("Not authorized" if broker.kind == SIMULATED else "Success")
        if broker.kind == MOSQUITTO:
            writer.kill()
    assert bob.receives_nothing()


# Versions


# Restart


@on_a_broker_of_its_own
def test_clients_reconnect_after_a_restart_of_the_broker(own_broker: RunningBroker) -> None:
    """Mosquitto has saved the retained messages; the simulated broker begins empty."""
    with Client(own_broker.port, "a") as alice, Client(own_broker.port, "b") as bob:
        alice.connect()
        bob.connect()
        alice.publish("obu/x/navigation/last_position", "here", retain=True)
        own_broker.restart()
        alice.ends()
        bob.ends()
        alice.connect()
        bob.connect()
        bob.subscribe("obu/#")
        kept = ["here"] if own_broker.kind == MOSQUITTO else []
        assert bob.payloads(len(kept)) == kept
        alice.publish("obu/x/mode/state", "live")
        assert bob.payloads() == ["live"]
