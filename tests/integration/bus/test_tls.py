"""Mosquitto with a second listener for other machines, which speaks TLS by the unit's own authority."""

import datetime
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from broker import keys, local_config, tls
from broker.keys import KeyFileOwners
from cli.demo.local import free_port
from shared.bus.bus import Bus
from shared.errors import UserError
from shared.messages.navigation import LastPosition
from shared.runtime.config import BrokerAddress, parse_vehicle
from shared.topics import TOPICS, subscriptions
from tests.support.bus import mosquitto
from tests.support.patience import HANGS_S

pytestmark = pytest.mark.broker

CAR = parse_vehicle('[vehicle]\nname = "car"\n')
NOW = datetime.datetime.now(datetime.UTC)
POSITION = LastPosition(
    sampled_ns=1, utc_ns=None, latitude_deg=48.0, longitude_deg=11.0, height_ellipsoid_m=500.0, yaw_rad=1.0,
    position_sd_ned_m=(1.0, 1.0, 2.0), yaw_sd_rad=0.1,
)  # fmt: skip


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    rules = tmp_path / "rules"
    _, rights = keys.make(tmp_path / "credentials", CAR, KeyFileOwners("", str(rules)))
    tls.make(rules / "tls", tmp_path / "credentials", ["127.0.0.1", "localhost"], NOW)
    monkeypatch.setattr(local_config, "TLS_PORT", free_port())
    plain = local_config.configuration
    monkeypatch.setattr(
        local_config, "configuration", lambda port, store, rules, socket: plain(port, store, rules, "127.0.0.1", socket)
    )
    running = mosquitto.start_closed(tmp_path, rights)
    yield local_config.TLS_PORT
    running.stop()


def wait_for(condition: Callable[[], bool], *buses: Bus) -> None:
    deadline = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < deadline, [bus.last_error for bus in buses]
        for bus in buses:
            bus.receive(0.05)


# paho leaves the socket of a handshake that failed to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_messages_come_by_tls_and_only_with_secret_and_authority(port: int, tmp_path: Path) -> None:
    trusted = BrokerAddress("127.0.0.1", port, tls=True, authority=str(tmp_path / "rules" / "tls" / "ca.pem"))
    controller = Bus("controller.mode", "car", trusted, subscriptions("controller.mode"), tmp_path)
    observer = Bus("observer", "car", trusted, TOPICS, tmp_path, observer=True)
    wait_for(lambda: controller.connected and observer.connected, controller, observer)
    arrived: list[str] = []

    def all_came() -> bool:
        arrived.extend(e.topic for e in observer.receive(0.0))
        return arrived.count("navigation/last_position") >= 200

    observer.receive(0.2)
    for _ in range(200):  # several in one TLS record
        controller.publish(POSITION)
    wait_for(all_came, controller)
    controller.close()
    observer.close()

    stranger = Bus("core.fusion", "car", replace(trusted, username="core.fusion", password="guess"), (), tmp_path)
    wait_for(lambda: "refuses" in str(stranger.last_error), stranger)
    unknown = Bus("core.fusion", "car", replace(trusted, authority=None), (), tmp_path)
    wait_for(lambda: "its certificate is not accepted: " in str(unknown.last_error), unknown)
    elsewhere = Bus("core.fusion", "car", replace(trusted, host="127.0.0.2"), (), tmp_path)
    elsewhere.receive(0.5)
    assert not elsewhere.connected
    for bus in (stranger, unknown, elsewhere):
        bus.close()
    with pytest.raises(UserError, match="OBU_BROKER_CA"):
        Bus("core.fusion", "car", replace(trusted, authority=str(tmp_path / "none")), (), tmp_path)


def test_the_authority_stays_and_its_key_is_with_the_secrets(tmp_path: Path) -> None:
    folder, secret = tmp_path / "tls", tmp_path / "credentials"
    secret.mkdir()
    first = tls.make(folder, secret, ["car.local"], NOW).read_bytes()
    server = (folder / tls.CERTIFICATE).read_bytes()
    assert tls.make(folder, secret, ["car.local", "192.168.1.7"], NOW).read_bytes() == first
    assert (folder / tls.CERTIFICATE).read_bytes() != server
    assert not list(folder.glob("ca.key"))
    later = NOW + datetime.timedelta(days=tls.AUTHORITY_DAYS + 1)
    assert tls.make(folder, secret, ["car.local"], later).read_bytes() != first, "it has expired"


@pytest.mark.parametrize("name", ["", "a b", "-x", "http://car", "x" * 300, "car\n"])
def test_what_is_no_name_of_a_host_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no name of a host"):
        tls.make(tmp_path, tmp_path, [name], NOW)
