"""Routes of the login: open a session, end it, and who has logged in."""

import logging
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from shared.page import body
from shared.page.access.peer import Peer
from shared.page.answers import Refusal, described, reference_to
from shared.page.body import json_response

from ..answers import LoginState
from .access import Access
from .guard import PEER, visitor_of
from .tokens import is_secret

log = logging.getLogger(__name__)


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
        wrong = {401: "No such token", 403: "A page from elsewhere", 413: "Too long", 422: "Not a login"}
        refused: dict[int | str, dict[str, Any]] = {status: described(Refusal, text) for status, text in wrong.items()}
        app.add_api_route(
            "/api/session", self.session, response_class=Response, tags=["login"],
            responses={200: described(LoginState, "The login")},
        )  # fmt: skip
        app.add_api_route(
            "/api/login", self.log_in, methods=["POST"], response_class=Response, tags=["login"],
            responses={200: described(LoginState, "Logged in"), **refused}, openapi_extra={"requestBody": BODY},
        )  # fmt: skip
        app.add_api_route(
            "/api/logout", self.log_out, methods=["POST"], response_class=Response, tags=["login"],
            responses={200: described(LoginState, "Logged out")},
        )  # fmt: skip

    def session(self, request: Request) -> Response:
        """Who asks, with which role; `csrf` is the value of the header X-OBU-CSRF of every change."""
        visitor = visitor_of(request)
        return json_response({
            "name": visitor.name if visitor else None,
            "role": visitor.right if visitor else None,
            "session": bool(visitor and visitor.session),
            "csrf": visitor.csrf if visitor else None,
        })  # fmt: skip

    async def log_in(self, request: Request) -> Response:
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
        answer = json_response({"name": session.token, "role": session.role, "session": True, "csrf": None})
        self._set_cookie(request, answer, cookie, round(seconds))
        return answer

    async def log_out(self, request: Request) -> Response:
        """End the session; without one nothing happens."""
        visitor = visitor_of(request)
        if visitor and visitor.session:
            await run_in_threadpool(self._access.tokens.log_out, visitor.session)
        answer = json_response({"name": None, "role": None, "session": False, "csrf": None})
        self._set_cookie(request, answer, "", 0)
        return answer

    def _set_cookie(self, request: Request, answer: Response, value: str, seconds: int) -> None:
        peer: Peer = request.scope[PEER]
        answer.set_cookie(
            self._access.cookie, value, max_age=seconds, path="/", secure=peer.encrypted, httponly=True,
            samesite="strict",
        )  # fmt: skip
