"""The outbox: what is not yet stored by the centre, in SQLite with a write-ahead log.

A report is first a row of its own, committed without waiting for the disk: that survives the end of this process at
any moment, and does not wear a memory card. `flush` makes a signed batch of the rows in one transaction that is on the
disk when it ends. A batch is deleted by its receipt alone.
"""

import fcntl
import json
import logging
import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from shared.errors import ObuError, UserError
from shared.evidence.signer import Signer
from shared.fleet.batch import (
    DIGEST_BYTES,
    EARLIEST_MS,
    LATEST_MS,
    MOST_EVENTS,
    MOST_REPORTS,
    BadBatch,
    Batch,
    Event,
    Gap,
    Kind,
    Report,
)
from shared.fleet.receipts import StoredBatch
from shared.fleet.sealed import RECEIPT_DIGEST_BYTES, chain_digest, seal, unsealed

log = logging.getLogger(__name__)

SCHEMA = Path(__file__).with_name("schema.sql")
VERSION = 1
CACHE_KIB = 512
LOG_PAGES, LOG_BYTES = 250, 1 << 20  # of the write-ahead log, when it is moved into the database, and afterwards
DROPPED_AT_ONCE = 50  # batches
FLUSHED_AT_ONCE = 20
DISK_FULL_CODES = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN)
DAMAGE_CODES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


class OutboxFault(ObuError):
    """The outbox cannot be used now; nothing of the transaction is stored."""


class OutboxDamaged(OutboxFault):
    """Its file is not one that this program wrote, or was damaged."""


class Row(NamedTuple):
    """A batch without its content."""

    id: int  # never used again
    kind: int
    epoch_ms: int
    first: int
    reports: int  # or events
    digest: bytes  # SHA-256


class LostReports(NamedTuple):
    """Reports that could not be stored."""

    number: int
    from_ms: int
    to_ms: int

    def more(self, utc_ms: int) -> "LostReports":
        """Add one."""
        return LostReports(self.number + 1, min(self.from_ms, utc_ms), max(self.to_ms, utc_ms))


@dataclass(frozen=True)
class Backlog:
    """What waits for its receipt."""

    batches: int
    refused: int
    bytes: int
    oldest_ms: int | None  # UTC


@dataclass
class _Chain:
    vehicle: str
    epoch_ms: int
    next: int
    previous: bytes


class Outbox:
    """One file. All methods raise `OutboxFault`, after which the same call may be made again."""

    def __init__(self, path: Path, vehicle: str, now_ms: int, most_bytes: int) -> None:
        self.path, self.most_bytes = path, most_bytes
        self.dropped = 0  # reports, since the start of this process
        self.unusable = 0  # rows of which no batch can be made
        with self._guarded():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, isolation_level=None, timeout=1.0)
            try:
                self._open(vehicle, now_ms)
            except BaseException:
                self._db.close()
                raise

    def _open(self, vehicle: str, now_ms: int) -> None:
        for pragma in ("journal_mode=WAL", "synchronous=NORMAL", f"wal_autocheckpoint={LOG_PAGES}",
                       f"journal_size_limit={LOG_BYTES}", "temp_store=MEMORY", f"cache_size=-{CACHE_KIB}"):  # fmt: skip
            self._db.execute(f"PRAGMA {pragma}")
        version = self._db.execute("PRAGMA user_version").fetchone()[0]
        if version not in (0, VERSION):
            raise OutboxDamaged(f"{self.path} is of version {version}, and this program writes {VERSION}")
        self._db.executescript(SCHEMA.read_text(encoding="utf-8"))
        self._db.execute(f"PRAGMA user_version={VERSION}")
        row = self._db.execute("SELECT vehicle, epoch_ms, next, previous FROM chain").fetchone()
        self._chain = _Chain(*row) if row else _Chain(vehicle, now_ms, 0, bytes(DIGEST_BYTES))
        if self._chain.vehicle != vehicle:
            raise OutboxDamaged(f"{self.path} is that of {self._chain.vehicle!r}, and this unit is {vehicle!r} now")
        self._batches = self._refused = 0
        self._count()

    @property
    def vehicle(self) -> str:
        """Name of the unit at the centre, as which its batches are signed."""
        return self._chain.vehicle

    @property
    def refused(self) -> int:
        """How many batches the centre has refused, of those that wait."""
        return self._refused

    @property
    def epoch_ms(self) -> int:
        """Creation time of the chain [ms, UTC]."""
        return self._chain.epoch_ms

    def add(self, *items: Report | Event | LostReports) -> None:
        """Keep reports or events for the next batch: all of them, or none."""
        with self._transaction(durable=False):
            self._db.executemany("INSERT INTO pending (kind, content) VALUES (?, ?)", map(_encoded, items))

    def flush(self, signer: Signer, kinds: Sequence[Kind] = (Kind.EVENTS, Kind.GAP, Kind.POSITIONS)) -> int:
        """Make signed batches of what is pending, events first; return how many."""
        made = 0
        for kind in kinds:
            most = {Kind.EVENTS: MOST_EVENTS, Kind.GAP: 1, Kind.POSITIONS: MOST_REPORTS}[kind]
            while made < FLUSHED_AT_ONCE and (rows := self._pending(kind, most)):
                made += self._flush(kind, rows, signer)
        self._make_room(signer)
        return made

    def _pending(self, kind: Kind, most: int) -> list[tuple[int, str]]:
        with self._guarded():
            return self._db.execute(
                "SELECT id, content FROM pending WHERE kind = ? ORDER BY id LIMIT ?", (int(kind), most)
            ).fetchall()

    def _flush(self, kind: Kind, rows: list[tuple[int, str]], signer: Signer) -> bool:
        """Make a batch of the first of these rows: all, or half of them as often as they are too much for one."""
        with self._guarded():
            items = [_decoded(kind, content) for _, content in rows]
        while True:
            try:
                batch = _batch(kind, self._chain, items)
                data = seal(batch, signer, self._chain.vehicle)
                break
            except BadBatch:
                if len(items) == 1:
                    self.unusable += 1
                    with self._transaction():
                        self._db.execute("DELETE FROM pending WHERE id = ?", (rows[0][0],))
                    return False
                items = items[: len(items) // 2]
        with self._transaction():
            ids = [(row[0],) for row in rows[: len(items)]]
            self._db.executemany("DELETE FROM pending WHERE id = ?", ids)
            chain = self._append(batch, data)
        self._chain, self._batches = chain, self._batches + 1
        return True

    def _append(self, batch: Batch, data: bytes, row_id: int | None = None) -> _Chain:
        """Insert a batch, and give the chain after it; within a transaction."""
        self._insert(batch, data, row_id)
        following = chain_digest(data) if batch.gap is None else batch.gap.last
        chain = _Chain(self._chain.vehicle, batch.epoch_ms, batch.first + batch.count, following)
        self._db.execute(
            "INSERT OR REPLACE INTO chain VALUES (1, ?, ?, ?, ?)",
            (chain.vehicle, chain.epoch_ms, chain.next, chain.previous),
        )
        return chain

    def _insert(self, batch: Batch, data: bytes, row_id: int | None) -> None:
        self._db.execute(
            "INSERT INTO batch (id, kind, epoch_ms, first, count, from_ms, digest, content) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (row_id, int(batch.kind), batch.epoch_ms, batch.first, batch.count, batch.span_ms[0], chain_digest(data),
             data),
        )  # fmt: skip

    def open_rows(self, *, kind: Kind | None = None, newest: bool = False, most: int = 1) -> list[Row]:
        """List batches that the centre has not refused, the oldest or the newest first."""
        of_kind = "" if kind is None else f"kind = {int(kind)} AND "
        return self._rows(f"{of_kind}refused_ns IS NULL ORDER BY id {'DESC' if newest else ''} LIMIT ?", most)

    def refused_rows(self, before_ns: int, now_ns: int, most: int = 1) -> list[Row]:
        """List batches that were refused before a time of the OBU time line, or in a boot with a later one."""
        return self._rows("(refused_ns <= ? OR refused_ns > ?) ORDER BY refused_ns LIMIT ?", before_ns, now_ns, most)

    def _rows(self, where: str, *values: int) -> list[Row]:
        with self._guarded():
            found = self._db.execute(
                f"SELECT id, kind, epoch_ms, first, count, digest FROM batch WHERE {where}", values
            )
            return [Row(*row) for row in found]

    def content(self, row_id: int) -> bytes | None:
        """Signed bytes of a batch; None if it is gone. Raises `OutboxDamaged` if they are not those that were made."""
        with self._guarded():
            row = self._db.execute("SELECT digest, content FROM batch WHERE id = ?", (row_id,)).fetchone()
        if row is not None and chain_digest(row[1]) != row[0]:
            raise OutboxDamaged(f"{self.path} is damaged: batch {row_id} is not as it was made")
        return None if row is None else bytes(row[1])

    def settle(self, stored: Iterable[StoredBatch]) -> list[int]:
        """Delete the batches that a receipt names exactly; return their IDs."""
        gone: list[int] = []
        refused = 0
        with self._transaction(durable=False):  # after a power cut they are sent, and receipted, once more
            for item in stored:
                if (row := self._named(*item)) is not None:
                    self._db.execute("DELETE FROM batch WHERE id = ?", (row[0],))
                    gone.append(row[0])
                    refused += row[1]
        self._batches, self._refused = self._batches - len(gone), self._refused - refused
        return gone

    def refuse(self, digest: bytes, reason: str, now_ns: int) -> Row | None:
        """Mark the batch of this digest as refused; return it, None if there is none.

        A centre that cannot verify a batch does not know its epoch and number, so that the digest alone names it.
        """
        ends = digest + b"\xff" * (DIGEST_BYTES - len(digest))
        with self._transaction(durable=False):
            found = self._db.execute(
                "SELECT id, kind, epoch_ms, first, count, digest, refused_ns IS NOT NULL FROM batch "
                "WHERE digest BETWEEN ? AND ?", (digest, ends)
            ).fetchone()  # fmt: skip
            if found is None:
                return None
            self._db.execute("UPDATE batch SET refused_ns = ?, reason = ? WHERE id = ?", (now_ns, reason, found[0]))
        self._refused += not found[-1]
        return Row(*found[:-1])

    def reopen(self, reason: str) -> None:
        """Take back that batches were refused for a reason that no longer holds."""
        with self._transaction(durable=False):
            self._db.execute("UPDATE batch SET refused_ns = NULL, reason = NULL WHERE reason = ?", (reason,))
        self._count()

    def _named(self, epoch_ms: int, first: int, digest: bytes) -> tuple[int, bool] | None:
        """ID of a batch, and whether it is refused."""
        row = self._db.execute(
            "SELECT id, refused_ns IS NOT NULL FROM batch WHERE epoch_ms = ? AND first = ? "
            f"AND substr(digest, 1, {RECEIPT_DIGEST_BYTES}) = ?",
            (epoch_ms, first, digest),
        ).fetchone()
        return None if row is None else (int(row[0]), bool(row[1]))

    def begin_epoch(self, now_ms: int) -> None:
        """Number from 0 again, in a chain of its own; written with its first batch."""
        self._chain = _Chain(
            self._chain.vehicle, min(max(now_ms, self._chain.epoch_ms + 1), LATEST_MS), 0, bytes(DIGEST_BYTES)
        )

    def make_anew(self, row_id: int, signer: Signer) -> None:
        """Put what a batch holds at the end of the present chain, in its place."""
        if (data := self.content(row_id)) is None:
            return
        with self._guarded():
            old = unsealed(data).batch
        chain = self._chain
        gap = None if old.gap is None else Gap(old.gap.from_ms, old.gap.to_ms, chain.previous)
        batch = Batch(old.kind, chain.epoch_ms, chain.next, old.count, chain.previous, old.reports, old.events, gap)
        try:
            sealed = seal(batch, signer, chain.vehicle)
        except BadBatch:
            return  # it was as large as can be, and is some bytes larger now: it stays refused
        with self._transaction():
            self._db.execute("DELETE FROM batch WHERE id = ?", (row_id,))
            after = self._append(batch, sealed)
        self._chain = after
        self._count()

    def backlog(self) -> Backlog:
        """Sum up what waits; its bytes are those of the file."""
        oldest = self.open_rows()
        with self._guarded():
            row = self._db.execute(
                "SELECT from_ms FROM batch WHERE id = ?", (oldest[0].id if oldest else 0,)
            ).fetchone()
            used = self._used_bytes()
        return Backlog(self._batches, self._refused, used, row[0] if row else None)

    def _used_bytes(self) -> int:
        pages, free, size = (
            int(self._db.execute(f"PRAGMA {name}").fetchone()[0])
            for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * size

    def _count(self) -> None:
        """Count batches after some were deleted or marked; raises `OutboxFault`."""
        with self._guarded():
            found = self._db.execute("SELECT count(*), count(refused_ns) FROM batch").fetchone()
        self._batches, self._refused = int(found[0]), int(found[1])

    def _make_room(self, signer: Signer) -> None:
        """Drop the oldest positions of an outbox that is too large; those that the centre has refused go first."""
        while self._used_bytes() > self.most_bytes:
            rows = self._rows("kind = 0 AND refused_ns IS NOT NULL ORDER BY id LIMIT ?", DROPPED_AT_ONCE)
            rows = rows or self._rows("kind = 0 AND refused_ns IS NULL ORDER BY id LIMIT ?", DROPPED_AT_ONCE)
            if not rows:
                return  # events alone: they stay
            with self._transaction():
                dropped = sum(self._replace(run, signer) for run in _runs(rows))
            self.dropped += dropped
            self._count()

    def _replace(self, run: list[Row], signer: Signer) -> int:
        """Put a gap in the place of adjoining batches, and of gaps beside them; return the number of reports."""
        batches = [unsealed(bytes(self.content(row.id) or b"")).batch for row in run]
        dropped = sum(batch.count for batch in batches)
        ids, last = [row.id for row in run], run[-1].digest
        before = self._gap_at("first + count = ?", batches[0].epoch_ms, batches[0].first)
        after = self._gap_at("first = ?", batches[0].epoch_ms, batches[-1].first + batches[-1].count)
        if before is not None:
            ids.insert(0, before[0])
            batches.insert(0, before[1])
        if after is not None and after[1].gap is not None:
            ids.append(after[0])
            batches.append(after[1])
            last = after[1].gap.last
        head, spans = batches[0], [batch.span_ms for batch in batches]
        gap = Gap(min(begin for begin, _ in spans), max(end for _, end in spans), last)
        count = sum(batch.count for batch in batches)
        batch = Batch(Kind.GAP, head.epoch_ms, head.first, count, head.previous, gap=gap)
        self._db.executemany("DELETE FROM batch WHERE id = ?", [(row,) for row in ids])
        self._insert(batch, seal(batch, signer, self._chain.vehicle), ids[0])
        return dropped

    def _gap_at(self, where: str, epoch_ms: int, number: int) -> tuple[int, Batch] | None:
        row = self._db.execute(
            f"SELECT id, content FROM batch WHERE epoch_ms = ? AND kind = 2 AND {where}", (epoch_ms, number)
        ).fetchone()
        return None if row is None else (int(row[0]), unsealed(bytes(row[1])).batch)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _transaction(self, *, durable: bool = True) -> Iterator[None]:
        """Store everything of the block, or nothing; on the disk if it is durable."""
        with self._guarded():
            if durable:
                self._db.execute("PRAGMA synchronous=FULL")
            try:
                self._db.execute("BEGIN IMMEDIATE")
                yield
                self._db.execute("COMMIT")
            finally:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                if durable:
                    self._db.execute("PRAGMA synchronous=NORMAL")

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.DatabaseError as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
            if code in DAMAGE_CODES:
                raise OutboxDamaged(f"{self.path} is damaged: {error}") from error
            remedy = "make room on its disk" if code in DISK_FULL_CODES else "check its folder's owner and its disk"
            raise OutboxFault(f"the outbox {self.path} cannot be used: {error}; {remedy}") from error
        except (BadBatch, ValueError) as error:  # content that SQLite reads and that is not what was written
            raise OutboxDamaged(f"{self.path} is damaged: {error}") from error
        except OSError as error:
            raise OutboxFault(f"cannot make {self.path}: {error.strerror}; check its folder's owner") from error


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the folder of an outbox: two processes would number their batches alike. Raises `UserError`.

    The kernel lets go of it when this process ends, however it does. A folder that cannot be made or opened holds
    nobody up: `Outbox` says what is the matter with it.
    """
    with ExitStack() as stack:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(
                f"another monitoring.uplink has the outbox in {folder}; end it, or give this unit a state folder of "
                "its own (OBU_STATE)"
            ) from error
        except OSError as error:
            log.warning("%s cannot be held for this process alone: %s", folder, error.strerror)
        yield


def set_aside(path: Path) -> Path:
    """Move a file of the outbox away, in the place of one that was moved before; raises `OutboxFault`."""
    place = path.with_name("outbox.damaged.sqlite")
    try:
        for suffix in ("", "-wal", "-shm"):
            source, target = path.with_name(path.name + suffix), place.with_name(place.name + suffix)
            if source.exists():
                source.replace(target)
            else:
                target.unlink(missing_ok=True)
    except OSError as error:
        raise OutboxFault(f"cannot move {path} away: {error.strerror}; check its folder's owner") from error
    return place


def in_range(utc_ms: int) -> bool:
    """Whether a stamp may enter a batch."""
    return EARLIEST_MS <= utc_ms < LATEST_MS


def _runs(rows: list[Row]) -> Iterator[list[Row]]:
    """Split rows in the order of their making where their sequence numbers do not adjoin."""
    run: list[Row] = []
    for row in rows:
        if run and (row.epoch_ms, row.first) != (run[-1].epoch_ms, run[-1].first + run[-1].reports):
            yield run
            run = []
        run.append(row)
    if run:
        yield run


def _encoded(item: Report | Event | LostReports) -> tuple[int, str]:
    kind = {Report: Kind.POSITIONS, Event: Kind.EVENTS, LostReports: Kind.GAP}[type(item)]
    return int(kind), json.dumps(list(item), separators=(",", ":"))


def _decoded(kind: Kind, text: str) -> Report | Event | LostReports:
    fields = json.loads(text)
    if kind is Kind.EVENTS:
        return Event(*fields)
    return LostReports(*fields) if kind is Kind.GAP else Report(*fields)


def _batch(kind: Kind, chain: _Chain, items: Sequence[Report | Event | LostReports]) -> Batch:
    head = chain.epoch_ms, chain.next
    if isinstance(lost := items[0], LostReports):  # no batch of these was made: the chain goes on as it was before them
        gap = Gap(lost.from_ms, lost.to_ms, chain.previous)
        return Batch(kind, *head, lost.number, chain.previous, gap=gap)
    reports = tuple(report for report in items if isinstance(report, Report))
    events = tuple(event for event in items if isinstance(event, Event))
    return Batch(kind, *head, len(items), chain.previous, reports, events)
