"""Holds what the centre has stored against the list of what was made."""

import csv
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import psycopg

from fleet.database.refusals import unusable
from shared.errors import UserError
from shared.fleet.batch import BadBatch, Kind
from shared.fleet.sealed import chain_digest, unsealed

from .outboxes import BatchTruth

STORED = """
SELECT vehicle, epoch, first_sequence, count, digest FROM segment WHERE vehicle = ANY(%s)
UNION ALL SELECT vehicle, 0, 0, 0, digest FROM set_aside WHERE vehicle = ANY(%s)
UNION ALL SELECT vehicle, epoch, first_sequence, count::int, ''::bytea FROM gap WHERE vehicle = ANY(%s)
"""
COUNTED = "SELECT vehicle, epoch, received FROM epoch WHERE vehicle = ANY(%s)"
CONTENT = "SELECT content FROM segment WHERE vehicle = %s ORDER BY epoch, first_sequence"


@dataclass
class Verdict:
    """Reports that were made and are not stored, stored twice, stored and never made, or counted wrongly."""

    made: int = 0
    stored: int = 0
    lost: int = 0
    double: int = 0
    foreign: int = 0
    faults: list[str] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        """Whether each report is stored once."""
        return not (self.lost or self.double or self.foreign or self.faults)

    def add(self, other: "Verdict") -> "Verdict":
        """Sum of two."""
        return Verdict(
            self.made + other.made, self.stored + other.stored, self.lost + other.lost, self.double + other.double,
            self.foreign + other.foreign, self.faults + other.faults,
        )  # fmt: skip


def write(path: Path, made: Iterable[BatchTruth]) -> None:
    """Write the truth list; raises `UserError`."""
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(BatchTruth._fields)
            writer.writerows((*item[:-1], item.digest.hex()) for item in made)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; name another file with --out") from error


def compared(dsn: str, vehicles: list[str], made: Iterable[BatchTruth]) -> Verdict:
    """Compare the truth list with the database, batch by batch; raises `UserError`."""
    truth = set(made)
    found = Verdict(made=sum(made.reports for made in truth))
    rows = Counter[BatchTruth]()
    ends: dict[tuple[str, int], list[tuple[int, int]]] = defaultdict(list)
    sums = Counter[tuple[str, int]]()
    with _connected(dsn) as db, db.cursor("stored") as cursor:
        for row in cursor.execute(STORED, (vehicles,) * 3):
            one = BatchTruth(row[0], row[1], row[2], row[3], bytes(row[4]))
            rows[one] += 1
            sums[one.vehicle, one.epoch_ms] += one.reports
            ends[one.vehicle, one.epoch_ms].append((one.first, one.first + one.reports))
        counted = {(row[0], row[1]): row[2] for row in db.execute(COUNTED, (vehicles,))}
    found.stored = sums.total()
    found.lost = sum(made.reports for made in truth - rows.keys())
    found.foreign = sum(made.reports or 1 for made in rows.keys() - truth)
    found.double = sum(made.reports * (number - 1) for made, number in rows.items()) + sum(map(_overlap, ends.values()))
    wrong = [key for key in sums.keys() | counted.keys() if sums[key] != counted.get(key, 0)]
    if wrong:
        found.faults.append(f"the counters of {len(wrong)} vehicles differ from their rows, as of {wrong[0][0]}")
    return found


def chained(dsn: str, vehicle: str, done: set[int], begun: set[int]) -> Verdict:
    """Compare the reports of one outbox on the disk, by their stamps, and follow its chain.

    `done` are the stamps [ms] that it has taken, each of which must be stored once; `begun` those that a killed process
    may or may not have given to it.
    """
    found, stamps = Verdict(made=len(done)), Counter[int]()
    following, previous, epoch = 0, bytes(32), None
    with _connected(dsn) as db:
        for data in _contents(db, vehicle):
            try:
                batch = unsealed(data).batch
            except BadBatch as error:
                found.faults.append(f"{vehicle}: {error}")
                continue
            if (epoch or batch.epoch_ms, following, previous) != (batch.epoch_ms, batch.first, batch.previous):
                found.faults.append(f"{vehicle}: the chain is broken at {batch.first}")
            if batch.kind is not Kind.POSITIONS:
                found.faults.append(f"{vehicle}: a batch that was never made at {batch.first}")
            epoch, following, previous = batch.epoch_ms, batch.first + batch.count, chain_digest(data)
            stamps.update(report.utc_ms for report in batch.reports)
    found.stored = stamps.total()
    found.lost = len(done - stamps.keys())
    found.double = found.stored - len(stamps)
    found.foreign = len(stamps.keys() - done - begun)
    return found


def summed(verdicts: Iterable[Verdict]) -> Verdict:
    """Sum of many."""
    total = Verdict()
    for verdict in verdicts:
        total = total.add(verdict)
    return total


def text_of(verdict: Verdict) -> Mapping[str, int]:
    """Its numbers by their names."""
    names = "made", "stored", "lost", "double", "foreign"
    return {name: getattr(verdict, name) for name in names}


def _contents(db: psycopg.Connection, vehicle: str) -> Iterator[bytes]:
    return (bytes(row[0]) for row in db.execute(CONTENT, (vehicle,)))


def _overlap(spans: list[tuple[int, int]]) -> int:
    """Sequence numbers that more than one row holds."""
    double, end = 0, 0
    for begin, until in sorted(spans):
        double += max(0, min(end, until) - begin)
        end = max(end, until)
    return double


def _connected(dsn: str) -> psycopg.Connection:
    try:
        return psycopg.connect(dsn, connect_timeout=5)
    except psycopg.OperationalError as error:
        raise UserError(unusable(error)) from error
