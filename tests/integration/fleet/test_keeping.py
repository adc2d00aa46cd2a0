"""Rights of the processes at the database, retention, and erasure."""

import threading
import time
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta

import psycopg
import pytest

from fleet.database.erasure import ErasureReport, erase
from fleet.database.maintenance import prepare
from fleet.database.migrate import migrate
from fleet.database.retention import RetentionReport, make_days, retain
from fleet.database.roles import ROLES, dsn_of_process, let_in
from fleet.ingest.keys import Keys
from fleet.ingest.store import Store
from fleet.ingest.verification import ReceivedBytes, VerifiedBatch, verified
from fleet.servers.postgres import Postgres
from tests.support.fleet.reports import Unit
from tests.support.fleet.web import tenant
from tests.support.patience import HANGS_S

PASSWORDS = {name: f"of-{name}" for name in ROLES}
DAY_MS = 86_400_000
TODAY = datetime(2026, 5, 20, tzinfo=UTC).date()
INSERT = (
    "INSERT INTO segment (day, vehicle, epoch, first_sequence, count, kind, from_ms, to_ms, tenant_id, digest, "
    "content) VALUES (%s, %s, 1, %s, 10, 0, 0, 0, %s, %s, 'x')"
)


@pytest.fixture
def as_process(dsn: str) -> dict[str, str]:
    """DSN of each process, which logs in by its password."""
    let_in(dsn, PASSWORDS)
    return {name: dsn_of_process(dsn, name, password) for name, password in PASSWORDS.items()}


@pytest.fixture
def owner(dsn: str) -> Iterator[psycopg.Connection]:
    with psycopg.connect(dsn, autocommit=True) as db:
        yield db


def put(db: psycopg.Connection, day: date, tenant_id: int, number: int = 0, vehicle: str = "car-1") -> None:
    db.execute("SELECT ensure_segment_day(%s)", (day,))
    db.execute(INSERT, (day, vehicle, number, tenant_id, f"{vehicle} {day} {number}".encode()))


def put_event(db: psycopg.Connection, day: date, tenant_id: int, name: str, number: int = 0) -> None:
    at_ms = round(datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp() * 1000)
    db.execute(
        "INSERT INTO event (vehicle, epoch, sequence, tenant_id, utc_ms, name, content) "
        "VALUES ('car-1', 1, %s, %s, %s, %s, '{}')",
        (number, tenant_id, at_ms, name),
    )


def days_of(db: psycopg.Connection) -> set[str]:
    query = "SELECT relname FROM pg_class JOIN pg_inherits ON inhrelid = oid WHERE inhparent = 'segment'::regclass"
    return {row[0] for row in db.execute(query)}


def test_days_are_those_of_utc_whatever_the_time_zone_of_the_server(dsn: str, owner: psycopg.Connection) -> None:
    short, _ = tenant(dsn, "short", {}), tenant(dsn, "long", {})
    owner.execute("UPDATE tenant SET retention_days = 10 WHERE tenant_id = %s", (short,))
    for age in (10, 11):
        put(owner, TODAY - timedelta(days=age), short, age)
    owner.execute("ALTER DATABASE fleet SET timezone = 'America/New_York'")
    try:
        assert retain(dsn, TODAY) == RetentionReport(0, 1)
    finally:
        owner.execute("ALTER DATABASE fleet RESET timezone")
    assert owner.execute("SELECT first_sequence FROM segment").fetchall() == [(10,)]


def test_migrations_may_run_again_and_at_once(dsn: str) -> None:
    threads = [threading.Thread(target=prepare, args=(dsn, PASSWORDS)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    migrate(dsn)
    with psycopg.connect(dsn) as db:
        assert db.execute("SELECT count(*) FROM alembic_version").fetchone() == (1,)
        assert db.execute("SELECT name FROM tenant").fetchall() == [("demo",)]


def test_a_wrong_password_does_not_log_in(as_process: dict[str, str], dsn: str) -> None:
    for name in as_process:
        with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
            psycopg.connect(dsn_of_process(dsn, name, "guessed"))


def test_the_owner_logs_in_without_a_password_as_the_user_of_this_machine_alone(postgres: Postgres) -> None:
    with pytest.raises(psycopg.OperationalError):
        psycopg.connect(f"{postgres.place} user=postgres")


@pytest.mark.parametrize(
    ("process", "statement"),
    [
        ("web", "UPDATE tenant SET retention_days = 1"),
        ("web", "UPDATE enrolment SET used = NULL"),
        ("web", "SELECT password FROM account"),
        ("web", "SELECT token_hash FROM enrolment"),
        ("web", "INSERT INTO vehicle (vehicle, tenant_id) VALUES ('car-x', 1)"),
        ("web", "DELETE FROM audit"),
        ("web", "SELECT ensure_segment_day('2026-01-01')"),
        ("web", "CREATE TEMPORARY TABLE account (name text)"),
        ("ingest", "SELECT * FROM account"),
        ("ingest", "INSERT INTO certificate SELECT * FROM certificate"),
        ("ingest", "DELETE FROM segment"),
        ("ingest", "DELETE FROM erased_batch"),
        ("web", "SELECT * FROM erased_batch"),
        ("ingest", "SELECT * FROM enrolment"),
        ("ingest", "CREATE TABLE other (name text)"),
        ("admission", "SELECT * FROM segment"),
        ("admission", "UPDATE certificate SET revoked = NULL"),
        ("admission", "UPDATE enrolment SET expires = now() + interval '1 year'"),
        ("admission", "SELECT * FROM account"),
        ("alarms", "SELECT * FROM account"),
        ("alarms", "DELETE FROM event"),
        ("alarms", "SELECT content FROM segment"),
        ("alarms", "SELECT login_account('admin')"),
    ],
)
def test_a_process_may_no_more_than_it_needs(as_process: dict[str, str], process: str, statement: str) -> None:
    with psycopg.connect(as_process[process]) as db, pytest.raises(psycopg.errors.InsufficientPrivilege):
        db.execute(statement.encode())


def test_ingest_stores_as_its_own_user(as_process: dict[str, str], dsn: str) -> None:
    unit = Unit("car-1", 1)
    unit.enter(dsn)
    store = Store(as_process["ingest"])
    keys = Keys(store.keys)
    keys.load({unit.signer.key_id})
    made = unit.positions((0, 5)), unit.events("trust/event"), unit.gap(20, 5), unit.gap(10, 30)
    arrived = [ReceivedBytes.of("car-1", data) for data in made]
    found = [verified(item, keys.find(unit.signer.key_id), unit.now_ms) for item in arrived]
    changed, refused = store.store([genuine for genuine in found if isinstance(genuine, VerifiedBatch)])
    store.tell_forgeries({("car-1", "signature"): 1}, unit.now_ms)
    store.close()
    assert (changed[0]["vehicle"], refused) == ("car-1", {})
    tables = "segment", "event", "gap", "alarm"
    with psycopg.connect(dsn) as db:
        counts = [db.execute(f"SELECT count(*) FROM {table}".encode()).fetchone() for table in tables]
    assert counts == [(2,), (1,), (1,), (1,)], "a gap that is part of a larger one has gone"


def test_the_pages_see_the_tenant_of_their_transaction_and_nothing_of_another(
    as_process: dict[str, str], dsn: str, owner: psycopg.Connection
) -> None:
    mine, other = tenant(dsn, "mine", {}), tenant(dsn, "other", {"olga": "admin"})
    for number, tenant_id in enumerate((mine, other)):
        put(owner, TODAY, tenant_id, number, f"car-{tenant_id}")
        put_event(owner, TODAY, tenant_id, "trust/event", number)
    with psycopg.connect(as_process["web"]) as db:
        assert db.execute("SELECT count(*) FROM segment").fetchone() == (0,)
        db.execute("SELECT set_config('fleet.tenant', %s, true)", (str(mine),))
        assert db.execute("SELECT vehicle FROM segment").fetchall() == [(f"car-{mine}",)]
        assert db.execute("SELECT tenant_id FROM event").fetchall() == [(mine,)]
        assert db.execute("SELECT name FROM account").fetchall() == []
        with pytest.raises(psycopg.errors.InsufficientPrivilege):
            db.execute("INSERT INTO audit (tenant_id, who, action) VALUES (%s, 'me', 'forged')", (other,))
    with psycopg.connect(as_process["web"]) as db, pytest.raises(psycopg.errors.InsufficientPrivilege):
        db.execute(f"SELECT * FROM segment_{TODAY:%Y%m%d}".encode())  # a partition has no policy of its own


def test_days_are_there_before_their_first_batch(dsn: str, owner: psycopg.Connection) -> None:
    make_days(dsn, TODAY)
    assert {f"segment_{TODAY + timedelta(days=ahead):%Y%m%d}" for ahead in range(-1, 8)} <= days_of(owner)


@pytest.mark.parametrize("day", ["2019-12-31", "2100-01-02"])
def test_no_partition_is_made_for_an_impossible_day(as_process: dict[str, str], day: str) -> None:
    with psycopg.connect(as_process["ingest"]) as db, pytest.raises(psycopg.errors.RaiseException, match="possible"):
        db.execute("SELECT ensure_segment_day(%s)", (day,))


def test_each_tenant_keeps_its_own_number_of_days_and_charges_apart(dsn: str, owner: psycopg.Connection) -> None:
    long, short = tenant(dsn, "long", {}), tenant(dsn, "short", {})
    owner.execute("UPDATE tenant SET retention_days = 90 WHERE tenant_id = %s", (long,))
    owner.execute("UPDATE tenant SET retention_days = 10, toll_retention_days = 60 WHERE tenant_id = %s", (short,))
    for number, (age, tenant_id) in enumerate((age, item) for item in (long, short) for age in (5, 50, 95)):
        put(owner, TODAY - timedelta(days=age), tenant_id, number)
        put_event(owner, TODAY - timedelta(days=age), tenant_id, "trust/event", 2 * number)
        put_event(owner, TODAY - timedelta(days=age), tenant_id, "toll/transaction", 2 * number + 1)
    removed = retain(dsn, TODAY)
    kept = owner.execute("SELECT tenant_id, %s - day FROM segment ORDER BY 1, 2", (TODAY,)).fetchall()
    assert kept == [(long, 5), (long, 50), (short, 5)]
    assert removed.rows == 1 + 1 + 2 + 1  # segment of short; events of long and of short; a charge of short
    names = owner.execute("SELECT tenant_id, name, count(*) FROM event GROUP BY 1, 2 ORDER BY 1, 2").fetchall()
    assert names == [
        (long, "toll/transaction", 3), (long, "trust/event", 2), (short, "toll/transaction", 2),
        (short, "trust/event", 1),
    ]  # fmt: skip
    assert retain(dsn, TODAY) == RetentionReport(0, 0)


def test_the_last_position_of_a_silent_vehicle_goes_with_the_retention_of_its_tenant(
    dsn: str, owner: psycopg.Connection
) -> None:
    long, short = tenant(dsn, "long", {}), tenant(dsn, "short", {})
    owner.execute("UPDATE tenant SET retention_days = 10 WHERE tenant_id = %s", (short,))
    at_ms = round(datetime(TODAY.year, TODAY.month, TODAY.day, tzinfo=UTC).timestamp() * 1000)
    # Of each vehicle: tenant, days since its last report, and since its last position.
    for name, tenant_id, age, place_age in (
        ("of-long", long, 50, 50), ("silent", short, 11, 11), ("placeless", short, 1, 11), ("kept", short, 9, 9),
    ):  # fmt: skip
        owner.execute("INSERT INTO vehicle (vehicle, tenant_id) VALUES (%s, %s)", (name, tenant_id))
        owner.execute(
            "INSERT INTO vehicle_now (vehicle, tenant_id, epoch, sequence, utc_ms, position_ms, latitude_deg, "
            "longitude_deg, height_m, verdict, verdict_since_ms) VALUES (%s, %s, 1, 1, %s, %s, 48, 11, 500, 0, 1)",
            (name, tenant_id, at_ms - age * DAY_MS, at_ms - place_age * DAY_MS),
        )
    assert retain(dsn, TODAY) == RetentionReport(0, 1)
    query = "SELECT vehicle, latitude_deg, longitude_deg, height_m, x_m IS NULL FROM vehicle_now ORDER BY 1"
    assert owner.execute(query).fetchall() == [
        ("kept", 48, 11, 500, False), ("of-long", 48, 11, 500, False), ("placeless", None, None, None, True),
    ]  # fmt: skip
    assert owner.execute("SELECT count(*) FROM vehicle").fetchone() == (4,), "it stays enrolled"


def test_a_day_is_dropped_while_ingest_inserts_into_others(dsn: str, owner: psycopg.Connection) -> None:
    tenant_id = tenant(dsn, "demo", {})
    put(owner, TODAY - timedelta(days=400), tenant_id)
    put(owner, TODAY, tenant_id, 1)
    with psycopg.connect(dsn) as inserting:  # holds its locks until the end of the transaction
        inserting.execute(INSERT, (TODAY, "car-2", 0, tenant_id, b"2"))
        removing = threading.Thread(target=retain, args=(dsn, TODAY))
        removing.start()
        waits = (
            "SELECT count(*) FROM pg_stat_activity WHERE query LIKE 'ALTER TABLE%CONCURRENTLY' "
            "AND wait_event_type = 'Lock'"
        )
        deadline = time.monotonic() + HANGS_S
        while owner.execute(waits).fetchone() == (0,):
            assert time.monotonic() < deadline, "the removal has not begun"
        owner.execute("SET statement_timeout = '5s'")
        owner.execute(INSERT, (TODAY, "car-3", 0, tenant_id, b"3"))  # another ingest goes on meanwhile
        inserting.commit()
    removing.join(HANGS_S)
    assert not removing.is_alive()
    assert f"segment_{TODAY - timedelta(days=400):%Y%m%d}" not in days_of(owner)
    assert owner.execute("SELECT count(*) FROM segment").fetchone() == (3,)


def test_a_removal_that_was_interrupted_is_completed_and_its_day_can_come_back(
    dsn: str, as_process: dict[str, str], owner: psycopg.Connection
) -> None:
    tenant_id = tenant(dsn, "demo", {})
    old = TODAY - timedelta(days=400)
    put(owner, old, tenant_id)
    owner.execute(f"ALTER TABLE segment DETACH PARTITION segment_{old:%Y%m%d} CONCURRENTLY".encode())
    with psycopg.connect(as_process["ingest"]) as db:  # a late batch of that day comes before the table is dropped
        db.execute("SELECT ensure_segment_day(%s)", (old,))
    put(owner, old, tenant_id, 1)
    assert owner.execute("SELECT first_sequence FROM segment").fetchall() == [(1,)]
    owner.execute(f"ALTER TABLE segment DETACH PARTITION segment_{old:%Y%m%d} CONCURRENTLY".encode())
    retain(dsn, TODAY)
    assert owner.execute("SELECT to_regclass(%s)", (f"segment_{old:%Y%m%d}",)).fetchone() == (None,)


def test_an_erased_vehicle_leaves_its_chain_its_keys_and_charges_and_nothing_that_tells_where_it_was(
    dsn: str, owner: psycopg.Connection
) -> None:
    unit = Unit("car-1", 1)
    unit.enter(dsn)
    tenant_id = tenant(dsn, "demo", {})
    put(owner, TODAY, tenant_id)
    put(owner, TODAY, tenant_id, 0, "car-2")
    put_event(owner, TODAY, tenant_id, "trust/event", 0)
    put_event(owner, TODAY, tenant_id, "toll/transaction", 1)
    owner.execute(
        "INSERT INTO vehicle_now (vehicle, tenant_id, epoch, sequence, utc_ms, verdict, verdict_since_ms) "
        "VALUES ('car-1', %s, 1, 1, 1, 0, 1)",
        (tenant_id,),
    )
    assert erase(owner, "car-1", "anna") == ErasureReport(1, 1, 1)
    assert owner.execute("SELECT vehicle FROM segment").fetchall() == [("car-2",)]
    assert owner.execute("SELECT count(*) FROM vehicle_now").fetchone() == (0,)
    assert owner.execute("SELECT name FROM event").fetchall() == [("toll/transaction",)]
    chain = owner.execute("SELECT vehicle, epoch, first_sequence, count, digest FROM erased_batch").fetchall()
    assert chain == [("car-1", 1, 0, 10, f"car-1 {TODAY} 0".encode())]
    assert owner.execute("SELECT count(*) FROM certificate WHERE vehicle = 'car-1'").fetchone() == (1,)
    assert owner.execute("SELECT who, action, vehicle FROM audit").fetchall() == [("anna", "erased", "car-1")]
    assert erase(owner, "car-9", "anna") is None
