"""Accounts of a tenant: list, add, change the role, disable."""

import asyncio
from typing import Annotated, Literal

from fastapi import FastAPI, HTTPException, Request, Response
from pydantic import Field

from shared.page.body import json_response

from ..audit import note
from ..database import Database
from ..requests import Body, conflict, read
from .guard import visitor_of
from .passwords import hashed, weakness
from .rights import MEANING, Role, Visitor
from .sessions import Sessions

LIST = """
SELECT account_id, name, role, (extract(epoch FROM created) * 1000)::bigint AS created_ms,
    disabled IS NOT NULL AS disabled
FROM account ORDER BY name LIMIT 500
"""
ADD = "INSERT INTO account (tenant_id, name, password, role) VALUES (%s, %s, %s, %s) ON CONFLICT (name) DO NOTHING"
CHANGE = """
UPDATE account SET role = coalesce(%(role)s, role), disabled = CASE WHEN %(disabled)s::boolean IS NULL THEN disabled
    WHEN %(disabled)s THEN coalesce(disabled, now()) END
WHERE name = %(name)s RETURNING account_id
"""
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^\w[\w.@+-]*$")]


class NewAccount(Body):
    """An account that is to be."""

    action: Literal["add"]
    name: Name
    role: Role
    password: Annotated[str, Field(max_length=200)]


class AccountChange(Body):
    """What is to change of an account."""

    action: Literal["change"]
    name: Name
    role: Role | None = None
    disabled: bool | None = None


class Command(Body):
    """One of the two."""

    command: Annotated[NewAccount | AccountChange, Field(discriminator="action")]


class AccountsApi:
    """What the page Accounts asks for."""

    def __init__(self, database: Database, sessions: Sessions) -> None:
        self._database, self._sessions = database, sessions

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/accounts", self.list)
        app.add_api_route("/api/accounts", self.change, methods=["POST"])

    async def list(self, request: Request) -> Response:
        """Accounts of the tenant."""
        async with self._database.tenant(visitor_of(request).tenant_id) as cursor:
            rows = await (await cursor.execute(LIST)).fetchall()
        return json_response({"accounts": rows, "roles": {role.value: text for role, text in MEANING.items()}})

    async def change(self, request: Request) -> Response:
        """Add or change an account; one that is disabled is logged out."""
        visitor, given = visitor_of(request), (await read(request, Command)).command
        if isinstance(given, NewAccount):
            await self._add(visitor, given)
        else:
            await self._change(visitor, given)
        self._sessions.forget()
        return json_response({})

    async def _add(self, visitor: Visitor, given: NewAccount) -> None:
        if (why := weakness(given.password, given.name)) is not None:
            raise HTTPException(422, why)
        stored = await asyncio.to_thread(hashed, given.password)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await cursor.execute(ADD, (visitor.tenant_id, given.name, stored, given.role))
            if not cursor.rowcount:
                raise conflict("the name is taken; choose another one")
            detail = {"account": given.name, "role": given.role}
            await note(cursor, visitor.tenant_id, visitor.name, "added an account", None, detail)

    async def _change(self, visitor: Visitor, given: AccountChange) -> None:
        if given.name == visitor.name:
            raise conflict("nobody can disable the own account or change its role; ask another administrator")
        values = given.model_dump(exclude={"action"}, mode="json")
        async with self._database.tenant(visitor.tenant_id) as cursor:
            row = await (await cursor.execute(CHANGE, values)).fetchone()
            if row is None:
                raise HTTPException(404, "there is no such account; load the page again")
            if given.disabled:
                await cursor.execute("DELETE FROM session WHERE account_id = %s", (row["account_id"],))
            await note(cursor, visitor.tenant_id, visitor.name, "changed an account", None, values)
