"""The receiver's port is changed on the page's way, and taken back where nothing comes from the new one."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import httpx
import pytest

from cli.demo.local import free_port
from cli.demo.supervisor import Supervisor
from shared.runtime.overlay import FILE, settings_folder
from tests.integration.test_devices import Port
from tests.support.bus import brokers
from tests.support.dashboard.status_server import change
from tests.support.patience import HANGS_S

PROCESSES = ("sensors.gnss", "parsers.gnss", "controller.settings", "monitoring.health", "monitoring.status")
Json = dict[str, object]


class Vehicle:
    """Five processes of a vehicle, as `obu up` supervises them, and its page."""

    def __init__(self, folder: Path, broker: int, receiver: Path) -> None:
        self.state, self.file, self.port = folder / "state", folder / "vehicle.toml", free_port()
        self.state.mkdir()
        self.file.write_text(
            '[vehicle]\nname = "car"\n\n'
            f'[sensors.gnss]\n# The receiver on the roof.\ndevice = "serial://{receiver}?baud=9600"\n\n'
            "[controller.settings]\nwatch_s = 20\nsettle_s = 5\n\n"
            f"[monitoring.status]\nport = {self.port}\nlogin_on_loopback = false\n"
        )
        self._environment = {
            "OBU_VEHICLE": str(self.file), "OBU_STATE": str(self.state), "OBU_BROKER": f"mqtt://127.0.0.1:{broker}",
            "PATH": "/usr/bin:/bin", "NUMBA_DISABLE_JIT": "1",
        }  # fmt: skip
        self.supervisor = Supervisor(self._environment, folder)
        for name in PROCESSES:
            self.supervisor.add_process(name)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def report(self) -> Json:
        try:
            return cast(Json, httpx.get(f"{self.address}/api/settings", timeout=5.0).json())
        except httpx.HTTPError:
            return {}

    def of_report(self, name: str) -> object:
        """A part of the report, once the page answers: a change of settings starts it again."""
        found: list[Json] = []

        def is_there() -> bool:
            found.append(self.report())
            return name in found[-1]

        self.until(is_there)
        return found[-1][name]

    def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + HANGS_S
        while not condition():
            assert time.monotonic() < deadline, "it did not happen"
            self.supervisor.watch()
            time.sleep(0.1)

    def ask(self, **command: object) -> str:
        """Hand a command to the page, once it answers: a change of settings starts it again."""
        answers: list[httpx.Response] = []
        self.until(lambda: self._is_answered(lambda: change(self.address, "/api/settings", command), answers))
        assert answers[-1].status_code == 202, answers[-1].text
        return str(answers[-1].json()["request_id"])

    @staticmethod
    def _is_answered(request: Callable[[], httpx.Response], answers: list[httpx.Response]) -> bool:
        try:
            answers.append(request())
        except httpx.ConnectError:
            return False
        return True

    def stage(self, request: str) -> object:
        """How far a command has come, by its answer or as the newest change."""
        found = self.report()
        state = cast("Json | None", found.get("state")) or {}
        newest = (cast("Json | None", found.get("answer")), cast("Json | None", state.get("change")))
        return next((one["stage"] for one in newest if one and one["request_id"] == request), None)

    def value(self, name: str) -> object:
        rows = cast("list[Json]", self.report().get("settings", []))
        return next((row["value"] for row in rows if row["name"] == name), None)

    def device(self) -> object:
        return self.value("sensors.gnss.device")

    def is_received(self) -> bool:
        """Whether bytes of the receiver come, by the deadlines of the unit."""
        answers: list[httpx.Response] = []
        if not self._is_answered(lambda: httpx.get(f"{self.address}/api/topics/gnss/raw", timeout=HANGS_S), answers):
            return False
        return answers[-1].status_code == 200 and answers[-1].json()["freshness"] == "fresh"


@contextmanager
def receiver(folder: Path) -> Iterator[Port]:
    folder.mkdir()
    port = Port(folder)
    try:
        yield port
    finally:
        port.close()


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Vehicle]:
    broker = brokers.start(brokers.SIMULATED, tmp_path)
    with receiver(tmp_path / "first") as first:
        made = Vehicle(tmp_path, broker.port, first.path)
        try:
            made.until(lambda: made.report().get("settings"))
            made.until(made.is_received)
            yield made
        finally:
            made.supervisor.stop()
            broker.stop()


def test_the_receivers_port_is_changed_watched_kept_or_taken_back(vehicle: Vehicle, tmp_path: Path) -> None:
    unit = vehicle
    before, text = unit.device(), unit.file.read_text()
    lives = unit.supervisor.children["parsers.gnss"].restarts
    with receiver(tmp_path / "second") as second:
        value = f'"serial://{second.path}?baud=9600"'
        checked = unit.ask(action="check", changes={"sensors.gnss.device": value})
        unit.until(lambda: unit.stage(checked) == "checked")
        answer = cast(Json, unit.of_report("answer"))
        assert answer["differences"] == [{"name": "sensors.gnss.device", "before": before, "after": value}]
        assert answer["touched"] == ["sensors.gnss", "monitoring.status"] and unit.device() == before, (
            "nothing is changed yet"
        )

        applied = unit.ask(action="apply", changes={"sensors.gnss.device": value})
        unit.until(lambda: unit.stage(applied) == "watched")
        unit.until(lambda: unit.device() == value)
        busy = unit.ask(action="apply", changes={"sensors.gnss.device": '"serial:///dev/null"'})
        unit.until(lambda: unit.stage(busy) == "refused")
        unit.until(lambda: unit.stage(applied) == "kept")
        unit.until(unit.is_received)
        assert unit.supervisor.children["parsers.gnss"].restarts == lives
        assert unit.file.read_text() == text, "the vehicle's file is never written"
        held = settings_folder(unit.state) / FILE
        assert "# The receiver on the roof." in held.read_text() and str(second.path) in held.read_text()

        wrong = unit.ask(action="apply", changes={"sensors.gnss.device": f'"serial://{tmp_path}/nothing"'})
        unit.until(lambda: unit.stage(wrong) == "taken_back")
        assert "gnss/raw" in str(unit.of_report("reasons")) and "is silent" in str(unit.of_report("reasons"))
        unit.until(lambda: unit.device() == value)
        unit.until(unit.is_received)
        versions = cast("list[Json]", cast(Json, unit.of_report("state"))["versions"])
        assert len(versions) == 3 and all(one["differing"] for one in versions[:1]), "what was wrong is kept too"


@pytest.mark.slow
def test_a_change_is_watched_on_after_the_process_was_killed_and_a_hand_edit_holds(vehicle: Vehicle) -> None:
    unit = vehicle
    port = free_port()
    applied = unit.ask(action="apply", changes={"monitoring.status.port": str(port)})
    old, unit.port = unit.port, port
    unit.until(lambda: unit.stage(applied) == "watched")
    change_of = cast(Json, cast(Json, unit.of_report("state"))["change"])
    assert change_of["confirmation"] is True, "it decides who reaches the page"
    killed = unit.supervisor.children["controller.settings"].process
    assert killed is not None
    killed.kill()
    unit.until(lambda: unit.supervisor.children["controller.settings"].restarts)
    unit.port = old
    unit.until(lambda: unit.stage(applied) == "taken_back")
    assert "unless it is confirmed" in str(unit.of_report("reasons"))

    unit.file.write_text(unit.file.read_text().replace("[monitoring.status]", "[monitoring.status]\nhistory_s = 60.0"))
    unit.until(lambda: unit.value("monitoring.status.history_s") == "60.0")
    assert "edited by hand" in str(unit.of_report("problem"))
