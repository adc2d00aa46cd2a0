"""Stores a group of batches in one transaction: what is there already stays as it is."""

import json
from collections.abc import Iterable, Sequence
from datetime import UTC, date, datetime, timedelta

import psycopg

from fleet.database.erasure import wait_for_erasures
from fleet.database.refusals import reason_of
from fleet.database.retention import TOLL
from shared.fleet.batch import Kind

from .keys import KeyRow, Limits
from .verification import CONFLICT, EPOCHS, FORMAT, VerifiedBatch, by_kind, last_position, newest

# Rows of a group come by COPY into tables of the connection, and from there where they are not yet.
STAGING = """
CREATE TEMP TABLE IF NOT EXISTS new_segment (
    day date, vehicle text, epoch bigint, first_sequence bigint, count integer, kind smallint, from_ms bigint,
    to_ms bigint, verdict smallint, tenant_id integer, digest bytea, content bytea
) ON COMMIT DELETE ROWS;
CREATE TEMP TABLE IF NOT EXISTS new_now (
    vehicle text, tenant_id integer, epoch bigint, sequence bigint, utc_ms bigint, position_ms bigint,
    latitude_deg double precision, longitude_deg double precision, height_m real, north_m_s real, east_m_s real,
    level_m real, verdict smallint, since_ms bigint, whole boolean
) ON COMMIT DELETE ROWS;
CREATE TEMP TABLE IF NOT EXISTS new_event (
    vehicle text, epoch bigint, sequence bigint, tenant_id integer, utc_ms bigint, name text, content jsonb,
    digest bytea
) ON COMMIT DELETE ROWS;
"""
COPY_SEGMENT = "COPY new_segment FROM STDIN (FORMAT BINARY)"
SEGMENT_TYPES = (
    "date", "text", "int8", "int8", "int4", "int2", "int8", "int8", "int2", "int4", "bytea", "bytea",
)  # fmt: skip
COPY_NOW = "COPY new_now FROM STDIN (FORMAT BINARY)"
NOW_TYPES = (
    "text", "int4", "int8", "int8", "int8", "int8", "float8", "float8", "float4", "float4", "float4", "float4", "int2",
    "int8", "bool",
)  # fmt: skip
COPY_EVENT = "COPY new_event FROM STDIN"
# Sequence numbers that hold other content already: a restored outbox, or a key in two hands. Positions of another day
# are not looked for, since each day is a partition with a key of its own: both are stored.
CONFLICTS = """
SELECT new.digest FROM new_segment AS new
JOIN segment AS old USING (day, vehicle, epoch, first_sequence) WHERE old.digest <> new.digest
UNION ALL
SELECT new.digest FROM new_segment AS new
JOIN erased_batch AS old USING (vehicle, epoch, first_sequence) WHERE old.digest <> new.digest
UNION ALL
SELECT new.digest FROM new_event AS new JOIN event AS old USING (vehicle, epoch, sequence)
WHERE (old.utc_ms, old.name, old.content) <> (new.utc_ms, new.name, new.content)
"""
# An outbox begins an epoch when it is made, or after a conflict, at most once an hour.
MAX_EPOCHS = 10_000  # of a vehicle
KNOWN_EPOCHS = 50_000  # remembered as made
MAKE_EPOCHS = f"""
INSERT INTO epoch (vehicle, epoch, tenant_id)
SELECT * FROM unnest(%(vehicles)s::text[], %(epochs)s::bigint[], %(tenants)s::integer[]) AS new (vehicle, epoch, tenant)
WHERE (SELECT count(*) FROM epoch AS old WHERE old.vehicle = new.vehicle) < {MAX_EPOCHS} ON CONFLICT DO NOTHING
"""
# What has an epoch waits for those that store of the same one, before it looks at what is there: otherwise two of them
# would not see each other's conflicts and gaps. All take them in one order, so that none waits for one that waits.
LOCK_EPOCHS = """
SELECT vehicle, epoch FROM epoch JOIN unnest(%(vehicles)s::text[], %(epochs)s::bigint[]) AS new (vehicle, epoch)
    USING (vehicle, epoch) ORDER BY vehicle, epoch FOR UPDATE OF epoch
"""
LEAVE_OUT = "DELETE FROM new_segment WHERE digest = ANY(%s)"
LEAVE_EVENTS_OUT = "DELETE FROM new_event WHERE digest = ANY(%s)"
# Batches of before an erasure, which a vehicle sends late or again: digests and charges are kept, and nothing else.
ERASED = """
SELECT digest FROM new_segment AS new JOIN vehicle USING (vehicle) WHERE erased IS NOT NULL AND (
    from_ms < extract(epoch FROM erased) * 1000
    OR EXISTS (SELECT FROM erased_batch AS old WHERE
        (old.vehicle, old.epoch, old.first_sequence) = (new.vehicle, new.epoch, new.first_sequence))
    OR EXISTS (SELECT FROM set_aside AS old WHERE old.digest = new.digest AND old.content = ''))
"""
# The rows of one vehicle are taken in one order by every ingest, so that two of them do not wait for each other.
ACCOUNT = """
INSERT INTO epoch (vehicle, epoch, tenant_id, received, highest)
SELECT vehicle, epoch, min(tenant_id), sum(count), max(after) FROM stored GROUP BY vehicle, epoch ORDER BY 1, 2
ON CONFLICT (vehicle, epoch) DO UPDATE SET
    received = epoch.received + excluded.received, highest = greatest(epoch.highest, excluded.highest)
"""
FORGET = f"""
WITH gone AS ({LEAVE_OUT} RETURNING *), stored AS (
    INSERT INTO erased_batch (vehicle, epoch, first_sequence, count, tenant_id, digest)
    SELECT vehicle, epoch, first_sequence, count, tenant_id, digest FROM gone ORDER BY vehicle, epoch, first_sequence
    ON CONFLICT DO NOTHING RETURNING vehicle, tenant_id, epoch, count, first_sequence + count AS after
){ACCOUNT}"""
INSERT_SEGMENT = f"""
WITH stored AS (
    INSERT INTO segment (day, vehicle, epoch, first_sequence, count, kind, from_ms, to_ms, verdict, tenant_id, digest,
        content)
    SELECT day, vehicle, epoch, first_sequence, count, kind, from_ms, to_ms, verdict, tenant_id, digest, content
    FROM new_segment ORDER BY vehicle, epoch, first_sequence
    ON CONFLICT DO NOTHING RETURNING vehicle, tenant_id, epoch, count, first_sequence + count AS after
){ACCOUNT}"""
UPDATE_NOW = """
INSERT INTO vehicle_now AS old (vehicle, tenant_id, epoch, sequence, utc_ms, position_ms, latitude_deg, longitude_deg,
    height_m, north_m_s, east_m_s, level_m, verdict, verdict_since_ms)
SELECT new.vehicle, new.tenant_id, new.epoch, new.sequence,
    least(new.utc_ms, (extract(epoch FROM now()) * 1000)::bigint), coalesce(new.position_ms, old.position_ms),
    coalesce(new.latitude_deg, old.latitude_deg), coalesce(new.longitude_deg, old.longitude_deg),
    coalesce(new.height_m, old.height_m), new.north_m_s, new.east_m_s, new.level_m, new.verdict,
    CASE WHEN new.whole AND new.verdict = old.verdict THEN old.verdict_since_ms ELSE new.since_ms END
FROM (SELECT DISTINCT ON (vehicle) * FROM new_now ORDER BY vehicle, epoch DESC, sequence DESC) AS new
LEFT JOIN vehicle_now AS old USING (vehicle) ORDER BY new.vehicle
ON CONFLICT (vehicle) DO UPDATE SET
    epoch = excluded.epoch, sequence = excluded.sequence, utc_ms = excluded.utc_ms, arrived = now(),
    position_ms = excluded.position_ms, latitude_deg = excluded.latitude_deg, longitude_deg = excluded.longitude_deg,
    height_m = excluded.height_m, north_m_s = excluded.north_m_s, east_m_s = excluded.east_m_s,
    level_m = excluded.level_m, verdict = excluded.verdict, verdict_since_ms = excluded.verdict_since_ms
WHERE CASE excluded.epoch WHEN old.epoch THEN excluded.sequence > old.sequence ELSE excluded.utc_ms > old.utc_ms END
RETURNING vehicle, tenant_id, epoch, sequence, utc_ms, position_ms, latitude_deg, longitude_deg, height_m, north_m_s,
    east_m_s, level_m, verdict, verdict_since_ms
"""
INSERT_EVENT = """
INSERT INTO event (vehicle, epoch, sequence, tenant_id, utc_ms, name, content)
SELECT vehicle, epoch, sequence, tenant_id, utc_ms, name, content FROM new_event ON CONFLICT DO NOTHING
"""
# An erased vehicle's gaps and what is set aside of it have the time of the erasure, and no content.
ERASURE = """SELECT vehicle, coalesce(extract(epoch FROM erased) * 1000, 0)::bigint AS erased_ms FROM vehicle
WHERE vehicle = %(vehicle)s"""
SET_ASIDE = f"""
WITH erasure AS ({ERASURE})
INSERT INTO set_aside (digest, vehicle, tenant_id, reason, content)
SELECT %(digest)s, vehicle, %(tenant)s, %(reason)s, CASE WHEN %(from)s < erased_ms THEN '' ELSE %(content)s END
FROM erasure ON CONFLICT DO NOTHING
"""
# An outbox signs adjoining gaps anew as one, which takes the place of those that are stored; one of those that comes
# again is known. So the gaps of an epoch do not overlap, and the last that begins before a number may hold it.
UPSERT_GAP = f"""
WITH erasure AS ({ERASURE}),
larger AS (
    SELECT vehicle, erased_ms FROM erasure WHERE %(first)s + %(count)s > coalesce((
        SELECT first_sequence + count FROM gap WHERE (gap.vehicle, epoch) = (erasure.vehicle, %(epoch)s)
        AND first_sequence <= %(first)s ORDER BY first_sequence DESC LIMIT 1), 0)
),
parts AS (
    DELETE FROM gap USING larger WHERE (gap.vehicle, epoch) = (larger.vehicle, %(epoch)s)
        AND first_sequence > %(first)s AND first_sequence < %(first)s + %(count)s
        AND first_sequence + count <= %(first)s + %(count)s RETURNING count, told
),
before AS (
    SELECT coalesce(sum(count), 0) AS count, coalesce(sum(told), 0) AS told FROM (
        SELECT count, told FROM parts UNION ALL
        SELECT count, told FROM gap WHERE (vehicle, epoch, first_sequence) = (%(vehicle)s, %(epoch)s, %(first)s)
    ) AS old
),
stored AS (
    INSERT INTO gap (vehicle, epoch, first_sequence, count, tenant_id, from_ms, to_ms, content, told)
    SELECT vehicle, %(epoch)s, %(first)s, %(count)s, %(tenant)s, greatest(%(from)s, erased_ms),
        greatest(%(to)s, erased_ms), CASE WHEN %(from)s < erased_ms THEN '' ELSE %(content)s END, before.told
    FROM larger, before
    ON CONFLICT (vehicle, epoch, first_sequence) DO UPDATE SET count = excluded.count, from_ms = excluded.from_ms,
        to_ms = excluded.to_ms, content = excluded.content, told = excluded.told RETURNING count
)
INSERT INTO epoch (vehicle, epoch, tenant_id, lost, highest)
SELECT %(vehicle)s, %(epoch)s, %(tenant)s, stored.count - before.count, %(first)s + %(count)s FROM stored, before
ON CONFLICT (vehicle, epoch) DO UPDATE SET
    lost = epoch.lost + excluded.lost, highest = greatest(epoch.highest, excluded.highest)
"""
# An open alarm with a reason and a count, each under a name of its own in the detail; its count grows.
ALARM = """
INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, detail)
SELECT tenant_id, vehicle, %(kind)s, %(now)s, jsonb_build_object(
    %(reason_name)s::text, %(reason)s::text, %(count_name)s::text, %(count)s::int, 'last_ms', %(now)s::bigint)
FROM vehicle WHERE vehicle = %(vehicle)s
ON CONFLICT (vehicle, kind) WHERE until_ms IS NULL DO UPDATE SET detail = excluded.detail ||
    jsonb_build_object(%(count_name)s::text, (alarm.detail->>%(count_name)s::text)::bigint + %(count)s)
"""
KEYS = """
SELECT key_id, vehicle, tenant_id, public_key, revoked IS NOT NULL, vehicle_mb_day, mb_day
FROM certificate JOIN tenant USING (tenant_id) WHERE key_id = ANY(%s) AND kind = 'evidence'
"""
Changed = dict[str, object]  # a row of vehicle_now


class DatabaseUnavailable(Exception):
    """The database cannot store now; nothing of the group is stored, and vehicles send it again."""


class Store:
    """One connection to the database; after `DatabaseUnavailable` the next call connects again."""

    def __init__(self, dsn: str) -> None:
        self._dsn = dsn
        self._db: psycopg.Connection | None = None
        self._days: set[date] = set()
        self._epochs = set[tuple[str, int]]()

    def keys(self, key_ids: list[str]) -> list[KeyRow]:
        """Ask for evidence keys; raises `DatabaseUnavailable`."""
        try:
            with self._connection().transaction(), self._connection().cursor() as cursor:
                return [
                    KeyRow(key_id, vehicle, tenant, public_key, revoked, Limits(vehicle_mb, tenant_mb))
                    for key_id, vehicle, tenant, public_key, revoked, vehicle_mb, tenant_mb in cursor.execute(
                        KEYS, (key_ids,)
                    )
                ]
        except psycopg.Error as error:
            raise self._failed(error) from error

    def store(self, batches: Sequence[VerifiedBatch]) -> tuple[list[Changed], dict[bytes, str]]:
        """Store a group in one transaction; raises `DatabaseUnavailable`.

        Returns
        -------
        changed : list of dict
            New rows of `vehicle_now`.
        refused : dict of bytes to str
            Digest and reason of those that are not stored.
        """
        try:
            return self._store(batches)
        except (psycopg.errors.DataError, psycopg.errors.IntegrityError) as error:
            if len(batches) > 1:  # one that the database does not take must not stop the others
                return self._halves(batches)
            self._failed(error)
            return [], {batches[0].digest: FORMAT}
        except psycopg.Error as error:
            raise self._failed(error) from error

    def tell_forgeries(self, counts: dict[tuple[str, str], int], now_ms: int) -> None:
        """Raise an alarm for batches of a known vehicle's topic that it has not signed.

        Raises `DatabaseUnavailable`.
        """
        self._alarm("signature", "reason", "count", counts, now_ms)

    def tell_floods(self, counts: dict[tuple[str, str], int], now_ms: int) -> None:
        """Raise an alarm for batches that get no receipt, by vehicle and whose budget is used up.

        Raises `DatabaseUnavailable`.
        """
        self._alarm("flood", "budget", "withheld", counts, now_ms)

    def _alarm(
        self, kind: str, reason_name: str, count_name: str, counts: dict[tuple[str, str], int], now_ms: int
    ) -> None:
        names = {"kind": kind, "reason_name": reason_name, "count_name": count_name, "now": now_ms}
        try:
            with self._connection().transaction(), self._connection().cursor() as cursor:
                for (vehicle, reason), count in sorted(counts.items()):
                    cursor.execute(ALARM, {**names, "vehicle": vehicle, "reason": reason, "count": count})
        except psycopg.Error as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """End the connection."""
        if self._db is not None:
            self._db.close()
        self._db = None

    def _halves(self, batches: Sequence[VerifiedBatch]) -> tuple[list[Changed], dict[bytes, str]]:
        """Store what can be: few transactions more for each that cannot, those of one vehicle beside each other."""
        changed, refused = list[Changed](), dict[bytes, str]()
        ordered = sorted(batches, key=lambda genuine: genuine.vehicle)
        middle = len(ordered) // 2
        for some in (ordered[:middle], ordered[middle:]):
            found, why = self.store(some)
            changed += found
            refused |= why
        return changed, refused

    def _store(self, batches: Sequence[VerifiedBatch]) -> tuple[list[Changed], dict[bytes, str]]:
        usable = list({(batch.vehicle, batch.digest): batch for batch in batches}.values())
        epochs = {
            (genuine.vehicle, genuine.batch.epoch_ms): genuine.tenant_id for genuine in usable if genuine.aside is None
        }
        self._make_epochs(epochs)
        self._make_days(
            {genuine.day for genuine in usable if genuine.aside is None and genuine.batch.kind is not Kind.GAP}
        )
        with self._connection().transaction(), self._connection().cursor() as cursor:
            wait_for_erasures(cursor)
            missing = epochs.keys() - set(cursor.execute(LOCK_EPOCHS, _columns(epochs)))
            self._epochs -= missing
            beyond = {
                genuine.digest: EPOCHS for genuine in usable if (genuine.vehicle, genuine.batch.epoch_ms) in missing
            }
            changed, refused = self._write(cursor, [genuine for genuine in usable if genuine.digest not in beyond])
        return changed, refused | beyond

    def _write(self, cursor: psycopg.Cursor, batches: list[VerifiedBatch]) -> tuple[list[Changed], dict[bytes, str]]:
        events = by_kind(batches, Kind.EVENTS)
        segments = [*by_kind(batches, Kind.POSITIONS), *events]
        self._copy_segments(cursor, segments)
        if events:
            self._copy_events(cursor, events)
        refused = dict.fromkeys(_digests(cursor.execute(CONFLICTS)), CONFLICT) | _twice(segments)
        if refused:
            cursor.execute(LEAVE_OUT, (list(refused),))
            cursor.execute(LEAVE_EVENTS_OUT, (list(refused),))
        if erased := _digests(cursor.execute(ERASED)):
            cursor.execute(FORGET, (erased,))
            cursor.execute(f"{LEAVE_EVENTS_OUT} AND name <> %s".encode(), (erased, TOLL))
        cursor.execute(INSERT_SEGMENT)
        if events:
            cursor.execute(INSERT_EVENT)
        for genuine in by_kind(batches, Kind.GAP):
            cursor.execute(UPSERT_GAP, _values(genuine))
        aside = [batch for batch in batches if batch.aside is not None]
        for genuine in sorted(aside, key=lambda item: item.digest):  # two ingests may hold them in another order
            cursor.execute(SET_ASIDE, _values(genuine))
        changed = self._update_now(
            cursor, [segment for segment in segments if segment.digest not in {*refused, *erased}]
        )
        return changed, refused

    def _make_epochs(self, epochs: dict[tuple[str, int], int]) -> None:
        """Make rows of epochs that are not known to be there, in a transaction of their own; not beyond the limit."""
        if new := {key: tenant for key, tenant in epochs.items() if key not in self._epochs}:
            with self._connection().transaction():
                self._connection().execute(MAKE_EPOCHS, _columns(new))
            if len(self._epochs) > KNOWN_EPOCHS:
                self._epochs.clear()
            self._epochs.update(new)

    def _make_days(self, days: set[date]) -> None:
        """Make partitions that are not there yet, in a transaction of their own."""
        # An older one may have been removed since it was made: a tenant keeps a day at the least.
        lasting = datetime.now(UTC).date() - timedelta(days=1)
        for day in sorted(day for day in days if day not in self._days or day < lasting):
            with self._connection().transaction():
                self._connection().execute("SELECT ensure_segment_day(%s)", (day,))
            self._days.add(day)

    @staticmethod
    def _copy_segments(cursor: psycopg.Cursor, segments: Iterable[VerifiedBatch]) -> None:
        with cursor.copy(COPY_SEGMENT) as copy:
            copy.set_types(SEGMENT_TYPES)
            for segment in segments:
                batch = segment.batch
                copy.write_row((
                    segment.day, segment.vehicle, batch.epoch_ms, batch.first, batch.count, int(batch.kind),
                    *batch.span_ms,
                    segment.worst, segment.tenant_id, segment.digest, segment.data,
                ))  # fmt: skip

    @staticmethod
    def _copy_events(cursor: psycopg.Cursor, batches: Iterable[VerifiedBatch]) -> None:
        with cursor.copy(COPY_EVENT) as copy:
            for batch in batches:
                for number, event in enumerate(batch.batch.events, batch.batch.first):
                    text = json.dumps(event.content)
                    copy.write_row((
                        batch.vehicle, batch.batch.epoch_ms, number, batch.tenant_id, event.utc_ms, event.name, text,
                        batch.digest,
                    ))  # fmt: skip

    @staticmethod
    def _update_now(cursor: psycopg.Cursor, segments: Iterable[VerifiedBatch]) -> list[Changed]:
        with cursor.copy(COPY_NOW) as copy:
            copy.set_types(NOW_TYPES)
            for segment in segments:
                if segment.batch.kind is Kind.POSITIONS:
                    copy.write_row(_now_row(segment))
        cursor.execute(UPDATE_NOW)
        names = [column.name for column in cursor.description or ()]
        return [dict(zip(names, row, strict=True)) for row in cursor]

    def _connection(self) -> psycopg.Connection:
        if self._db is None or self._db.closed:
            self._db = psycopg.connect(self._dsn, autocommit=True, connect_timeout=5)
            self._db.execute(STAGING)
            self._days.clear()
            self._epochs.clear()
        return self._db

    def _failed(self, error: psycopg.Error) -> DatabaseUnavailable:
        self.close()
        return DatabaseUnavailable(reason_of(error))


def _twice(segments: Sequence[VerifiedBatch]) -> dict[bytes, str]:
    """Find batches of a group with the same sequence numbers as an earlier one of it, and other content."""
    first: dict[tuple[str, int, int], bytes] = {}
    return {
        segment.digest: CONFLICT
        for segment in segments
        if first.setdefault((segment.vehicle, segment.batch.epoch_ms, segment.batch.first), segment.digest)
        != segment.digest
    }


def _now_row(one: VerifiedBatch) -> tuple[object, ...]:
    last, since_ms, whole = newest(one.batch)
    known = last_position(one.batch)

    def scaled(value: int | None, per_unit: float) -> float | None:
        return None if value is None else value / per_unit

    place = (
        (None, None, None, None)
        if known is None
        else (
            known.utc_ms,
            scaled(known.latitude_e7, 1e7),
            scaled(known.longitude_e7, 1e7),
            scaled(known.height_cm, 100),
        )
    )
    motion = scaled(last.north_cm_s, 100), scaled(last.east_cm_s, 100), scaled(last.level_dm, 10)
    sequence = one.batch.first + one.batch.count - 1
    return (
        one.vehicle, one.tenant_id, one.batch.epoch_ms, sequence, last.utc_ms, *place, *motion, last.verdict, since_ms,
        whole,
    )  # fmt: skip


def _columns(epochs: dict[tuple[str, int], int]) -> dict[str, list[str] | list[int]]:
    """Vehicles, epochs and tenants in one order for all."""
    keys = sorted(epochs)
    return {
        "vehicles": [vehicle for vehicle, _ in keys], "epochs": [epoch for _, epoch in keys],
        "tenants": [epochs[key] for key in keys],
    }  # fmt: skip


def _digests(rows: Iterable[tuple[bytes]]) -> list[bytes]:
    return [bytes(row[0]) for row in rows]


def _values(one: VerifiedBatch) -> dict[str, object]:
    begin, end = one.batch.span_ms
    return {
        "vehicle": one.vehicle, "epoch": one.batch.epoch_ms, "first": one.batch.first, "count": one.batch.count,
        "tenant": one.tenant_id, "from": begin, "to": end, "content": one.data, "digest": one.digest,
        "reason": one.aside,
    }  # fmt: skip
