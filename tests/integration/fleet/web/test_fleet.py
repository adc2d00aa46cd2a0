"""What the pages of a centre show of vehicles, alarms and keys."""

import asyncio
import json
import threading
import time
from math import asinh, floor, pi, radians, tan
from typing import Any

import httpx
import psycopg
import pytest
from websockets.sync.client import connect

from fleet.bus import closed, connected, told
from fleet.servers.nats import NatsAccess
from fleet.web import enrolment, vehicles
from fleet.web.vehicles import TRAIL_POINTS, TRAIL_REPORTS, columns_of
from shared.fleet.batch import MOST_REPORTS
from shared.fleet.times import MAX_AGE_S, RESTING_S, RETRY_S
from shared.fleet.topics import REVOKED
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.reports import Unit
from tests.support.fleet.web import FINGERPRINT, PASSWORD, RunningWeb, Visitor, bus
from tests.support.patience import HANGS_S


def now_ms() -> int:
    return time.time_ns() // 1_000_000


@pytest.fixture(scope="module")
def anna(running: RunningWeb) -> Visitor:
    return running.visitor("anna")


@pytest.fixture(scope="module")
def otto(running: RunningWeb) -> Visitor:
    return running.visitor("otto")


def enter(running: RunningWeb, name: str, *verdicts: int, age_s: float = 0.0) -> Unit:
    unit = Unit(name, abs(hash(name)) % 1_000_000 + 1, now_ms() - round(age_s * 1000) - 1000 * len(verdicts))
    unit.enter(running.dsn)
    running.report(unit, *verdicts)
    return unit


def names(answer: httpx.Response) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [row["vehicle"] for row in answer.json()["vehicles"]]


def test_the_list_has_the_gravest_first_and_is_filtered_by_name_verdict_age_and_alarm(
    running: RunningWeb, anna: Visitor
) -> None:
    enter(running, "list-safe", 0)
    enter(running, "list-unsafe", 5)
    enter(running, "list-old", 1, age_s=300)
    running.rows(
        "INSERT INTO alarm (tenant_id, vehicle, kind, since_ms) VALUES (1, 'list-old', 'silent', 1) RETURNING 1"
    )
    assert names(anna.get("/api/vehicles?find=LIST-")) == ["list-unsafe", "list-safe", "list-old"]
    assert names(anna.get("/api/vehicles?find=list-&verdicts=0,1")) == ["list-safe", "list-old"]
    assert names(anna.get("/api/vehicles?find=list-&age=old")) == ["list-old"]
    assert names(anna.get("/api/vehicles?find=list-&age=fresh")) == ["list-unsafe", "list-safe"]
    assert names(anna.get("/api/vehicles?find=list-&alarm=true")) == ["list-old"]
    assert names(anna.get("/api/vehicles?find=%25")) == [], "no wildcards"
    for bad in ("verdicts=9", "age=young", "find=" + "x" * 49, "skip=-1"):
        assert anna.get(f"/api/vehicles?{bad}").status_code == 422
    assert anna.get("/api/vehicles?find=%00").status_code == 422


def test_a_vehicle_at_rest_is_not_old_between_two_of_its_reports(running: RunningWeb, anna: Visitor) -> None:
    enter(running, "rest-new", 0, age_s=RESTING_S + RETRY_S + 2)
    enter(running, "rest-old", 0, age_s=MAX_AGE_S + 1)
    assert names(anna.get("/api/vehicles?find=rest-&age=fresh")) == ["rest-new"]
    assert names(anna.get("/api/vehicles?find=rest-&age=old")) == ["rest-old"]
    assert f"OLD_S = {MAX_AGE_S};" in anna.get("/store.js").text, "the page and the database agree"
    assert f"older than {MAX_AGE_S} s" in anna.get("/words.js").text


def test_a_vehicle_is_told_with_its_track_events_gaps_and_keys(running: RunningWeb, anna: Visitor) -> None:
    unit = enter(running, "one-1", 0, 0, 2)
    running.send("one-1", unit.events("trust/event", "outage/event"))
    running.wait_for("SELECT 1 FROM event WHERE vehicle = 'one-1' AND name = 'outage/event'")
    running.send("one-1", unit.gap(unit.next, 40))
    running.wait_for("SELECT 1 FROM gap WHERE vehicle = 'one-1'")
    told: dict[str, Any] = anna.get("/api/vehicles/one-1").json()
    assert told["vehicle"]["verdict"] == 2 and told["vehicle"]["latitude_deg"] == pytest.approx(48.1000002)
    assert {row["name"] for row in told["events"]} == {"trust/event", "outage/event"}
    assert [row["count"] for row in told["gaps"]] == [40]
    assert [(row["kind"], row["key_id"]) for row in told["keys"]] == [("evidence", unit.signer.key_id)]
    trail = anna.get("/api/vehicles/one-1/trail").json()
    assert trail["verdict"] == [0, 0, 2] and len(trail["time_ms"]) == 3
    assert trail["latitude_deg"][0] == pytest.approx(48.1)
    assert anna.get("/api/vehicles/one-1/trail?minutes=100000").status_code == 422
    assert anna.get("/api/vehicles/nobody").status_code == 404
    assert anna.get("/vehicles/one-1").headers["location"] == "../#/vehicles/one-1"


def test_the_track_of_a_vehicle_that_signs_too_much_is_bounded_and_holds_up_nobody(
    running: RunningWeb, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = Unit("many-1", 61)
    unit.enter(running.dsn)
    running.report(unit, *[0] * MOST_REPORTS)
    with psycopg.connect(running.dsn) as db:
        db.execute(
            "INSERT INTO segment (day, vehicle, epoch, first_sequence, count, kind, from_ms, to_ms, verdict, "
            "tenant_id, digest, content) "
            "SELECT day, vehicle, epoch, first_sequence + n * 1000, count, kind, from_ms, to_ms, "
            "verdict, tenant_id, digest, content FROM segment, generate_series(1, 400) AS n WHERE vehicle = 'many-1'"
        )
    decoded = list[tuple[int, bool]]()

    def counted(batches: list[bytes], from_ms: int) -> dict[str, object]:
        decoded.append((len(batches), threading.current_thread() is loop_thread))
        return columns_of(batches, from_ms)

    async def thread() -> threading.Thread:
        return threading.current_thread()

    loop_thread = running.run(thread())
    monkeypatch.setattr(vehicles, "columns_of", counted)
    trail = running.visitor("anna").get("/api/vehicles/many-1/trail?minutes=1440").json()
    assert decoded == [(TRAIL_REPORTS // MOST_REPORTS, False)]
    assert 0 < len(trail["time_ms"]) <= TRAIL_POINTS + 1


def test_a_report_without_position_shows_no_place_and_leaves_a_hole_in_the_track(
    running: RunningWeb, anna: Visitor
) -> None:
    unit = Unit("blind-1", 77, now_ms() - 4000)
    unit.enter(running.dsn)
    running.report(unit, 4, 4, placed=False)
    assert anna.get("/api/vehicles/blind-1").json()["vehicle"]["latitude_deg"] is None
    assert anna.get("/api/vehicles/blind-1/trail").json()["latitude_deg"] == [None, None]
    assert b"blind-1" not in anna.get("/tiles/0/0/0.mvt?find=blind").content


def test_a_tile_clusters_what_is_near_and_shows_single_vehicles_near_by(running: RunningWeb, anna: Visitor) -> None:
    for number, verdict in enumerate((0, 1, 5)):
        enter(running, f"tile-{number}", verdict)
    far = anna.get("/tiles/5/17/11.mvt?find=tile-")
    assert far.status_code == 200 and b"tile-0" not in far.content, "three at one place are a cluster"
    x = floor((11.5 + 180) / 360 * 2**18)
    y = floor((1 - asinh(tan(radians(48.1))) / pi) / 2 * 2**18)
    near = anna.get(f"/tiles/18/{x}/{y}.mvt?find=tile-")
    assert near.status_code == 200, "the place is in this tile"
    assert all(f"tile-{number}".encode() in near.content for number in range(3))
    assert anna.get("/tiles/5/3/3.mvt?find=tile-").status_code == 204
    assert anna.get("/tiles/1/2/0.mvt").status_code == 404
    assert anna.get("/tiles/1/0/0.mvt").headers["cache-control"].startswith("private")


def test_a_change_of_verdict_and_an_alarm_reach_an_open_page(running: RunningWeb, anna: Visitor) -> None:
    unit = enter(running, "push-1", 0)
    headers = {"Cookie": f"obu-centre={anna.http.cookies['obu-centre']}"}
    with connect(running.address.replace("http", "ws") + "/ws", additional_headers=headers) as socket:
        first = json.loads(socket.recv(timeout=HANGS_S))
        assert first["bus"] is True and first["changes"] == []
        running.report(unit, 5)
        change = next_with(socket, "changes")
        if (
            change[0]["verdict"] == 0
        ):  # the bus was slower than the database: a vehicle that appears is a change as well
            change = next_with(socket, "changes")
        assert [(row["vehicle"], row["verdict"]) for row in change] == [("push-1", 5)]
        running.publish("centre.alarm", {"tenant_id": 1, "alarm_id": 7, "vehicle": "push-1", "kind": "unsafe"})
        running.publish("centre.alarm", {"tenant_id": 2, "alarm_id": 8, "vehicle": "foreign", "kind": "unsafe"})
        running.publish("centre.now", ["nonsense", {"vehicle": 3}, 5])
        assert [row["alarm_id"] for row in next_with(socket, "alarms")] == [7]
        running.report(unit, 5)
        running.report(unit, 1)
        change = next_with(socket, "changes")
        assert [row["verdict"] for row in change] == [1], "the same verdict again is no change"


def test_a_first_report_and_one_that_a_newer_one_has_overtaken_are_no_change(
    running: RunningWeb, anna: Visitor
) -> None:
    def row(name: str, verdict: int, sequence: int, since_ms: int) -> dict[str, object]:
        times = {"utc_ms": now_ms(), "verdict_since_ms": since_ms}
        return {"vehicle": name, "tenant_id": 1, "verdict": verdict, "epoch": 7, "sequence": sequence, **times}

    long_ago = now_ms() - 3_600_000
    headers = {"Cookie": f"obu-centre={anna.http.cookies['obu-centre']}"}
    with connect(running.address.replace("http", "ws") + "/ws", additional_headers=headers) as socket:
        socket.recv(timeout=HANGS_S)
        for some in (
            [row("known-before", 5, 9, long_ago), row("new-1", 5, 0, now_ms())],
            [row("known-before", 0, 8, long_ago)],
            [row("known-before", 5, 10, long_ago)],
            [row("new-1", 1, 2, now_ms())],
            [row("new-1", 5, 1, now_ms())],
        ):
            running.publish("centre.now", some)
            time.sleep(0.6)  # two frames
        running.publish("centre.alarm", {"tenant_id": 1, "alarm_id": 7, "vehicle": "new-1", "kind": "unsafe"})
        changes = list[tuple[str, int]]()
        while not (frame := json.loads(socket.recv(timeout=HANGS_S)))["alarms"]:
            changes += [(item["vehicle"], item["verdict"]) for item in frame["changes"]]
    assert changes == [("new-1", 5), ("new-1", 1)]


def next_with(socket: Any, part: str) -> list[dict[str, Any]]:
    deadline = time.monotonic() + HANGS_S
    while time.monotonic() < deadline:
        frame = json.loads(socket.recv(timeout=HANGS_S))
        if frame[part]:
            return list(frame[part])
    raise AssertionError(f"no frame with {part}")


def test_an_operator_acknowledges_an_alarm_once(running: RunningWeb, anna: Visitor, otto: Visitor) -> None:
    enter(running, "alarm-1", 5)
    rows = running.rows(
        "INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, late) VALUES (1, 'alarm-1', 'unsafe', 1, true) "
        "RETURNING alarm_id"
    )
    number = rows[0][0]
    listed = otto.get("/api/alarms?show=open&kind=unsafe").json()["alarms"]
    assert [row["late"] for row in listed if row["alarm_id"] == number] == [True]
    assert otto.post(f"/api/alarms/{number}/acknowledge", {}).json()["acknowledged_by"] == "otto"
    assert anna.post(f"/api/alarms/{number}/acknowledge", {}).status_code == 404
    assert "alarm-1" not in str(otto.get("/api/alarms?show=unacknowledged").json())
    assert ("otto", "acknowledged an alarm", "alarm-1") in [
        (row["who"], row["action"], row["vehicle"]) for row in anna.get("/api/audit?find=alarm-1").json()["rows"]
    ]


@pytest.mark.parametrize("address", ["http://x.example/", "https://u:p@x.example/", "ftp://x", "https://", "nonsense"])
def test_a_web_hook_is_https_without_password(anna: Visitor, address: str) -> None:
    assert anna.post("/api/web-hook", {"address": address}).status_code == 422
    assert anna.post("/api/web-hook", {"address": "https://hook.example/x"}).status_code == 200
    stored = anna.get("/api/web-hook").json()
    assert stored["address"] == "https://hook.example/x" and stored["secret"].startswith("whsec_")
    again = anna.post("/api/web-hook", {"address": "https://hook.example/x"}).json()
    assert again["secret"] != stored["secret"] and again["secret"] not in anna.get("/api/audit").text
    assert anna.post("/api/web-hook", {"address": ""}).json() == {"address": "", "secret": ""}


def test_a_token_is_shown_once_and_a_revoked_vehicle_is_told_to_the_centre(running: RunningWeb, anna: Visitor) -> None:
    command = anna.post("/api/enrolment", {"vehicle": "new-1", "hours": 2}).json()["command"]
    obu, enrol, address, token, option, name = command.split()
    secret, _, fingerprint = token.partition(".")
    assert (obu, enrol, address, fingerprint) == ("obu", "enrol", "https://centre.example:8444", FINGERPRINT)
    assert (option, name) == ("--name", "new-1")
    assert "--name" not in anna.post("/api/enrolment", {}).json()["command"]
    assert secret not in anna.get("/api/enrolment").text and secret not in anna.get("/api/audit").text
    assert running.rows("SELECT vehicle, made_by FROM enrolment WHERE vehicle = 'new-1'") == [("new-1", "anna")]
    assert anna.post("/api/enrolment", {"vehicle": "no name"}).status_code == 422
    assert anna.post("/api/enrolment", {"hours": 10_000}).status_code == 422

    heard: list[bytes] = []

    async def take(message: Any) -> None:
        heard.append(message.data)

    running.run(running.client.subscribe("centre.revoked", cb=take))
    running.run(running.client.flush())
    unit = enter(running, "bad-1", 0)
    assert anna.post("/api/enrolment", {"vehicle": "bad-1"}).status_code == 200
    done = anna.post("/api/revoke", {"vehicle": "bad-1", "reason": "stolen"})
    assert done.json() == {"keys": [unit.signer.key_id], "told": True}
    assert running.rows("SELECT 1 FROM enrolment WHERE vehicle = 'bad-1' AND expires > now()") == [], "nor by a token"
    assert running.rows("SELECT 1 FROM enrolment WHERE vehicle = 'new-1' AND expires > now()") == [(1,)]
    eventually(lambda: heard == [json.dumps({"key": unit.signer.key_id}).encode()])
    assert anna.get("/api/vehicles/bad-1").json()["keys"][0]["reason"] == "stolen"
    assert anna.post("/api/revoke", {"vehicle": "bad-1"}).status_code == 409


def test_a_revocation_that_could_not_be_told_holds_and_the_answer_says_so(
    running: RunningWeb, anna: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def is_away(*_: object) -> bool:
        return False

    monkeypatch.setattr(enrolment, "told", is_away)
    unit = enter(running, "bad-2", 0)
    done = anna.post("/api/revoke", {"vehicle": "bad-2"})
    assert (done.status_code, done.json()) == (200, {"keys": [unit.signer.key_id], "told": False})
    assert running.rows("SELECT 1 FROM certificate WHERE vehicle = 'bad-2' AND revoked IS NOT NULL") == [(1,)]


def test_a_server_that_is_away_is_not_taken_for_told() -> None:
    async def work() -> None:
        with bus() as url:
            client = await connected(NatsAccess(url), "test")
            assert await told(client, REVOKED, [b"{}"])
        eventually_s = time.monotonic() + HANGS_S
        while client.is_connected:
            assert time.monotonic() < eventually_s
            await asyncio.sleep(0.05)
        assert not await told(client, REVOKED, [b"{}"])
        await closed(client)
        assert not await told(client, REVOKED, [b"{}"])

    asyncio.run(work())


def test_accounts_are_added_changed_and_disabled(running: RunningWeb, anna: Visitor) -> None:
    def change(**command: object) -> httpx.Response:
        return anna.post("/api/accounts", {"command": command})

    new = {"action": "add", "name": "nina", "role": "viewer", "password": PASSWORD}
    assert change(**new).status_code == 200
    assert change(**new).status_code == 409
    assert change(**{**new, "name": "weak", "password": "short"}).status_code == 422
    nina = running.visitor("nina")
    assert nina.get("/api/vehicles").status_code == 200
    assert nina.get("/api/audit").status_code == 403
    assert change(action="change", name="nina", role="admin").status_code == 200
    assert nina.get("/api/audit").status_code == 200
    assert nina.post("/api/password", {"old": "wrong", "new": "four words and two"}).status_code == 401
    assert nina.post("/api/password", {"old": PASSWORD, "new": "four words and two"}).status_code == 200
    assert change(action="change", name="nina", disabled=True).status_code == 200
    assert nina.get("/api/vehicles").status_code == 401
    assert nina.log_in("nina", "four words and two").status_code == 401
    assert change(action="change", name="anna", role="viewer").status_code == 409, "nobody demotes the own account"
    assert change(action="change", name="olga", disabled=True).status_code == 404, "of another tenant"
    assert "four words" not in anna.get("/api/audit").text


def test_the_toll_role_sees_passages_and_no_positions(running: RunningWeb) -> None:
    unit = enter(running, "gate-1", 0)
    running.send("gate-1", unit.events("toll/transaction", "trust/event"))
    running.wait_for("SELECT 1 FROM event WHERE vehicle = 'gate-1'")
    tom = running.visitor("tom")
    assert [row["name"] for row in tom.get("/api/passages").json()["passages"]] == ["toll/transaction"]
    for path in ("/api/vehicles", "/api/vehicles/gate-1/trail", "/tiles/0/0/0.mvt", "/api/alarms"):
        assert tom.get(path).status_code == 403


def test_an_event_of_any_size_keeps_the_lists_small(running: RunningWeb, anna: Visitor) -> None:
    unit = enter(running, "gate-2", 0)
    running.send("gate-2", unit.events("toll/transaction", "origin/state"))
    running.wait_for("SELECT 1 FROM event WHERE vehicle = 'gate-2'")
    large = {"kind": "k" * 90_000, "name": "n" * 90_000}
    with psycopg.connect(running.dsn) as db:
        db.execute("UPDATE event SET content = %s WHERE vehicle = 'gate-2'", (json.dumps(large),))
    for path in ("/api/passages", "/api/vehicles/gate-2"):
        answer = anna.get(path)
        assert "left_out" in answer.text and len(answer.content) < 20_000
    events = anna.get("/api/vehicles/gate-2").json()["events"]
    assert [event["content"] for event in events] == [{"left_out": "180024 bytes"}] * 2
    assert [item["content"] for item in anna.get("/api/vehicles/gate-1").json()["events"]] == [{"why": "test"}] * 2


def test_a_token_that_nobody_has_used_is_withdrawn(running: RunningWeb) -> None:
    anna = running.visitor("anna")
    assert anna.post("/api/enrolment", {"vehicle": "car-77", "hours": 1}).status_code == 200
    (token,) = [item for item in anna.get("/api/enrolment").json()["tokens"] if item["vehicle"] == "car-77"]
    assert anna.post("/api/withdraw", {"token": token["id"]}).status_code == 200
    refused = anna.post("/api/withdraw", {"token": token["id"]})
    assert refused.status_code == 409 and "load the page again" in refused.text
    assert anna.post("/api/withdraw", {"token": "0" * 16}).status_code == 409
    assert running.rows("SELECT action, vehicle FROM audit WHERE action = 'withdrew a token'") == [
        ("withdrew a token", "car-77")
    ]


def test_errors_of_the_pages_are_counted_and_shown_to_administrators(
    running: RunningWeb, anna: Visitor, caplog: pytest.LogCaptureFixture
) -> None:
    vera = running.visitor("vera")
    before = anna.get("/api/page-errors").json()["errors"]
    error = {"page": "map", "message": "TypeError: x\nsecond line\u202e", "place": "map.js:1:2"}
    for _ in range(30):
        assert vera.post("/api/page-error", error).status_code == 202
    found = anna.get("/api/page-errors").json()
    assert found["errors"] == before + 30
    assert "TypeError" in found["newest"]["sentence"] and "\n" not in found["newest"]["sentence"]
    assert 0 < sum("TypeError" in record.message for record in caplog.records) < 10
    assert vera.get("/api/page-errors").status_code == 403
    assert vera.post("/api/page-error", {**error, "more": 1}).status_code == 422
    assert vera.post("/api/page-error", {**error, "message": "m" * 500}).status_code == 422
    assert vera.http.post("/api/page-error", json=error).status_code == 403, "a page from elsewhere"
