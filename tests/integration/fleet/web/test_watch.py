"""Watching a vehicle: its own page, fed by what it passes on, at the centre."""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection

from fleet.web.watch import gate
from fleet.web.watch.time_line import NS, TimeLine
from shared.fleet.topics import WATCHABLE
from tests.support.dashboard.frames import followed
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.reports import Unit
from tests.support.fleet.watched_page import stream
from tests.support.fleet.watched_unit import watched_unit
from tests.support.fleet.web import RunningWeb, tenant
from tests.support.patience import HANGS_S


def until(socket: ClientConnection, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Follow the stream until its state is so."""
    state: dict[str, Any] = {}
    deadline = time.monotonic() + HANGS_S
    while time.monotonic() < deadline:
        frame = json.loads(socket.recv(timeout=HANGS_S))
        state = followed(state, frame)
        if holds(state):
            return state
    raise AssertionError(f"it did not come about: {state.get('banner')} {state.get('watch')}")


def test_the_page_of_a_watched_vehicle_shows_what_it_passes_on_and_the_watch_ends(
    running: RunningWeb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "LINGER_S", 1.0)
    monkeypatch.setattr(gate, "REPEAT_S", 1.0)
    Unit("watch-1", 21, time.time_ns() // 1_000_000).enter(running.dsn)
    otto = running.visitor("otto")
    with watched_unit(running, "watch-1", tmp_path) as vehicle:
        page = otto.get("/vehicles/watch-1/live/")
        assert page.status_code == 200 and "./main.js" in page.text
        with stream(running, otto, "watch-1") as socket:
            state = until(socket, lambda s: s["banner"]["state"] == "safe" and not s["watch"]["silent"])
            assert state["vehicle"] == "watch-1"
            assert state["solution"]["latitude_deg"] == pytest.approx(48.135, abs=0.01)
            assert otto.get("/vehicles/watch-1/live/api/topics/gnss/fix").json()["freshness"] == "fresh"
            assert otto.get("/vehicles/watch-1/live/api/gnss").json()["receivers"]
            eventually(lambda: len(vehicle.requests) >= 3)
            assert vehicle.requests[0]["topics"] == list(WATCHABLE) and vehicle.requests[0]["for_s"] == 30
        eventually(lambda: vehicle.requests[-1]["watchers"] == 0)
        running.wait_for("SELECT 1 FROM audit WHERE vehicle = 'watch-1' AND action = 'ended to watch'")
    assert running.rows("SELECT who FROM audit WHERE vehicle = 'watch-1' AND action = 'began to watch'") == [("otto",)]


def events_of(lines: Iterator[str], number: int) -> list[str]:
    """Names of the next events of a stream."""
    found = list[str]()
    for line in lines:
        if line.startswith("event: "):
            found.append(line.removeprefix("event: "))
        if len(found) == number:
            break
    return found


def test_a_program_reads_the_stream_of_events_of_a_watched_vehicle_for_as_long_as_it_likes(
    running: RunningWeb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "LINGER_S", 1.0)
    Unit("watch-5", 25, time.time_ns() // 1_000_000).enter(running.dsn)
    otto, second = running.visitor("otto"), running.visitor("otto")
    address = "/vehicles/watch-5/live/api/events"
    with watched_unit(running, "watch-5", tmp_path), otto.http.stream("GET", address) as answer:
        assert answer.status_code == 200 and answer.headers["x-accel-buffering"] == "no"
        lines = answer.iter_lines()
        solutions = 0  # on a busy machine verdicts and outages come between them
        while solutions < 3:
            (event,) = events_of(lines, 1)
            solutions += event == "solution"
        with second.http.stream("GET", address) as beside:
            assert len(events_of(beside.iter_lines(), 4)) == 4, "a second one reads as well"
        assert len(events_of(lines, 4)) == 4
        assert running.rows("SELECT 1 FROM audit WHERE vehicle = 'watch-5' AND action = 'ended to watch'") == []


def test_a_stream_of_events_ends_with_the_session_of_its_reader(running: RunningWeb, tmp_path: Path) -> None:
    tenant(running.dsn, "demo", {"eve": "operator"})
    Unit("watch-6", 26, time.time_ns() // 1_000_000).enter(running.dsn)
    eve, anna = running.visitor("eve"), running.visitor("anna")
    with (
        watched_unit(running, "watch-6", tmp_path),
        eve.http.stream("GET", "/vehicles/watch-6/live/api/events") as answer,
    ):
        lines = answer.iter_lines()
        assert events_of(lines, 4)
        change = {"command": {"action": "change", "name": "eve", "disabled": True}}
        assert anna.post("/api/accounts", change).status_code == 200
        for _ in lines:  # until it ends
            pass


def test_a_vehicle_that_does_not_answer_is_shown_so_with_its_last_report(running: RunningWeb) -> None:
    unit = Unit("watch-2", 22, time.time_ns() // 1_000_000)
    unit.enter(running.dsn)
    running.report(unit, 1)
    with stream(running, running.visitor("otto"), "watch-2") as socket:
        state = until(socket, lambda s: s["banner"]["state"] == "disconnected")
    assert "sends nothing" in state["banner"]["sentence"]
    assert state["watch"]["last"]["verdict"] == "caution" and state["watch"]["heard_ns"] is None


def test_what_is_no_message_of_the_contract_is_counted_and_ends_nothing(running: RunningWeb, tmp_path: Path) -> None:
    Unit("watch-3", 23, time.time_ns() // 1_000_000).enter(running.dsn)
    otto = running.visitor("otto")
    with watched_unit(running, "watch-3", tmp_path), stream(running, otto, "watch-3") as socket:
        for noun in ("gnss/fix", "trust/state", "mode/command", "nothing", "a/b/c/d"):
            for data in (b"", b"{}", b"\xff" * 3000, b'{"sender":{"process":"x"}}', b"[" * 60_000):
                running.run(running.client.publish(f"obu.watch-3.live.{noun.replace('/', '.')}", data))
        until(socket, lambda s: s["banner"]["state"] == "safe")


def test_a_page_that_is_watched_can_change_nothing(running: RunningWeb) -> None:
    Unit("watch-4", 24, time.time_ns() // 1_000_000).enter(running.dsn)
    otto, anna = running.visitor("otto"), running.visitor("anna")
    for path in ("api/command", "api/simulation/attack", "api/recordings", "api/tokens", "api/login"):
        assert otto.post(f"/vehicles/watch-4/live/{path}", {}).status_code == 403
        assert anna.post(f"/vehicles/watch-4/live/{path}", {}).status_code in (404, 405)
        assert anna.get(f"/vehicles/watch-4/live/{path}").status_code in (404, 405)


@pytest.mark.parametrize("offset_s", [0.0, -7200.0, 86_400.0])
def test_the_time_line_of_a_unit_with_another_clock_is_found(offset_s: float) -> None:
    line, now_ns = TimeLine(), 1_796_000_000 * NS
    delays_s = (0.3, 0.05, 0.1, 0.8, 0.06)
    for number, delay_s in enumerate(delays_s):
        arrival_ns = now_ns + number * NS // 5
        line.take("imu/sample", arrival_ns - round((delay_s - offset_s) * NS), arrival_ns)
    assert line.offset_ns == (0 if offset_s == 0 else pytest.approx((offset_s - 0.05) * NS))


def test_a_clock_that_is_set_makes_another_time_line() -> None:
    line, now_ns = TimeLine(), 1_796_000_000 * NS
    topic = "trust/state"
    assert not line.take(topic, now_ns - NS // 10, now_ns), "equal clocks need no new beginning"
    assert not line.take(topic, now_ns, now_ns + NS)
    assert line.take(topic, now_ns + 3600 * NS, now_ns + 2 * NS)
    assert not line.take(topic, now_ns + 3601 * NS, now_ns + 3 * NS)


@pytest.mark.parametrize("back_s", [4, 20, 3600])
def test_a_clock_that_is_set_back_is_found_by_the_first_message_of_a_topic_that_was_there(back_s: int) -> None:
    line, now_ns = TimeLine(), 1_796_000_000 * NS
    for second in range(40):
        line.take("trust/state", now_ns + second * NS, now_ns + second * NS)
    now_ns += 40 * NS
    assert line.take("trust/state", now_ns - back_s * NS, now_ns)
    assert line.offset_ns == -back_s * NS
    assert not line.take("imu/sample", now_ns - back_s * NS, now_ns + NS // 100)


def test_what_a_network_has_held_back_is_late_and_not_of_another_clock() -> None:
    line, now_ns = TimeLine(), 1_796_000_000 * NS
    for second in range(10):
        line.take("trust/state", now_ns + second * NS, now_ns + second * NS)
    for second in range(10, 20):  # all at once, behind ten seconds without a message
        assert not line.take("trust/state", now_ns + second * NS, now_ns + 20 * NS)
        assert not line.take("imu/sample", now_ns + (second - 2) * NS, now_ns + 20 * NS)
    assert line.offset_ns == 0
