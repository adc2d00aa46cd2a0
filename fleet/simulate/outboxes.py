"""Outboxes of simulated vehicles: one in memory for thousands of them, and that of `monitoring.uplink` on the disk."""

import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from services.monitoring.uplink.outbox import Outbox
from services.monitoring.uplink.sending import RETRY_NS, BatchCounters, BatchSelection
from shared.evidence.signer import Signer
from shared.fleet.batch import Batch, Kind, Report
from shared.fleet.receipts import Receipt
from shared.fleet.sealed import RECEIPT_DIGEST_BYTES, chain_digest, seal

WINDOW = 4
MAX_RETRY = 30  # times the first one
MAX_BYTES = 1 << 28  # of an outbox on the disk: none is dropped here


class BatchTruth(NamedTuple):
    """A batch, as the truth list has it."""

    vehicle: str
    epoch_ms: int
    first: int
    reports: int
    digest: bytes  # SHA-256


class BatchSender(Protocol):
    """What sends batches until a receipt names them; times in s of any clock."""

    @property
    def waiting(self) -> int:
        """Batches without a receipt."""
        ...

    def next(self, now_s: float) -> bytes | None:
        """Give a batch to be sent now; None if there is none, or the window is full."""
        ...

    def take(self, receipt: Receipt, now_s: float) -> list[float]:
        """Settle what a receipt names; give how long each took since it was first sent [s]."""
        ...

    def restart(self) -> None:
        """Forget what is in flight: the connection is new."""
        ...


@dataclass
class _Entry:
    data: bytes
    number: int  # of the batch, from 0
    first_s: float | None = None  # when it was first sent
    due_s: float = 0.0
    attempts: int = 0


class MemoryOutbox:
    """Batches in memory: the newest first, then the oldest, four in flight."""

    def __init__(self, vehicle: str, signer: Signer, epoch_ms: int, retry_s: float) -> None:
        self.made: list[BatchTruth] = []
        self.refused = Counter[str]()
        self.repeated_receipts = 0
        self._vehicle, self._signer, self._epoch_ms, self._retry_s = vehicle, signer, epoch_ms, retry_s
        self._next, self._previous = 0, bytes(32)
        self._open: dict[bytes, _Entry] = {}  # by the digest of the receipt
        self._unsent = deque[bytes]()
        self._is_newest_unsent = False
        self._flying: dict[bytes, _Entry] = {}
        self._resting: dict[bytes, _Entry] = {}

    @property
    def waiting(self) -> int:
        """Batches without a receipt."""
        return len(self._open)

    @property
    def settled(self) -> int:
        """Number of the first batches without a gap that have their receipts."""
        return next(iter(self._open.values())).number if self._open else len(self.made)

    def make(self, reports: Sequence[Report]) -> None:
        """Make a signed batch."""
        batch = Batch(Kind.POSITIONS, self._epoch_ms, self._next, len(reports), self._previous, tuple(reports))
        data = seal(batch, self._signer, self._vehicle)
        digest = chain_digest(data)
        self.made.append(BatchTruth(self._vehicle, self._epoch_ms, self._next, len(reports), digest))
        self._next, self._previous = self._next + len(reports), digest
        name = digest[:RECEIPT_DIGEST_BYTES]
        self._open[name] = _Entry(data, len(self.made) - 1)
        self._unsent.append(name)
        self._is_newest_unsent = True

    def next(self, now_s: float) -> bytes | None:
        """Give a batch to be sent now: the newest of those never sent, or one whose retry is due, then the oldest."""
        for name in [name for name, entry in self._flying.items() if now_s >= entry.due_s]:
            self._resting[name] = self._flying.pop(name)
        if len(self._flying) >= WINDOW:
            return None
        chosen = self._choose(now_s)
        if chosen is None:
            return None
        entry = self._flying[chosen] = self._open[chosen]
        entry.first_s = now_s if entry.first_s is None else entry.first_s
        entry.due_s = now_s + self._retry_s * min(1 << min(entry.attempts, 10), MAX_RETRY)
        entry.attempts += 1
        return entry.data

    def _choose(self, now_s: float) -> bytes | None:
        for name, entry in self._resting.items():
            if now_s >= entry.due_s:
                del self._resting[name]
                return name
        if not self._unsent:
            return None
        is_newest, self._is_newest_unsent = self._is_newest_unsent, False
        return self._unsent.pop() if is_newest else self._unsent.popleft()

    def take(self, receipt: Receipt, now_s: float) -> list[float]:
        """Settle what a receipt names; what is refused stays open, and is counted."""
        taken = []
        for stored in receipt.stored:
            entry = self._open.pop(stored.digest, None)
            if entry is None:
                self.repeated_receipts += 1
                continue
            self._flying.pop(stored.digest, None)
            self._resting.pop(stored.digest, None)
            taken.append(now_s - (entry.first_s if entry.first_s is not None else now_s))
        self.refused.update(refused.reason for refused in receipt.refused)
        return taken

    def restart(self) -> None:
        """Send again, from now on, what was in flight."""
        for entry in (*self._flying.values(), *self._resting.values()):
            entry.due_s, entry.attempts = 0.0, 0
        self._resting |= self._flying
        self._flying.clear()


class DiskOutbox:
    """The outbox of `monitoring.uplink`; its retries are made shorter by a faster clock."""

    def __init__(self, path: Path, vehicle: str, signer: Signer, retry_s: float) -> None:
        self.outbox = Outbox(path, vehicle, time.time_ns() // 1_000_000, MAX_BYTES)
        self._signer, self._speed = signer, RETRY_NS / retry_s  # ns of its clock a second
        self._sending = BatchSelection(self.outbox, BatchCounters(), Counter())

    @property
    def waiting(self) -> int:
        """Batches without a receipt."""
        return self.outbox.backlog().batches

    def add(self, reports: Sequence[Report]) -> None:
        """Keep reports: all of them, or none."""
        self.outbox.add(*reports)

    def flush(self) -> None:
        """Make signed batches of what is kept."""
        self.outbox.flush(self._signer)

    def next(self, now_s: float) -> bytes | None:
        """Give a batch to be sent now."""
        found = self._sending.next(round(now_s * self._speed))
        return None if found is None else found[1]

    def take(self, receipt: Receipt, now_s: float) -> list[float]:
        """Settle what a receipt names; how long it took is not known."""
        self._sending.take(receipt, self._signer, round(now_s * self._speed), time.time_ns() // 1_000_000)
        return []

    def restart(self) -> None:
        """Forget what is in flight."""
        self._sending.restart()
