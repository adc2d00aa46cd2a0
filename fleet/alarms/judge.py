"""When a vehicle gives an alarm. All times are those that vehicles have signed, never those of arrival.

- `unsafe`: its verdict is UNSAFE for a minute or longer; until another verdict. What arrives late is in `late.py`.
- `silent`: it moved in its last report, and five minutes have passed since; standing, a day: a vehicle that is parked
  is switched off. A centre that was away itself, or its ingest, first hears for five minutes who comes back.
- `gap`: its outbox has dropped reports, or numbers are missing for ten minutes while later ones are there.
- `signature`: batches on its topic are not signed by it; raised by ingest, and ended here after an hour without more.
- `flood`: a vehicle sends more than its budget, or that of its tenant, holds, and gets no receipt for it; raised and
  ended as `signature`.

An alarm that is raised by reports that are older than five minutes is marked as late.
"""

from typing import Any

import psycopg
from psycopg.rows import dict_row

from fleet.database.erasure import wait_for_erasures

UNSAFE_MS = 60_000
MOVING_M_S = 1.0
SILENT_MOVING_MS, SILENT_STANDING_MS = 300_000, 86_400_000
RECONNECT_TIME_MS = 300_000  # vehicles connect again within a minute, and send again within five
MISSING_AFTER_MS = 600_000  # retries of a vehicle are up to five minutes apart
MAX_DELAY_MS = 300_000
CALM_PERIOD_MS = 3_600_000
LIMITS = {
    "unsafe_ms": UNSAFE_MS, "moving": MOVING_M_S, "silent_moving_ms": SILENT_MOVING_MS, "heard_ms": RECONNECT_TIME_MS,
    "silent_standing_ms": SILENT_STANDING_MS, "missing_ms": MISSING_AFTER_MS, "late_ms": MAX_DELAY_MS,
    "calm_ms": CALM_PERIOD_MS,
}  # fmt: skip
GAPS_PER_TURN = 1000  # gaps
UNSAFE_CODE = 5  # shared.fleet.batch.VERDICTS
Row = dict[str, Any]

COLUMNS = """alarm_id, tenant_id, vehicle, kind, since_ms, until_ms,
    (extract(epoch FROM raised) * 1000)::bigint AS raised_ms, late, detail,
    (extract(epoch FROM acknowledged) * 1000)::bigint AS acknowledged_ms, acknowledged_by"""
MOVED = """
WITH moved AS (
    SELECT *, CASE WHEN coalesce(north_m_s ^ 2 + east_m_s ^ 2, 0) > %(moving)s ^ 2 THEN %(silent_moving_ms)s
        ELSE %(silent_standing_ms)s END AS patience_ms FROM vehicle_now
)
"""
# What is the case now: an alarm is raised where none is open.
RAISE = f"""{MOVED}, now_case AS (
    SELECT tenant_id, vehicle, 'unsafe' AS kind, verdict_since_ms AS since_ms, utc_ms, '{{}}'::jsonb AS detail
    FROM vehicle_now WHERE verdict = {UNSAFE_CODE} AND utc_ms - verdict_since_ms >= %(unsafe_ms)s
    UNION ALL
    SELECT tenant_id, vehicle, 'silent', utc_ms, %(now)s::bigint, jsonb_build_object('after_s', patience_ms / 1000)
    FROM moved WHERE %(now)s - utc_ms >= patience_ms AND %(now)s - %(hears_since)s >= %(heard_ms)s
    UNION ALL
    SELECT tenant_id, vehicle, 'gap', min(since_ms), %(now)s::bigint, jsonb_build_object('missing', sum(missing))
    FROM missing_reports WHERE %(now)s - since_ms >= %(missing_ms)s GROUP BY tenant_id, vehicle
)
INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, late, detail)
SELECT tenant_id, vehicle, kind, since_ms, %(now)s - utc_ms > %(late_ms)s, detail FROM now_case
ON CONFLICT (vehicle, kind) WHERE until_ms IS NULL DO NOTHING RETURNING {COLUMNS}
"""
# An end has a condition of its own: what is not raised yet after a start of this process does not end what is open.
END = f"""{MOVED}, ended AS (
    SELECT alarm_id AS id, CASE kind
        WHEN 'unsafe' THEN CASE WHEN verdict IS DISTINCT FROM {UNSAFE_CODE} THEN coalesce(verdict_since_ms, %(now)s) END
        WHEN 'silent' THEN CASE WHEN utc_ms IS NULL OR %(now)s - utc_ms < patience_ms THEN coalesce(utc_ms, %(now)s) END
        WHEN 'gap' THEN CASE WHEN NOT EXISTS (
            SELECT FROM epoch WHERE epoch.vehicle = alarm.vehicle AND highest > received + lost) THEN %(now)s END
        ELSE CASE WHEN last_ms < %(now)s - %(calm_ms)s THEN last_ms END END AS at_ms
    FROM alarm LEFT JOIN moved USING (vehicle) CROSS JOIN LATERAL (
        SELECT coalesce((detail->>'last_ms')::bigint, since_ms) AS last_ms) AS forgery
    WHERE until_ms IS NULL
)
UPDATE alarm SET until_ms = greatest(since_ms, at_ms), ended = now()
FROM ended WHERE alarm_id = id AND at_ms IS NOT NULL RETURNING {COLUMNS}
"""
# Numbers that are missing, since when: the table is of this connection.
MISSING = """
CREATE TEMP TABLE IF NOT EXISTS missing_reports (
    vehicle text, epoch bigint, tenant_id integer, missing bigint, since_ms bigint, PRIMARY KEY (vehicle, epoch)
);
"""
FIND_MISSING = """
INSERT INTO missing_reports SELECT vehicle, epoch, tenant_id, highest - received - lost, %(now)s
FROM epoch WHERE highest > received + lost
ON CONFLICT (vehicle, epoch) DO UPDATE SET missing = excluded.missing
"""
FORGET_FOUND = """
DELETE FROM missing_reports USING epoch WHERE (missing_reports.vehicle, missing_reports.epoch) =
    (epoch.vehicle, epoch.epoch) AND epoch.highest <= epoch.received + epoch.lost
"""
# A gap that a vehicle has stated is over when it is known: a closed alarm. A vehicle may state one each second, so that
# all those of a day are counted in one alarm, until it is acknowledged. Rows that ingest holds now are told later.
DROPPED = f"""
WITH untold AS (
    SELECT vehicle, epoch, first_sequence, count - told AS number FROM gap WHERE told < count AND content <> ''
    LIMIT {GAPS_PER_TURN} FOR UPDATE SKIP LOCKED
), told AS (
    UPDATE gap SET told = count FROM untold
    WHERE (gap.vehicle, gap.epoch, gap.first_sequence) = (untold.vehicle, untold.epoch, untold.first_sequence)
    RETURNING gap.tenant_id, gap.vehicle, from_ms, to_ms, number
), stated AS (
    SELECT tenant_id AS of_tenant, vehicle AS of_vehicle, min(from_ms) AS from_ms, max(to_ms) AS to_ms,
        sum(number) AS number
    FROM told GROUP BY tenant_id, vehicle
), counted AS (
    UPDATE alarm SET since_ms = least(since_ms, from_ms), until_ms = greatest(until_ms, to_ms),
        detail = jsonb_build_object('dropped', (detail->>'dropped')::numeric + number)
    FROM stated WHERE vehicle = of_vehicle AND kind = 'gap' AND until_ms IS NOT NULL AND detail ? 'dropped'
        AND raised > now() - interval '1 day' AND acknowledged IS NULL
    RETURNING {COLUMNS}
), made AS (
    INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, until_ms, late, detail)
    SELECT of_tenant, of_vehicle, 'gap', from_ms, to_ms, %(now)s - to_ms > %(late_ms)s,
        jsonb_build_object('dropped', number)
    FROM stated WHERE of_vehicle NOT IN (SELECT vehicle FROM counted) RETURNING {COLUMNS}
)
SELECT * FROM counted UNION ALL SELECT * FROM made
"""


def judge(db: psycopg.Connection, now_ms: int, hears_since_ms: int, *, finds_missing: bool = True) -> list[Row]:
    """Raise and end alarms in one transaction; return the rows that changed.

    `hears_since_ms` is when this process began to hear of vehicles, or heard of them again. To find missing numbers
    reads each epoch of each vehicle that is kept.
    """
    values = {**LIMITS, "now": now_ms, "hears_since": hears_since_ms}
    with db.transaction(), db.cursor(row_factory=dict_row) as cursor:
        wait_for_erasures(cursor)
        cursor.execute(MISSING)
        if finds_missing:
            cursor.execute(FIND_MISSING, values)
        cursor.execute(FORGET_FOUND)
        changed = list[Row]()
        for statement in (END, RAISE, DROPPED):
            changed += cursor.execute(statement, values).fetchall()
    return changed
