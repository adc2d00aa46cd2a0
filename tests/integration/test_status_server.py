"""The HTTP and WebSocket API over real sockets on loopback; the bus is a simulated one."""

import json
import logging
import os
import re
import socket
import subprocess
import sys
import zlib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
import jsonschema
import pytest
from openapi_spec_validator import validate
from pydantic import TypeAdapter
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Close
from websockets.sync.client import ClientConnection, connect

from services.monitoring.status.history.columns import HistoryColumns
from services.monitoring.status.process import Config, Process
from services.monitoring.status.views.models.dashboard import Contract, Dashboard, DashboardState
from services.monitoring.status.views.models.gnss import Receivers
from services.monitoring.status.views.models.position import Feature, Solution
from services.monitoring.status.views.models.recordings import Recordings
from services.monitoring.status.views.models.simulation import Simulation
from services.monitoring.status.views.models.trust import HypothesesReport, TrustReport
from services.monitoring.status.views.models.unit import Health, Outages, Topic, Viewers
from services.monitoring.status.web.map import TrackRows
from services.monitoring.status.web.replay import Replay
from services.monitoring.status.web.routes import openapi
from services.monitoring.status.web.stream.websocket import PERIOD_S
from shared.errors import UserError
from shared.messages.gnss import FixType, GnssFix
from shared.messages.operation import ModeCommand, OperatorCommand, Origin, OriginKind
from shared.messages.simulation import AttackName
from shared.page.answers import Refusal
from shared.page.map.installed import MapAnswer
from shared.recording.folder import RecordingFolder
from shared.runtime.config import ADDRESS_FILE
from tests.support.bus.envelopes import sent
from tests.support.dashboard.fake_unit import FakeBus
from tests.support.dashboard.frames import followed
from tests.support.dashboard.status_server import RunningServer, change, eventually, status_server
from tests.support.patience import HANGS_S

Json = dict[str, Any]
ROOT = Path(__file__).parents[2]
LIBRARIES = ROOT / "services/monitoring/status/dashboard/node_modules/uplot"
needs_libraries = pytest.mark.skipif(
    not LIBRARIES.exists(), reason="the dashboard's libraries are not installed: run `make setup`"
)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningServer]:
    with status_server(tmp_path_factory.mktemp("status")) as running:
        eventually(lambda: get(running, "/api/state")["solution"] is not None)
        yield running


def ask(server: RunningServer, path: str, **headers: str) -> httpx.Response:
    return httpx.get(server.address + path, headers=headers, timeout=HANGS_S)


def get(server: RunningServer, path: str) -> Json:
    found = ask(server, path).json()
    assert isinstance(found, dict)
    return found


def watch(server: RunningServer, **headers: str) -> ClientConnection:
    return connect(server.address.replace("http", "ws") + "/ws", additional_headers=headers, max_size=None)


def frame(socket_: ClientConnection) -> Json:
    found = json.loads(socket_.recv(timeout=HANGS_S))
    assert isinstance(found, dict)
    return found


def test_the_state_holds_the_newest_message_of_each_topic(server: RunningServer) -> None:
    eventually(lambda: get(server, "/api/state")["banner"]["word"] == "SAFE")
    state = get(server, "/api/state")
    assert state["vehicle"] == "truck-07"
    assert state["origin"]["kind"] == "simulated"
    assert state["solution"]["latitude_deg"] == pytest.approx(48.135, abs=0.01)
    assert state["fix"]["satellites_used"] == 17
    assert state["mode"]["mode"] == "measuring"
    assert state["topics"]["gnss/fix"]["message"]["carrier_solution"] == "float"
    assert state["topics"]["gnss/fix"]["age_s"] < 3.0


def test_answers_are_json_and_not_cached(server: RunningServer) -> None:
    for path in (
        "/api/state",
        "/api/health",
        "/api/outages",
        "/api/history",
        "/api/trust",
        "/api/topics/gnss/fix",
        "/asyncapi.json",
    ):
        answer = ask(server, path)
        assert answer.status_code == 200, path
        assert answer.headers["content-type"] == "application/json"
        assert answer.headers["cache-control"] == "no-store"


def test_a_topic_is_shown_with_its_rate_and_size(server: RunningServer) -> None:
    topic = get(server, "/api/topics/health/core.fusion")
    assert topic["type"] == "ProcessHealth"
    assert topic["message"]["process"] == "core.fusion"
    assert topic["bytes"] > 100


def test_a_fast_topic_comes_here_only_while_somebody_asks_and_is_shown_then(
    tmp_path: Path,
) -> None:
    with status_server(tmp_path) as server:
        eventually(lambda: "imu/raw" not in server.bus.followed)
        assert {"navigation/solution", "vehicle/wheel_speed"} <= server.bus.followed
        eventually(lambda: get(server, "/api/topics/imu/raw")["message"] is not None)  # the first, if not busy
        shown = get(server, "/api/topics/imu/raw")
        assert shown["message"]["source"] == "imu0"
        assert shown["freshness"] == "fresh"
        assert "imu/raw" in server.bus.followed
        eventually(lambda: get(server, "/api/state")["topics"]["can/raw"]["message"] is not None)
        eventually(lambda: bool(get(server, "/api/fields/imu/sample")["fields"]))
        eventually(lambda: not {"imu/raw", "can/raw", "imu/sample"} & server.bus.followed)
        health = get(server, "/api/health")["topics"]["imu/raw"]
        assert (health["freshness"], health["cause"]) == ("fresh", None)


def test_an_unknown_topic_is_404_with_a_remedy(server: RunningServer) -> None:
    answer = ask(server, "/api/topics/gnss/colour")
    assert answer.status_code == 404
    assert "/api/state" in answer.json()["detail"]


def test_the_history_holds_the_requested_fields(server: RunningServer) -> None:
    eventually(lambda: len(get(server, "/api/history?seconds=60&fields=speed_fused_m_s")["time_ns"]) > 4)
    history = get(server, "/api/history?seconds=60&fields=speed_fused_m_s,position_error_m")
    assert set(history["fields"]) == {"speed_fused_m_s", "position_error_m"}
    assert len(history["fields"]["speed_fused_m_s"]) == len(history["time_ns"])


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("seconds=0", 422),
        ("seconds=-1", 422),
        ("seconds=nan", 422),
        ("seconds=1e9", 422),
        ("seconds=x", 422),
        ("fields=colour", 404),
        (f"fields={'a,' * 300}", 422),
    ],
)
def test_requests_out_of_bounds_are_rejected(server: RunningServer, query: str, status: int) -> None:
    assert ask(server, f"/api/history?{query}").status_code == status


def test_a_long_topic_name_is_rejected(server: RunningServer) -> None:
    assert ask(server, f"/api/topics/{'x' * 500}").status_code == 422


def test_only_attacks_can_be_commanded_over_http(server: RunningServer) -> None:
    head = {"X-OBU-CSRF": get(server, "/api/session")["csrf"]}
    for path in ("/", "/api/state", "/api/topics/gnss/fix", "/ws"):
        for method in ("POST", "PUT", "DELETE", "PATCH"):
            assert httpx.request(method, server.address + path, headers=head, timeout=HANGS_S).status_code in (404, 405)


def test_metrics_are_in_the_format_of_prometheus(server: RunningServer) -> None:
    answer = ask(server, "/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert 'obu_integrity_state{state="safe"} 1.0' in answer.text


def test_every_answer_carries_the_security_headers(server: RunningServer) -> None:
    for path in ("/", "/style.css", "/api/state", "/metrics", "/docs", "/nowhere"):
        headers = ask(server, path).headers
        assert "default-src" in headers["content-security-policy"], path
        assert "'unsafe-inline'" not in headers["content-security-policy"] or path == "/docs"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"
        assert "server" not in headers


def test_a_websocket_of_another_origin_is_rejected(server: RunningServer) -> None:
    with pytest.raises(InvalidStatus) as rejected:
        watch(server, Origin="http://attacker.example")
    assert rejected.value.response.status_code == 403


def test_an_unknown_host_name_is_rejected(server: RunningServer) -> None:
    assert ask(server, "/api/state", Host="attacker.example").status_code == 421
    with pytest.raises(InvalidStatus) as rejected:
        connect(server.address.replace("http", "ws") + "/ws", additional_headers={"Host": "attacker.example"})
    assert rejected.value.response.status_code in (400, 421)


def test_the_websocket_sends_a_snapshot_and_then_changes(server: RunningServer) -> None:
    with watch(server) as first:
        snapshot = frame(first)
        assert snapshot["kind"] == "snapshot"
        assert set(snapshot["contract"]["topics"]) >= {"gnss/fix", "health/+"}
        assert snapshot["history"]["fields"]["speed_fused_m_s"]
        state, sequence = snapshot["state"], snapshot["sequence"]
        for _ in range(10):
            change = frame(first)
            assert (change["kind"], change["sequence"]) == ("difference", sequence + 1)
            state, sequence = followed(state, change), sequence + 1
        with watch(server) as second:
            whole = frame(second)
            while sequence < whole["sequence"]:
                change = frame(first)
                state, sequence = followed(state, change), change["sequence"]
    assert state == whole["state"], "all differences give the snapshot of a new client"


def test_all_browsers_receive_the_same_frames_within_their_budget(server: RunningServer) -> None:
    with watch(server) as one, watch(server) as two:
        frame(one), frame(two)
        frames: list[dict[int, str | bytes]] = [{}, {}]
        for kept, browser in zip(frames, (one, two), strict=True):
            while len(kept) < 10:
                text = browser.recv(timeout=HANGS_S)
                kept[int(json.loads(text)["sequence"])] = text
    both = frames[0].keys() & frames[1].keys()
    assert len(both) >= 8, "the second one may have come a frame later"
    assert all(frames[0][number] == frames[1][number] for number in both)
    began = min(frames[0])
    assert sorted(frames[0]) == list(range(began, began + 10)), "a frame is missing"
    size = sum(map(len, frames[0].values())) / 10
    assert size / PERIOD_S < 60_000, "the budget of a browser is 60 kB/s"


def test_a_stopped_process_is_shown_stale_and_is_the_one_outage(server: RunningServer) -> None:
    assert server.unit is not None
    server.unit.silent.add("parsers.can")
    eventually(lambda: get(server, "/api/health")["processes"]["parsers.can"]["status"] == "stale")
    assert ask(server, "/api/health").status_code == 200
    assert get(server, "/api/health")["state"] == "degraded"
    assert [outage["what"] for outage in get(server, "/api/outages")["open"]] == ["parsers.can"]
    server.unit.silent.clear()
    eventually(lambda: get(server, "/api/health")["state"] == "ok")
    assert [outage["what"] for outage in get(server, "/api/outages")["closed"]] == ["parsers.can"]


def test_the_verdict_its_monitors_and_their_history_are_one_answer(server: RunningServer) -> None:
    eventually(lambda: get(server, "/api/trust")["history"]["ratios"].get("satellites"))
    # The verdict is of the newest message of each process, and the first of them have not all come yet.
    eventually(lambda: get(server, "/api/health")["position"]["state"] == "safe")
    trust = get(server, "/api/trust")
    assert trust["state"] == "safe"
    assert trust["monitors"]["motion"]["outcome"] == "not_evaluated"
    assert trust["history"]["changes"][-1]["state"] == "safe"
    assert ask(server, "/api/trust?seconds=-1").status_code == 422


def test_an_invalid_message_is_counted_and_the_server_continues(server: RunningServer) -> None:
    before = server.bus.rejects["payload"]
    server.bus.feed_bytes("mode/state", b'{"mode": "flying"}', "controller.mode")
    server.bus.feed_bytes("vehicle/wheel_speed", b'{"received_ns":1,"source":"y"}', "parsers.can")
    eventually(lambda: server.bus.rejects["payload"] == before + 2)
    assert server.bus.last_error
    assert get(server, "/api/state")["mode"]["mode"] == "measuring"


def test_a_lost_broker_is_the_only_reason_for_503(server: RunningServer) -> None:
    server.bus.connected = False
    eventually(lambda: ask(server, "/api/health").status_code == 503)
    assert get(server, "/api/health")["state"] == "failed"
    eventually(lambda: get(server, "/api/state")["banner"]["word"] == "BROKER LOST")
    server.bus.connected = True
    eventually(lambda: ask(server, "/api/health").status_code == 200)


@needs_libraries
def test_pages_are_compressed_and_unchanged_ones_are_304(server: RunningServer) -> None:
    first = ask(server, "/main.js", **{"Accept-Encoding": "gzip"})
    assert first.headers["content-encoding"] == "gzip"
    assert first.text.startswith("//")
    assert ask(server, "/main.js", **{"If-None-Match": first.headers["etag"]}).status_code == 304
    plain = ask(server, "/main.js", **{"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.text == first.text


@needs_libraries
@pytest.mark.parametrize(
    "path", ["/lib/../package.json", "/package.json", "/lib/package.json", "/%2e%2e/process.py", "/.npmrc"]
)
def test_only_listed_files_are_served(server: RunningServer, path: str) -> None:
    assert ask(server, path).status_code == 404


@needs_libraries
def test_the_page_of_the_api_loads_no_external_resources(server: RunningServer) -> None:
    page = ask(server, "/docs")
    assert page.status_code == 200
    for asset in re.findall(r'(?:src|href)="([^"]+)"', page.text):
        assert ":" not in asset and ask(server, f"/{asset}").status_code == 200
    paths = get(server, "/openapi.json")["paths"]
    assert set(paths) == {
        "/api/state", "/api/health", "/api/topics/{name}", "/api/history", "/api/trust", "/api/outages", "/metrics",
        "/api/simulation", "/api/simulation/attack", "/api/solution", "/api/events", "/api/viewers", "/api/replay",
        "/api/series", "/api/fields/{name}", "/api/gnss", "/api/track", "/api/track.gpx", "/api/track.kml", "/api/map",
        "/api/hypotheses", "/api/command", "/api/alive", "/api/login", "/api/logout", "/api/session", "/api/tokens",
        "/api/recordings", "/api/recordings/{name}", "/api/recordings/{name}/report", "/api/page-error",
        "/api/settings", "/api/set-up", "/api/set-up/certificate", "/api/set-up/qr.svg",
        "/api/draft", "/api/support",
    }  # fmt: skip


def test_missing_libraries_are_reported_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<html></html>")
    with status_server(tmp_path, unit=False, static_dir=str(tmp_path)) as server:
        answer = ask(server, "/")
        assert answer.status_code == 503
        assert "make setup" in answer.text
        assert "make setup" in ask(server, "/docs").text
        assert ask(server, "/api/state").status_code == 200


def test_a_viewer_above_the_limit_is_rejected_with_their_number_and_not_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with status_server(tmp_path, unit=False, clients_maximum=1) as server, watch(server) as first:
        frame(first)
        with watch(server) as second, pytest.raises(ConnectionClosed) as rejected:
            second.recv(timeout=HANGS_S)
        assert rejected.value.rcvd == Close(1013, "too many viewers: 1 are connected; try again")
        assert get(server, "/api/viewers") == {"connected": 1, "events": 0, "maximum": 1}
        charts = server.address.replace("http", "ws") + "/ws/series?fields=gnss/fix:hdop"
        with connect(charts), connect(charts) as other:
            assert json.loads(other.recv(timeout=HANGS_S))["reason"].startswith("too many pages of charts are open")
        with pytest.raises(InvalidStatus):
            connect(charts, additional_headers={"Origin": "http://elsewhere.example"})
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_a_packed_frame_is_the_same_frame_in_less_than_half_the_bytes(server: RunningServer) -> None:
    packed = connect(server.address.replace("http", "ws") + "/ws?packed=1", max_size=None)
    with packed, watch(server) as plain:
        one, other = packed.recv(timeout=HANGS_S), plain.recv(timeout=HANGS_S)
        assert isinstance(one, bytes) and json.loads(zlib.decompress(one))["kind"] == frame_of(other)["kind"]
        sizes, frames = [0, 0], {}
        for _ in range(10):
            text = plain.recv(timeout=HANGS_S)
            frames[frame_of(text)["sequence"]] = text
            sizes[0] += len(text)
            body = packed.recv(timeout=HANGS_S)
            assert isinstance(body, bytes)
            sizes[1] += len(body)
            unpacked = zlib.decompress(body).decode()
            assert frames.get(frame_of(unpacked)["sequence"], unpacked) == unpacked
        assert sizes[1] < sizes[0] / 2


def frame_of(text: str | bytes) -> Json:
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


def events(answer: httpx.Response) -> Iterator[tuple[str, Json | None]]:
    """Read server-sent events; comments have no content."""
    kind = ""
    for line in answer.iter_lines():
        if line.startswith(":"):
            yield line, None
        elif line.startswith("event: "):
            kind = line.removeprefix("event: ")
        elif line.startswith("data: "):
            yield kind, json.loads(line.removeprefix("data: "))


def test_events_give_the_verdict_when_it_changes_the_solution_each_second_and_heartbeats(tmp_path: Path) -> None:
    with status_server(tmp_path, clients_maximum=1) as server:
        assert server.unit is not None
        eventually(lambda: get(server, "/api/health")["position"]["state"] == "safe")
        with httpx.stream("GET", server.address + "/api/events", timeout=HANGS_S) as stream:
            assert stream.headers["content-type"].startswith("text/event-stream")
            seen: list[tuple[str, Json | None]] = []
            for kind, content in events(stream):
                if len(seen) == 2:
                    assert ask(server, "/api/events").status_code == 503, "the bound on readers"
                    server.unit.rejecting = True  # the inertial monitor accuses GNSS
                seen.append((kind, content))
                verdicts = [shown["state"] for name, shown in seen if name == "verdict" and shown]
                stamps = [shown["sampled_ns"] for name, shown in seen if name == "solution" and shown]
                if len(verdicts) > 1 and len(stamps) > 3 and (": heartbeat", None) in seen:
                    break
            assert verdicts[:2] == ["safe", "unsafe"]
            steps_s = [(b - a) * 1e-9 for a, b in pairwise(stamps[1:])]
            assert steps_s and all(0.7 < step_s < 1.4 for step_s in steps_s)
        eventually(lambda: get(server, "/api/viewers")["events"] == 0)


def test_the_begin_and_the_end_of_an_outage_are_events(tmp_path: Path) -> None:
    with status_server(tmp_path) as server:
        unit = server.unit
        assert unit is not None
        eventually(lambda: get(server, "/api/health")["state"] == "ok")
        with httpx.stream("GET", server.address + "/api/events", timeout=HANGS_S) as stream:
            seen = []
            for kind, content in events(stream):
                if kind == "verdict":
                    unit.kill("parsers.can")
                if kind == "outage" and content:
                    seen.append(content)
                    unit.revive("parsers.can")
                    if content["until_ns"]:
                        break
        assert {row["what"] for row in seen} == {"parsers.can"}
        assert seen[0]["until_ns"] is None


def test_the_solution_is_json_or_geojson_as_requested(server: RunningServer) -> None:
    flat = get(server, "/api/solution")
    assert flat["live"] and flat["verdict_known"] and flat["age_s"] < 2.0
    for answer in (
        ask(server, "/api/solution?format=geojson"),
        ask(server, "/api/solution", Accept="application/geo+json"),
    ):
        assert answer.headers["content-type"] == "application/geo+json"
        feature = answer.json()
        longitude, latitude, height = feature["geometry"]["coordinates"]
        assert longitude == pytest.approx(flat["longitude_deg"], abs=1e-3)
        assert latitude == pytest.approx(flat["latitude_deg"], abs=1e-3)
        assert height == pytest.approx(flat["height_ellipsoid_m"], abs=1.0)
        assert feature["properties"]["state"] == "safe"
    chosen = ask(server, "/api/solution?format=json", Accept="application/geo+json")
    assert chosen.headers["content-type"] == "application/json"
    assert ask(server, "/api/solution?format=kml").status_code == 422


def test_without_a_solution_every_value_is_null_and_nothing_is_live(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as server:
        flat = get(server, "/api/solution")
        assert (flat["live"], flat["latitude_deg"]) == (False, None)
        assert flat["state"] in ("starting", "stale"), "a server that is slow to answer waits no longer"
        feature = get(server, "/api/solution?format=geojson")
        assert feature["geometry"] is None
        TypeAdapter(Solution).validate_json(json.dumps(flat))
        TypeAdapter(Feature).validate_json(json.dumps(feature))


ANSWERS: dict[str, type] = {
    "/api/solution": Solution,
    "/api/solution?format=geojson": Feature,
    "/api/health": Health,
    "/api/trust": TrustReport,
    "/api/hypotheses": HypothesesReport,
    "/api/history": HistoryColumns,
    "/api/outages": Outages,
    "/api/topics/gnss/fix": Topic,
    "/api/topics/imu/raw": Topic,
    "/api/state": DashboardState,
    "/api/gnss": Receivers,
    "/api/viewers": Viewers,
    "/api/simulation": Simulation,
    "/api/replay": Replay,
    "/api/track": TrackRows,
    "/api/map": MapAnswer,
    "/api/recordings": Recordings,
    "/api/topics/gnss/colour": Refusal,
}


@pytest.mark.parametrize("path", ANSWERS)
def test_every_answer_is_valid_by_its_schema_and_kept_by_no_browser(server: RunningServer, path: str) -> None:
    answer = ask(server, path)
    TypeAdapter(ANSWERS[path]).validate_json(answer.content)
    if answer.status_code == 200:
        assert answer.headers["cache-control"] == "no-store"


def test_what_a_page_follows_is_valid_by_the_schema_of_the_views(server: RunningServer) -> None:
    with connect(server.address.replace("http", "ws") + "/ws", max_size=None) as stream:
        snapshot = json.loads(stream.recv(HANGS_S))
    state = snapshot["state"]
    assert state.pop("replay") is None
    TypeAdapter(Dashboard).validate_json(json.dumps(state))
    TypeAdapter(Contract).validate_json(json.dumps(snapshot["contract"]))
    TypeAdapter(HistoryColumns).validate_json(json.dumps(snapshot["history"]))


def test_the_description_of_the_api_is_openapi_with_a_tag_and_a_schema_for_every_route(server: RunningServer) -> None:
    description = get(server, "/openapi.json")
    validate(description)
    tags = {tag["name"] for tag in description["tags"]}
    for path, methods in description["paths"].items():
        for operation in methods.values():
            assert set(operation["tags"]) <= tags and operation["tags"], path
            assert operation["description"], path
            good = next(answer for status, answer in operation["responses"].items() if status in ("200", "202"))
            for kind, content in good["content"].items():
                assert content["schema"], (path, kind)


def test_every_example_is_valid_by_its_schema() -> None:
    schemas = openapi()["components"]["schemas"]
    examples = [(name, example) for name, schema in schemas.items() for example in schema.get("examples", ())]
    assert len(examples) > 8
    for name, example in examples:
        jsonschema.validate(example, {"$ref": f"#/components/schemas/{name}", "components": {"schemas": schemas}})


def test_a_port_in_use_is_reported_with_a_remedy(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=rf"port {port}.*\[monitoring.status\]"):
            Process(Config(port=port)).run(FakeBus(tmp_path))  # type: ignore[arg-type]  # has the same face


def test_the_end_leaves_no_address_behind(tmp_path: Path) -> None:
    with status_server(tmp_path) as server, watch(server) as browser:
        frame(browser)
        assert (tmp_path / ADDRESS_FILE).read_text() == server.address + "/"
        server.stop()
        assert not (tmp_path / ADDRESS_FILE).exists()
        with pytest.raises(ConnectionClosed):
            while True:
                browser.recv(timeout=HANGS_S)


def test_a_host_name_of_the_settings_is_accepted(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False, allowed_hosts=["truck.example"]) as server:
        assert ask(server, "/api/state", Host="truck.example").status_code == 200


MEMORY = """
import sys, threading
from pathlib import Path
from services.monitoring.status.process import Config, Process
from tests.support.dashboard.fake_unit import FakeBus, FakeUnit
bus = FakeBus(Path(sys.argv[1]))
unit = FakeUnit(bus)
threading.Thread(target=lambda: (sys.stdin.readline(), setattr(bus, "stopping", True)), daemon=True).start()
Process(Config(port=0)).run(bus)
"""


def test_the_process_has_less_than_69_mib(tmp_path: Path) -> None:
    command = [sys.executable, "-c", MEMORY, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, cwd=ROOT) as process:
        assert process.stdin is not None
        file = tmp_path / ADDRESS_FILE
        eventually(lambda: file.exists() and file.read_text().endswith("/"))
        address = file.read_text().rstrip("/")
        with connect(address.replace("http", "ws") + "/ws", max_size=None) as browser:
            for _ in range(10):
                browser.recv(timeout=HANGS_S)
            for path in ("/", "/api/state", "/metrics", "/api/history?seconds=900"):
                httpx.get(address + path, timeout=HANGS_S)
            status = Path(f"/proc/{process.pid}/status").read_text()
        process.stdin.close()
        assert process.wait(timeout=HANGS_S) == 0
    resident_kb = re.search(r"VmRSS:\s+(\d+)", status)
    # Measured: 67 MiB. 46 MiB are imported libraries, 8 MiB imports of our own, 1.3 MiB the simulated unit, 1.2 MiB the
    # last hour of the charts, 5 MiB routes and connections, 2 MiB what FastAPI checks and prints answers with. A new
    # version of a library moves the sum by 1 to 2 MiB; the limit finds what grows by more.
    assert resident_kb and int(resident_kb[1]) < 69 * 1024


def command(server: RunningServer, body: object, **headers: str) -> httpx.Response:
    return change(server.address, "/api/simulation/attack", body, **headers)


def test_an_attack_is_started_and_stopped_and_its_answer_is_shown(server: RunningServer) -> None:
    answer = command(server, {"command": "start", "attack": "drag_off", "parameters": {"speed": 1.0}})
    assert answer.status_code == 202
    request_id = answer.json()["request_id"]
    eventually(lambda: get(server, "/api/simulation")["simulation"]["request_id"] == request_id)
    (run,) = get(server, "/api/simulation")["simulation"]["attacks"]
    assert (run["attack"], run["parameters"]["speed"], run["ended_ns"]) == ("drag_off", 1.0, None)
    assert command(server, {"command": "stop"}).status_code == 202
    eventually(lambda: get(server, "/api/simulation")["simulation"]["attacks"][0]["ended_ns"] is not None)
    assert len(get(server, "/api/simulation")["attacks"]) == len(AttackName)


@pytest.mark.parametrize(
    ("body", "status", "detail"),
    [
        ({"command": "start", "attack": "flood"}, 422, "attack: Input should be 'tunnel'"),
        ({"command": "start"}, 422, "name the attack that shall start"),
        ({"command": "start", "attack": "jam", "parameters": {"x": 1.0}}, 422, "jam has no parameter 'x'"),
        ({"command": "start", "attack": "jam", "parameters": {"power": 1e9}}, 422, "jam: power must be 1 to 60 dB"),
        ({"command": "start", "attack": "jam", "duration_s": -1}, 422, "duration_s"),
        ({"command": "explode"}, 422, "command"),
        (["start"], 422, "a command is an object"),
        ({"command": "start", "attack": "jam", "x": "y" * 4000}, 413, "at most 2048 bytes"),
    ],
)
def test_a_command_that_cannot_be_executed_is_rejected(
    server: RunningServer, body: object, status: int, detail: str
) -> None:
    before = len(server.bus.published)
    answer = command(server, body)
    assert answer.status_code == status
    assert detail in answer.json()["detail"]
    assert len(server.bus.published) == before


def test_a_command_of_another_origin_is_rejected(server: RunningServer) -> None:
    assert command(server, {"command": "stop"}, Origin="http://evil.example").status_code == 403


def test_a_command_of_the_operator_is_published_as_it_was_given(server: RunningServer) -> None:
    given = {"request_id": "r7", "command": "select_source", "source": "gnss1"}
    answer = change(server.address, "/api/command", given)
    assert (answer.status_code, answer.json()) == (202, {"request_id": "r7"})
    eventually(lambda: any(isinstance(message, ModeCommand) for message in server.bus.published))
    (published,) = [message for message in server.bus.published if isinstance(message, ModeCommand)]
    assert (published.command, published.source) == (OperatorCommand.SELECT_SOURCE, "gnss1")


@pytest.mark.parametrize(
    ("body", "status", "headers"),
    [
        ({"command": "explode"}, 422, {}),
        ([], 422, {}),
        ({"command": "navigation_rate", "navigation_period_s": 0.0}, 422, {}),
        ({"command": "cold_start", "source": "x" * 3000}, 413, {}),
        ({"command": "cold_start"}, 403, {"Origin": "http://elsewhere.example"}),
    ],
)
def test_what_is_no_command_of_the_operator_is_rejected(
    server: RunningServer, body: object, status: int, headers: dict[str, str]
) -> None:
    answer = change(server.address, "/api/command", body, **headers)
    assert answer.status_code == status


def test_a_unit_that_is_not_simulated_rejects_attacks(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as real:
        assert command(real, {"command": "stop"}).status_code == 409, "no origin is known"
        real.bus.feed(Origin(now_ns=real.bus.now_ns(), kind=OriginKind.LIVE, name="truck"), "sensors.gnss")
        eventually(lambda: get(real, "/api/state")["origin"] is not None)
        answer = command(real, {"command": "start", "attack": "jam"})
        assert answer.status_code == 409 and "not simulated" in answer.json()["detail"]
        real.bus.feed(Origin(now_ns=real.bus.now_ns(), kind=OriginKind.SIMULATED, name="lot"), "sensors.simulator")
        eventually(lambda: len(get(real, "/api/state")["topics"]["origin/state"]) > 0)
        assert command(real, {"command": "stop"}).status_code == 409, "a real receiver among simulated devices"
        assert not real.bus.published and get(real, "/api/state")["simulation"] is None


def test_any_numeric_field_is_a_series_and_another_field_is_rejected(server: RunningServer) -> None:
    listed = {field["path"]: field for field in get(server, "/api/fields/navigation/aiding")["fields"]}
    assert listed["test_ratio"]["name"].startswith("navigation/aiding[gnss_")
    assert get(server, "/api/fields/gnss/fix")["fields"][-1]["path"] == "@latency_s"
    names = "navigation/solution:yaw_rad,computed:error_horizontal_m,gnss/fix:hdop"
    get(server, f"/api/series?fields={names}&seconds=30")
    eventually(lambda: known(get(server, f"/api/series?fields={names}&seconds=30"), "navigation/solution:yaw_rad") > 2)
    found = get(server, f"/api/series?fields={names}&seconds=30")
    assert found["period_s"] == 0.2
    assert found["fields"]["navigation/solution:yaw_rad"] == {"unit": "rad", "axis": ""}
    assert {len(values) for values in found["values"].values()} == {len(found["time_ns"])}
    assert [v for v in found["values"]["gnss/fix:hdop"] if v is not None][-1] == 0.8
    for fields in ("", "hdop", "no/topic:x", ",".join(f"gnss/fix:x{n}" for n in range(17))):
        assert ask(server, f"/api/series?fields={fields}").status_code == 422
    assert ask(server, "/api/fields/no/topic").status_code == 404


def known(series: Json, name: str) -> int:
    return sum(value is not None for value in series["values"][name])


def test_series_are_continued_over_a_websocket_without_a_gap_or_a_repetition(server: RunningServer) -> None:
    address = server.address.replace("http", "ws")
    with connect(f"{address}/ws/series?fields=computed:speed_m_s&seconds=20") as socket:
        frames = [json.loads(socket.recv(timeout=HANGS_S)) for _ in range(6)]
    assert [frame["kind"] for frame in frames] == ["past", *["more"] * 5]
    stamps = [ns for frame in frames for ns in frame["time_ns"]]
    assert {b - a for a, b in pairwise(stamps)} == {200_000_000}
    with connect(f"{address}/ws/series?fields=nothing") as socket:
        refused = json.loads(socket.recv(timeout=HANGS_S))
    assert refused["kind"] == "refused"
    assert "write topic:field" in refused["reason"]


def test_the_history_of_charts_is_read_from_the_recording_after_a_restart(tmp_path: Path) -> None:
    start_ns = 1_795_000_000 * 10**9  # of the simulated unit
    folder = RecordingFolder(tmp_path / "recordings")
    folder.stored()
    folder.open("drive", vehicle="truck-07", vehicle_toml="", chunk_bytes=4096)
    stamps = [start_ns - second * 10**9 for second in range(1200, 0, -1)]
    fixes = [
        GnssFix(sampled_ns=ns, received_ns=ns, source="gnss0", fix_type=FixType.THREE_D, hdop=1 + n / 1000, vdop=2.0)
        for n, ns in enumerate(stamps)
    ]
    folder.write([sent(fix, fix.sampled_ns + 1_000_000, "parsers.gnss") for fix in fixes])
    folder.flush()  # not closed, as while the recorder writes
    with status_server(tmp_path, unit=False) as running:
        address = "/api/series?fields=gnss/fix:hdop,gnss/fix:satellites_used&seconds=1100"
        eventually(lambda: known(get(running, address), "gnss/fix:hdop") > 1000)
        found = [value for value in get(running, address)["values"]["gnss/fix:hdop"] if value is not None]
        assert found == sorted(found) and found[-1] == pytest.approx(2.199)
        chosen = "/api/series?fields=gnss/fix:@latency_s&seconds=1100"  # not requested before the restart
        eventually(lambda: known(get(running, chosen), "gnss/fix:@latency_s") > 1000)
        assert next(v for v in get(running, chosen)["values"]["gnss/fix:@latency_s"] if v) == pytest.approx(1e-3)
    folder.close()
