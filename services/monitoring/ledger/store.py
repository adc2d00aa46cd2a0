"""The database of the ledger: SQLite with a write-ahead log, every commit on the disk before anything follows."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOSPC
from pathlib import Path

from shared.errors import ObuError

SCHEMA = Path(__file__).with_name("schema.sql")
VERSION = 4
# Columns that tables of earlier versions lack: 1 held no names beside a crossing, and charged without detectors; 2 had
# no signatures; 3 had no registrations as they were signed, and no tickets.
ADDED_COLUMNS = {
    "evidence": ("seal TEXT",),
    "crossing": (
        "passage_id TEXT", "overlaps TEXT NOT NULL DEFAULT '[]'", "settled_ns INTEGER NOT NULL DEFAULT 0",
        "authenticated INTEGER NOT NULL DEFAULT 0", "in_review INTEGER NOT NULL DEFAULT 0",
        "modes TEXT NOT NULL DEFAULT '[]'",
    ),
    "pulse": ("backward INTEGER NOT NULL DEFAULT 0", "owner TEXT"),
    "passage": ("registrations TEXT NOT NULL DEFAULT '[]'", "seal TEXT"),
    "held": ("registrations TEXT NOT NULL DEFAULT '[]'", "seal TEXT"),
    "chain": (
        "crossing_ns INTEGER", "sd_s REAL NOT NULL DEFAULT 1.0", "lane TEXT",
        "authenticated INTEGER NOT NULL DEFAULT 0",
    ),
}  # fmt: skip
# A contract beside a passage, which anybody could change in the file; passages in progress are reviewed.
REMOVED_COLUMNS = {"passage": ("contract", "tariff_class"), "held": ("contract", "tariff_class")}
REPLACED_TABLES = {"registration": "identity"}  # by a column that the newest version has: vehicles register again
Row = sqlite3.Row
Value = str | int | float | bytes | None


class LedgerFault(ObuError):
    """The database cannot be used now; nothing of the transaction is stored."""


class Store:
    """One connection to the ledger's file, with one transaction at a time.

    `synchronous=FULL` makes a commit survive a power cut, `secure_delete` overwrites what is deleted, and `scrub`
    empties the write-ahead log, which holds older versions of the pages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._guarded():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(path, isolation_level=None, timeout=1.0)
            self._db.row_factory = sqlite3.Row
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "secure_delete=ON", "foreign_keys=ON",
                           "journal_size_limit=0", "temp_store=MEMORY"):  # fmt: skip
                self._db.execute(f"PRAGMA {pragma}")
            if (found := self._db.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise sqlite3.DatabaseError(found)
            version = self._db.execute("PRAGMA user_version").fetchone()[0]
            if version not in range(VERSION + 1):
                raise LedgerFault(
                    f"{path} is of version {version}, this program writes {VERSION}: update it, or move the file away"
                )
            self._migrate()
            self._db.executescript(SCHEMA.read_text(encoding="utf-8"))
            self._db.execute(f"PRAGMA user_version={VERSION}")

    def _migrate(self) -> None:
        """Bring the tables of an earlier version to this one, whatever it says: a kill may come between.

        Bookings, evidence and accounts are valid as they are; new tables are created by the schema.
        """
        for table, columns in ADDED_COLUMNS.items():
            present = {row["name"] for row in self._db.execute(f"PRAGMA table_info({table})")}
            for column in columns if present else ():
                if column.split()[0] not in present:
                    self._db.execute(f"ALTER TABLE {table} ADD COLUMN {column}")
            for column in REMOVED_COLUMNS.get(table, ()):
                if column in present:
                    self._db.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
        for table, column in REPLACED_TABLES.items():
            present = {row["name"] for row in self._db.execute(f"PRAGMA table_info({table})")}
            if present and column not in present:
                self._db.execute(f"DROP TABLE {table}")

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Store everything of the block, or nothing."""
        with self._guarded():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            finally:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")

    @contextmanager
    def part(self) -> Iterator[None]:
        """Store everything of the block, or nothing of it, within a transaction that goes on."""
        with self._guarded():
            self._db.execute("SAVEPOINT part")
            try:
                yield
            except BaseException:
                self._db.execute("ROLLBACK TO part")
                raise
            finally:
                self._db.execute("RELEASE part")

    def execute(self, sql: str, *values: Value) -> int:
        """Run a statement; return the number of rows that it changed."""
        return self._db.execute(sql, values).rowcount

    def rows(self, sql: str, *values: Value) -> list[Row]:
        """Run a query."""
        with self._guarded():
            return self._db.execute(sql, values).fetchall()

    def row(self, sql: str, *values: Value) -> Row | None:
        """Run a query for at most one row."""
        return next(iter(self.rows(sql, *values)), None)

    def scrub(self) -> None:
        """Move the write-ahead log into the database and empty it: what was deleted is on the disk no more."""
        with self._guarded():
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def close(self) -> None:
        """Close the connection; an open transaction is rolled back."""
        self._db.close()

    def damaged(self, what: str, error: object) -> LedgerFault:
        """Make the fault of content that SQLite reads and that is not what was written."""
        first = str(error).splitlines()[0]
        return LedgerFault(f"{self.path} is damaged: {what} cannot be read: {first}; {RESTORE}")

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError) as error:
            raise LedgerFault(f"the ledger {self.path} cannot be used: {error}; {_remedy(error)}") from error


DISK_FULL_REMEDY = "make room on its disk; charging continues by itself"
DAMAGE_CODES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)  # the last: content of a row
RESTORE = "move it away for examination and restore its backup; without one a new ledger is begun"


def _remedy(error: Exception) -> str:
    """What to do, by the codes of SQLite and of the operating system; an error of ours without one is damage."""
    code = getattr(error, "sqlite_errorcode", None)
    primary = None if code is None else code & 0xFF
    if primary == sqlite3.SQLITE_FULL or (isinstance(error, OSError) and error.errno == ENOSPC):
        return DISK_FULL_REMEDY
    is_ours = code is None and type(error) is sqlite3.DatabaseError
    if primary in DAMAGE_CODES or is_ours:
        return RESTORE
    return "check its folder's owner and its disk"
