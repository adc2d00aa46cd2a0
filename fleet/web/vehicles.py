"""The list of vehicles, and what the database knows of one: newest report, track, events, gaps, keys."""

import asyncio
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime, timedelta
from typing import Annotated, Any

from fastapi import Depends, FastAPI, HTTPException, Path, Query, Request, Response

from shared.fleet.batch import BadBatch, Kind
from shared.fleet.sealed import unsealed
from shared.fleet.times import MAX_AGE_S
from shared.fleet.topics import VEHICLE
from shared.page.body import json_response
from shared.words.words import words

from .access.guard import visitor_of
from .database import CONTENT, Cursor, Database, Row
from .tiles import CHOSEN, Filter, filter_of, now_ms
from .told import with_languages

Name = Annotated[str, Path(pattern=f"^{VEHICLE.pattern}$")]
Values = Sequence[Any] | Mapping[str, Any] | None
LISTED = 100
TRAIL_MINUTES, MOST_TRAIL_MINUTES = 30, 24 * 60
TRAIL_POINTS = 5000
SEGMENTS = 4000
TRAIL_REPORTS = 100_000  # more than a day has at one a second; a vehicle may sign 600 of the same second in a batch
NOW = """
    vehicle_now.vehicle, epoch, sequence, utc_ms, position_ms, latitude_deg, longitude_deg, height_m, north_m_s,
    east_m_s, level_m, verdict, verdict_since_ms, (extract(epoch FROM arrived) * 1000)::bigint AS arrived_ms
"""
ALARMS = "ARRAY(SELECT kind FROM alarm WHERE alarm.vehicle = vehicle_now.vehicle AND until_ms IS NULL ORDER BY kind)"
LIST = f"""
SELECT {NOW}, {ALARMS} AS alarms FROM vehicle_now WHERE {CHOSEN}
ORDER BY (verdict = 5) DESC, (%(now)s - utc_ms > {MAX_AGE_S * 1000}), verdict DESC, vehicle
LIMIT {LISTED} OFFSET %(skip)s
"""
COUNTS = f"""
SELECT verdict, %(now)s - utc_ms > {MAX_AGE_S * 1000} AS old, count(*) AS vehicles FROM vehicle_now GROUP BY 1, 2
"""
EXTENT = """
SELECT min(longitude_deg) AS west, min(latitude_deg) AS south, max(longitude_deg) AS east, max(latitude_deg) AS north
FROM vehicle_now
"""
SILENT = """
SELECT count(*) AS vehicles FROM vehicle
WHERE NOT EXISTS (SELECT FROM vehicle_now WHERE vehicle_now.vehicle = vehicle.vehicle)
"""
ONE = f"""
SELECT vehicle.vehicle, {NOW.replace("vehicle_now.vehicle,", "")}, {ALARMS} AS alarms,
    (extract(epoch FROM created) * 1000)::bigint AS created_ms, erased IS NOT NULL AS erased, note
FROM vehicle LEFT JOIN vehicle_now USING (vehicle) WHERE vehicle.vehicle = %s
"""
EVENTS = f"SELECT utc_ms, name, {CONTENT} FROM event WHERE vehicle = %s ORDER BY utc_ms DESC LIMIT 50"
# What the unit's data are, of each process that says so: an event when that changes.
ORIGINS = """
SELECT DISTINCT ON (content->>'kind', content->>'name') left(content->>'kind', 100) AS kind,
    left(content->>'name', 100) AS name FROM event
WHERE vehicle = %s AND name = 'origin/state' AND epoch = (SELECT epoch FROM vehicle_now WHERE vehicle = event.vehicle)
LIMIT 5
"""
GAPS = "SELECT from_ms, to_ms, count FROM gap WHERE vehicle = %s ORDER BY from_ms DESC LIMIT 50"
ASIDE = "SELECT reason, count(*) AS batches FROM set_aside WHERE vehicle = %s GROUP BY reason ORDER BY reason"
EPOCHS = "SELECT epoch, received, lost, highest FROM epoch WHERE vehicle = %s ORDER BY epoch DESC LIMIT 10"
KEYS = """
SELECT key_id, kind, serial, (extract(epoch FROM registered) * 1000)::bigint AS made_ms,
    (extract(epoch FROM not_after) * 1000)::bigint AS to_ms, (extract(epoch FROM revoked) * 1000)::bigint AS revoked_ms,
    reason
FROM certificate WHERE vehicle = %s ORDER BY not_before DESC LIMIT 50
"""
TRAIL = f"""
WITH newest AS (
    SELECT day, epoch, first_sequence, from_ms,
        sum(count) OVER (ORDER BY from_ms DESC, epoch, first_sequence) AS reports
    FROM segment
    WHERE vehicle = %(vehicle)s AND kind = 0 AND to_ms >= %(from)s AND from_ms <= %(to)s
        AND day BETWEEN %(first_day)s AND %(last_day)s
    ORDER BY from_ms DESC, epoch, first_sequence LIMIT {SEGMENTS}
)
SELECT content FROM newest JOIN segment USING (day, epoch, first_sequence)
WHERE vehicle = %(vehicle)s AND reports <= {TRAIL_REPORTS}
"""


class VehiclesApi:
    """What the map's list and the page of a vehicle ask for."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/vehicles", self.list)
        app.add_api_route("/api/vehicles/{vehicle}", self.one)
        app.add_api_route("/api/vehicles/{vehicle}/trail", self.trail)

    async def list(
        self,
        request: Request,
        chosen: Annotated[Filter, Depends(filter_of)],
        skip: Annotated[int, Query(ge=0, le=100_000)] = 0,
    ) -> Response:
        """Vehicles of the filter, the gravest verdict first; counts and extent of all."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            values = chosen.values
            rows = await _rows(cursor, LIST, {**values, "skip": skip})
            counts = await _rows(cursor, COUNTS, values)
            extent = (await _rows(cursor, EXTENT))[0]
            silent = (await _rows(cursor, SILENT))[0]["vehicles"]
        return json_response({
            "now_ms": now_ms(), "vehicles": rows, "more": len(rows) == LISTED, "counts": counts,
            "extent": extent if extent["west"] is not None else None, "never_reported": silent,
        })  # fmt: skip

    async def one(self, request: Request, vehicle: Name) -> Response:
        """The newest known of a vehicle, with its events, gaps and keys."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            found = await _rows(cursor, ONE, (vehicle,))
            if not found:
                raise unknown(vehicle)
            parts = {
                name: await _rows(cursor, query, (vehicle,))
                for name, query in (
                    ("origins", ORIGINS), ("events", EVENTS),
                    ("gaps", GAPS), ("keys", KEYS), ("epochs", EPOCHS), ("set_aside", ASIDE),
                )
            }  # fmt: skip
        parts["events"] = [with_languages(row) for row in parts["events"]]
        parts["set_aside"] = [{**row, "told": words().name("refusal", row["reason"])} for row in parts["set_aside"]]
        return json_response({"now_ms": now_ms(), "vehicle": found[0], **parts})

    async def trail(
        self,
        request: Request,
        vehicle: Name,
        minutes: Annotated[int, Query(ge=1, le=MOST_TRAIL_MINUTES)] = TRAIL_MINUTES,
    ) -> Response:
        """Positions of the last minutes that the vehicle reported, as columns; null where it knew no position."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            known = await _rows(cursor, "SELECT utc_ms FROM vehicle_now WHERE vehicle = %s", (vehicle,))
            to_ms = known[0]["utc_ms"] if known else now_ms()
            from_ms = to_ms - minutes * 60_000
            values = {
                "vehicle": vehicle, "from": from_ms, "to": to_ms, "first_day": _day(from_ms) - timedelta(days=1),
                "last_day": _day(to_ms),
            }  # fmt: skip
            rows = await _rows(cursor, TRAIL, values)
        # In a thread: a long track costs a second, in which the pages of all tenants go on.
        return json_response(await asyncio.to_thread(columns_of, [bytes(row["content"]) for row in rows], from_ms))


def columns_of(batches: "list[bytes]", from_ms: int) -> dict[str, object]:
    """Decode signed batches that were verified when they were stored; thinned to a bounded number of points."""
    reports, unreadable = [], 0
    for data in batches:
        try:
            batch = unsealed(data).batch
        except BadBatch:
            unreadable += 1
            continue
        if batch.kind is Kind.POSITIONS:
            reports += [report for report in batch.reports if report.utc_ms >= from_ms]
    reports.sort(key=lambda report: report.utc_ms)
    step = -(-len(reports) // TRAIL_POINTS) or 1
    kept = [report for number, report in enumerate(reports) if number % step == 0 or number == len(reports) - 1]

    def degrees(value: int | None) -> float | None:
        return None if value is None else value / 1e7

    return {
        "unreadable": unreadable,
        "time_ms": [report.utc_ms for report in kept],
        "latitude_deg": [degrees(report.latitude_e7) for report in kept],
        "longitude_deg": [degrees(report.longitude_e7) for report in kept],
        "verdict": [report.verdict for report in kept],
    }


def unknown(vehicle: str) -> HTTPException:
    """The answer about a vehicle that this tenant does not have."""
    return HTTPException(404, f"there is no vehicle {vehicle} here; the page Enrolment lists them")


def _day(ms: int) -> date:
    return datetime.fromtimestamp(ms / 1000, UTC).date()


async def _rows(cursor: Cursor, query: str, values: Values = None) -> "list[Row]":
    await cursor.execute(query, values)
    return await cursor.fetchall()
