"""Takes batches from NATS, stores them in groups, and answers with receipts after the commit."""

import asyncio
import contextlib
import json
import logging
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence

from nats.aio.client import Client
from nats.aio.msg import Msg

from fleet.bus import closed, connected
from fleet.servers.nats import NatsAccess
from shared.fleet.receipts import MAX_BATCHES, Receipt, RejectedBatch, StoredBatch
from shared.fleet.topics import BATCH, CHANGED, RECEIPT, REVOKED, subject, vehicle_of

from .budgets import ROW_BYTES, VEHICLE, Budgets, storage_bytes
from .keys import Keys, Limits
from .store import Changed, DatabaseUnavailable, Store
from .verification import FORMAT, KEY, ReceivedBytes, VerifiedBatch, verified
from .waiting import TenantQueue

log = logging.getLogger(__name__)

QUEUE = "ingest"
GROUP = 500  # batches a transaction
LINGER_S = 0.2  # in which batches gather for one transaction: its cost is nearly that of a hundred batches
LEAST_LINGER_S, MANY = 0.02, 100  # with fewer in the last transaction for less: a vehicle that empties its outbox waits
TOLD_ROWS = 200  # of `vehicle_now` in a message: the longest has 500 bytes, and NATS takes 128 kB
RETRY_S = 2.0  # after the database could not be used
BEAT_S = 10.0  # an empty list of changes says after as long that an ingest works
FLOOD_S = 5.0  # between two looks at what was withheld
UNKNOWN_TENANT = 0  # tenant of what no known key of its vehicle has signed
Counts = Counter[tuple[str, str]]  # batches by vehicle and reason


def now_ms() -> int:
    """Time of day [ms, UTC]."""
    return time.time_ns() // 1_000_000


class Ingest:
    """One of any number that share the batches of all vehicles."""

    def __init__(self, client: Client, store: Store, clock_ms: Callable[[], int] = now_ms) -> None:
        self._client, self._store, self._clock_ms = client, store, clock_ms
        self._keys = Keys(store.keys)
        self._waiting, self._budgets = TenantQueue(), Budgets()
        self._withheld = Counts()  # of each vehicle, and whose account was empty; not told yet
        self._flood_s = self._told_s = -BEAT_S

    async def run(self) -> None:
        """Work until cancelled."""
        await self._client.subscribe(subject("*", BATCH), QUEUE, self._take)
        await self._client.subscribe(REVOKED, cb=self._forget)
        number = 0
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(BEAT_S):
                    await self._waiting.any()
            if len(self._waiting) and len(self._waiting) < GROUP:
                await asyncio.sleep(max(LEAST_LINGER_S, LINGER_S * min(1.0, number / MANY)))
            group = self._waiting.take(GROUP)
            number = len(group)
            try:
                await self._store_group(group)
            except DatabaseUnavailable as error:
                log.error("nothing is stored, vehicles will send it again: %s", error)
                await asyncio.sleep(RETRY_S)

    async def _store_group(self, group: Sequence[ReceivedBytes]) -> None:
        """Store what has come, and answer; raises `DatabaseUnavailable`."""
        changed, answers, forgeries, withheld = await asyncio.to_thread(self._work, group)
        self._withheld += withheld
        await self._tell(changed, answers)
        if forgeries:
            log.warning("refused: %s", dict(forgeries))
        if self._withheld and time.monotonic() - self._flood_s >= FLOOD_S:
            await self._tell_floods()

    async def _tell_floods(self) -> None:
        """Raise the alarm `flood`; raises `DatabaseUnavailable`, and what was counted is told later."""
        counts = dict(self._withheld)
        await asyncio.to_thread(self._store.tell_floods, counts, self._clock_ms())
        self._withheld.subtract(counts)
        self._withheld += Counter()  # without those that are told
        self._flood_s = time.monotonic()
        most = sorted(counts, key=lambda pair: -counts[pair])[:5]
        log.warning("without a receipt, beyond the budget: %d batches of %d vehicles, most of %s", sum(counts.values()),
                    len({vehicle for vehicle, _ in counts}), ", ".join(vehicle for vehicle, _ in most))  # fmt: skip

    async def _take(self, message: Msg) -> None:
        vehicle = vehicle_of(message.subject)
        if vehicle is None:
            return
        if self._budgets.is_empty(vehicle, time.monotonic()):
            self._withheld[vehicle, VEHICLE] += 1
            return
        arrived = ReceivedBytes.of(vehicle, message.data)
        key = None if arrived.sealed is None else self._keys.find(arrived.sealed.key)
        self._waiting.add(UNKNOWN_TENANT if key is None or key.vehicle != vehicle else key.tenant_id, arrived)

    async def _forget(self, message: Msg) -> None:
        with contextlib.suppress(ValueError, KeyError, TypeError):  # from a process of the centre
            self._keys.forget(str(json.loads(message.data)["key"]))

    def _work(
        self, group: Sequence[ReceivedBytes]
    ) -> tuple[list[Changed], dict[str, list[StoredBatch | RejectedBatch]], Counts, Counts]:
        """Verify and store a group; raises `DatabaseUnavailable`.

        Returns rows of `vehicle_now`, answers, forgeries, and what gets no answer since a budget is used up.
        """
        answers: dict[str, list[StoredBatch | RejectedBatch]] = defaultdict(list)
        forgeries, withheld = Counts(), Counts()
        self._keys.load({arrived.sealed.key for arrived in group if arrived.sealed is not None})
        genuine: list[VerifiedBatch] = []
        at_ms = self._clock_ms()
        for arrived in group:
            key = None if arrived.sealed is None else self._keys.find(arrived.sealed.key)
            found = verified(arrived, key, at_ms)
            if (whose := self._withheld_by(arrived, found, Limits() if key is None else key.limits)) is not None:
                withheld[arrived.vehicle, whose] += 1
                continue
            if isinstance(found, VerifiedBatch):
                genuine.append(found)
                continue
            answers[arrived.vehicle].append(found)
            if found.reason not in (FORMAT, KEY):
                forgeries[arrived.vehicle, found.reason] += 1
        changed, refused = self._store.store(genuine) if genuine else ([], {})
        for batch in genuine:
            reason = refused.get(batch.digest)
            answers[batch.vehicle].append(batch.stored if reason is None else batch.refused(reason))
        if forgeries:
            self._store.tell_forgeries(dict(forgeries), at_ms)
        return changed, answers, forgeries, withheld

    def _withheld_by(self, one: ReceivedBytes, found: VerifiedBatch | RejectedBatch, limits: Limits) -> str | None:
        """Take a batch from the budgets; or say whose is used up."""
        if isinstance(found, VerifiedBatch):
            size, tenant = storage_bytes(found), found.tenant_id
        else:
            size, tenant = ROW_BYTES + len(one.data), None
        return self._budgets.withheld(one.vehicle, tenant, limits, size, time.monotonic())

    async def _tell(self, changed: list[Changed], answers: dict[str, list[StoredBatch | RejectedBatch]]) -> None:
        now_s = time.monotonic()
        if changed or now_s - self._told_s >= BEAT_S:
            for begin in range(0, max(len(changed), 1), TOLD_ROWS):
                await self._client.publish(CHANGED, json.dumps(changed[begin : begin + TOLD_ROWS]).encode())
            self._told_s = now_s
        for vehicle, rows in answers.items():
            for begin in range(0, len(rows), MAX_BATCHES):
                some = rows[begin : begin + MAX_BATCHES]
                receipt = Receipt(
                    tuple(row for row in some if isinstance(row, StoredBatch)),
                    tuple(row for row in some if isinstance(row, RejectedBatch)),
                )
                await self._client.publish(subject(vehicle, RECEIPT), receipt.encode())


async def serve(server: NatsAccess, dsn: str) -> None:
    """Run one ingest until cancelled; the connection to NATS comes back by itself."""
    client = await connected(server, "ingest")
    store = Store(dsn)
    try:
        await Ingest(client, store).run()
    finally:
        store.close()
        await closed(client)
