"""A page of one tenant never sees what another one has."""

import json
import time
from contextlib import ExitStack

import psycopg
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from fleet.web import live
from fleet.web.database import OPTIONS
from fleet.web.watch import gate
from tests.support.fleet.reports import Unit
from tests.support.fleet.web import RunningWeb, Visitor
from tests.support.patience import HANGS_S

TABLES = (
    "tenant", "vehicle", "certificate", "segment", "gap", "epoch", "set_aside", "vehicle_now", "event", "alarm",
    "account", "audit",
)  # fmt: skip
NOW_MS = time.time_ns() // 1_000_000


@pytest.fixture(scope="module")
def units(running: RunningWeb) -> list[Unit]:
    mine, theirs = Unit("mine-1", 1, NOW_MS), Unit("theirs-1", 2, NOW_MS)
    mine.enter(running.dsn)
    theirs.enter(running.dsn, "other")
    for unit in (mine, theirs):
        running.report(unit, 0, 0, 5)
        running.send(unit.vehicle, unit.events("trust/event"))
        running.wait_for("SELECT 1 FROM event WHERE vehicle = %s", unit.vehicle)
    return [mine, theirs]


def test_lists_vehicles_tiles_and_tracks_are_of_the_own_tenant(running: RunningWeb, units: list[Unit]) -> None:
    demo, other = running.visitor("anna"), running.visitor("olga")
    for visitor, seen, hidden in ((demo, "mine-1", "theirs-1"), (other, "theirs-1", "mine-1")):
        listed = visitor.get("/api/vehicles").json()
        assert [row["vehicle"] for row in listed["vehicles"]] == [seen]
        assert sum(row["vehicles"] for row in listed["counts"]) == 1
        tile = visitor.get("/tiles/0/0/0.mvt").content
        assert seen.encode() in tile and hidden.encode() not in tile
        assert visitor.get(f"/api/vehicles/{hidden}").status_code == 404
        assert visitor.get(f"/api/vehicles/{hidden}/trail").json()["time_ms"] == []
        assert visitor.get(f"/vehicles/{hidden}/live/").status_code == 404
        assert visitor.post("/api/revoke", {"vehicle": hidden}).status_code == 404
        assert hidden not in visitor.get("/api/enrolment").text
        assert hidden not in visitor.get("/api/audit").text


def test_the_role_of_the_pages_sees_no_row_without_a_tenant_and_none_of_another(
    running: RunningWeb, units: list[Unit]
) -> None:
    with psycopg.connect(running.dsn, options=OPTIONS, autocommit=True) as db:
        for table in TABLES:
            column = "name" if table == "account" else "1"
            assert db.execute(f"SELECT {column} FROM {table}".encode()).fetchall() == [], table
    with psycopg.connect(running.dsn, options=OPTIONS) as db:
        db.execute("SELECT set_config('fleet.tenant', '1', true)")
        assert db.execute("SELECT vehicle FROM vehicle").fetchall() == [("mine-1",)]
        with pytest.raises(psycopg.errors.InsufficientPrivilege):
            db.execute("INSERT INTO audit (tenant_id, who, action) VALUES (2, 'anna', 'forged')")
    with psycopg.connect(running.dsn, options=OPTIONS) as db, pytest.raises(psycopg.errors.InsufficientPrivilege):
        db.execute("SELECT password FROM account")


def test_the_pages_cannot_change_evidence_or_the_audit(running: RunningWeb, units: list[Unit]) -> None:
    for change in (
        "DELETE FROM segment", "UPDATE segment SET verdict = 0", "DELETE FROM event", "DELETE FROM audit",
        "UPDATE audit SET who = 'x'", "UPDATE vehicle_now SET verdict = 0", "UPDATE tenant SET name = 'x'",
        "DELETE FROM gap", "UPDATE certificate SET public_key = ''", "UPDATE alarm SET until_ms = 1",
    ):  # fmt: skip
        with (
            psycopg.connect(running.dsn, options=OPTIONS) as db,
            pytest.raises(psycopg.errors.InsufficientPrivilege),
        ):
            db.execute("SELECT set_config('fleet.tenant', '1', true)")
            db.execute(change.encode())


def test_a_tenant_watches_its_share_of_vehicles_and_leaves_the_others_theirs(
    running: RunningWeb, units: list[Unit], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "LINGER_S", HANGS_S)
    anna, olga = running.visitor("anna"), running.visitor("olga")
    for number in range(gate.MOST_OF_TENANT + 1):
        Unit(f"share-{number}", 50 + number).enter(running.dsn)
    for number in range(gate.MOST_OF_TENANT):
        assert anna.get(f"/vehicles/share-{number}/live/").status_code == 200
    refused = anna.get(f"/vehicles/share-{gate.MOST_OF_TENANT}/live/")
    assert refused.status_code == 503 and refused.json()["detail"] == gate.SHARE
    assert anna.get("/vehicles/share-0/live/").status_code == 200, "one that is watched has its place"
    assert olga.get("/vehicles/theirs-1/live/").status_code == 200


def test_a_tenant_opens_its_share_of_pages_and_leaves_the_others_theirs(
    running: RunningWeb, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "MOST_OF_TENANT", 3)
    anna, olga = running.visitor("anna"), running.visitor("olga")
    with ExitStack() as stack:

        def opened(visitor: Visitor) -> ClientConnection:
            headers = {"Cookie": f"obu-centre={visitor.http.cookies['obu-centre']}"}
            address = running.address.replace("http", "ws") + "/ws"
            return stack.enter_context(connect(address, additional_headers=headers))

        for _ in range(3):
            assert json.loads(opened(anna).recv(timeout=HANGS_S))["bus"]
        with pytest.raises(ConnectionClosed, match="too many pages of this tenant are open; close one"):
            opened(anna).recv(timeout=HANGS_S)
        assert json.loads(opened(olga).recv(timeout=HANGS_S))["bus"]
