"""Which batches are sent when: four are in flight, events before the newest before the oldest of the backlog."""

from collections import Counter, OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from shared.evidence.signer import Signer
from shared.fleet.batch import Kind
from shared.fleet.receipts import Receipt
from shared.fleet.times import RETRY_S

from .outbox import Outbox, Row

NS = 1_000_000_000
WINDOW = 4
RETRY_NS, LONGEST_RETRY_NS = RETRY_S * NS, 300 * NS
MAX_RESTING = 256  # batches without a receipt that wait for their next attempt
REFUSED_RETRY_NS = 3600 * NS
# Between two batches that were refused before, while the centre takes none of them: some 1.5 MB an hour at most of a
# network that may be paid by the byte, and not the whole outbox.
PROBE_NS = 60 * NS
CONFLICT, KEY = "conflict", "key"


@dataclass
class BatchCounters:
    """Batches since the start of the process, repeated ones as well."""

    sent: int = 0
    receipted: int = 0
    refused: int = 0


@dataclass
class Flight:
    """A batch that was sent."""

    row: Row
    sent_ns: int
    until_ns: int  # how long its place in the window is kept for it
    attempts: int
    silent: int  # as `Sending._silent` when it was sent


def _retry_ns(attempts: int) -> int:
    return min(RETRY_NS << min(attempts, 10), LONGEST_RETRY_NS)


class BatchSelection:
    """Chooses batches of an outbox, and settles them by receipts. Times in ns on the OBU time line."""

    def __init__(self, outbox: Outbox, tally: BatchCounters, rejects: Counter[str]) -> None:
        self.outbox = outbox
        self._tally = tally
        self._conflict_ns: int | None = None  # when the last epoch was begun for a conflict
        self._rejects = rejects
        self._flights: dict[int, Flight] = {}
        self._resting: OrderedDict[int, tuple[int, int]] = OrderedDict()  # when due, and attempts
        self._probe_ns = 0  # when a refused batch may be sent again
        self._receipt_ns = self._silent = 0  # last receipt; windows in a row without any
        self._newest = 0  # highest ID that was sent over this connection

    def restart(self) -> None:
        """Forget what is in flight: the connection is new."""
        self._flights.clear()
        self._resting.clear()
        self._silent = self._newest = 0

    def next(self, now_ns: int) -> tuple[Row, bytes] | None:
        """Give a batch to be sent now, which is in flight from then on; raises `OutboxFault`."""
        self._expire(now_ns)
        row = self._choose(now_ns)
        if row is None:
            return None
        data = self.outbox.content(row.id)
        if data is None:
            return None
        _, attempts = self._resting.pop(row.id, (0, 0))
        self._flights[row.id] = Flight(row, now_ns, now_ns + _retry_ns(self._silent), attempts, self._silent)
        self._newest = max(self._newest, row.id)
        self._tally.sent += 1
        return row, data

    def take(self, receipt: Receipt, signer: Signer, now_ns: int, utc_ms: int) -> None:
        """Delete what is stored, mark what is refused; raises `OutboxFault`."""
        refused = self.outbox.refused
        gone = self.outbox.settle(receipt.stored)
        if self.outbox.refused < refused:
            self._probe_ns = 0  # the reason is no more: the others follow at once
        self._tally.receipted += len(gone)
        unknown = len(receipt.stored) - len(gone)
        for item in receipt.refused:
            row = self.outbox.refuse(item.digest, item.reason, now_ns)
            if row is None:
                unknown += 1
                continue
            self._tally.refused += 1
            gone.append(row.id)
            if item.reason == CONFLICT:
                self._solve_conflict(row, signer, now_ns, utc_ms)
        if unknown:  # repeated, or of a batch that is now part of a gap
            self._rejects["receipt of no batch"] += unknown
        for row_id in gone:
            self._flights.pop(row_id, None)
            self._resting.pop(row_id, None)
        if gone:
            self._receipt_ns, self._silent = now_ns, 0
            for flight in self._flights.values():
                flight.until_ns = min(flight.until_ns, now_ns + RETRY_NS)

    def _solve_conflict(self, row: Row, signer: Signer, now_ns: int, utc_ms: int) -> None:
        """Put the batch into another epoch: its sequence numbers hold other content, as after a restored backup."""
        if row.epoch_ms == self.outbox.epoch_ms:
            if self._conflict_ns is not None and now_ns - self._conflict_ns < REFUSED_RETRY_NS:
                return  # it stays refused
            self._conflict_ns = now_ns
            self.outbox.begin_epoch(utc_ms)
        self.outbox.make_anew(row.id, signer)

    def _expire(self, now_ns: int) -> None:
        for row_id, flight in list(self._flights.items()):
            if now_ns >= flight.until_ns:
                self._rest(row_id)
                if self._receipt_ns < flight.sent_ns:
                    self._silent = max(self._silent, flight.silent + 1)

    def _rest(self, row_id: int) -> None:
        flight = self._flights.pop(row_id)
        self._resting[row_id] = flight.sent_ns + _retry_ns(flight.attempts), flight.attempts + 1
        if len(self._resting) > MAX_RESTING:
            self._resting.popitem(last=False)

    def _choose(self, now_ns: int) -> Row | None:
        busy = len(self._flights) >= WINDOW
        event = self._free(now_ns, kind=Kind.EVENTS)
        if busy:
            # An event that was never sent takes the place of positions.
            positions = [flight for flight in self._flights.values() if flight.row.kind != Kind.EVENTS]
            if event is None or event.id in self._resting or not positions:
                return None
            oldest = min(positions, key=lambda flight: flight.sent_ns)
            self._rest(oldest.row.id)
            return event
        if event is not None:
            return event
        newest = next(iter(self.outbox.open_rows(newest=True)), None)
        if newest is not None and newest.id > self._newest:
            return newest
        return self._free(now_ns) or self._refused(now_ns)

    def _free(self, now_ns: int, *, kind: Kind | None = None) -> Row | None:
        """Find the oldest batch that can be sent now."""
        return self._first(self.outbox.open_rows(kind=kind, most=self._most()), now_ns)

    def _refused(self, now_ns: int) -> Row | None:
        if 0 < self._probe_ns - now_ns <= PROBE_NS:
            return None
        row = self._first(self.outbox.refused_rows(now_ns - REFUSED_RETRY_NS, now_ns, self._most()), now_ns)
        if row is not None:
            self._probe_ns = now_ns + PROBE_NS
        return row

    def _most(self) -> int:
        """One more than those that cannot be sent now."""
        return len(self._flights) + len(self._resting) + 1

    def _first(self, rows: Iterable[Row], now_ns: int) -> Row | None:
        """Find the first batch that is neither in flight nor waits for its next attempt."""
        for row in rows:
            if row.id not in self._flights and self._resting.get(row.id, (0, 0))[0] <= now_ns:
                return row
        return None
