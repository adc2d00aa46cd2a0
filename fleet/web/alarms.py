"""Alarms: list, acknowledgement by operators, and the web hook of the tenant."""

from typing import Annotated

from fastapi import FastAPI, HTTPException, Path, Query, Request, Response
from pydantic import Field

from fleet.alarms.signing import new_secret
from fleet.alarms.web_hook import MAX_ADDRESS, SET, AddressPolicy
from shared.page.body import json_response

from .access.guard import visitor_of
from .audit import note
from .database import Database
from .live import VerdictNotifier
from .requests import Body, read
from .tiles import now_ms
from .told import alarm_with_languages

LISTED = 200
COLUMNS = """
    alarm_id, tenant_id, vehicle, kind, since_ms, until_ms, (extract(epoch FROM raised) * 1000)::bigint AS raised_ms,
    late, detail, (extract(epoch FROM acknowledged) * 1000)::bigint AS acknowledged_ms, acknowledged_by
"""
LIST = f"""
SELECT {COLUMNS} FROM alarm
WHERE (%(kind)s = 'any' OR kind = %(kind)s) AND CASE %(show)s
    WHEN 'open' THEN until_ms IS NULL WHEN 'unacknowledged' THEN acknowledged IS NULL
    WHEN 'closed' THEN until_ms IS NOT NULL ELSE true END
ORDER BY (until_ms IS NULL) DESC, raised DESC LIMIT {LISTED}
"""
OPEN = "SELECT count(*) AS alarms FROM alarm WHERE until_ms IS NULL AND acknowledged IS NULL"
ACKNOWLEDGE = f"""
UPDATE alarm SET acknowledged = now(), acknowledged_by = %s WHERE alarm_id = %s AND acknowledged IS NULL
RETURNING {COLUMNS}
"""


class WebHook(Body):
    """Address that is told of alarms; empty: none."""

    address: Annotated[str, Field(max_length=MAX_ADDRESS)]


class AlarmsApi:
    """What the page Alarms asks for."""

    def __init__(self, database: Database, live: VerdictNotifier, reach: AddressPolicy) -> None:
        self._database, self._live, self._reach = database, live, reach

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/alarms", self.list)
        app.add_api_route("/api/alarms/{alarm}/acknowledge", self.acknowledge, methods=["POST"])
        app.add_api_route("/api/web-hook", self.web_hook)
        app.add_api_route("/api/web-hook", self.set_web_hook, methods=["POST"])

    async def list(
        self,
        request: Request,
        show: Annotated[str, Query(pattern="^(open|unacknowledged|closed|all)$")] = "open",
        kind: Annotated[str, Query(pattern="^(any|unsafe|gap|silent|signature|flood)$")] = "any",
    ) -> Response:
        """Alarms, the open ones first, then the newest."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            rows = await (await cursor.execute(LIST, {"show": show, "kind": kind})).fetchall()
            unacknowledged = await (await cursor.execute(OPEN)).fetchone()
        return json_response({
            "now_ms": now_ms(), "alarms": [alarm_with_languages(row) for row in rows], "more": len(rows) == LISTED,
            "unacknowledged": unacknowledged["alarms"] if unacknowledged else 0,
        })  # fmt: skip

    async def acknowledge(self, request: Request, alarm: Annotated[int, Path(ge=1, lt=2**62)]) -> Response:
        """Note that an operator has seen an alarm; the first one counts."""
        visitor = visitor_of(request)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            row = await (await cursor.execute(ACKNOWLEDGE, (visitor.name, alarm))).fetchone()
            if row is None:
                raise HTTPException(404, "there is no such alarm, or somebody has acknowledged it already")
            detail = {"alarm": alarm, "kind": row["kind"]}
            await note(cursor, visitor.tenant_id, visitor.name, "acknowledged an alarm", row["vehicle"], detail)
        self._live.add_alarm(visitor.tenant_id, row)
        return json_response(alarm_with_languages(row))

    async def web_hook(self, request: Request) -> Response:
        """The address that is told of alarms, and the secret that its server compares signatures with."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            row = await (await cursor.execute("SELECT web_hook, web_hook_secret FROM tenant")).fetchone()
        row = row or {}
        return json_response({"address": row.get("web_hook") or "", "secret": row.get("web_hook_secret") or ""})

    async def set_web_hook(self, request: Request) -> Response:
        """Change that address; the secret is another one after each change."""
        visitor, given = visitor_of(request), await read(request, WebHook)
        if given.address and (why := self._reach.why_not(given.address)) is not None:
            raise HTTPException(422, why)
        secret = new_secret() if given.address else ""
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await cursor.execute(SET, (given.address or None, secret or None, visitor.tenant_id))
            await note(cursor, visitor.tenant_id, visitor.name, "changed the web hook", None, {"to": given.address})
        return json_response({"address": given.address, "secret": secret})
