"""Partitions made ahead, and removal of what is older than its tenant keeps."""

import re
from datetime import UTC, date, datetime, timedelta
from typing import NamedTuple

import psycopg
from psycopg import sql

AHEAD_DAYS = 7
RENEW_AFTER_END = timedelta(days=180)  # in which a certificate that has ended can be renewed
PART_ROWS = 5000  # a statement: locks and memory stay small
TOLL = "toll/transaction"  # kept apart
ENROLMENT_DAYS = 90  # after which a token that was used or has expired is forgotten
RETENTION_S = 3600  # after which attempts to log in do not count any more
PARTITION = re.compile(r"segment_(\d{8})")
# Rows of one tenant, by a column of days or of milliseconds [UTC].
OLD_ROWS = {
    "segment": "day < (to_timestamp(%(before_ms)s / 1000.0) AT TIME ZONE 'UTC')::date",
    "event": f"name <> '{TOLL}' AND utc_ms < %(before_ms)s",
    "gap": "to_ms < %(before_ms)s",
    "alarm": "coalesce(until_ms, since_ms) < %(before_ms)s AND until_ms IS NOT NULL",
    "vehicle_now": "utc_ms < %(before_ms)s",
    "set_aside": "arrived < to_timestamp(%(before_ms)s / 1000.0)",
}
# A vehicle that reports on without a position keeps the last one, until that is old.
FORGET_PLACE = """
UPDATE vehicle_now SET position_ms = NULL, latitude_deg = NULL, longitude_deg = NULL, height_m = NULL
WHERE tenant_id = %(tenant)s AND position_ms < %(before_ms)s
"""
OLD_TOLL = f"name = '{TOLL}' AND utc_ms < %(before_ms)s"
ATTACHED = """
SELECT relname, inhdetachpending FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid
WHERE inhparent = 'segment'::regclass
"""
LEFT = """
SELECT relname FROM pg_class WHERE relkind = 'r' AND relname ~ '^segment_[0-9]{8}$'
    AND relnamespace = 'public'::regnamespace AND NOT EXISTS (SELECT FROM pg_inherits WHERE inhrelid = pg_class.oid)
"""


class RetentionReport(NamedTuple):
    """What one run has removed."""

    days: int  # partitions
    rows: int  # of tenants who keep less than the longest


def make_days(dsn: str, today: date | None = None) -> None:
    """Make the partitions of the next days, so that no batch waits for one; raises errors of psycopg."""
    first = today or datetime.now(UTC).date()
    with psycopg.connect(dsn, autocommit=True) as db:
        for ahead in range(-1, AHEAD_DAYS + 1):
            db.execute("SELECT ensure_segment_day(%s)", (first + timedelta(days=ahead),))


def retain(dsn: str, today: date | None = None) -> RetentionReport:
    """Remove what no tenant keeps any more; needs the owner of the database. Raises errors of psycopg.

    A day that is older than all tenants keep is detached without a lock that stops ingest, and dropped; of others the
    rows are deleted in parts.
    """
    today = today or datetime.now(UTC).date()
    with psycopg.connect(dsn, autocommit=True) as db:
        db.execute("SET lock_timeout = '5s'")
        tenants = db.execute("SELECT tenant_id, retention_days, toll_retention_days FROM tenant").fetchall()
        if not tenants:
            return RetentionReport(0, 0)
        days = _drop_days(db, today - timedelta(days=max(row[1] for row in tenants)))
        rows = sum(_delete(db, today, *row) for row in tenants)
        db.execute(
            "DELETE FROM enrolment WHERE coalesce(used, expires) < now() - make_interval(days => %s)", (ENROLMENT_DAYS,)
        )
        db.execute("DELETE FROM certificate WHERE kind = 'tls' AND not_after < now() - %s", (RENEW_AFTER_END,))
        db.execute("DELETE FROM session WHERE expires < now()")
        db.execute("DELETE FROM attempt WHERE last < now() - make_interval(secs => %s)", (RETENTION_S,))
    return RetentionReport(days, rows)


def _drop_days(db: psycopg.Connection, before: date) -> int:
    dropped = 0
    for name, pending in db.execute(ATTACHED).fetchall():
        if not pending and not _is_before(name, before):
            continue
        how = sql.SQL("FINALIZE" if pending else "CONCURRENTLY")  # FINALIZE: of a run that was interrupted
        db.execute(sql.SQL("ALTER TABLE segment DETACH PARTITION {} {}").format(sql.Identifier(name), how))
        dropped += 1
    for (name,) in db.execute(LEFT).fetchall():
        db.execute(sql.SQL("DROP TABLE IF EXISTS {}").format(sql.Identifier("public", name)))
    return dropped


def _is_before(name: str, before: date) -> bool:
    found = PARTITION.fullmatch(name)
    return found is not None and datetime.strptime(found[1], "%Y%m%d").replace(tzinfo=UTC).date() < before


def _delete(db: psycopg.Connection, today: date, tenant: int, days: int, toll_days: int) -> int:
    db.execute(FORGET_PLACE, {"tenant": tenant, "before_ms": _ms(today - timedelta(days=days))})
    conditions = [(table, condition, days) for table, condition in OLD_ROWS.items()]
    return sum(
        _delete_parts(db, table, condition, {"tenant": tenant, "before_ms": _ms(today - timedelta(days=kept))})
        for table, condition, kept in (*conditions, ("event", OLD_TOLL, toll_days))
    )


def _delete_parts(db: psycopg.Connection, table: str, condition: str, values: dict[str, int]) -> int:
    query = (
        f"DELETE FROM {table} WHERE (tableoid, ctid) IN (SELECT tableoid, ctid FROM {table} "  # constants
        f"WHERE tenant_id = %(tenant)s AND {condition} LIMIT {PART_ROWS})"
    )
    deleted = 0
    while count := db.execute(query.encode(), values).rowcount:
        deleted += count
    return deleted


def _ms(day: date) -> int:
    return round(datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp() * 1000)
