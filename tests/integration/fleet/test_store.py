"""What ingest stores in a real PostgreSQL: each batch once, and the newest report of each vehicle."""

import asyncio
import contextlib
import random
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import permutations

import psycopg
import pytest
from nats.aio.msg import Msg

from benchmarks import fuzz_fleet
from fleet.alarms.judge import judge
from fleet.database.erasure import ErasureReport, erase
from fleet.database.retention import make_days, retain
from fleet.ingest.keys import Keys
from fleet.ingest.process import GROUP, Ingest
from fleet.ingest.store import MAX_EPOCHS, Changed, DatabaseUnavailable, Store
from fleet.ingest.verification import ReceivedBytes, VerifiedBatch, verified
from fleet.ingest.waiting import VEHICLE_SHARE
from shared.fleet.batch import BadBatch
from shared.fleet.receipts import RejectedBatch, StoredBatch
from shared.fleet.sealed import chain_digest
from tests.support.fleet.reports import START_MS, Unit, genuine
from tests.support.patience import HANGS_S

DAY_MS = 86_400_000


def rows(dsn: str, query: str) -> list[tuple[object, ...]]:
    with psycopg.connect(dsn) as db:
        return db.execute(query).fetchall()


@pytest.fixture
def unit(dsn: str) -> Unit:
    unit = Unit("car-1")
    unit.enter(dsn)
    return unit


@pytest.fixture
def store(dsn: str) -> Iterator[Store]:
    store = Store(dsn)
    yield store
    store.close()


def test_repeated_and_reordered_batches_are_stored_once(dsn: str, store: Store, unit: Unit) -> None:
    batches = [unit.positions([0] * 10) for _ in range(20)] + [unit.events("trust/event", "outage/event")]
    sent = genuine(store, unit, [*batches, *batches[::3]])
    random.Random(1).shuffle(sent)
    for begin in range(0, len(sent), 7):
        _, refused = store.store(sent[begin : begin + 7])
        assert refused == {}
    assert rows(dsn, "SELECT count(*), sum(count) FROM segment") == [(21, 202)]
    assert rows(dsn, "SELECT received, lost, highest FROM epoch") == [(202, 0, 202)]
    assert rows(dsn, "SELECT count(*) FROM event") == [(2,)]
    assert rows(dsn, "SELECT sequence, utc_ms, latitude_deg FROM vehicle_now") == [(199, START_MS + 200_000, 48.100019)]


def test_the_newest_report_does_not_go_back(dsn: str, store: Store, unit: Unit) -> None:
    old, new = unit.positions([0]), unit.positions([5])
    store.store(genuine(store, unit, [new]))
    changed, _ = store.store(genuine(store, unit, [old]))
    assert changed == []
    assert rows(dsn, "SELECT sequence, verdict FROM vehicle_now") == [(1, 5)]


def test_an_epoch_of_a_clock_that_was_years_ahead_does_not_hide_the_next_one(
    dsn: str, store: Store, unit: Unit
) -> None:
    ahead = Unit("car-1", epoch_ms=START_MS + 7000 * DAY_MS)
    ahead.now_ms = START_MS
    store.store(genuine(store, unit, [ahead.positions([0])]))
    store.store(genuine(store, unit, [unit.positions([0]), unit.positions([5])]))
    assert rows(dsn, "SELECT epoch, sequence, verdict FROM vehicle_now") == [(START_MS, 1, 5)]
    store.store(genuine(store, unit, [ahead.positions([0])]))
    assert rows(dsn, "SELECT epoch, sequence, verdict FROM vehicle_now") == [(START_MS, 1, 5)]


def test_a_verdict_has_its_beginning_over_batches(dsn: str, store: Store, unit: Unit) -> None:
    for verdicts, since_s in (([0, 0], 1), ([0, 0], 1), ([0, 5], 6), ([5, 5], 6), ([1, 1], 9)):
        store.store(genuine(store, unit, [unit.positions(verdicts)]))
        assert rows(dsn, "SELECT verdict_since_ms FROM vehicle_now") == [(START_MS + since_s * 1000,)]


def test_without_a_position_the_last_one_stays_with_its_time(dsn: str, store: Store, unit: Unit) -> None:
    store.store(genuine(store, unit, [unit.positions([0])]))
    store.store(genuine(store, unit, [unit.positions([4], placed=False)]))
    assert rows(dsn, "SELECT latitude_deg, position_ms, utc_ms, verdict, x_m IS NULL FROM vehicle_now") == [
        (48.1, START_MS + 1000, START_MS + 2000, 4, False)
    ]


def test_the_same_numbers_with_other_content_are_refused_and_the_first_stays(
    dsn: str, store: Store, unit: Unit
) -> None:
    other = Unit("car-1")
    first, second = genuine(store, unit, [unit.positions([0]), other.positions([5])])
    store.store([first])
    assert store.store([second])[1] == {second.digest: "conflict"}
    assert store.store([first, second])[1] == {second.digest: "conflict"}
    assert rows(dsn, "SELECT verdict FROM segment") == [(0,)]
    assert rows(dsn, "SELECT verdict FROM vehicle_now") == [(0,)]


def test_events_with_numbers_of_another_day_are_refused_and_neither_is_lost(dsn: str, store: Store, unit: Unit) -> None:
    unit.positions([0])
    restored = Unit("car-1")
    restored.next, restored.now_ms = unit.next, unit.now_ms + 2 * DAY_MS
    first, second = genuine(store, unit, [unit.events("trust/event"), restored.events("outage/event")], restored.now_ms)
    assert store.store([first]) == ([], {})
    assert store.store([first, second]) == ([], {second.digest: "conflict"})
    assert rows(dsn, "SELECT name FROM event") == [("trust/event",)]
    assert rows(dsn, "SELECT digest FROM segment") == [(first.digest,)]


def test_nothing_of_the_time_before_an_erasure_comes_back(dsn: str, store: Store, unit: Unit) -> None:
    now_ms = time.time_ns() // 1_000_000
    unit = Unit("car-2", 2, now_ms - 3_600_000)
    unit.enter(dsn)
    before = [unit.positions([0] * 10), unit.events("trust/event", "toll/transaction"), unit.gap(12, 5)]
    unit.next = 17
    late = [unit.positions([5]), unit.events("toll/transaction", "outage/event"), unit.gap(30, 3)]
    unit.now_ms = now_ms + 3_600_000  # by a clock that is ahead
    before.append(unit.positions([0]))
    unit.now_ms = now_ms + 30 * DAY_MS
    before.append(unit.positions([0]))
    assert store.store(genuine(store, unit, before, now_ms))[1] == {}
    with psycopg.connect(dsn) as db:
        assert erase(db, "car-2", "anna") == ErasureReport(3, 1, 1)
    unit.now_ms = now_ms
    for group in ([*before, *late], before[::-1], late, [unit.gap(12, 6)]):
        assert store.store(genuine(store, unit, group, now_ms)) == ([], {})
    assert store.store(genuine(store, unit, before[-1:], now_ms + 30 * DAY_MS)) == ([], {})  # no longer in the future
    for table in ("segment", "vehicle_now", "alarm"):
        assert rows(dsn, f"SELECT count(*) FROM {table}") == [(0,)]
    assert rows(dsn, "SELECT sequence, name FROM event ORDER BY 1") == [
        (11, "toll/transaction"),
        (18, "toll/transaction"),
    ]
    assert rows(dsn, "SELECT first_sequence FROM erased_batch ORDER BY 1") == [(0,), (10,), (17,), (18,), (20,), (21,)]
    assert rows(
        dsn, f"SELECT first_sequence, count, content, from_ms = to_ms, from_ms >= {now_ms} FROM gap ORDER BY 1"
    ) == [(12, 6, b"", True, True), (30, 3, b"", True, True)]
    assert rows(dsn, "SELECT content FROM set_aside") == [(b"",)]
    assert rows(dsn, "SELECT received, lost FROM epoch") == [(12 + 1 + 2 + 1 + 1, 6 + 3)]
    unit.now_ms = time.time_ns() // 1_000_000 + 60_000
    changed, _ = store.store(genuine(store, unit, [unit.positions([1])], unit.now_ms))
    assert [row["verdict"] for row in changed] == [1]
    assert rows(dsn, "SELECT count(*) FROM segment") == [(1,)]


def test_a_batch_that_is_stored_while_its_vehicle_is_erased_does_not_stay(dsn: str, store: Store, unit: Unit) -> None:
    now_ms = time.time_ns() // 1_000_000
    unit.now_ms = now_ms - 60_000
    found = genuine(store, unit, [unit.positions([0])], now_ms)
    make_days(dsn)  # a partition that is not there would be waited for instead
    with psycopg.connect(dsn, autocommit=True) as watching, psycopg.connect(dsn) as db, db.transaction():
        assert erase(db, "car-1", "anna") == ErasureReport(0, 0, 0)  # not committed
        storing = threading.Thread(target=store.store, args=(found,))
        storing.start()
        waiting = "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"
        deadline = time.monotonic() + HANGS_S
        while watching.execute(waiting).fetchone() == (0,):
            assert time.monotonic() < deadline, "ingest does not wait for the erasure"
    storing.join(HANGS_S)
    assert rows(dsn, "SELECT count(*) FROM segment") == [(0,)]
    assert rows(dsn, "SELECT count(*) FROM erased_batch") == [(1,)]


def test_a_gap_that_grows_is_counted_once(dsn: str, store: Store, unit: Unit) -> None:
    for count in (10, 10, 30, 20):
        store.store(genuine(store, unit, [unit.gap(0, count)]))
    assert rows(dsn, "SELECT count FROM gap") == [(30,)]
    assert rows(dsn, "SELECT received, lost, highest FROM epoch") == [(0, 30, 30)]


@pytest.mark.slow
def test_gaps_that_the_outbox_has_merged_are_counted_once_in_any_order(dsn: str, store: Store, unit: Unit) -> None:
    parts = [unit.gap(10, 5), unit.gap(30, 10), unit.gap(5, 10), unit.gap(5, 40), unit.gap(45, 1)]
    for order in permutations(parts):
        with psycopg.connect(dsn) as db:
            db.execute("TRUNCATE gap, epoch")
        store.close()  # it knows which epochs are there
        for group in (order[:2], order[2:], order):
            assert store.store(genuine(store, unit, group))[1] == {}
        assert rows(dsn, "SELECT first_sequence, count FROM gap ORDER BY 1") == [(5, 40), (45, 1)]
        assert rows(dsn, "SELECT received, lost, highest FROM epoch") == [(0, 41, 46)]


@pytest.mark.parametrize(("days", "reason"), [(-2, "future"), (500, "past"), (-3650, "future")])
def test_stamps_of_an_impossible_day_are_set_aside(dsn: str, store: Store, unit: Unit, days: int, reason: str) -> None:
    batch = unit.positions([0])
    found = genuine(store, unit, [batch], START_MS + days * 86_400_000)
    changed, refused = store.store([*found, *found])
    assert (changed, refused) == ([], {})
    assert rows(dsn, "SELECT reason, content FROM set_aside") == [(reason, batch)]
    assert rows(dsn, "SELECT count(*) FROM segment") == [(0,)]


def test_an_outbox_or_a_stamp_of_the_future_does_not_hold_the_newest_report(dsn: str, store: Store, unit: Unit) -> None:
    now_ms = time.time_ns() // 1_000_000
    fast = Unit(unit.vehicle, 1, now_ms + 2 * DAY_MS)  # its clock was wrong when the outbox was made
    fast.now_ms = now_ms
    assert [item.aside for item in genuine(store, unit, [fast.positions([0])], now_ms)] == ["future"]
    unit.now_ms = now_ms + DAY_MS // 2
    store.store(genuine(store, unit, [unit.positions([0])], now_ms))
    ((shown_ms,),) = rows(dsn, "SELECT utc_ms FROM vehicle_now")
    assert abs(int(str(shown_ms)) - now_ms) < 60_000, "its age counts from its arrival"


def test_who_signs_as_another_vehicle_or_without_a_known_key_is_refused(dsn: str, store: Store, unit: Unit) -> None:
    stranger, neighbour = Unit("car-1", 7), Unit("car-2", 2)
    neighbour.enter(dsn)
    keys = Keys(store.keys)
    keys.load({unit.signer.key_id, stranger.signer.key_id, neighbour.signer.key_id})

    def reason(vehicle: str, data: bytes) -> str:
        arrived = ReceivedBytes.of(vehicle, data)
        one = verified(arrived, None if arrived.sealed is None else keys.find(arrived.sealed.key), START_MS)
        assert isinstance(one, RejectedBatch)
        return one.reason

    assert reason("car-1", stranger.positions()) == "key"
    assert reason("car-1", neighbour.positions()) == "vehicle"
    neighbour.vehicle = "car-1"
    assert reason("car-2", neighbour.positions()) == "signature"
    assert reason("car-1", b"nothing") == "format"


def test_a_revoked_key_is_refused_once_its_message_has_come(dsn: str, store: Store, unit: Unit) -> None:
    keys = Keys(store.keys)
    arrived = ReceivedBytes.of("car-1", unit.positions())
    keys.load({unit.signer.key_id})
    assert isinstance(verified(arrived, keys.find(unit.signer.key_id), START_MS), VerifiedBatch)
    with psycopg.connect(dsn) as db:
        db.execute("UPDATE certificate SET revoked = now()")
    keys.forget(unit.signer.key_id)
    keys.load({unit.signer.key_id})
    assert isinstance(verified(arrived, keys.find(unit.signer.key_id), START_MS), RejectedBatch)


def test_two_that_store_the_same_at_once_store_it_once(dsn: str, store: Store, unit: Unit) -> None:
    batches = genuine(store, unit, [unit.positions([0] * 10) for _ in range(50)])
    failures: list[BaseException] = []

    def work(seed: int) -> None:
        own, mine = Store(dsn), list(batches)
        random.Random(seed).shuffle(mine)
        try:
            for begin in range(0, len(mine), 5):
                own.store(mine[begin : begin + 5])
        except BaseException as error:  # noqa: BLE001  # shown by the test
            failures.append(error)
        own.close()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert rows(dsn, "SELECT count(*), sum(count) FROM segment") == [(50, 500)]
    assert rows(dsn, "SELECT received, highest FROM epoch") == [(500, 500)]


class DelayedCommit(Store):
    """Waits before its transaction ends, until another store that has begun later ends or waits for this one."""

    between: Callable[[], None] = staticmethod(lambda: None)

    def _update_now(self, cursor: psycopg.Cursor, segments: Iterable[VerifiedBatch]) -> list[Changed]:  # type: ignore[override]
        self.between()
        return super()._update_now(cursor, segments)


class OtherIngest:
    """Another ingest, which stores a group in a thread while the first one is at work."""

    def __init__(self, dsn: str, batches: list[VerifiedBatch]) -> None:
        self._dsn, self._batches = dsn, batches
        self._store = Store(dsn)
        self._failures = list[BaseException]()
        self._thread = threading.Thread(target=self._work)
        self.refused = dict[bytes, str]()

    def start(self) -> None:
        self._thread.start()

    def begin(self) -> None:
        """Start, and wait until it ends or waits for somebody."""
        self.start()
        waiting = "SELECT count(*) FROM pg_locks WHERE NOT granted"
        deadline = time.monotonic() + HANGS_S
        while self._thread.is_alive() and rows(self._dsn, waiting) == [(0,)]:
            assert time.monotonic() < deadline, "the other ingest neither ends nor waits"

    def end(self) -> None:
        self._thread.join(HANGS_S)
        self._store.close()
        assert self._failures == []

    def _work(self) -> None:
        try:
            self.refused = self._store.store(self._batches)[1]
        except DatabaseUnavailable as error:
            self._failures.append(error)


def stored_beside(
    dsn: str, mine: list[VerifiedBatch], others: list[VerifiedBatch]
) -> tuple[dict[bytes, str], dict[bytes, str]]:
    """Store two groups at once; what each has refused."""
    late, other = DelayedCommit(dsn), OtherIngest(dsn, others)
    late.between = other.begin
    refused = late.store(mine)[1]
    other.end()
    late.close()
    return refused, other.refused


@pytest.mark.parametrize("days", [0, 2])
def test_of_two_that_store_the_same_numbers_at_once_one_is_refused(
    dsn: str, store: Store, unit: Unit, days: int
) -> None:
    restored = Unit("car-1")
    restored.now_ms += days * DAY_MS + 1000
    (first,) = genuine(store, unit, [unit.events("trust/event")], restored.now_ms)
    (second,) = genuine(store, unit, [restored.events("outage/event")], restored.now_ms)
    assert stored_beside(dsn, [first], [second]) == ({}, {second.digest: "conflict"})
    assert rows(dsn, "SELECT digest FROM segment") == [(first.digest,)]
    assert rows(dsn, "SELECT name FROM event") == [("trust/event",)]


def test_a_gap_that_grows_while_it_is_stored_is_counted_once(dsn: str, store: Store, unit: Unit) -> None:
    small, large = genuine(store, unit, [unit.gap(0, 10), unit.gap(0, 30)])
    assert stored_beside(dsn, [small], [large]) == ({}, {})
    assert rows(dsn, "SELECT lost, highest FROM epoch") == [(30, 30)]


def test_what_two_ingests_hold_in_another_order_makes_neither_fail(dsn: str, store: Store, unit: Unit) -> None:
    for turn in range(10):
        parts = [Unit("car-1", epoch_ms=START_MS + 100 * turn + number) for number in range(20)]
        gaps = genuine(store, unit, [part.gap(10, 5) for part in parts])
        ahead = Unit("car-1", epoch_ms=START_MS + 100 * turn + 50)
        ahead.now_ms += 30 * DAY_MS
        aside = genuine(store, unit, [ahead.positions() for _ in range(20)])
        mine, other = Store(dsn), OtherIngest(dsn, [*gaps[::-1], *aside[::-1]])
        other.start()
        assert mine.store([*gaps, *aside])[1] == {}
        mine.close()
        other.end()
    assert rows(dsn, "SELECT count(*), sum(lost) FROM epoch") == [(200, 1000)]
    assert rows(dsn, "SELECT count(*) FROM set_aside") == [(200,)]


def test_batches_that_the_database_does_not_take_cost_others_few_transactions(dsn: str, store: Store) -> None:
    hostile = Unit("car-9", 9)
    hostile.enter(dsn)
    honest = [Unit(f"car-{number}", number + 10) for number in range(20, 60)]
    for unit in honest:
        unit.enter(dsn)
    most = 1 << 53
    store.store(genuine(store, hostile, [hostile.gap(0, most - 1)]))
    group = [item for unit in honest for item in genuine(store, unit, [unit.positions() for _ in range(5)])]
    bad = genuine(store, hostile, [hostile.gap(first, most - first) for first in range(1, 5)])
    for number, refused in enumerate(bad):
        group.insert(number * 50, refused)
    tried = list[int]()

    class CountingStore(Store):
        def _store(self, batches: Sequence[VerifiedBatch]) -> tuple[list[Changed], dict[bytes, str]]:
            tried.append(len(batches))
            return super()._store(batches)

    counting = CountingStore(dsn)
    assert counting.store(group)[1] == dict.fromkeys((genuine.digest for genuine in bad), "format")
    counting.close()
    assert rows(dsn, "SELECT count(*) FROM segment") == [(200,)]
    assert len(tried) < 30, "one transaction each would hold up the whole centre"


def test_a_day_that_was_removed_is_made_again_for_what_comes_later(dsn: str, store: Store, unit: Unit) -> None:
    first, second = genuine(store, unit, [unit.positions(), unit.positions()])
    assert store.store([first])[1] == {}
    retain(dsn, datetime.fromtimestamp(START_MS / 1000, UTC).date() + timedelta(days=200))
    assert store.store([second])[1] == {}
    assert rows(dsn, "SELECT digest FROM segment") == [(second.digest,)]


@pytest.mark.parametrize("seed", range(3))
def test_whatever_a_vehicle_signs_is_stored_or_refused_and_holds_up_nobody(dsn: str, store: Store, seed: int) -> None:
    chance, honest = random.Random(seed), Unit("car-2", 2)
    fuzz_fleet.UNIT.enter(dsn)
    honest.enter(dsn)
    taken = 0
    with fuzz_fleet.readers() as readers, psycopg.connect(dsn) as db:
        for _ in range(40):
            group = genuine(store, honest, [honest.positions()])
            for _ in range(100):
                with contextlib.suppress(BadBatch):
                    one = fuzz_fleet.read_batch(fuzz_fleet.message(readers["batch"], chance))
                    group.append(replace(one, digest=chain_digest(one.data)))
            taken += len(group) - 1
            _, refused = store.store(group)
            assert group[0].digest not in refused
            judge(db, START_MS, START_MS)
    assert taken > 100
    assert rows(dsn, "SELECT received FROM epoch WHERE vehicle = 'car-2'") == [(40,)]


def test_more_lost_reports_than_there_are_numbers_are_refused(dsn: str, store: Store, unit: Unit) -> None:
    most = 1 << 53
    gaps = [unit.gap(0, most - 1), unit.gap(1, most - 1), unit.gap(2, most - 2)]
    for item in genuine(store, unit, gaps):
        store.store([item])
    assert rows(dsn, "SELECT lost FROM epoch") == [(most - 1,)]
    honest = genuine(store, unit, [unit.positions()])
    assert store.store([*genuine(store, unit, gaps[1:]), *honest])[1].keys() == {chain_digest(gap) for gap in gaps[1:]}
    with psycopg.connect(dsn) as db:
        judge(db, START_MS, START_MS)


def test_a_lost_database_stores_nothing_and_is_used_again(dsn: str, store: Store, unit: Unit) -> None:
    found = genuine(store, unit, [unit.positions()])
    with psycopg.connect(dsn, autocommit=True) as db:
        db.execute(
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid() AND datname = 'fleet'"
        )  # one statement
    with pytest.raises(DatabaseUnavailable):
        store.store(found)
    store.store(found)
    assert rows(dsn, "SELECT count(*) FROM segment") == [(1,)]


class PublishedMessages:
    """Takes what ingest publishes, as NATS does: no message of more than its limit."""

    def __init__(self) -> None:
        self.sizes = dict[str, list[int]]()

    async def publish(self, subject: str, content: bytes) -> None:
        assert len(content) <= 131_072, f"{subject}: NATS refuses {len(content)} bytes, and ingest ends"
        self.sizes.setdefault(subject, []).append(len(content))


def test_a_vehicle_that_floods_has_a_share_of_what_waits_and_no_more(store: Store) -> None:
    ingest = Ingest(PublishedMessages(), store)  # type: ignore[arg-type]

    async def work() -> None:
        for number in range(1000):
            await ingest._take(Msg(None, "obu.car-1.uplink.batch", data=b"%d" % number))  # type: ignore[arg-type]
        await ingest._take(Msg(None, "obu.car-2.uplink.batch", data=b"other"))  # type: ignore[arg-type]
        assert len(ingest._waiting) == VEHICLE_SHARE + 1
        assert [arrived.vehicle for arrived in ingest._waiting.take(VEHICLE_SHARE + 1)][:3] == [
            "car-1",
            "car-2",
            "car-1",
        ]
        await ingest._take(Msg(None, "obu.car-1.uplink.batch", data=b"again"))  # type: ignore[arg-type]
        assert len(ingest._waiting) == 1

    asyncio.run(work())


def test_a_vehicle_may_not_begin_epochs_without_end(dsn: str, store: Store, unit: Unit) -> None:
    store.store(genuine(store, unit, [unit.positions()]))
    with psycopg.connect(dsn) as db:
        many = "INSERT INTO epoch (vehicle, epoch, tenant_id) SELECT 'car-1', n, 1 FROM generate_series(2, %s) AS n"
        db.execute(many, (MAX_EPOCHS,))
    other = Unit("car-1", epoch_ms=START_MS + 5)
    new = [*genuine(store, other, [other.positions(), other.gap(7, 2)]), *genuine(store, unit, [unit.positions()])]
    _, refused = store.store(new)
    assert refused == {new[0].digest: "epochs", new[1].digest: "epochs"}
    assert rows(dsn, "SELECT count(*) FROM segment") == [(2,)]
    assert rows(dsn, "SELECT count(*) FROM epoch") == [(MAX_EPOCHS,)]


def test_what_a_whole_group_changes_fits_into_messages(dsn: str, store: Store) -> None:
    units = [
        Unit(f"{'a-vehicle-with-a-name-of-the-greatest-length':0<44}{number:04}", number) for number in range(GROUP)
    ]
    for unit in units:
        unit.enter(dsn)
    changed, refused = store.store([item for unit in units for item in genuine(store, unit, [unit.positions()])])
    assert len(changed) == GROUP and refused == {}
    heard = PublishedMessages()
    answers = {unit.vehicle: [StoredBatch(START_MS, 0, bytes(8))] for unit in units}
    asyncio.run(Ingest(heard, store)._tell(changed, answers))  # type: ignore[arg-type]
    assert len(heard.sizes) == GROUP + 1
    assert sum(heard.sizes["centre.now"]) > 131_072, "more than one message can hold"
