"""Vehicles that report, for tests of a centre."""

from collections.abc import Sequence

import psycopg

from fleet.ingest.keys import Keys
from fleet.ingest.store import Store
from fleet.ingest.verification import ReceivedBytes, VerifiedBatch, verified
from shared.evidence.signer import FileSigner
from shared.fleet.batch import Batch, Event, Gap, Kind, Report
from shared.fleet.sealed import chain_digest, seal

START_MS = 1_790_000_000_000


class Unit:
    """Makes batches as the outbox of a vehicle does."""

    def __init__(self, vehicle: str, number: int = 1, epoch_ms: int = START_MS) -> None:
        self.vehicle, self.epoch_ms = vehicle, epoch_ms
        self.signer = FileSigner(number.to_bytes(32, "big"))
        self.next, self.previous, self.now_ms = 0, bytes(32), epoch_ms

    def enter(self, dsn: str, tenant: str = "demo") -> None:
        """Enter vehicle and evidence key into the database, as an enrolment does."""
        with psycopg.connect(dsn) as db:
            db.execute("INSERT INTO tenant (name) VALUES (%s) ON CONFLICT DO NOTHING", (tenant,))
            row = db.execute("SELECT tenant_id FROM tenant WHERE name = %s", (tenant,)).fetchone()
            assert row is not None
            db.execute("INSERT INTO vehicle (vehicle, tenant_id) VALUES (%s, %s)", (self.vehicle, row[0]))
            db.execute(
                "INSERT INTO certificate (key_id, vehicle, tenant_id, kind, public_key, not_before) "
                "VALUES (%s, %s, %s, 'evidence', %s, now())",
                (self.signer.key_id, self.vehicle, row[0], self.signer.public_key),
            )

    def positions(self, verdicts: Sequence[int] = (0,), *, placed: bool = True) -> bytes:
        """Make a batch of one report a second with these verdicts."""
        reports = []
        for verdict in verdicts:
            self.now_ms += 1000
            place = (481_000_000 + self.next, 115_000_000, 50_000, 1000, 0) if placed else (None,) * 5
            reports.append(Report._make((self.now_ms, *place, 35, verdict)))
        return self._made(Batch(Kind.POSITIONS, self.epoch_ms, self.next, len(reports), self.previous, tuple(reports)))

    def events(self, *names: str) -> bytes:
        """Make a batch of events."""
        events = tuple(Event(self.now_ms, name, {"why": "test"}) for name in names)
        return self._made(Batch(Kind.EVENTS, self.epoch_ms, self.next, len(events), self.previous, events=events))

    def gap(self, first: int, count: int) -> bytes:
        """Make a gap in the place of batches that the outbox dropped."""
        gap = Gap(self.epoch_ms, self.now_ms, bytes(32))
        return seal(Batch(Kind.GAP, self.epoch_ms, first, count, bytes(32), gap=gap), self.signer, self.vehicle)

    def _made(self, batch: Batch) -> bytes:
        data = seal(batch, self.signer, self.vehicle)
        self.next += batch.count
        self.previous = chain_digest(data)
        return data


def genuine(store: Store, unit: Unit, batches: Sequence[bytes], now_ms: int = START_MS + 60_000) -> list[VerifiedBatch]:
    """Verify batches as ingest does."""
    keys = Keys(store.keys)
    found = []
    for data in batches:
        arrived = ReceivedBytes.of(unit.vehicle, data)
        assert arrived.sealed is not None
        keys.load({arrived.sealed.key})
        one = verified(arrived, keys.find(arrived.sealed.key), now_ms)
        assert isinstance(one, VerifiedBatch)
        found.append(one)
    return found
