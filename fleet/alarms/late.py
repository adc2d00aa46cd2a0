"""Finds what was UNSAFE for long in reports that arrived late: `vehicle_now` has never shown it, or not its beginning.

Batches come in any order, so that a vehicle's are looked at when none of its numbers is missing, or has been for ten
minutes. Content of batches is not read: they end where the verdict changes, and a minute later in the mode trips.
"""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import psycopg
from psycopg.rows import TupleRow, dict_row

from fleet.database.erasure import wait_for_erasures

from .judge import COLUMNS, MISSING_AFTER_MS, UNSAFE_CODE, UNSAFE_MS, Row

DAY_S = 86_400  # looked back at the start
DELAY_MS = 30_000  # batches that arrive later than this after their end are late
MARGIN_MS = 600_000  # of the period that is looked at
WAITING = """
CREATE TEMP TABLE IF NOT EXISTS late_unsafe (
    vehicle text, epoch bigint, tenant_id integer, from_ms bigint, to_ms bigint, seen_ms bigint,
    PRIMARY KEY (vehicle, epoch)
)
"""
FIND = f"""
INSERT INTO late_unsafe AS old SELECT vehicle, epoch, min(tenant_id), min(from_ms), max(to_ms), %(now)s
FROM segment WHERE verdict = {UNSAFE_CODE} AND arrived > now() - make_interval(secs => %(back_s)s)
    AND to_ms < extract(epoch FROM arrived) * 1000 - {DELAY_MS}
GROUP BY vehicle, epoch
ON CONFLICT (vehicle, epoch) DO UPDATE SET
    from_ms = least(old.from_ms, excluded.from_ms), to_ms = greatest(old.to_ms, excluded.to_ms)
"""
WHOLE = f"""
DELETE FROM late_unsafe AS late USING epoch WHERE (late.vehicle, late.epoch) = (epoch.vehicle, epoch.epoch)
    AND (epoch.highest <= epoch.received + epoch.lost OR late.seen_ms < %(now)s - {MISSING_AFTER_MS})
RETURNING late.vehicle, late.epoch, late.tenant_id, late.from_ms, late.to_ms,
    (SELECT min(since_ms) FROM alarm WHERE alarm.vehicle = late.vehicle AND kind = 'unsafe'
        AND since_ms <= late.to_ms AND coalesce(until_ms, late.to_ms) >= late.from_ms) AS alarm_ms,
    (SELECT utc_ms FROM vehicle_now WHERE vehicle_now.vehicle = late.vehicle AND verdict = {UNSAFE_CODE}) AS unsafe_ms
"""
SEGMENTS = """
SELECT to_ms, verdict FROM segment WHERE vehicle = %(vehicle)s AND epoch = %(epoch)s AND kind = 0
    AND from_ms BETWEEN %(from)s AND %(to)s AND day BETWEEN %(first_day)s AND %(last_day)s ORDER BY first_sequence
"""
CORRECT = f"""
UPDATE alarm SET since_ms = least(since_ms, %(since)s),
    until_ms = CASE WHEN until_ms IS NOT NULL THEN least(until_ms, %(until)s) END
WHERE vehicle = %(vehicle)s AND kind = 'unsafe' AND since_ms <= %(until)s
    AND coalesce(until_ms, %(until)s) >= %(since)s AND (since_ms > %(since)s OR until_ms > %(until)s)
RETURNING {COLUMNS}
"""
RAISE = f"""
INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, until_ms, late)
SELECT %(tenant)s, %(vehicle)s, 'unsafe', %(since)s, CASE WHEN NOT %(lasts)s THEN %(until)s::bigint END, true
WHERE NOT EXISTS (
    SELECT FROM alarm WHERE vehicle = %(vehicle)s AND kind = 'unsafe' AND since_ms <= %(until)s
    AND coalesce(until_ms, %(until)s) >= %(since)s
) ON CONFLICT (vehicle, kind) WHERE until_ms IS NULL DO NOTHING RETURNING {COLUMNS}
"""


class Period(NamedTuple):
    """How long a verdict was UNSAFE [ms, UTC]; one that is cut may have gone on."""

    since_ms: int
    until_ms: int
    is_cut: bool


def periods(batches: Iterable[tuple[int, int]]) -> Iterator[Period]:
    """Periods of batches in their order, each by its end [ms] and its worst verdict."""
    since_ms = until_ms = None
    for end_ms, verdict in batches:
        if verdict == UNSAFE_CODE:
            since_ms, until_ms = end_ms if since_ms is None else since_ms, end_ms
        elif since_ms is not None and until_ms is not None:
            yield Period(since_ms, until_ms, False)
            since_ms = None
    if since_ms is not None and until_ms is not None:
        yield Period(since_ms, until_ms, True)


def judge_late(db: psycopg.Connection, now_ms: int, back_s: float) -> list[Row]:
    """Raise and correct alarms by what arrived in the last `back_s`; return the rows that changed."""
    changed = list[Row]()
    with db.transaction(), db.cursor(row_factory=dict_row) as cursor:
        wait_for_erasures(cursor)
        cursor.execute(WAITING)
        cursor.execute(FIND, {"now": now_ms, "back_s": back_s})
        for late in cursor.execute(WHOLE, {"now": now_ms}).fetchall():
            for period in periods(_segments(db, late)):
                values = {
                    "vehicle": late["vehicle"], "tenant": late["tenant_id"], "since": period.since_ms,
                    "until": period.until_ms, "lasts": period.is_cut and period.until_ms == late["unsafe_ms"],
                }  # fmt: skip
                changed += cursor.execute(CORRECT, values).fetchall()
                if period.until_ms - period.since_ms >= UNSAFE_MS:
                    changed += cursor.execute(RAISE, values).fetchall()
    return changed


def _segments(db: psycopg.Connection, late: Row) -> list[TupleRow]:
    from_ms = min(late["from_ms"], late["alarm_ms"] or late["from_ms"]) - MARGIN_MS
    to_ms = late["to_ms"] + MARGIN_MS
    first, last = (datetime.fromtimestamp(ms / 1000, UTC).date() for ms in (from_ms, to_ms))
    values = {
        "vehicle": late["vehicle"], "epoch": late["epoch"], "from": from_ms, "to": to_ms,
        "first_day": first - timedelta(days=1), "last_day": last,
    }  # fmt: skip
    return db.execute(SEGMENTS, values).fetchall()
