"""Routes of the login: open a session, end it, who has logged in, and the own password."""

import asyncio
import logging
from collections.abc import Sequence
from math import ceil
from typing import Annotated

from fastapi import FastAPI, HTTPException, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from shared.page import body
from shared.page.body import json_response

from ..audit import note
from ..database import Database
from ..requests import Body, read
from .attempts import Attempts, FreeAttempts, Origin, origins
from .guard import VISITOR, visitor_of
from .passwords import agrees, hashed, weakness
from .rights import GRANTED, Visitor
from .sessions import COOKIE, Account, Sessions

log = logging.getLogger(__name__)

# Of an account that there is not: so that an answer takes as long as for one that there is.
UNKNOWN_ACCOUNT_HASH = hashed("no account has this password")
WRONG_CREDENTIALS = "name or password is wrong"
MAX_CONCURRENT = 2  # passwords that are derived at once, 32 MB each
Name = Annotated[str, Field(max_length=80)]
Password = Annotated[str, Field(max_length=200)]


class LoginRequest(BaseModel):
    """Name and password."""

    model_config = ConfigDict(extra="forbid")
    name: Name
    password: Password


class PasswordRequest(Body):
    """The password that holds, and another one."""

    old: Password
    new: Password


class LoginApi:
    """Opens and ends sessions."""

    def __init__(self, database: Database, sessions: Sessions, attempts: Attempts) -> None:
        self._database, self._sessions, self._attempts = database, sessions, attempts
        self._deriving = asyncio.Semaphore(MAX_CONCURRENT)

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        app.add_api_route("/api/session", self.session)
        app.add_api_route("/api/login", self.log_in, methods=["POST"])
        app.add_api_route("/api/logout", self.log_out, methods=["POST"])
        app.add_api_route("/api/password", self.password, methods=["POST"])

    async def session(self, request: Request) -> Response:
        """Who asks; `csrf` is the value of the header X-OBU-CSRF of every change."""
        return _who(request.scope[VISITOR])

    async def log_in(self, request: Request) -> Response:
        """Open a session: the answer sets a cookie."""
        try:
            given = LoginRequest.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise HTTPException(422, 'a login is an object such as {"name": "...", "password": "..."}') from error
        host = request.client.host if request.client else ""
        account = await self._checked(given.name, given.password, origins(given.name, host))
        cookie = await self._sessions.open(account)
        async with self._database.tenant(account.tenant_id) as cursor:
            await note(cursor, account.tenant_id, account.name, "logged in")
        answer = json_response({"name": account.name, "role": account.role})
        self._set_cookie(request, answer, cookie, round(self._sessions.session_s))
        return answer

    async def log_out(self, request: Request) -> Response:
        """End the session."""
        await self._sessions.end(visitor_of(request))
        answer = _who(None)
        self._set_cookie(request, answer, "", 0)
        return answer

    async def password(self, request: Request) -> Response:
        """Change the own password; every other session of the account ends."""
        visitor, given = visitor_of(request), await read(request, PasswordRequest)
        own = Origin(f"session of {visitor.name}", FreeAttempts.ONE)  # counted apart: a stolen one locks no login
        await self._checked(visitor.name, given.old, [own])
        if (why := weakness(given.new, visitor.name)) is not None:
            raise HTTPException(422, why)
        async with self._deriving:
            stored = await asyncio.to_thread(hashed, given.new)
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await cursor.execute("UPDATE account SET password = %s WHERE account_id = %s", (stored, visitor.account_id))
            await cursor.execute(
                "DELETE FROM session WHERE account_id = %s AND token_hash <> %s",
                (visitor.account_id, visitor.token_hash),
            )
            await note(cursor, visitor.tenant_id, visitor.name, "changed the own password")
        self._sessions.forget()
        return json_response({})

    async def _checked(self, name: str, password: str, counted: Sequence[Origin]) -> Account:
        """The account of a name with this password; raises `HTTPException`."""
        wait_s = await self._attempts.begin(counted)  # before anything else: attempts may run beside each other
        if wait_s > 0:
            text = f"too many wrong passwords; try again in {ceil(wait_s)} s"
            raise HTTPException(429, text, {"Retry-After": str(ceil(wait_s))})
        account = await self._sessions.account(name)
        async with self._deriving:
            right = await asyncio.to_thread(agrees, password, account.password if account else UNKNOWN_ACCOUNT_HASH)
        if account is None or not right:
            # A name that there is not may be a password in the wrong field.
            log.warning("refused a password of %s", account.name if account else "an account that there is not")
            raise HTTPException(401, WRONG_CREDENTIALS)
        await self._attempts.succeeded(counted)
        return account

    @staticmethod
    def _set_cookie(request: Request, answer: Response, value: str, seconds: int) -> None:
        encrypted = request.url.scheme == "https"
        answer.set_cookie(COOKIE, value, max_age=seconds, secure=encrypted, httponly=True, samesite="strict")


def _who(visitor: Visitor | None) -> Response:
    if visitor is None:
        return json_response({"name": None, "role": None, "tenant": None, "csrf": None, "rights": []})
    rights = sorted(right.value for right in GRANTED[visitor.role])
    return json_response(
        {"name": visitor.name, "role": visitor.role, "tenant": visitor.tenant, "csrf": visitor.csrf, "rights": rights}
    )
