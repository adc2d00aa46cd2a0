"""A watch session with the real process of the unit: it is asked, answers, says so in the vehicle, and it ends."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection

from fleet.web.watch import gate
from tests.support.dashboard.frames import followed
from tests.support.fleet.certificates import Authority
from tests.support.fleet.reports import Unit
from tests.support.fleet.small_centre import Broker
from tests.support.fleet.uplink_process import UplinkProcess
from tests.support.fleet.watched_page import stream
from tests.support.fleet.web import RunningWeb, tenant, web

NS = 1_000_000_000


class Page:
    """What an open page shows."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self.state = socket, dict[str, Any]()

    def look(self) -> dict[str, Any]:
        """Take what has come."""
        while True:
            try:
                self.state = followed(self.state, json.loads(self._socket.recv(timeout=0.0)))
            except TimeoutError:
                return self.state

    @property
    def is_live(self) -> bool:
        state = self.look()
        return bool(state) and not state["watch"]["silent"] and state["banner"]["state"] == "safe"

    @property
    def age_s(self) -> float:
        heard_ns = self.look()["watch"]["heard_ns"]
        return (time.time_ns() - int(heard_ns)) / NS


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[tuple[Broker, Authority]]:
    authority = Authority()
    broker = Broker(tmp_path / "centre", authority)
    yield broker, authority
    broker.stop()


@pytest.fixture
def unit(tmp_path: Path, broker: tuple[Broker, Authority]) -> Iterator[UplinkProcess]:
    made = UplinkProcess(tmp_path, broker[0].port, broker[1])
    yield made
    made.close()
    assert made.ended_with == 0


@pytest.fixture
def pages(dsn: str, broker: tuple[Broker, Authority], unit: UplinkProcess) -> Iterator[RunningWeb]:
    tenant(dsn)
    vehicle = Unit("car")
    vehicle.signer = unit.key
    vehicle.enter(dsn)
    with web(dsn, f"nats://127.0.0.1:{broker[0].inner_port}") as running:
        yield running


@pytest.mark.slow
def test_a_vehicle_is_watched_shows_it_and_is_left_alone_again(
    pages: RunningWeb, unit: UplinkProcess, broker: tuple[Broker, Authority], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "LINGER_S", 1.0)
    monkeypatch.setattr(gate, "REPEAT_S", 1.0)
    unit.drive_until(lambda: bool(unit.states) and unit.states[-1].connected and unit.states[-1].receipted > 0)
    otto = pages.visitor("otto")
    assert unit.states[-1].watchers == 0

    with stream(pages, otto, "car") as socket, stream(pages, otto, "car"):
        page = Page(socket)
        unit.drive_until(lambda: page.is_live and unit.states[-1].watchers == 2)
        assert 0.0 <= page.age_s < 1.0
        assert page.state["solution"]["latitude_deg"] == pytest.approx(48.1, abs=0.1)
        unit.drive_until(lambda: page.look()["uplink"]["watchers"] == 2)
    unit.drive_until(lambda: unit.states[-1].watchers == 0)

    with stream(pages, otto, "car") as socket:
        page = Page(socket)
        unit.drive_until(lambda: page.is_live and unit.states[-1].watchers == 1)
        broker[0].stop()
        cut_s = time.monotonic()
        unit.drive_until(lambda: unit.states[-1].watchers == 0)
        assert time.monotonic() - cut_s < gate.FOR_S / 2, "by the lost connection, and not by the end of its time"
        assert not unit.states[-1].connected
        unit.drive_until(lambda: bool(page.look()["watch"]["silent"]))
        assert page.state["banner"]["state"] == "disconnected"
        broker[0].start()
        unit.drive_until(lambda: page.is_live and unit.states[-1].watchers == 1)
