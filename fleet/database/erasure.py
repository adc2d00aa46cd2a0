"""Erasure of what a vehicle has reported; hashes of its batches stay, so that the chain of those that come fits on."""

from typing import Any, NamedTuple

import psycopg

from .retention import TOLL

ERASING = 2401  # lock
KEEP_CHAIN = """
WITH gone AS (DELETE FROM segment WHERE vehicle = %s RETURNING *)
INSERT INTO erased_batch (vehicle, epoch, first_sequence, count, tenant_id, digest)
SELECT DISTINCT ON (vehicle, epoch, first_sequence) vehicle, epoch, first_sequence, count, tenant_id, digest FROM gone
ORDER BY vehicle, epoch, first_sequence ON CONFLICT DO NOTHING
"""
# Numbers and digests of these stay, so that what is sent again does not count, or come back, a second time.
EMPTY = (
    "UPDATE gap SET from_ms = extract(epoch FROM erased) * 1000, to_ms = extract(epoch FROM erased) * 1000, "
    "content = '' FROM vehicle WHERE gap.vehicle = vehicle.vehicle AND gap.vehicle = %s",
    "UPDATE set_aside SET content = '', arrived = now() WHERE vehicle = %s",
    "DELETE FROM vehicle_now WHERE vehicle = %s",
    "DELETE FROM alarm WHERE vehicle = %s",
)


def wait_for_erasures(cursor: psycopg.Cursor[Any]) -> None:
    """Begin a transaction that writes what vehicles report, or follows from it: none is erased before it ends.

    An erasure waits for such transactions, and those that wait for it know of it by their next statement.
    """
    cursor.execute("SELECT pg_advisory_xact_lock_shared(%s)", (ERASING,))


class ErasureReport(NamedTuple):
    """What was erased of a vehicle."""

    batches: int
    events: int
    charges_kept: int  # of a toll plaza


def erase(db: psycopg.Connection, vehicle: str, who: str) -> ErasureReport | None:
    """Erase positions, events and alarms of a vehicle in one transaction; None: there is no such vehicle.

    Keys and audit stay, and charges of a toll plaza, which have a retention of their own. What the vehicle sends
    afterwards of the time before is receipted, and not stored.
    """
    with db.transaction():
        db.execute("SELECT pg_advisory_xact_lock(%s)", (ERASING,))
        row = db.execute(
            "UPDATE vehicle SET erased = clock_timestamp() WHERE vehicle = %s RETURNING tenant_id", (vehicle,)
        ).fetchone()
        if row is None:
            return None
        batches = db.execute(KEEP_CHAIN, (vehicle,)).rowcount
        events = db.execute("DELETE FROM event WHERE vehicle = %s AND name <> %s", (vehicle, TOLL)).rowcount
        kept = db.execute("SELECT count(*) FROM event WHERE vehicle = %s", (vehicle,)).fetchone()
        for statement in EMPTY:
            db.execute(statement, (vehicle,))
        done = ErasureReport(batches, events, 0 if kept is None else int(kept[0]))
        db.execute(
            "INSERT INTO audit (tenant_id, who, action, vehicle, detail) "
            "VALUES (%s, %s, 'erased', %s, jsonb_build_object('batches', %s::int, 'events', %s::int))",
            (row[0], who, vehicle, done.batches, done.events),
        )
    return done
