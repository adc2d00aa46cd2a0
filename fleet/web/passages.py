"""Toll passages: what roadside units have reported of charges; neither positions nor tracks."""

from fastapi import FastAPI, Request, Response

from shared.page.body import json_response

from .access.guard import visitor_of
from .database import CONTENT, Database
from .told import with_languages

NEWEST = f"""
SELECT utc_ms, vehicle, name, {CONTENT} FROM event WHERE name = 'toll/transaction' ORDER BY utc_ms DESC LIMIT 200
"""


class PassagesApi:
    """What the page Passages asks for."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add_to(self, app: FastAPI) -> None:
        """Add the route."""
        app.add_api_route("/api/passages", self.newest)

    async def newest(self, request: Request) -> Response:
        """The newest passages."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            rows = await (await cursor.execute(NEWEST)).fetchall()
        return json_response({"passages": [with_languages(row) for row in rows], "more": len(rows) == 200})
