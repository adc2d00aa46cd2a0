"""`obu replay` as a command: its broker, its player and its dashboard, over HTTP and WebSocket."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import connect

from shared.library.summary import SUFFIX
from tests.support.dashboard.frames import followed
from tests.support.dashboard.status_server import change, eventually
from tests.support.drives.meridian import BEGIN_NS, NORTH_M_S, SECOND, record
from tests.support.patience import HANGS_S

Json = dict[str, Any]
ROOT = Path(__file__).parents[2]
LENGTH_S = 600


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("replay")
    drive = record(folder / "drive.mcap", LENGTH_S)
    log = folder / "output.txt"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "cli", "replay", str(drive), "--port", "0"],
            cwd=ROOT, env={**os.environ, "OBU_STATE": str(folder)}, stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
    eventually(lambda: "replayed at" in log.read_text())
    yield log.read_text().split("replayed at ")[1].split()[0]
    process.send_signal(signal.SIGTERM)
    assert process.wait(HANGS_S) == 0
    assert not list((folder / "replays").iterdir()), "it leaves nothing behind"
    assert [path.name for path in (folder / "recordings").iterdir()] == [f"drive.mcap{SUFFIX}"], "but the summary"


def command(address: str, **fields: object) -> httpx.Response:
    return change(address, "/api/replay", fields)


def state(address: str) -> Json:
    found = httpx.get(f"{address}/api/state", timeout=HANGS_S).json()
    assert isinstance(found, dict)
    return found


def shown_s(address: str) -> float:
    """Give the recorded second of the solution that is shown, by its stamp and by its latitude."""
    solution = state(address)["solution"] or {"sampled_ns": BEGIN_NS - SECOND, "latitude_deg": 48.0}
    return float((solution["sampled_ns"] - BEGIN_NS) / SECOND)


def test_a_drive_is_shown_in_recorded_time_as_a_replay(address: str) -> None:
    command(address, command="pause")
    assert command(address, command="seek", position_s=100.0).status_code == 202
    eventually(lambda: shown_s(address) == pytest.approx(100.0, abs=0.11))
    shown = state(address)
    assert shown["origin"]["kind"] == "replay"
    assert abs(shown["now_ns"] - BEGIN_NS - 100 * SECOND) < SECOND // 10
    # From 100 s to 120 s the recorded verdict is unsafe; it is another message than the solution and may come after it.
    eventually(lambda: state(address)["banner"]["word"] == "UNSAFE")
    latitude_deg = 48.0 + 100.0 * NORTH_M_S / 111_194.9
    assert shown["solution"]["latitude_deg"] == pytest.approx(latitude_deg, abs=2e-5)


def test_after_a_jump_back_nothing_newer_and_the_minute_before_it_is_shown(address: str) -> None:
    command(address, command="pause")
    command(address, command="seek", position_s=500.0)
    eventually(lambda: shown_s(address) == pytest.approx(500.0, abs=0.11))
    command(address, command="seek", position_s=90.0)
    eventually(lambda: shown_s(address) == pytest.approx(90.0, abs=0.11))

    def past() -> list[float]:
        columns = httpx.get(f"{address}/api/history?seconds=60&fields=speed_fused_m_s", timeout=HANGS_S).json()
        return [(stamp - BEGIN_NS) / SECOND for stamp in columns["time_ns"]]

    eventually(lambda: past() and past()[0] < 32.0)
    assert 89.0 < past()[-1] < 90.2

    def events() -> dict[str, list[dict[str, str]]]:
        found: dict[str, list[dict[str, str]]] = httpx.get(f"{address}/api/replay", timeout=HANGS_S).json()["replay"]
        return found

    eventually(lambda: events()["trust"])  # the recording is read for them while it plays
    assert [change["state"] for change in events()["trust"][:3]] == ["safe", "unsafe", "safe"]
    assert [outage["what"] for outage in events()["outages"]] == ["sensors.imu"]


def test_recorded_time_passes_at_the_requested_speed_and_not_while_paused(address: str) -> None:
    command(address, command="seek", position_s=10.0)
    command(address, command="speed", speed=10.0)
    command(address, command="play")
    eventually(lambda: shown_s(address) > 15.0)
    before, at = shown_s(address), time.monotonic()
    eventually(lambda: shown_s(address) > before + 20.0)
    assert 20.0 / (time.monotonic() - at) == pytest.approx(10.0, rel=0.35)
    command(address, command="pause")
    time.sleep(0.5)
    held = state(address)["now_ns"]
    time.sleep(0.5)
    assert state(address)["now_ns"] == held
    command(address, command="speed", speed=1.0)


def test_at_least_16_of_20_seeks_in_two_seconds_are_shown(address: str) -> None:
    command(address, command="pause")
    shown: set[int] = set()
    with (
        connect(address.replace("http", "ws") + "/ws", max_size=None) as socket,
        httpx.Client(timeout=HANGS_S) as client,
    ):
        view = json.loads(socket.recv(timeout=HANGS_S))["state"]
        client.headers["X-OBU-CSRF"] = client.get(f"{address}/api/session").json()["csrf"]
        began = time.monotonic()
        for step in range(20):
            client.post(f"{address}/api/replay", json={"command": "seek", "position_s": 200.0 + 10.0 * step})
            until = began + (step + 1) * 0.1
            while (left := until - time.monotonic()) > 0:
                try:
                    frame = json.loads(socket.recv(timeout=left))
                except TimeoutError:
                    break
                view = followed(view, frame)
                solution = view["solution"]
                assert isinstance(solution, dict)
                shown.add(round((solution["sampled_ns"] - BEGIN_NS) / SECOND))
    reached = [200 + 10 * step for step in range(20) if {200 + 10 * step, 199 + 10 * step} & shown]
    assert len(reached) >= 16, f"only {reached} of 20 positions in two seconds"


def test_replay_commands_of_other_origins_and_invalid_ones_are_rejected(address: str) -> None:
    body = {"command": "pause"}
    foreign = change(address, "/api/replay", body, Origin="http://evil.example")
    assert foreign.status_code == 403
    assert command(address, command="fly").status_code == 422
    assert command(address, command="speed", speed=1e9).status_code == 422
    attack = change(address, "/api/simulation/attack", {"command": "stop"})
    assert attack.status_code == 409, "a recording of a simulation cannot be attacked"
