"""The audit: who did what, when, to which vehicle; rows are added and never changed by the pages."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from psycopg.types.json import Jsonb

from shared.page.body import json_response

from .access.guard import visitor_of
from .database import Cursor, Database

ROWS = 200
NEWEST = """
SELECT (extract(epoch FROM at) * 1000)::bigint AS at_ms, who, action, vehicle, detail FROM audit
WHERE (%(before)s::bigint IS NULL OR at < to_timestamp(%(before)s / 1000.0))
    AND (%(find)s = '' OR position(lower(%(find)s) IN lower(concat_ws(' ', who, action, vehicle))) > 0)
ORDER BY at DESC LIMIT %(rows)s
"""


async def note(
    cursor: Cursor,
    tenant_id: int,
    who: str,
    action: str,
    vehicle: str | None = None,
    detail: Mapping[str, object] | None = None,
) -> None:
    """Write a row, in the transaction of what it tells of."""
    await cursor.execute(
        "INSERT INTO audit (tenant_id, who, action, vehicle, detail) VALUES (%s, %s, %s, %s, %s)",
        (tenant_id, who, action, vehicle, Jsonb(dict(detail or {}))),
    )


class AuditApi:
    """Shows the audit to administrators."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        app.add_api_route("/api/audit", self.newest)

    async def newest(
        self,
        request: Request,
        before: Annotated[int | None, Query(ge=0, lt=2**53)] = None,
        find: Annotated[str, Query(max_length=80)] = "",
    ) -> Response:
        """The newest rows, or those before a time [ms]."""
        values = {"before": before, "find": find, "rows": ROWS}
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            rows = await (await cursor.execute(NEWEST, values)).fetchall()
        return json_response({"rows": rows, "more": len(rows) == ROWS})
