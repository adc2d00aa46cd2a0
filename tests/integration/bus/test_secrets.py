"""Each broker as on a vehicle: nobody speaks or listens without a secret, and each name has its rights alone."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from paho.mqtt.client import topic_matches_sub

from broker.keys import rows_of
from shared.bus.bus import Bus
from shared.errors import UserError
from shared.messages.navigation import LastPosition
from shared.messages.operation import ProcessState
from shared.runtime import credentials
from shared.runtime.config import BrokerAddress, parse_vehicle
from shared.topics import TOPICS, readable, subscriptions
from tests.support.bus import brokers
from tests.support.bus.mqtt import Client
from tests.support.patience import HANGS_S

VEHICLE = parse_vehicle('[vehicle]\nname = "car"\n\n[sensors.gnss]\n\n[sensors.imu]\n')
NAMES = tuple(row.name for row in rows_of(VEHICLE))
SOLUTION = "obu/car/navigation/solution"


@pytest.fixture(scope="module", params=brokers.KINDS)
def broker(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[brokers.RunningBroker]:
    folder = tmp_path_factory.mktemp("unit")
    running = brokers.start_closed(request.param, folder, VEHICLE)
    running.folder = folder  # type: ignore[attr-defined]  # of its secrets
    yield running
    running.stop()


def folder_of(broker: brokers.RunningBroker) -> Path:
    found: Path = broker.folder  # type: ignore[attr-defined]
    return found


def secret(broker: brokers.RunningBroker, name: str) -> str:
    return (folder_of(broker) / "credentials" / name).read_text().strip()


def client(broker: brokers.RunningBroker, name: str) -> Client:
    return Client(broker.port, user=name, password=secret(broker, name))


def bus(broker: brokers.RunningBroker, process: str, *, observer: bool = False) -> Bus:
    topics = TOPICS if observer else subscriptions(process)
    return Bus(process, "car", BrokerAddress("127.0.0.1", broker.port), topics, folder_of(broker), observer=observer)


def wait_for(condition: Callable[[], bool], *buses: Bus) -> None:
    deadline = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < deadline, [each.last_error for each in buses]
        for each in buses:
            each.receive(0.02)


@pytest.mark.parametrize("password", [None, "", "wrong", "0" * 64])
def test_no_process_connects_without_its_secret(broker: brokers.RunningBroker, password: str | None) -> None:
    for name in (
        *NAMES,
        *credentials.OBSERVERS,
        credentials.WATCH,
        credentials.CHECK,
        "",
        "root",
        "observer",
        "sensors.simulator",
    ):
        with Client(broker.port, name, user=name, password=password) as intruder:
            assert intruder.connect().is_failure, name
    with Client(broker.port, "nobody", user=None) as intruder:
        assert intruder.connect().is_failure


def test_a_secret_is_of_one_name_alone(broker: brokers.RunningBroker) -> None:
    for name in NAMES:
        with Client(broker.port, user=name, password=secret(broker, "observer.8")) as intruder:
            assert intruder.connect().is_failure, name


def test_every_process_connects_with_its_secret_and_finds_it_itself(broker: brokers.RunningBroker) -> None:
    for name in NAMES:
        process = bus(broker, name)
        wait_for(lambda process=process: process.connected, process)  # type: ignore[misc]
        process.receive(0.1)
        assert process.last_error is None and not process.rejects
        process.close()


def test_nobody_takes_over_the_session_of_another(broker: brokers.RunningBroker) -> None:
    with client(broker, "core.fusion") as fusion, client(broker, "parsers.imu") as parser:
        fusion.connect()
        parser.paho._client_id = b"core.fusion"  # what it calls itself
        assert not parser.connect().is_failure
        fusion.spin(0.2)
        assert not fusion.ended, "the broker takes the user for the identifier"


def test_rights_are_those_of_the_two_tables_and_of_this_vehicle_alone(broker: brokers.RunningBroker) -> None:
    users = [*NAMES, "observer.1"]
    with ExitStack() as stack:
        clients = {name: stack.enter_context(client(broker, name)) for name in users}
        for each in clients.values():
            each.connect()
            each.subscribe("#", "obu/other/#", *(f"obu/car/{topic.name}" for topic in TOPICS))
        for name, each in clients.items():
            for topic in TOPICS:
                for vehicle in ("car", "other"):
                    each.publish(f"obu/{vehicle}/{topic.name.replace('+', name)}", name)
        for name, each in clients.items():
            patterns = [topic.name for topic in readable(name)]
            wanted = [
                topic for topic in TOPICS
                if name == "observer.1" or any(topic_matches_sub(pattern, topic.name) for pattern in patterns)
            ]  # fmt: skip
            allowed = {
                (f"obu/car/{topic.name.replace('+', sender)}", sender)
                for topic in wanted
                for sender in topic.producers
                if sender in NAMES
            }
            with suppress(AssertionError):  # what is missing is named below
                each.until(lambda wanted=allowed, each=each: wanted <= heard(each, users))  # type: ignore[misc]
            each.spin(0.1)
            assert heard(each, users) == allowed, name


def heard(listener: Client, users: Sequence[str]) -> set[tuple[str, str]]:
    """Topics and users of what has arrived."""
    return {(m.topic, m.payload.decode()) for m in listener.messages if m.payload.decode() in users}


def test_an_observer_writes_nothing(broker: brokers.RunningBroker) -> None:
    with client(broker, "observer.2") as writer, client(broker, "observer.3") as listener:
        writer.connect()
        listener.connect()
        listener.subscribe("obu/car/#")
        listener.spin(0.2)
        listener.messages.clear()
        for topic in TOPICS:
            writer.publish(f"obu/car/{topic.name.replace('+', 'core.fusion')}", "forged", retain=True)
        assert listener.receives_nothing()


def test_eight_programs_listen_and_the_ninth_is_told_what_to_do(broker: brokers.RunningBroker) -> None:
    listeners = [bus(broker, "observer", observer=True) for _ in credentials.OBSERVERS]
    with pytest.raises(UserError, match="obu keys add"):
        bus(broker, "observer", observer=True)
    wait_for(lambda: all(listener.connected for listener in listeners), *listeners)
    for listener in listeners:
        listener.receive(0.05)
    assert all(listener.connected for listener in listeners), "none evicts another"
    listeners[3].close()
    again = bus(broker, "observer", observer=True)
    wait_for(lambda: again.connected, again)
    for listener in (*listeners, again):
        listener.close()


def test_refused_connections_are_counted_and_named(broker: brokers.RunningBroker) -> None:
    health = bus(broker, "monitoring.health")
    health.hear_broker()
    wait_for(lambda: health.connected, health)
    health.receive(0.2)
    for _ in range(3):
        with Client(broker.port, "core.fusion", user="core.fusion", password="guess") as intruder:
            assert intruder.connect().is_failure
    wait_for(lambda: health.refusals == 3, health)
    assert len(health.refused) == 3
    health.close()


def test_a_message_whose_sender_may_not_write_its_topic_is_dropped_and_counted(broker: brokers.RunningBroker) -> None:
    controller = bus(broker, "controller.mode")
    wait_for(lambda: controller.connected, controller)
    controller.receive(0.2)
    with client(broker, "core.fusion") as fusion:
        fusion.connect()
        forged = LastPosition(
            sampled_ns=1, utc_ns=None, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0, yaw_rad=1.0,
            position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.1,
        ).model_dump(mode="json")  # fmt: skip
        body = {"sender": {"process": "core.trust", "incarnation": 1, "sequence": 1}} | forged
        fusion.publish(SOLUTION, json.dumps(body))
        wait_for(lambda: controller.rejects["sender"] == 1, controller)
    assert "core.trust" in str(controller.last_error)
    assert controller.health(ProcessState.READY).rejects == {"sender": 1}
    controller.close()
