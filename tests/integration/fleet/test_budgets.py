"""A vehicle, or a whole tenant, that floods: budgets, receipts that are withheld, the alarm, and who is beside it."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable

import psycopg
import pytest
from nats.aio.msg import Msg

from fleet.alarms.judge import CALM_PERIOD_MS, judge
from fleet.database.roles import ROLES, dsn_of_process, let_in
from fleet.ingest.budgets import DAY_S, MB, ROW_BYTES, TENANT, VEHICLE, Budgets
from fleet.ingest.keys import Limits
from fleet.ingest.process import Ingest
from fleet.ingest.store import Store
from fleet.ingest.verification import ReceivedBytes
from fleet.ingest.waiting import MAX_BATCHES, VEHICLE_SHARE, TenantQueue
from shared.fleet.batch import Batch, Event, Kind
from shared.fleet.receipts import Receipt
from tests.support.fleet.reports import START_MS, Unit

NOW_MS = START_MS + 3_600_000
Make = Callable[[Unit], bytes]


class Receipts:
    """Takes what ingest publishes."""

    def __init__(self) -> None:
        self.stored, self.refused = Counter[str](), Counter[str]()

    async def publish(self, subject: str, content: bytes) -> None:
        if subject.endswith(".uplink.receipt"):
            receipt = Receipt.decode(content)
            self.stored[subject.split(".")[1]] += len(receipt.stored)
            self.refused[subject.split(".")[1]] += len(receipt.refused)


@pytest.fixture
def ingest_dsn(dsn: str) -> str:
    let_in(dsn, dict.fromkeys(ROLES, "a password"))
    with psycopg.connect(dsn) as db:
        db.execute("INSERT INTO tenant (name, vehicle_mb_day) VALUES ('demo', 1), ('other', 50)")
    return dsn_of_process(dsn, "ingest", "a password")


def large_event(unit: Unit) -> bytes:
    events = tuple(Event(unit.now_ms, "core/state", {"text": "a" * 1000}) for _ in range(100))
    return unit._made(Batch(Kind.EVENTS, unit.epoch_ms, unit.next, 100, unit.previous, events=events))


def many_positions(unit: Unit) -> bytes:
    return unit.positions([0] * 600)


def gap(unit: Unit) -> bytes:
    unit.next += 1000
    unit.now_ms += 1
    return unit.gap(unit.next, 10)


def charge(unit: Unit) -> bytes:
    content = {"passage_id": f"p{unit.next}", "evidence": "e" * 3000}
    event = Event(unit.now_ms, "toll/transaction", content)
    return unit._made(Batch(Kind.EVENTS, unit.epoch_ms, unit.next, 1, unit.previous, events=(event,)))


def junk(unit: Unit) -> bytes:
    unit.next += 1
    return b"%d" % unit.next + bytes(2000)


async def drive(ingest: Ingest, sent: Iterable[tuple[str, bytes]]) -> None:
    """Let batches arrive as NATS hands them over, and store them group by group."""
    for number, (vehicle, data) in enumerate(sent):
        await ingest._take(Msg(None, f"obu.{vehicle}.uplink.batch", data=data))  # type: ignore[arg-type]
        if number % 10 == 9:
            await ingest._store_group(ingest._waiting.take(500))
    await ingest._store_group(ingest._waiting.take(500))
    if ingest._withheld:
        await ingest._tell_floods()


@pytest.mark.parametrize("make", [large_event, many_positions, gap, charge])
def test_a_flood_of_any_kind_is_withheld_and_an_honest_vehicle_beside_it_is_stored(
    dsn: str, ingest_dsn: str, make: Make
) -> None:
    flood, honest = Unit("flood", 1), Unit("honest", 2)
    flood.enter(dsn)
    honest.enter(dsn, "other")
    heard, store = Receipts(), Store(ingest_dsn)
    ingest = Ingest(heard, store, lambda: NOW_MS)  # type: ignore[arg-type]
    number = 600
    sent = [pair for _ in range(number) for pair in (("flood", make(flood)), ("honest", honest.positions()))]
    asyncio.run(drive(ingest, sent))
    store.close()
    limit = 0.1 * MB + 262_144  # of the budget at once, and one batch beyond it
    with psycopg.connect(dsn) as db:
        assert heard.stored["flood"] < number / 2, "all is receipted"
        assert heard.stored["flood"] * ROW_BYTES < limit
        row = db.execute("SELECT coalesce(sum(octet_length(content::text)), 0) FROM event").fetchone()
        assert row is not None and row[0] < limit
        alarms = db.execute("SELECT vehicle, kind, detail->>'budget', (detail->>'withheld')::int FROM alarm").fetchall()
        assert [alarm for alarm in alarms if alarm[0] == "flood"] == [
            ("flood", "flood", VEHICLE, number - heard.stored["flood"])
        ]
        assert not [alarm for alarm in alarms if alarm[0] == "honest"]
    assert heard.stored["honest"] == number


def test_what_a_vehicle_has_not_signed_is_answered_within_its_budget_only(dsn: str, ingest_dsn: str) -> None:
    flood = Unit("flood", 1)
    flood.enter(dsn)
    heard, store = Receipts(), Store(ingest_dsn)
    ingest = Ingest(heard, store, lambda: NOW_MS)  # type: ignore[arg-type]
    most = round(0.1 * Limits().vehicle_mb * MB / 2000)  # no key is known, and with it no tenant
    asyncio.run(drive(ingest, (("flood", junk(flood)) for _ in range(2 * most))))
    store.close()
    assert 0 < heard.refused["flood"] <= most
    with psycopg.connect(dsn) as db:
        assert db.execute("SELECT kind FROM alarm").fetchall() == [("flood",)]


def test_the_alarm_ends_an_hour_after_the_last_batch_that_was_withheld(dsn: str, ingest_dsn: str) -> None:
    Unit("car-1").enter(dsn)
    store = Store(ingest_dsn)
    store.tell_floods({("car-1", VEHICLE): 3}, NOW_MS)
    store.tell_floods({("car-1", TENANT): 4}, NOW_MS + 1000)
    store.close()
    with psycopg.connect(dsn, autocommit=True) as db:
        query = "SELECT detail, until_ms FROM alarm"
        detail = {"budget": TENANT, "withheld": 7, "last_ms": NOW_MS + 1000}
        assert db.execute(query).fetchall() == [(detail, None)]
        assert judge(db, NOW_MS + CALM_PERIOD_MS, NOW_MS) == []
        assert [row["kind"] for row in judge(db, NOW_MS + CALM_PERIOD_MS + 2000, NOW_MS)] == ["flood"]


def test_a_week_of_honest_reports_is_taken_within_an_hour() -> None:
    budgets, at_s = Budgets(), 0.0
    batch_bytes = ROW_BYTES + 400  # ten reports of one second each
    for _ in range(7 * 86_400 // 10):
        while budgets.withheld("car-1", 1, Limits(), batch_bytes, at_s) is not None:
            at_s += 0.01
    assert at_s < 3600.0
    for _ in range(360):  # and goes on to report, an hour
        at_s += 10.0
        assert budgets.withheld("car-1", 1, Limits(), batch_bytes, at_s) is None


def test_a_vehicle_that_floods_for_days_stores_its_budget_of_a_day_and_what_it_had_left() -> None:
    budgets, limits, days = Budgets(), Limits(vehicle_mb=50), 10
    stored = 0
    for second in range(0, days * 86_400, 20):
        while budgets.withheld("car-1", 1, limits, 65_536, float(second)) is None:
            stored += 65_536
    assert stored == pytest.approx((days + 3) * 50 * MB, rel=0.01)


def test_vehicles_of_one_tenant_that_flood_together_stop_neither_another_tenant_nor_who_reports_as_usual() -> None:
    budgets, limits = Budgets(), Limits(vehicle_mb=50, tenant_mb=1000)
    stored, usual = 0, 0
    for second in range(2 * round(DAY_S)):
        if second % 10 == 0:
            usual += budgets.withheld("usual", 1, limits, 656, float(second)) is None
            assert budgets.withheld("elsewhere", 2, limits, 656, float(second)) is None
        for number in range(100):
            if second % 600 == 0 and budgets.withheld(f"flood-{number}", 1, limits, 2_000_000, float(second)) is None:
                stored += 2_000_000
    assert usual == 2 * DAY_S / 10
    assert stored < (3 + 2) * 1000 * MB
    asked = [budgets.withheld(f"flood-{number}", 1, limits, 1_000_000, 2 * DAY_S) for number in range(100)]
    assert TENANT in asked


def test_a_budget_that_is_changed_holds_at_once() -> None:
    budgets = Budgets()
    assert budgets.withheld("car-1", 1, Limits(1, 1000), 100_001, 0.0) is None
    assert budgets.withheld("car-1", 1, Limits(1, 1000), 1, 0.0) == VEHICLE
    assert budgets.is_empty("car-1", 0.0)
    assert budgets.withheld("car-1", 1, Limits(100, 1000), 1, 1.0) is None


def test_a_tenant_leaves_room_and_turns_to_others_whatever_it_sends() -> None:
    waiting = TenantQueue()
    for number in range(MAX_BATCHES):
        for _ in range(VEHICLE_SHARE):
            waiting.add(1, ReceivedBytes(f"flood-{number}", b"", None))
    assert len(waiting) == MAX_BATCHES / 2
    assert all(waiting.add(2, ReceivedBytes("honest", bytes([n]), None)) for n in range(4))
    group = [arrived for arrived in waiting.take(20) if arrived.vehicle == "honest"]
    assert [arrived.data for arrived in group] == [b"\0", b"\1", b"\2", b"\3"]
    assert len(waiting.take(MAX_BATCHES)) == MAX_BATCHES / 2 - 16 and len(waiting) == 0
    assert waiting.add(1, ReceivedBytes("flood-1", b"", None))
