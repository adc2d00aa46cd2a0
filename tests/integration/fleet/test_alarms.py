"""When a centre raises and ends alarms, by a real database and as the user of its process."""

import asyncio
import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import nats
import psycopg
import pytest
from nats.aio.msg import Msg

from fleet.alarms import judge as rules
from fleet.alarms import process
from fleet.alarms.judge import (
    CALM_PERIOD_MS,
    LIMITS,
    MISSING_AFTER_MS,
    RECONNECT_TIME_MS,
    SILENT_MOVING_MS,
    SILENT_STANDING_MS,
    judge,
)
from fleet.alarms.late import Period, judge_late, periods
from fleet.alarms.process import Alarms
from fleet.alarms.web_hook import AddressPolicy
from fleet.database.erasure import erase
from fleet.database.roles import ROLES, dsn_of_process, let_in
from fleet.ingest import process as ingest
from fleet.ingest.store import Store
from fleet.servers.nats import NatsAccess
from shared.fleet.topics import ALARM
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.reports import Unit, genuine
from tests.support.fleet.web import bus
from tests.support.patience import HANGS_S

UNSAFE, SAFE = 5, 0
HOUR_MS = 3_600_000
Put = Callable[..., None]


@pytest.fixture
def now_ms() -> int:
    return time.time_ns() // 1_000_000


@pytest.fixture
def alarms_dsn(dsn: str) -> str:
    let_in(dsn, dict.fromkeys(ROLES, "a password"))
    return dsn_of_process(dsn, "alarms", "a password")


@pytest.fixture
def db(alarms_dsn: str) -> Iterator[psycopg.Connection]:
    with psycopg.connect(alarms_dsn, autocommit=True) as db:
        yield db


@pytest.fixture
def unit(dsn: str, now_ms: int) -> Unit:
    unit = Unit("car-1", 1, now_ms - HOUR_MS)
    unit.enter(dsn)
    return unit


@pytest.fixture
def put(dsn: str, now_ms: int) -> Iterator[Put]:
    """Store batches, in the order that is given."""
    store = Store(dsn)

    def put(unit: Unit, *batches: bytes) -> None:
        for item in genuine(store, unit, batches, now_ms):
            assert store.store([item])[1] == {}

    yield put
    store.close()


def on_time(unit: Unit, put: Put, verdicts: Sequence[int]) -> int:
    """Report once; gives the time of the last report."""
    put(unit, unit.positions(verdicts))
    return unit.now_ms


def told(db: psycopg.Connection) -> list[tuple[object, ...]]:
    return db.execute("SELECT kind, since_ms, until_ms FROM alarm ORDER BY since_ms").fetchall()


def test_unsafe_for_long_is_raised_once_and_ended_by_another_verdict(
    db: psycopg.Connection, unit: Unit, put: Put
) -> None:
    at_ms = on_time(unit, put, [SAFE] * 5 + [UNSAFE])
    since_ms = at_ms
    assert judge(db, at_ms, 0) == []
    at_ms = on_time(unit, put, [UNSAFE] * 59)
    assert judge(db, at_ms, 0) == [], "59 s are not long"
    at_ms = on_time(unit, put, [UNSAFE])
    raised = judge(db, at_ms, 0)
    assert [(row["kind"], row["since_ms"], row["until_ms"], row["late"]) for row in raised] == [
        ("unsafe", since_ms, None, False)
    ]
    assert judge(db, at_ms + 1000, 0) == [], "it is raised once"
    at_ms = on_time(unit, put, [UNSAFE] * 10 + [SAFE])
    ended = judge(db, at_ms + 2000, 0)
    assert [(row["alarm_id"], row["until_ms"]) for row in ended] == [(raised[0]["alarm_id"], at_ms)]
    assert judge(db, at_ms + 3000, 0) == []
    on_time(unit, put, [UNSAFE] * 61)
    assert [row["until_ms"] for row in judge(db, unit.now_ms, 0)] == [None], "another period is another alarm"


def test_a_start_of_the_process_neither_repeats_nor_ends_what_is_open(
    db: psycopg.Connection, alarms_dsn: str, unit: Unit, put: Put, now_ms: int
) -> None:
    unit.positions([SAFE])
    on_time(unit, put, [UNSAFE] * 61)
    judge(db, now_ms, 0)
    judge(db, now_ms + MISSING_AFTER_MS, 0)
    before = told(db)
    assert {kind for kind, _, until_ms in before if until_ms is None} == {"unsafe", "silent", "gap"}
    with psycopg.connect(alarms_dsn, autocommit=True) as another:
        assert judge(another, now_ms + MISSING_AFTER_MS + 1000, now_ms + MISSING_AFTER_MS) == []
        assert judge_late(another, now_ms + MISSING_AFTER_MS, 86_400.0) == []
    assert told(db) == before


@pytest.mark.parametrize(("moving", "patience_ms"), [(True, SILENT_MOVING_MS), (False, SILENT_STANDING_MS)])
def test_a_silent_vehicle_is_raised_and_ended_by_its_next_report(
    db: psycopg.Connection, dsn: str, unit: Unit, put: Put, moving: bool, patience_ms: int
) -> None:
    at_ms = on_time(unit, put, [SAFE])
    if not moving:
        with psycopg.connect(dsn) as owner:
            owner.execute("UPDATE vehicle_now SET north_m_s = 0.2, east_m_s = 0")
    assert judge(db, at_ms + patience_ms - 1, 0) == []
    raised = judge(db, at_ms + patience_ms, 0)
    assert [(row["kind"], row["since_ms"], row["late"]) for row in raised] == [("silent", at_ms, False)]
    again_ms = on_time(unit, put, [SAFE])
    judge(db, again_ms + 500, 0)
    assert told(db) == [("silent", at_ms, again_ms)]


def test_a_centre_that_was_away_gives_vehicles_the_time_to_come_back(
    db: psycopg.Connection, dsn: str, unit: Unit, put: Put, now_ms: int
) -> None:
    other = Unit("car-2", 2, now_ms - HOUR_MS)
    other.enter(dsn)
    on_time(unit, put, [SAFE])
    on_time(other, put, [SAFE])
    assert judge(db, now_ms, now_ms) == []
    unit.now_ms = now_ms + 60_000
    on_time(unit, put, [SAFE])
    assert judge(db, now_ms + RECONNECT_TIME_MS - 1, now_ms) == []
    assert [(row["kind"], row["vehicle"]) for row in judge(db, now_ms + RECONNECT_TIME_MS, now_ms)] == [
        ("silent", "car-2")
    ]


def test_the_process_counts_from_its_start_and_from_when_the_database_is_back(
    alarms_dsn: str, unit: Unit, put: Put, now_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_time(unit, put, [SAFE])
    clock_ms = [now_ms]
    monkeypatch.setattr(time, "time_ns", lambda: clock_ms[0] * 1_000_000)
    alarms = Alarms(alarms_dsn)
    try:
        assert alarms.turn() == []
        clock_ms[0] += RECONNECT_TIME_MS
        with monkeypatch.context() as away:
            away.setattr(alarms, "_dsn", "host=127.0.0.1 port=1")
            alarms.close()
            with pytest.raises(psycopg.OperationalError):
                alarms.turn()
        assert alarms.turn() == []
        clock_ms[0] += RECONNECT_TIME_MS
        assert [row["kind"] for row in alarms.turn()] == ["silent"]
    finally:
        alarms.close()


def test_the_process_publishes_what_it_raises_and_outlives_its_connection_to_the_database(
    dsn: str, alarms_dsn: str, unit: Unit, put: Put, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "RETRY_S", 0.1)
    monkeypatch.setattr(process, "PERIOD_S", 0.1)

    async def work(url: str) -> list[Any]:
        heard = list[Any]()

        async def take(message: Msg) -> None:
            heard.append(json.loads(message.data))

        client = await nats.connect(url)
        await client.subscribe(ALARM, cb=take)
        task = asyncio.create_task(process.serve(NatsAccess(url), alarms_dsn, AddressPolicy()))
        try:
            async with asyncio.timeout(20.0):
                await asyncio.to_thread(on_time, unit, put, [UNSAFE] * 61)
                while not heard:
                    await asyncio.sleep(0.05)
                with psycopg.connect(dsn, autocommit=True) as owner:
                    owner.execute(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = 'fleet_alarms'"
                    )
                await asyncio.to_thread(on_time, unit, put, [SAFE])
                while len(heard) < 2:
                    await asyncio.sleep(0.05)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            await client.close()
        return heard

    with bus() as url:
        heard = asyncio.run(work(url))
    assert [(row["vehicle"], row["kind"], row["until_ms"]) for row in heard] == [
        ("car-1", "unsafe", None), ("car-1", "unsafe", unit.now_ms),
    ]  # fmt: skip


def test_a_fleet_is_not_silent_while_no_ingest_works(
    dsn: str, alarms_dsn: str, unit: Unit, put: Put, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ingest, "BEAT_S", 0.1)
    monkeypatch.setattr(process, "PERIOD_S", 0.1)
    monkeypatch.setattr(process, "INGEST_TIMEOUT_S", 1.0)
    monkeypatch.setitem(LIMITS, "heard_ms", 500)
    on_time(unit, put, [SAFE])

    def raised() -> list[Any]:
        with psycopg.connect(dsn) as owner:
            return owner.execute("SELECT kind FROM alarm").fetchall()

    async def work(url: str) -> None:
        tasks = [asyncio.create_task(process.serve(NatsAccess(url), alarms_dsn, AddressPolicy()))]
        try:
            await asyncio.sleep(2.0)
            assert raised() == []
            tasks.append(asyncio.create_task(ingest.serve(NatsAccess(url), dsn)))
            async with asyncio.timeout(20.0):
                while raised() != [("silent",)]:
                    await asyncio.sleep(0.1)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    with bus() as url:
        asyncio.run(work(url))


def test_missing_numbers_are_a_gap_after_ten_minutes_until_they_come(
    db: psycopg.Connection, unit: Unit, put: Put
) -> None:
    lost = unit.positions([SAFE] * 3)
    at_ms = on_time(unit, put, [SAFE])
    assert judge(db, at_ms, at_ms) == []
    raised = judge(db, at_ms + MISSING_AFTER_MS, at_ms + MISSING_AFTER_MS)
    assert [(row["kind"], row["detail"]) for row in raised] == [("gap", {"missing": 3})]
    put(unit, lost)
    ended = judge(db, at_ms + MISSING_AFTER_MS + 5000, at_ms + MISSING_AFTER_MS)
    assert [row["until_ms"] for row in ended] == [at_ms + MISSING_AFTER_MS + 5000]


def test_a_gap_that_a_vehicle_states_is_told_once(db: psycopg.Connection, unit: Unit, put: Put) -> None:
    put(unit, unit.gap(0, 40))
    raised = judge(db, unit.now_ms, unit.now_ms)
    assert [(row["kind"], row["until_ms"] is None, row["detail"]["dropped"]) for row in raised] == [("gap", False, 40)]
    assert judge(db, unit.now_ms + 1000, unit.now_ms) == []


def test_however_many_gaps_a_vehicle_states_they_are_one_alarm_until_it_is_acknowledged(
    db: psycopg.Connection, dsn: str, unit: Unit, put: Put
) -> None:
    other = Unit("car-2", 2, unit.epoch_ms)
    other.enter(dsn)
    put(other, other.gap(0, 3))
    for number in range(30):
        put(unit, unit.gap(10 * number, 4))
        if number % 10 == 0:
            judge(db, unit.now_ms, unit.now_ms)
    put(unit, unit.gap(0, 14))  # two of them, and what was between
    (changed,) = judge(db, unit.now_ms, unit.now_ms)
    assert changed["vehicle"] == "car-1" and changed["detail"] == {"dropped": 30 * 4 + 6}
    assert judge(db, unit.now_ms + 1000, unit.now_ms) == []
    query = "SELECT vehicle, (detail->>'dropped')::int FROM alarm ORDER BY vehicle, alarm_id"
    assert db.execute(query).fetchall() == [("car-1", 126), ("car-2", 3)]
    db.execute("UPDATE alarm SET acknowledged = now()")
    put(unit, unit.gap(400, 9))
    judge(db, unit.now_ms, unit.now_ms)
    assert db.execute(query).fetchall() == [("car-1", 126), ("car-1", 9), ("car-2", 3)]


def test_gaps_that_ingest_holds_are_told_later_and_keep_nobody_waiting(
    db: psycopg.Connection, dsn: str, unit: Unit, put: Put
) -> None:
    put(unit, unit.gap(0, 4), unit.gap(10, 4))
    with psycopg.connect(dsn) as ingest, ingest.transaction():
        ingest.execute("SELECT FROM gap WHERE first_sequence = 0 FOR UPDATE")
        assert [row["detail"] for row in judge(db, unit.now_ms, unit.now_ms)] == [{"dropped": 4}]
    assert [row["detail"] for row in judge(db, unit.now_ms, unit.now_ms)] == [{"dropped": 8}]


def test_what_is_told_of_gaps_is_found_by_an_index(db: psycopg.Connection, unit: Unit, put: Put) -> None:
    db.execute("SET enable_seqscan = off")
    plan = db.execute(f"EXPLAIN {rules.DROPPED}".encode(), {**LIMITS, "now": 0}).fetchall()
    assert any("gap_untold" in line for (line,) in plan), plan
    assert any("alarm_vehicle" in line for (line,) in plan), plan


@pytest.mark.parametrize("late", [False, True])
def test_what_is_judged_while_a_vehicle_is_erased_leaves_no_alarm(
    db: psycopg.Connection, dsn: str, unit: Unit, put: Put, now_ms: int, late: bool
) -> None:
    put(unit, *backlog(unit, (SAFE, 10), (UNSAFE, 70), (SAFE if late else UNSAFE, 20)))
    work = (lambda: judge_late(db, now_ms, 60.0)) if late else (lambda: judge(db, unit.now_ms, now_ms))
    waiting = "SELECT FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"
    with psycopg.connect(dsn, autocommit=True) as watching, psycopg.connect(dsn) as other, other.transaction():
        assert erase(other, "car-1", "anna") is not None  # not committed
        judging = threading.Thread(target=work)
        judging.start()
        eventually(lambda: not judging.is_alive() or bool(watching.execute(waiting).fetchall()))
    judging.join(HANGS_S)
    assert told(db) == []


def test_foreign_signatures_are_over_an_hour_after_the_last_of_them(
    db: psycopg.Connection, dsn: str, unit: Unit, now_ms: int
) -> None:
    store = Store(dsn)
    forged = {("car-1", "signature"): 2}
    store.tell_forgeries(forged, now_ms)
    store.tell_forgeries(forged, now_ms + CALM_PERIOD_MS - 1)
    store.close()
    assert judge(db, now_ms + CALM_PERIOD_MS + 1, now_ms + CALM_PERIOD_MS) == []
    ended = judge(db, now_ms + 2 * CALM_PERIOD_MS, now_ms + CALM_PERIOD_MS)
    assert [(row["kind"], row["until_ms"], row["detail"]["count"]) for row in ended] == [
        ("signature", now_ms + CALM_PERIOD_MS - 1, 4)
    ]


def backlog(unit: Unit, *seconds: tuple[int, int]) -> list[bytes]:
    """Batches as an outbox makes them: of ten seconds, and one at each change of the verdict."""
    made, verdicts, before = list[bytes](), list[int](), SAFE
    for verdict, count in seconds:
        for _ in range(count):
            verdicts.append(verdict)
            if verdict != before or len(verdicts) == 10:
                made.append(unit.positions(verdicts))
                verdicts, before = [], verdict
    return [*made, unit.positions(verdicts)] if verdicts else made


def test_unsafe_within_a_backlog_is_told_with_its_times_when_all_of_it_is_there(
    db: psycopg.Connection, unit: Unit, put: Put, now_ms: int
) -> None:
    start_ms = unit.now_ms
    made = backlog(unit, (SAFE, 25), (UNSAFE, 90), (SAFE, 12), (UNSAFE, 30), (SAFE, 20))
    put(unit, made[-1], *made[:6])
    assert judge(db, now_ms, now_ms) == [] and judge_late(db, now_ms, 60.0) == [], "numbers are missing"
    put(unit, *reversed(made))
    raised = judge_late(db, now_ms, 60.0)
    assert [(row["kind"], row["since_ms"], row["until_ms"], row["late"]) for row in raised] == [
        ("unsafe", start_ms + 26_000, start_ms + 116_000, True)
    ]
    assert judge_late(db, now_ms, 86_400.0) == [], "a start looks at it again, and finds it told"


def test_unsafe_that_begins_in_a_backlog_and_lasts_is_one_alarm_from_its_beginning(
    db: psycopg.Connection, unit: Unit, put: Put, now_ms: int
) -> None:
    unit.now_ms = start_ms = now_ms - 300_000
    made = backlog(unit, (SAFE, 20), (UNSAFE, 270))
    put(unit, made[-1], *made[:-1])
    assert judge(db, unit.now_ms, now_ms) == [], "the newest batch alone is not long"
    assert [(row["since_ms"], row["until_ms"]) for row in judge_late(db, now_ms, 60.0)] == [(start_ms + 21_000, None)]
    assert judge(db, unit.now_ms, now_ms) == []
    end_ms = on_time(unit, put, [UNSAFE] * 3 + [SAFE])
    judge(db, end_ms, now_ms)
    assert told(db) == [("unsafe", start_ms + 21_000, end_ms)]


def test_an_alarm_whose_end_was_not_known_has_its_own_end_when_the_backlog_is_there(
    db: psycopg.Connection, unit: Unit, put: Put, now_ms: int
) -> None:
    begin_ms = unit.now_ms + 1000
    first = backlog(unit, (UNSAFE, 71))
    put(unit, *first)
    assert len(judge(db, unit.now_ms, now_ms)) == 1
    made = backlog(unit, (UNSAFE, 50), (SAFE, 600), (UNSAFE, 80), (SAFE, 10))
    put(unit, made[-1])
    judge(db, now_ms, now_ms)
    put(unit, *made)
    judge_late(db, now_ms, 60.0)
    found = told(db)
    assert [since_ms for _, since_ms, _ in found] == [begin_ms, begin_ms + 721_000]
    assert found[0][2] == begin_ms + 121_000 and found[1][2] == begin_ms + 801_000


def test_periods_of_batches() -> None:
    assert list(periods([])) == []
    assert list(periods([(1, 0), (2, 5), (3, 5), (4, 1), (5, 5)])) == [Period(2, 3, False), Period(5, 5, True)]
