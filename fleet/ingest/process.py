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
from shared.fleet.receipts import MOST_BATCHES, Receipt, Refused, Stored
from shared.fleet.topics import BATCH, CHANGED, RECEIPT, REVOKED, subject, vehicle_of

from .keys import Keys
from .store import Changed, Store, Unusable
from .verification import FORMAT, KEY, Arrived, Genuine, verified

log = logging.getLogger(__name__)

QUEUE = "ingest"
GROUP = 500  # batches a transaction
LINGER_S = 0.2  # in which batches gather for one transaction: its cost is nearly that of a hundred batches
TOLD_ROWS = 200  # of `vehicle_now` in a message: the longest has 500 bytes, and NATS takes 128 kB
WAITING = 5000  # batches; what comes beyond is dropped, and vehicles send it again
SHARE = 16  # of one vehicle among them, so that none keeps others out: its outbox has four in flight
RETRY_S = 2.0  # after the database could not be used
BEAT_S = 10.0  # an empty list of changes says after as long that an ingest works


def now_ms() -> int:
    """Time of day [ms, UTC]."""
    return time.time_ns() // 1_000_000


class Ingest:
    """One of any number that share the batches of all vehicles."""

    def __init__(self, client: Client, store: Store, clock_ms: Callable[[], int] = now_ms) -> None:
        self._client, self._store, self._clock_ms = client, store, clock_ms
        self._keys = Keys(store.keys)
        self._arrived: asyncio.Queue[Arrived] = asyncio.Queue(WAITING)
        self._waiting = Counter[str]()  # of each vehicle
        self._told_s = -BEAT_S

    async def run(self) -> None:
        """Work until cancelled."""
        await self._client.subscribe(subject("*", BATCH), QUEUE, self._take)
        await self._client.subscribe(REVOKED, cb=self._forget)
        while True:
            try:
                async with asyncio.timeout(BEAT_S):
                    group = [self._taken(await self._arrived.get())]
            except TimeoutError:
                await self._tell([], {})
                continue
            if self._arrived.qsize() < GROUP:
                await asyncio.sleep(LINGER_S)
            while len(group) < GROUP and not self._arrived.empty():
                group.append(self._taken(self._arrived.get_nowait()))
            try:
                changed, answers, forgeries = await asyncio.to_thread(self._work, group)
            except Unusable as error:
                log.error("nothing is stored, vehicles will send it again: %s", error)
                await asyncio.sleep(RETRY_S)
                continue
            await self._tell(changed, answers)
            if forgeries:
                log.warning("refused: %s", dict(forgeries))

    async def _take(self, message: Msg) -> None:
        vehicle = vehicle_of(message.subject)
        if vehicle is not None and not self._arrived.full() and self._waiting[vehicle] < SHARE:
            self._waiting[vehicle] += 1
            self._arrived.put_nowait(Arrived.of(vehicle, message.data))

    def _taken(self, one: Arrived) -> Arrived:
        self._waiting[one.vehicle] -= 1
        if not self._waiting[one.vehicle]:
            del self._waiting[one.vehicle]
        return one

    async def _forget(self, message: Msg) -> None:
        with contextlib.suppress(ValueError, KeyError, TypeError):  # from a process of the centre
            self._keys.forget(str(json.loads(message.data)["key"]))

    def _work(
        self, group: Sequence[Arrived]
    ) -> tuple[list[Changed], dict[str, list[Stored | Refused]], Counter[tuple[str, str]]]:
        """Verify and store a group; raises `Unusable`."""
        answers: dict[str, list[Stored | Refused]] = defaultdict(list)
        forgeries: Counter[tuple[str, str]] = Counter()
        self._keys.load({one.sealed.key for one in group if one.sealed is not None})
        genuine: list[Genuine] = []
        at_ms = self._clock_ms()
        for one in group:
            key = None if one.sealed is None else self._keys.find(one.sealed.key)
            found = verified(one, key, at_ms)
            if isinstance(found, Genuine):
                genuine.append(found)
                continue
            answers[one.vehicle].append(found)
            if found.reason not in (FORMAT, KEY):
                forgeries[one.vehicle, found.reason] += 1
        changed, refused = self._store.store(genuine) if genuine else ([], {})
        for batch in genuine:
            reason = refused.get(batch.digest)
            answers[batch.vehicle].append(batch.stored if reason is None else batch.refused(reason))
        if forgeries:
            self._store.tell_forgeries(dict(forgeries), at_ms)
        return changed, answers, forgeries

    async def _tell(self, changed: list[Changed], answers: dict[str, list[Stored | Refused]]) -> None:
        now_s = time.monotonic()
        if changed or now_s - self._told_s >= BEAT_S:
            for begin in range(0, max(len(changed), 1), TOLD_ROWS):
                await self._client.publish(CHANGED, json.dumps(changed[begin : begin + TOLD_ROWS]).encode())
            self._told_s = now_s
        for vehicle, rows in answers.items():
            for begin in range(0, len(rows), MOST_BATCHES):
                some = rows[begin : begin + MOST_BATCHES]
                receipt = Receipt(
                    tuple(row for row in some if isinstance(row, Stored)),
                    tuple(row for row in some if isinstance(row, Refused)),
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
