"""Is this batch of this vehicle? Pure: no bus, no database, and time is an argument."""

from dataclasses import dataclass
from datetime import UTC, date, datetime

from shared.fleet.batch import BadBatch, Batch, Kind, Report
from shared.fleet.receipts import REASONS, RejectedBatch, StoredBatch
from shared.fleet.sealed import SealedBatch, chain_digest, receipt_digest, unsealed

from .keys import Key

DAY_MS = 86_400_000
FUTURE_MS = DAY_MS  # a clock that is wrong by more is none
MAX_AGE_MS = 400 * DAY_MS  # nothing is kept that long; each day has a partition of its own
SIGNATURE, KEY, VEHICLE, FORMAT, CONFLICT, EPOCHS = REASONS


@dataclass(frozen=True)
class ReceivedBytes:
    """Bytes from the topic of a vehicle, read as far as they can be without its key."""

    vehicle: str
    data: bytes
    sealed: SealedBatch | None  # None: they are no batch

    @classmethod
    def of(cls, vehicle: str, data: bytes) -> "ReceivedBytes":
        """Read the frame."""
        try:
            return cls(vehicle, data, unsealed(data))
        except BadBatch:
            return cls(vehicle, data, None)


@dataclass(frozen=True)
class VerifiedBatch:
    """A batch that its vehicle has signed."""

    vehicle: str
    tenant_id: int
    data: bytes
    digest: bytes  # SHA-256
    batch: Batch
    aside: str | None  # why it is set aside: its stamps cannot be

    @property
    def stored(self) -> StoredBatch:
        """How a receipt names it."""
        return StoredBatch(self.batch.epoch_ms, self.batch.first, receipt_digest(self.data))

    def refused(self, reason: str) -> RejectedBatch:
        """How a receipt refuses it."""
        return RejectedBatch(*self.stored, reason)

    @property
    def day(self) -> date:
        """Day of its first stamp, UTC."""
        return datetime.fromtimestamp(self.batch.span_ms[0] / 1000, UTC).date()

    @property
    def worst(self) -> int | None:
        """Gravest verdict; None of events."""
        return max((report.verdict for report in self.batch.reports), default=None)


def verified(arrived: ReceivedBytes, key: Key | None, now_ms: int) -> VerifiedBatch | RejectedBatch:
    """Verify bytes with the key that they name; what is refused is named by its digest alone."""

    def refused(reason: str) -> RejectedBatch:
        return RejectedBatch(0, 0, receipt_digest(arrived.data), reason)

    sealed = arrived.sealed
    if sealed is None:
        return refused(FORMAT)
    if key is None or key.revoked or key.public_key is None:
        return refused(KEY)
    if key.vehicle != arrived.vehicle:
        return refused(VEHICLE)
    if not sealed.is_genuine(key.public_key, arrived.vehicle):
        return refused(SIGNATURE)
    try:
        batch = sealed.batch
    except BadBatch:
        return refused(FORMAT)
    return VerifiedBatch(
        arrived.vehicle, key.tenant_id, arrived.data, chain_digest(arrived.data), batch, _impossible(batch, now_ms)
    )


def _impossible(batch: Batch, now_ms: int) -> str | None:
    begin, end = batch.span_ms
    if max(end, batch.epoch_ms) > now_ms + FUTURE_MS:
        return "future"
    if begin < now_ms - MAX_AGE_MS:
        return "past"
    return None


def newest(batch: Batch) -> tuple[Report, int, bool]:
    """Give the newest report of positions, since when [ms] it has its verdict, and whether the whole batch has it."""
    last = batch.reports[-1]
    since = last.utc_ms
    for report in reversed(batch.reports):
        if report.verdict != last.verdict:
            return last, since, False
        since = report.utc_ms
    return last, since, True


def last_position(batch: Batch) -> Report | None:
    """Give the newest report with a position."""
    return next((report for report in reversed(batch.reports) if report.latitude_e7 is not None), None)


def by_kind(batches: "list[VerifiedBatch]", kind: Kind) -> "list[VerifiedBatch]":
    """Choose those of a kind that are not set aside."""
    return [batch for batch in batches if batch.batch.kind is kind and batch.aside is None]
