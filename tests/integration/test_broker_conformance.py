"""What the unit asks of a broker, of Mosquitto and the simulated one alike; where they differ, the test says so."""

import contextlib
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from paho.mqtt.enums import MQTTProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode

from tests.support import brokers, raw_mqtt
from tests.support.brokers import MOSQUITTO, SIMULATED, RunningBroker
from tests.support.mqtt import Client, expiry_s, user_properties

NOT_AUTHORIZED, TAKEN_OVER, TOO_LARGE, KEEP_ALIVE_TIMEOUT = 0x87, 0x8E, 0x95, 0x8D
UNSPECIFIED = 0x80  # what paho says of a connection that was closed without a reason
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


def a_second_on(broker: RunningBroker) -> float:
    """Time after which what expires in a second has expired; Mosquitto counts in whole seconds."""
    return 1.2 if broker.kind == SIMULATED else 2.2


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
    assert alice.publish(topic, bytes(range(256)), qos=qos) in (None, 0)
    (message,) = bob.take()
    assert (message.topic, message.payload, message.qos, message.retain) == (topic, bytes(range(256)), qos, False)


@pytest.mark.parametrize(("sent", "granted", "arrives"), [(0, 1, 0), (1, 0, 0), (1, 1, 1)])
def test_the_lower_qos_of_message_and_subscription_holds(
    alice: Client, bob: Client, topic: str, sent: int, granted: int, arrives: int
) -> None:
    bob.subscribe(topic, qos=granted)
    alice.publish(topic, "x", qos=sent)
    assert bob.take()[0].qos == arrives


def test_user_properties_arrive_unchanged_and_in_order(alice: Client, bob: Client, topic: str) -> None:
    pairs = [
        ("from", "core.fusion"),
        ("life", "1700000000000000000"),
        ("twice", "a"),
        ("twice", "b"),
        ("ü", "°"),
        ("", ""),
    ]
    bob.subscribe(topic)
    alice.publish(topic, "x", user=pairs)
    assert user_properties(bob.take()[0]) == pairs


def test_the_other_properties_of_a_message_arrive_too(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    given = {"PayloadFormatIndicator": 1, "ContentType": "application/json", "ResponseTopic": "test/answer"}
    alice.publish(topic, "{}", CorrelationData=b"\x00\xff", **given)  # type: ignore[arg-type]  # paho sets any type
    properties = bob.take()[0].properties
    assert {name: getattr(properties, name, None) for name in given} == given
    assert getattr(properties, "CorrelationData", None) == b"\x00\xff"


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
        for _ in range(50):  # within what Mosquitto keeps for a client that does not acknowledge yet
            alice.paho.publish(topic, str(sent), qos=1)
            sent += 1
        bob.until(all_have_arrived)
    assert bob.payloads(1000) == [str(number) for number in range(1000)]


def test_every_subscriber_sees_the_messages_of_all_publishers_in_one_order(broker: RunningBroker, topic: str) -> None:
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


def test_a_payload_of_a_mebibyte_arrives_whole(alice: Client, bob: Client, topic: str) -> None:
    payload = bytes(range(256)) * 4096
    bob.subscribe(topic)
    assert alice.publish(topic, payload) == 0
    assert bob.take()[0].payload == payload


def test_a_packet_beyond_the_limit_ends_the_connection(broker: RunningBroker, alice: Client, topic: str) -> None:
    with Client(broker.port) as client:
        client.connect()
        client.paho.publish(topic, bytes(1_200_000), qos=0)
        # Both send reason 0x95, but close while bytes are on their way, so that the client may see only the reset.
        assert client.ends_with() in (TOO_LARGE, UNSPECIFIED)
    assert alice.publish(topic, "others go on") in (0, 0x10)


def test_a_client_gets_no_packet_larger_than_it_takes(broker: RunningBroker, alice: Client, topic: str) -> None:
    with Client(broker.port) as client:
        client.connect(MaximumPacketSize=200)
        client.subscribe(topic)
        alice.publish(topic, "x" * 300)
        alice.publish(topic, "small")
        assert client.payloads() == ["small"]


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


def test_a_client_that_does_not_read_costs_a_bounded_queue_and_delays_nobody(
    broker: RunningBroker, alice: Client, bob: Client, topic: str
) -> None:
    """The simulated broker forgets the oldest messages, so that the last one arrives; Mosquitto drops the newest."""
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
def test_wildcards_take_what_they_should(
    alice: Client, bob: Client, topic: str, pattern: str, taken: list[str]
) -> None:
    bob.subscribe(pattern.format(topic))
    for tail in ("", "a", "a/", "a/b", "a/b/c", "c/b"):
        alice.publish(f"{topic}/{tail}" if tail else topic, tail)
    assert sorted(bob.payloads(len(taken))) == sorted(taken)
    assert bob.hears_nothing()


def test_a_bare_hash_does_not_take_topics_that_begin_with_a_dollar(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe("#", qos=0, retain_handling=2)
    alice.publish(f"$other/{topic}", "hidden")
    alice.publish(topic, "seen")
    assert bob.payloads() == ["seen"]


@pytest.mark.parametrize("pattern", ["a/#/b", "a/b#", "a+/b"])
def test_an_invalid_filter_is_refused(broker: RunningBroker, pattern: str) -> None:
    """The simulated broker answers with a reason code; Mosquitto ends the connection. (paho would not send it.)"""
    with raw_mqtt.connect(broker.port, "careless", user="tester") as raw:
        raw.sendall(raw_mqtt.subscribe(pattern))
        assert raw.recv(100) == (b"\x90\x04\0\1\0\x8f" if broker.kind == SIMULATED else b"\xe0\x01\x81")


def test_overlapping_subscriptions_bring_a_message_once_with_the_highest_qos(
    broker: RunningBroker, alice: Client, bob: Client, topic: str
) -> None:
    """Mosquitto sends one copy for each subscription; the specification allows both, so our clients never overlap."""
    bob.subscribe(f"{topic}/#", qos=0)
    bob.subscribe(f"{topic}/+", qos=1)
    alice.publish(f"{topic}/a", "once")
    expected = [1] if broker.kind == SIMULATED else [0, 1]
    assert sorted(message.qos for message in bob.take(len(expected))) == expected
    assert bob.hears_nothing()


def test_unsubscribing_ends_the_messages(alice: Client, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    assert bob.unsubscribe(topic) == [0]
    assert bob.unsubscribe(topic) == [0x11]
    alice.publish(topic, "x")
    assert bob.hears_nothing()


def test_no_local_spares_a_client_its_own_messages(alice: Client, bob: Client, topic: str) -> None:
    alice.subscribe(topic, no_local=True)
    alice.publish(topic, "own")
    bob.publish(topic, "other")
    assert alice.payloads() == ["other"]


def test_without_no_local_a_client_hears_itself(alice: Client, topic: str) -> None:
    alice.subscribe(topic)
    alice.publish(topic, "own")
    assert alice.payloads() == ["own"]


# Retained messages


def test_a_retained_message_greets_each_new_subscriber_until_an_empty_one_clears_it(
    alice: Client, bob: Client, topic: str
) -> None:
    alice.publish(topic, "old", retain=True)
    alice.publish(topic, "new", retain=True, user=[("seq", "2")])
    bob.subscribe(topic)
    (message,) = bob.take()
    assert (message.payload, message.retain, message.qos, user_properties(message)) == (b"new", True, 1, [("seq", "2")])
    alice.publish(topic, "", retain=True)
    assert bob.payloads() == [""]
    bob.unsubscribe(topic)
    bob.subscribe(topic)
    assert bob.hears_nothing()


def test_a_retained_message_expires_and_says_how_long_it_still_holds(
    broker: RunningBroker, alice: Client, bob: Client, topic: str
) -> None:
    alice.publish(topic, "state", retain=True, MessageExpiryInterval=1)
    alice.publish(f"{topic}/long", "state", retain=True, MessageExpiryInterval=100)
    bob.subscribe(topic)
    assert expiry_s(bob.take()[0]) in (0, 1)
    bob.spin(a_second_on(broker))
    bob.subscribe(f"{topic}/#")
    (message,) = bob.take()
    assert message.topic == f"{topic}/long"
    assert 95 <= (expiry_s(message) or 0) <= 99
    alice.publish(f"{topic}/long", "", retain=True)


@pytest.mark.parametrize(("handling", "at_first", "again"), [(0, 1, 1), (1, 1, 0), (2, 0, 0)])
def test_retain_handling_chooses_when_the_retained_message_comes(
    alice: Client, bob: Client, topic: str, handling: int, at_first: int, again: int
) -> None:
    alice.publish(topic, "kept", retain=True)
    for expected in (at_first, again):
        bob.subscribe(topic, retain_handling=handling)
        assert len(bob.take(expected)) == expected
        assert bob.hears_nothing()
    alice.publish(topic, "", retain=True)


@pytest.mark.parametrize("as_published", [False, True])
def test_a_live_message_keeps_its_retain_flag_only_where_asked(
    alice: Client, bob: Client, topic: str, as_published: bool
) -> None:
    bob.subscribe(topic, retain_as_published=as_published)
    alice.publish(topic, "x", retain=True)
    assert bob.take()[0].retain is as_published
    alice.publish(topic, "", retain=True)


# Wills, keep-alive, take-over


def test_a_killed_client_leaves_its_will_at_once(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as client:
        client.will(topic, "lost", retain=True, user=[("from", "core.fusion")])
        client.connect()
        started = time.monotonic()
        client.kill()
        (message,) = bob.take()
    assert time.monotonic() - started < 0.5
    assert (message.payload, message.qos, user_properties(message)) == (b"lost", 1, [("from", "core.fusion")])
    bob.unsubscribe(topic)
    bob.subscribe(topic)
    assert bob.take()[0].retain
    bob.publish(topic, "", retain=True)


@pytest.mark.parametrize(("reason", "heard"), [(0x00, False), (0x04, True)])
def test_a_client_that_takes_leave_chooses_whether_its_will_is_sent(
    broker: RunningBroker, bob: Client, topic: str, reason: int, heard: bool
) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as client:
        client.will(topic, "lost")
        client.connect()
        client.leave(reason)
    assert bob.hears_nothing() is not heard


def test_a_hung_client_is_given_up_after_its_keep_alive(broker: RunningBroker, bob: Client, topic: str) -> None:
    """After 1.5 times the keep-alive; Mosquitto 2.0.11 looks only every 5 s, and does not say why."""
    bob.subscribe(topic)
    with Client(broker.port) as hung:
        hung.will(topic, "lost")
        hung.connect(keep_alive_s=1)
        started = time.monotonic()
        assert bob.payloads(within_s=8) == ["lost"]
        assert 1.4 < time.monotonic() - started < (2.0 if broker.kind == SIMULATED else 7.0)
        assert hung.ends_with() in (KEEP_ALIVE_TIMEOUT, UNSPECIFIED if broker.kind == MOSQUITTO else KEEP_ALIVE_TIMEOUT)


def test_a_quiet_client_that_pings_stays(broker: RunningBroker, bob: Client, topic: str) -> None:
    bob.subscribe(topic)
    with Client(broker.port) as quiet:
        quiet.will(topic, "lost")
        quiet.connect(keep_alive_s=1)
        quiet.spin(1.8)
        assert quiet.farewell is None
    assert bob.hears_nothing()


def test_a_second_client_of_the_same_name_takes_over(broker: RunningBroker, bob: Client, topic: str) -> None:
    """Mosquitto 2.0.11 closes the old connection without saying why."""
    bob.subscribe(topic)
    with Client(broker.port, "process") as old, Client(broker.port, "process") as new:
        old.will(topic, "lost")
        old.connect()
        new.connect()
        assert old.ends_with() in (TAKEN_OVER, UNSPECIFIED if broker.kind == MOSQUITTO else TAKEN_OVER)
        assert bob.payloads() == ["lost"]
        new.publish(topic, "back")
        assert bob.payloads() == ["back"]


def test_a_client_without_a_name_is_given_one(alice: Client, bob: Client) -> None:
    names = {getattr(client.connack_properties, "AssignedClientIdentifier", "") for client in (alice, bob)}
    assert len(names) == 2
    assert "" not in names


# Sessions


def test_a_session_that_is_kept_collects_qos_1_while_its_client_is_away(
    broker: RunningBroker, alice: Client, topic: str
) -> None:
    """QoS 0 is not collected, by either broker."""
    with Client(broker.port, topic) as away:
        away.connect(SessionExpiryInterval=60)
        away.subscribe(topic)
        away.kill()
        for number in range(5):
            alice.publish(topic, f"one {number}")
        alice.publish(topic, "zero", qos=0)
        away.connect(clean_start=False, SessionExpiryInterval=60)
        assert away.session_present
        assert away.payloads(5) == [f"one {number}" for number in range(5)]
        assert away.hears_nothing()
        away.connect(clean_start=True)
        assert not away.session_present


def test_what_was_not_acknowledged_is_sent_again_as_a_duplicate(
    broker: RunningBroker, alice: Client, topic: str
) -> None:
    with Client(broker.port, topic, manual_ack=True) as client:
        client.connect(SessionExpiryInterval=60)
        client.subscribe(topic)
        alice.publish(topic, "first")
        alice.publish(topic, "second")
        seen = client.take(2)
        client.paho.ack(seen[0].mid, 1)
        client.spin(0.05)
        client.kill()
        client.connect(clean_start=False)
        (again,) = client.take()
        assert (again.payload, again.dup, again.mid) == (b"second", True, seen[1].mid)
        client.paho.ack(again.mid, 1)


def test_a_session_ends_when_its_time_is_over(broker: RunningBroker, topic: str) -> None:
    with Client(broker.port, topic) as client:
        client.connect(SessionExpiryInterval=1)
        client.kill()
        time.sleep(a_second_on(broker))
        client.connect(clean_start=False)
        assert not client.session_present


def test_no_more_messages_are_in_flight_than_the_client_takes(broker: RunningBroker, alice: Client, topic: str) -> None:
    with Client(broker.port, topic, manual_ack=True) as client:
        client.connect(ReceiveMaximum=2)
        client.subscribe(topic)
        for number in range(4):
            alice.publish(topic, str(number))
        first = client.take(2)
        assert client.hears_nothing()
        client.paho.ack(first[0].mid, 1)
        client.paho.ack(first[1].mid, 1)
        assert client.payloads(2) == ["2", "3"]


# Access


def test_a_message_that_is_not_allowed_reaches_nobody(broker: RunningBroker, bob: Client) -> None:
    bob.subscribe("open/#", "closed/#")
    with Client(broker.port, user="writer") as writer:
        writer.connect()
        assert writer.publish("open/temperature", "20") == 0
        assert writer.publish("open/health/writer", "ready") == 0
        assert writer.publish("open/health/reader", "forged") == NOT_AUTHORIZED
        assert writer.publish("closed/door", "forged") == NOT_AUTHORIZED
        writer.publish("closed/door", "forged", qos=0)
        assert bob.payloads(2) == ["20", "ready"]
        assert bob.hears_nothing()
        assert writer.farewell is None


def test_a_message_reaches_only_those_who_may_read_it(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user="reader") as reader:
        reader.connect()
        reader.subscribe("open/#", "obu/+/gnss/fix")
        for topic in ("open/a/b", "obu/x/gnss/raw", "open/a", "obu/x/gnss/fix"):
            alice.publish(topic, topic)
        assert reader.payloads(2) == ["open/a", "obu/x/gnss/fix"]
        assert reader.hears_nothing()


@pytest.mark.parametrize("user", ["reader", "writer", "stranger"])
def test_a_subscription_that_could_bring_nothing_is_refused(broker: RunningBroker, user: str) -> None:
    """Mosquitto 2.0.11 grants every subscription and filters messages; the simulated broker filters, and says so."""
    with Client(broker.port, user=user) as client:
        client.connect()
        assert client.subscribe("closed/#") == [NOT_AUTHORIZED if broker.kind == SIMULATED else 1]


def test_a_stranger_hears_and_says_nothing(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user="stranger") as stranger:
        stranger.connect()
        stranger.subscribe("#")
        alice.publish("open/a", "x", retain=True)
        assert stranger.publish("open/a", "x") == NOT_AUTHORIZED
        assert stranger.hears_nothing()
    alice.publish("open/a", "", retain=True)


def test_a_client_without_a_name_has_the_rules_before_the_first_user(broker: RunningBroker, alice: Client) -> None:
    with Client(broker.port, user=None) as nameless:
        nameless.connect()
        nameless.subscribe("#")
        alice.publish("closed/a", "hidden")
        alice.publish("open/a", "seen")
        assert nameless.payloads() == ["seen"]
        assert nameless.publish("open/a", "x") == NOT_AUTHORIZED


def test_a_will_that_is_not_allowed_never_arrives(broker: RunningBroker, bob: Client) -> None:
    """The simulated broker refuses the client; Mosquitto takes it and drops the will."""
    bob.subscribe("closed/#")
    with Client(broker.port, user="writer") as writer:
        writer.will("closed/door", "forged")
        answer = writer.connect()
        assert answer == (ReasonCode(answer.packetType, "Not authorized") if broker.kind == SIMULATED else 0)
        if broker.kind == MOSQUITTO:
            writer.kill()
    assert bob.hears_nothing()


# Versions


def test_an_older_client_is_told_that_its_version_is_not_spoken(broker: RunningBroker, alice: Client) -> None:
    """Only by the simulated broker; Mosquitto speaks 3.1.1 too."""
    with Client(broker.port, protocol=MQTTProtocolVersion.MQTTv311) as old:
        answer = old.connect()
        assert answer == ("Unsupported protocol version" if broker.kind == SIMULATED else "Success")
    assert alice.publish("test/x", "others go on") in (0, 0x10)


# Restart


@on_a_broker_of_its_own
def test_clients_come_back_after_a_restart_of_the_broker(own_broker: RunningBroker) -> None:
    """Mosquitto has saved the retained messages; the simulated broker begins empty."""
    with Client(own_broker.port, "a") as alice, Client(own_broker.port, "b") as bob:
        alice.connect()
        bob.connect()
        assert alice.publish("obu/x/navigation/last_position", "here", retain=True) in (0, 0x10)
        own_broker.restart()
        alice.until(lambda: alice.farewell is not None)
        bob.until(lambda: bob.farewell is not None)
        alice.connect()
        bob.connect()
        bob.subscribe("obu/#")
        kept = ["here"] if own_broker.kind == MOSQUITTO else []
        assert bob.payloads(len(kept)) == kept
        alice.publish("obu/x/mode/state", "live")
        assert bob.payloads() == ["live"]


@on_a_broker_of_its_own
def test_a_session_outlives_a_restart_where_the_broker_saves_it(own_broker: RunningBroker) -> None:
    """Mosquitto saves one that was begun with clean start 0; the simulated broker's `session present` is honest."""
    with Client(own_broker.port, "a") as alice, Client(own_broker.port, "b") as bob:
        alice.connect()
        bob.connect(clean_start=False, SessionExpiryInterval=60)
        bob.subscribe("test/#")
        bob.kill()
        alice.publish("test/x", "while away")
        own_broker.restart()
        bob.connect(clean_start=False, SessionExpiryInterval=60)
        assert bob.session_present is (own_broker.kind == MOSQUITTO)
        if bob.session_present:
            assert bob.payloads() == ["while away"]
