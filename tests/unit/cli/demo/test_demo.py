"""What the demo prints before it starts any process."""

import json
import logging
import socket
from pathlib import Path

import pytest

from cli.demo import demo
from cli.demo.demo import DemoOptions
from cli.demo.local import free_port, port_or_free
from shared.errors import UserError
from shared.processes import Role, running

# What a demo starts: the standing processes, the simulator, and the broker.
EXPECTED = len(running(Role.OBU, ["sensors.simulator"])) + 1


def options(scenario: str = "urban", port: int = 0) -> DemoOptions:
    return DemoOptions(scenario, seed=1, duration_s=1.0, json_output=True, http_port=port, broker="simulated")


def test_an_unknown_scenario_is_reported_before_any_process_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    with pytest.raises(UserError, match=r"unknown scenario 'moon'; try one of parking_lot, urban, .*degraded"):
        demo.run(options("moon"))
    assert list(tmp_path.iterdir()) == []


def test_a_free_port_is_used_without_a_message() -> None:
    port = free_port()
    assert port_or_free(port) == (port, None)


def test_a_port_in_use_is_reported_with_the_port_used_instead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setattr(demo, "_watch", lambda *_: None)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        demo.run(options(port=taken))
    out, err = capfd.readouterr()
    vehicle = (tmp_path / "demo" / "vehicle.toml").read_text()
    used = int(vehicle.partition("port = ")[2].split()[0])
    assert used != taken
    assert f"port {taken} is in use: the dashboard uses {used}; to choose one: `obu demo --port NUMBER`" in err
    assert json.loads(out)["healthy"] is False, "standard output is the balance alone"
    assert f"not healthy: 0 of {EXPECTED} processes were alive at the end: see the logs" in err


def test_the_last_line_states_where_the_recording_is_kept_until_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        (tmp_path / "demo" / "recordings").mkdir()
        (tmp_path / "demo" / "recordings" / "drive.mcap").touch()
        raise KeyboardInterrupt

    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.setattr(demo, "_watch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        demo.run(options())
    printed = " ".join(capfd.readouterr().err.split())
    assert f"recorded: {tmp_path}/demo/recordings/drive.mcap (copy it: the next demo removes it)" in printed
    assert logging.getLogger("shared").isEnabledFor(logging.WARNING), "the log level is restored"
