"""The broker after a power cut: a store that Mosquitto cannot read is set aside, and it starts."""

import time
from collections.abc import Callable
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from tests.support.bus import mosquitto

pytestmark = pytest.mark.broker
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "null bytes": lambda data: bytes(len(data)),
    "noise": lambda data: bytes(k * 89 + 7 & 0xFF for k in range(len(data))),
    "cut off": lambda data: data[: len(data) - 20],
    "half": lambda data: data[: len(data) // 2],
    "overwritten": lambda data: data[:60] + bytes(k * 89 + 7 & 0xFF for k in range(40)) + data[100:],
}


def retained(port: int) -> list[str]:
    """Topics of the retained messages."""
    found: list[str] = []
    client = mqtt.Client(CallbackAPIVersion.VERSION2, "observer.1")
    client.username_pw_set("observer.1")
    client.on_connect = lambda c, *_: c.subscribe("obu/car/#")
    client.on_message = lambda _c, _u, message: found.append(message.topic)
    client.connect("127.0.0.1", port)
    deadline = time.monotonic() + 0.5
    while time.monotonic() < deadline:
        client.loop(0.05)
    client.disconnect()
    return found


def retain(port: int) -> None:
    client = mqtt.Client(CallbackAPIVersion.VERSION2, "controller.mode")
    client.username_pw_set("controller.mode")
    client.connect("127.0.0.1", port)
    client.loop_start()
    client.publish("obu/car/mode/state", b"{}", qos=1, retain=True).wait_for_publish(3.0)
    client.loop_stop()
    client.disconnect()


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_store_that_cannot_be_read_is_set_aside_and_the_broker_starts(tmp_path: Path, damage: str) -> None:
    broker = mosquitto.start(tmp_path)
    store = tmp_path / "broker" / "mosquitto.db"
    try:
        retain(broker.port)
        assert retained(broker.port) == ["obu/car/mode/state"]
        broker.restart()
        assert retained(broker.port) == ["obu/car/mode/state"], "a good store is read"
        broker.stop()
        store.write_bytes(damaged := DAMAGE[damage](store.read_bytes()))
        assert broker.try_start(), "at once"
        assert retained(broker.port) == []
        assert (tmp_path / "broker" / "mosquitto.db.unreadable").read_bytes() == damaged
        assert "set aside as" in (tmp_path / "mosquitto.log").read_text()
        retain(broker.port)
        broker.restart()
        assert retained(broker.port) == ["obu/car/mode/state"], "and the new one is kept"
    finally:
        broker.stop()


def test_a_good_store_stays_over_many_starts(tmp_path: Path) -> None:
    broker = mosquitto.start(tmp_path)
    try:
        retain(broker.port)
        for _ in range(3):
            broker.restart()
            assert retained(broker.port) == ["obu/car/mode/state"]
    finally:
        broker.stop()
    assert not (tmp_path / "broker" / "mosquitto.db.unreadable").exists()


def test_a_broker_that_is_killed_before_its_first_save_keeps_its_store(tmp_path: Path) -> None:
    broker = mosquitto.start(tmp_path)
    try:
        retain(broker.port)
        broker.restart()
        for _ in range(3):  # as when it runs out of memory, or the power fails, soon after each start
            broker.kill()
            assert broker.try_start()
            assert retained(broker.port) == ["obu/car/mode/state"]
    finally:
        broker.stop()
    assert not (tmp_path / "broker" / "mosquitto.db.unreadable").exists()
