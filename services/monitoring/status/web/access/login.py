"""Routes of the login: open a session, end it, and who has logged in."""

import logging

from fastapi import FastAPI, HTTPException, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool
from typing_extensions import TypedDict

from shared.page import body
from shared.page.access.peer import Peer
from shared.page.answers import answer, reference_to, refusals

from .access import Access
from .guard import PEER, visitor_of
from .rights import Right
from .tokens import is_secret

log = logging.getLogger(__name__)


@answer()
class LoginState(TypedDict):
    """Who asks."""

    name: str | None
    """of the token; "local" where no login is needed; null: not logged in"""
    role: Right | None
    session: bool
    """whether there is a session, which can be ended"""
    csrf: str | None
    """value of the header X-OBU-CSRF that each change needs; null with a token in the header Authorization"""


class LoginRequest(BaseModel):
    """A token."""

    model_config = ConfigDict(extra="forbid")
    token: str = Field(max_length=200)


BODY = {"content": {"application/json": {"schema": reference_to(LoginRequest)}}, "required": True}


class LoginApi:
    """Opens and ends sessions."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add_to(self, app: FastAPI) -> None:
        """Add the routes."""
        refused = refusals({401: "No such token", 403: "A page from elsewhere", 413: "Too long", 422: "Not a login"})
        app.add_api_route("/api/session", self.session, tags=["login"], response_description="The login")
        app.add_api_route(
            "/api/login", self.log_in, methods=["POST"], tags=["login"], response_description="Logged in",
            responses=refused, openapi_extra={"requestBody": BODY},
        )  # fmt: skip
        app.add_api_route(
            "/api/logout", self.log_out, methods=["POST"], tags=["login"], response_description="Logged out"
        )

    def session(self, request: Request) -> LoginState:
        """Who asks, with which role; `csrf` is the value of the header X-OBU-CSRF of every change."""
        visitor = visitor_of(request)
        return {
            "name": visitor.name if visitor else None,
            "role": visitor.right if visitor else None,
            "session": bool(visitor and visitor.session),
            "csrf": visitor.csrf if visitor else None,
        }

    async def log_in(self, request: Request, response: Response) -> LoginState:
        """Open a session with a token: the answer sets a cookie."""
        try:
            given = LoginRequest.model_validate_json(await body.read(request))
        except ValidationError as error:
            raise HTTPException(422, 'a login is an object such as {"token": "..."}') from error
        secret = given.token.strip()
        seconds = self._access.rules.session_s
        opened = await run_in_threadpool(self._access.tokens.log_in, secret, seconds) if is_secret(secret) else None
        peer: Peer = request.scope[PEER]
        if opened is None:
            log.warning("refused a login from %s", peer.address[:45])
            raise HTTPException(401, "this token is not valid: it was mistyped, revoked, has expired, or its link was "
                                "used before; `obu token show-link` on the unit makes a new link")  # fmt: skip
        cookie, session = opened
        log.info("%s logged in from %s as %s", session.token, peer.address[:45], session.role)
        self._set_cookie(request, response, cookie, round(seconds))
        return {"name": session.token, "role": session.role, "session": True, "csrf": None}

    async def log_out(self, request: Request, response: Response) -> LoginState:
        """End the session; without one nothing happens."""
        visitor = visitor_of(request)
        if visitor and visitor.session:
            await run_in_threadpool(self._access.tokens.log_out, visitor.session)
        self._set_cookie(request, response, "", 0)
        return {"name": None, "role": None, "session": False, "csrf": None}

    def _set_cookie(self, request: Request, response: Response, value: str, seconds: int) -> None:
        peer: Peer = request.scope[PEER]
        response.set_cookie(
            self._access.cookie, value, max_age=seconds, path="/", secure=peer.encrypted, httponly=True,
            samesite="strict",
        )  # fmt: skip
