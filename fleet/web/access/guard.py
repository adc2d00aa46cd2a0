"""Stands before every route of the centre's pages: host, origin, who asks, and what the route needs."""

import logging
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from typing import cast

from fastapi import HTTPException, Request, Response, WebSocketDisconnect

from shared.page.access import hosts
from shared.page.access.requests import (
    CSRF_HEADER,
    LOGGED_OUT,
    App,
    Receive,
    Scope,
    Send,
    answer_head,
    headers_of,
    refusal_of,
    with_headers,
)
from shared.page.access.table import SAFE_METHODS, WEBSOCKET
from shared.page.told import readable

from .rights import Right, Visitor, needed
from .sessions import COOKIE, Sessions

log = logging.getLogger(__name__)

VISITOR = "centre.visitor"  # in the scope of a request
COOKIE_VALUE = "centre.cookie"
LOGIN_PAGE = "login"
STYLE = "unit/style.css"
NOT_HERE = "this centre does not answer to that name; add it to web_names in centre.toml"


class SessionEnded(Exception):
    """The session has ended while an answer was sent."""


class Guard:
    """Answers what may not be asked, and passes the rest on."""

    def __init__(self, app: App, sessions: Sessions, names: tuple[str, ...] = ()) -> None:
        self._app, self._sessions, self._names = app, sessions, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        send = with_headers(send)
        refusal = await self._refusal(scope)
        if refusal is not None:
            await readable(refusal, scope, headers_of(scope), STYLE)(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._watch(scope, receive, send)
        elif scope["method"] == "HEAD":
            await answer_head(self._app, scope, receive, send)
        else:
            await self._stream(scope, receive, send)

    async def _refusal(self, scope: Scope) -> Response | None:
        """Decide on a request; what may pass has its visitor in the scope."""
        headers = headers_of(scope)
        if not hosts.host_allowed(headers.get("host"), self._names):
            return refusal_of(421, NOT_HERE)
        if not hosts.same_origin(headers.get("origin"), headers.get("host")):
            return refusal_of(403, "this page is not from here")
        method = str(scope["method"]) if scope["type"] == "http" else WEBSOCKET
        right = needed(method, scope["path"])
        cookie = _cookie(headers)
        try:
            visitor = await self._sessions.find(cookie) if cookie else None
        except HTTPException as error:  # without the database nobody is known, and the page of the login is served
            if right is not Right.PUBLIC:
                return refusal_of(error.status_code, error.detail, error.headers)
            visitor = None
        scope[VISITOR], scope[COOKIE_VALUE] = visitor, cookie
        return _decision(method, scope["path"], right, visitor, headers)

    async def _watch(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a WebSocket on, and end it when the session of its visitor ends."""
        visitor, cookie = scope[VISITOR], scope[COOKIE_VALUE]

        async def send_while_valid(message: Scope) -> None:
            if message["type"] == "websocket.send" and not await self._is_valid(visitor, cookie):
                await send({"type": "websocket.close", "code": LOGGED_OUT, "reason": "logged out"})
                raise WebSocketDisconnect(LOGGED_OUT)
            await send(message)

        await self._app(scope, receive, send_while_valid)

    async def _stream(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; a stream of events ends when the session of its visitor ends."""
        visitor, cookie = scope[VISITOR], scope[COOKIE_VALUE]

        async def send_while_valid(message: Scope) -> None:
            goes_on = message["type"] == "http.response.body" and message.get("more_body", False)
            if goes_on and visitor is not None and not await self._is_valid(visitor, cookie):
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                raise SessionEnded
            await send(message)

        try:
            await self._app(scope, receive, send_while_valid)
        except* SessionEnded:  # of a group: an answer that goes on is sent by a task
            log.info("an answer to %s was ended with the session", visitor.name)

    async def _is_valid(self, visitor: Visitor, cookie: str) -> bool:
        try:
            return await self._sessions.find(cookie) == visitor
        except HTTPException:  # the database is away: what was granted holds until it is back
            return True


def visitor_of(request: Request) -> Visitor:
    """Who asks, on a route that needs a login."""
    return cast("Visitor", request.scope[VISITOR])


def _decision(
    method: str, path: str, right: Right, visitor: Visitor | None, headers: Mapping[str, str]
) -> Response | None:
    changes = method not in (*SAFE_METHODS, WEBSOCKET)
    if right is Right.PUBLIC:
        return refusal_of(403, f"a change needs the header {CSRF_HEADER}") if changes and not _csrf(headers) else None
    if visitor is None:
        return _unknown(method, path, headers)
    if changes and _csrf(headers) != visitor.csrf:
        return refusal_of(403, f"a change needs the header {CSRF_HEADER} with the value of /api/session")
    if not visitor.may(right):
        return refusal_of(403, f"the role {visitor.role} of {visitor.name} does not include this; an administrator "
                          "of this centre can change the role")  # fmt: skip
    return None


def _csrf(headers: Mapping[str, str]) -> str | None:
    return headers.get(CSRF_HEADER)


def _cookie(headers: Mapping[str, str]) -> str | None:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return found.value[:200] if found else None


def _unknown(method: str, path: str, headers: Mapping[str, str]) -> Response:
    """Send a browser that opens a page to the login; say to everyone else what is missing."""
    if method in SAFE_METHODS and "text/html" in headers.get("accept", ""):
        address = "../" * (path.count("/") - 1) + LOGIN_PAGE
        return Response(status_code=303, headers={"Location": address, "Cache-Control": "no-store"})
    return refusal_of(401, "log in at /login")
