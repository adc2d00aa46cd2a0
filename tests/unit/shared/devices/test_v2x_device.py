"""The MQTT radio; that of UDP is tested with its driver."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from shared.devices.device import DeviceBusy, DeviceLost
from shared.devices.v2x_device import Radio, open_radio
from shared.messages.v2x import MAX_FRAME_BYTES, Encapsulation
from shared.v2x import cam, geonetworking
from tests.support.bus import brokers
from tests.support.patience import HANGS_S
from tests.support.v2x import cams

OPEN_TO_ALL = "topic readwrite #\n"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[brokers.RunningBroker]:
    running = brokers.start(brokers.SIMULATED, tmp_path, OPEN_TO_ALL)
    yield running
    running.stop()


@pytest.fixture
def port(broker: brokers.RunningBroker) -> int:
    return broker.port


@pytest.fixture
def far(port: int) -> Iterator[mqtt.Client]:
    """Client in place of the modem at the broker; it stores what was published for it."""
    client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv311, userdata=[])
    client.on_connect = lambda c, *_: c.subscribe("plaza/send")
    client.on_message = lambda _c, kept, message: kept.append(message.payload)
    client.connect("127.0.0.1", port)
    client.loop_start()
    yield client
    client.loop_stop()
    client.disconnect()


def read_until(radio: Radio, enough: Callable[[list[tuple[int, bytes]]], bool]) -> list[tuple[int, bytes]]:
    found: list[tuple[int, bytes]] = []
    deadline = time.monotonic() + HANGS_S
    while not enough(found):
        assert time.monotonic() < deadline, f"only {len(found)} frames arrived"
        found += radio.read(100)
        time.sleep(0.005)
    return found


def connected(port: int, far: mqtt.Client, rejects: Counter[str]) -> Radio:
    """Open a radio and wait until its subscription is there."""
    radio = open_radio(f"mqtt://127.0.0.1:{port}/plaza", None, rejects)
    deadline = time.monotonic() + HANGS_S
    while not radio.read(100):
        assert time.monotonic() < deadline, "the radio did not subscribe"
        far.publish("plaza/received", b"first")
        time.sleep(0.02)
    time.sleep(0.2)
    radio.read(100)
    return radio


def test_bare_cams_arrive_with_their_ages_and_frames_that_are_too_long_are_counted(port: int, far: mqtt.Client) -> None:
    rejects: Counter[str] = Counter()
    radio = connected(port, far, rejects)
    for payload in (b"cam 1", b"", bytes(MAX_FRAME_BYTES + 1), b"cam 2"):
        far.publish("plaza/received", payload)
    found = read_until(radio, lambda arrived: len(arrived) >= 2)
    assert [data for _, data in found] == [b"cam 1", b"cam 2"]
    assert all(0 <= age_ns < 5e9 for age_ns, _ in found)
    assert rejects == Counter({"frame_length": 2})
    assert radio.encapsulation is Encapsulation.NONE
    radio.close()


def test_rejected_frames_do_not_block_a_read(port: int, far: mqtt.Client) -> None:
    rejects: Counter[str] = Counter()
    radio = connected(port, far, rejects)
    for _ in range(50):
        far.publish("plaza/received", b"")
    time.sleep(0.3)
    assert radio.read(10) == []
    assert rejects["frame_length"] <= 10
    radio.close()


def test_a_packet_is_sent_as_bare_cam(port: int, far: mqtt.Client) -> None:
    radio = connected(port, far, Counter())
    payload = cam.encode(cams.BRAKING, 1)
    radio.write(geonetworking.encode_packet(payload, cams.SENDER))
    kept: list[bytes] = far.user_data_get()
    deadline = time.monotonic() + HANGS_S
    while not kept:
        assert time.monotonic() < deadline
        radio.read(1)
        time.sleep(0.01)
    assert kept == [payload]
    with pytest.raises(DeviceBusy):
        radio.write(b"no packet")
    radio.close()


def test_a_lost_or_absent_broker_raises_device_lost(broker: brokers.RunningBroker, far: mqtt.Client) -> None:
    radio = connected(broker.port, far, Counter())
    far.loop_stop()
    far.disconnect()
    broker.stop()
    with pytest.raises(DeviceLost, match="check the broker"):
        deadline = time.monotonic() + HANGS_S
        while time.monotonic() < deadline:
            radio.read(1)
            time.sleep(0.02)
    with pytest.raises(DeviceLost, match="cannot open"):
        open_radio(f"mqtt://127.0.0.1:{broker.port}/plaza", None, Counter())
