"""The whole unit on this machine, as `make demo` starts it; `test_watchdog.py` kills and stops its parts."""

import json
import math
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
import pytest
from playwright.sync_api import Page, expect

from cli.demo.local import free_port
from shared.messages.base import Message, RawBytes
from shared.messages.navigation import NavigationSolution
from shared.processes import Role, running
from shared.recording import Recording
from shared.runtime.config import load_vehicle
from shared.runtime.live import arrival_ns
from shared.runtime.offline import OfflineUnit
from tests.support.dashboard.chromium import chromium
from tests.support.dashboard.status_server import change
from tests.support.drives.golden import record_golden_drive
from tests.support.patience import HANGS_S

pytestmark = [pytest.mark.whole_unit, pytest.mark.broker]

# What a demo starts: the standing processes, the simulator, and the broker.
EXPECTED = len(running(Role.OBU, ["sensors.simulator"])) + 1

KINDS = ("mosquitto", "simulated")
SIMULATED = set(load_vehicle(Path(__file__).parents[2] / "deploy" / "vehicles" / "simulated.toml").processes)


@dataclass
class Demo:
    """A running demo, its dashboard's port and its folder."""

    process: subprocess.Popen[str]
    port: int
    folder: Path

    def get(self, path: str) -> dict[str, object]:
        """Request from the API; an empty answer while it is not reachable."""
        try:
            return dict(httpx.get(f"http://127.0.0.1:{self.port}{path}", timeout=HANGS_S).json())
        except (httpx.HTTPError, json.JSONDecodeError):
            return {}

    def child(self, mark: str) -> psutil.Process:
        """Find a process of this demo by its command line."""
        for process in psutil.Process(self.process.pid).children(recursive=True):
            if mark in " ".join(process.cmdline()):
                return process
        raise AssertionError(f"no child with {mark!r}")

    def wait(self, condition: Callable[[], bool], what: str) -> float:
        """Wait for a condition; return the seconds that it took."""
        started = time.monotonic()
        while not condition():
            assert time.monotonic() - started < HANGS_S, f"not within {HANGS_S} s: {what}"
            time.sleep(0.1)
        return time.monotonic() - started

    def statuses(self) -> dict[str, str]:
        """Give the state of each process as the API shows it."""
        processes = self.get("/api/health").get("processes", {})
        assert isinstance(processes, dict)
        return {name: str(entry["status"]) for name, entry in processes.items()}

    def all_ready(self) -> bool:
        found = self.statuses()
        return set(found) == SIMULATED and set(found.values()) == {"ready"}

    def solutions(self) -> int:
        """Count the solutions that the page has received."""
        entry = self.get("/api/topics/navigation/solution")
        return int(str(entry.get("count", 0)))


def start_demo(folder: Path, *arguments: str) -> Demo:
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "cli", "demo", "--port", str(port), *arguments],
        env=os.environ | {"OBU_STATE": str(folder)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    return Demo(process, port, folder / "demo")


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demo]:
    running = start_demo(tmp_path, "--broker", "mosquitto")
    running.wait(running.all_ready, "every process is ready")
    yield running
    running.process.terminate()
    running.process.communicate(timeout=HANGS_S)


@pytest.mark.browser
def test_a_drive_is_replayed_and_solved_from_the_page(demo: Demo) -> None:
    broken = demo.folder / "recordings" / "20200101T000000Z_broken.mcap"
    broken.write_bytes(b"this is no recording")
    half_a_minute = record_golden_drive(demo.folder / "recordings" / "20200102T000000Z_demo.mcap")
    address = f"http://127.0.0.1:{demo.port}"
    with chromium() as browser:
        page = browser.new_page()
        page.goto(f"{address}/#/recordings")
        ours = page.locator(".recording", has_text="being recorded")
        short = page.locator(".recording", has=page.get_by_role("button", name=f"Delete {half_a_minute.name}"))
        short.get_by_role("button", name="Replay").click()
        opens = page.get_by_role("link", name="Open the replay")
        expect(opens).to_be_visible(timeout=1000 * HANGS_S)
        expect(ours.get_by_role("button", name="Reprocess")).to_be_disabled()
        second = change(address, "/api/recordings", {"action": "solve", "name": broken.name})
        assert (second.status_code, second.json()["detail"]) == (409, "another job runs; stop it first")
        with page.expect_popup() as popup:
            opens.click()
        replay_and_scrub(popup.value)
        page.get_by_role("button", name="Stop").click()
        job = page.locator(".job")
        expect(job).to_contain_text("has ended")
        short.get_by_role("button", name="Reprocess").click()
        expect(job).to_contain_text("runs")
        report = short.get_by_role("link", name="Report")
        expect(report).to_be_visible(timeout=1000 * HANGS_S)
        expect(job).to_contain_text(re.compile("has ended.*the next fix is predicted"))
        with page.expect_popup() as popup:
            report.click()
        expect(popup.value.get_by_role("heading", level=1)).to_be_visible()
        page.locator(".recording", has_text="broken").get_by_role("button", name="Reprocess").click()
        expect(job).to_contain_text("is no recording, not even a damaged one")
        expect(job).to_contain_text("failed")
        expect(page.locator(".recording", has_text="broken")).to_contain_text("cannot be read")


def replay_and_scrub(page: Page) -> None:
    """Pause, choose a speed and drag to a position: the page shows recorded time as a replay."""
    expect(page.locator(".origin")).to_contain_text("REPLAY")
    page.get_by_role("button", name="Pause the replay").click()
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_visible()
    page.get_by_label("Speed of the replay").select_option("10")
    scrubber = page.get_by_role("slider")
    scrubber.fill("12")
    expect(page.locator(".replay-time")).to_contain_text("0:12 of")
    held = page.locator(".replay-time").inner_text()
    page.wait_for_timeout(500)
    assert page.locator(".replay-time").inner_text() == held
    page.get_by_role("button", name="Play", exact=True).click()
    expect(page.locator(".replay-time")).to_contain_text(re.compile("0:(1[5-9]|[2-5])"))


@pytest.mark.slow
def test_a_run_ends_in_one_json_object_and_can_be_repeated_exactly(tmp_path: Path) -> None:
    demo = start_demo(tmp_path, "--scenario", "parking_lot", "--duration", "32", "--json")
    output, errors = demo.process.communicate(timeout=HANGS_S)
    assert demo.process.returncode == 0, errors
    summary = json.loads(output)
    assert summary["processes_alive"] == summary["processes_expected"] == EXPECTED
    assert summary["restarts"] == 0
    assert summary["messages_per_second"] > 100
    assert 0.0 < summary["fusion_position_rmse_m"] < 1.5
    assert 0.0 < summary["gnss_position_rmse_m"] < 3.0
    assert 0.0 < summary["end_to_end_latency_p50_ms"] <= summary["end_to_end_latency_p99_ms"]
    assert summary["worst_topic_age_s"] is not None

    (file,) = (tmp_path / "demo" / "recordings").glob("*.mcap")
    verified = subprocess.run(
        [sys.executable, "-m", "cli", "verify", str(file)],
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
        env=os.environ | {"OBU_STATE": str(tmp_path)},  # whose keys outlive the demo
    )
    assert verified.returncode == 0, verified.stdout + verified.stderr
    with Recording(file) as recording:
        messages = [envelope.decode() for envelope in recording if not envelope.topic.startswith("consumed/")]
    assert_live_and_offline_agree(messages, demo.folder / "vehicle.toml")


def assert_live_and_offline_agree(messages: list[Message], vehicle: Path) -> None:
    raw = sorted((m for m in messages if isinstance(m, RawBytes)), key=lambda m: arrival_ns(m) or 0)
    live = {m.sampled_ns: m for m in messages if isinstance(m, NavigationSolution)}
    first, second = (list(OfflineUnit(load_vehicle(vehicle)).run(raw)) for _ in range(2))
    assert first == second, "two runs over the same bytes differ"
    offline = {m.sampled_ns: m for m in first if isinstance(m, NavigationSolution)}
    common = live.keys() & offline.keys()
    assert len(common) > 0.95 * len(live) > 20
    for stamp in common:
        a, b = live[stamp], offline[stamp]
        assert abs(a.latitude_deg - b.latitude_deg) * 111e3 < 0.01
        assert abs(a.longitude_deg - b.longitude_deg) * 111e3 < 0.01
        assert abs(a.height_ellipsoid_m - b.height_ellipsoid_m) < 0.01
        turn = math.remainder(a.yaw_rad - b.yaw_rad, math.tau)
        # On a busy machine a late measurement is used by a replay; what is hardly known yet then differs by more.
        sd_rad = math.sqrt(a.attitude_cov_ned_rad2[5])
        assert abs(turn) < max(math.radians(0.01), 0.01 * sd_rad)
        assert max(abs(a.roll_rad - b.roll_rad), abs(a.pitch_rad - b.pitch_rad)) < math.radians(0.01)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["demo", "--scenario", "moon"], "moon"),
        (["up", "--vehicle", "gone.toml"], "gone.toml"),
        (["run", "core.fusoin"], "did you mean core.fusion"),
        (["tail", "no/topic"], "obu topics"),
        (["solve", "gone.mcap"], "gone.mcap"),
        (["verify", "gone.mcap"], "gone.mcap"),
        (["import", "gone.toml", "."], "gone.toml"),
    ],
)
def test_a_user_error_is_one_sentence(arguments: list[str], sentence: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cli", *arguments], capture_output=True, text=True, timeout=HANGS_S, check=False,
        env=os.environ | {"OBU_STATE": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_with_its_port_in_use_the_dashboard_uses_a_free_one(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = subprocess.run(
            [sys.executable, "-m", "cli", "demo", "--port", str(port), "--duration", "2"],
            env=os.environ | {"OBU_STATE": str(tmp_path)}, capture_output=True, text=True, timeout=HANGS_S, check=False,
        )  # fmt: skip
    assert "dashboard: http://127.0.0.1:" in done.stderr
    assert f"127.0.0.1:{port}" not in done.stderr
