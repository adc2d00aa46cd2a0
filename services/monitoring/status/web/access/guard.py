"""Stands before every route: host, origin, who asks, what the route needs; and headers that keep a browser safe."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import cast

from fastapi import HTTPException, Request, Response, WebSocketDisconnect

from shared.page.access import hosts
from shared.page.access.peer import Peer
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

from .access import Access, Visitor, csrf_agrees
from .rights import Right
from .table import needed

TOKENS = "/api/tokens"  # every program of the machine is a visitor of a simulated unit, and a token outlives that
VISITOR = "obu.visitor"  # in the scope of a request
PEER = "obu.peer"
LOGIN_PAGE = "login"
STYLE = "style.css"


class _SessionEndedError(Exception):
    """The session of an open stream has ended."""


class Guard:
    """Answers what may not be asked, and passes the rest on."""

    def __init__(self, app: App, access: Access) -> None:
        self._app, self._access = app, access
        self._open: Counter[str] = Counter()  # requests of each address behind a trusted proxy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        send = with_headers(send)
        headers = headers_of(scope)
        peer = self._access.peer(scope, headers)
        refusal = self._refusal(scope, headers, peer)
        if refusal is not None:
            await readable(refusal, scope, headers, STYLE)(scope, receive, send)
            return
        with self._counted(peer) as admitted:
            if not admitted:
                text = "too many requests of this address at once; close some pages, then load this one again"
                await refusal_of(503, text, {"Retry-After": "5"})(scope, receive, send)
            elif scope["type"] == "websocket":
                await self._watch(scope, receive, send)
            elif scope["method"] == "HEAD":
                await answer_head(self._app, scope, receive, send)
            else:
                await self._watch(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Mapping[str, str], peer: Peer) -> Response | None:
        """Decide on a request; what may pass has its visitor in the scope."""
        if not hosts.host_allowed(headers.get("host"), self._access.rules.allowed_hosts):
            return refusal_of(
                421, "this unit does not answer to that name; add it to allowed_hosts in [monitoring.status]"
            )
        if not hosts.same_origin(headers.get("origin"), headers.get("host")):
            return refusal_of(403, "this page is not from here")
        method = str(scope.get("method", WEBSOCKET)) if scope["type"] == "http" else WEBSOCKET
        right = needed(method, scope["path"])
        visitor = self._access.visitor(peer, headers)
        scope[VISITOR], scope[PEER] = visitor, peer
        if visitor is None and right is not Right.PUBLIC:
            return _unknown(method, scope["path"], headers)
        if method not in (*SAFE_METHODS, WEBSOCKET) and not _is_from_page(visitor, right, headers):
            text = f"a change needs the header {CSRF_HEADER} with the value of /api/session, or a token in the header"
            return refusal_of(403, f"{text} Authorization")
        return _lacking(scope["path"], visitor, right) if visitor is not None else None

    @contextmanager
    def _counted(self, peer: Peer) -> Iterator[bool]:
        """Count the open requests of a client behind a proxy; others are counted by their connections."""
        if not peer.proxied:
            yield True
            return
        admitted = self._open[peer.address] < self._access.rules.per_address
        self._open[peer.address] += admitted
        try:
            yield admitted
        finally:
            self._open[peer.address] -= admitted
            if not self._open[peer.address]:
                del self._open[peer.address]

    async def _watch(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and end its stream when the session of its visitor ends."""
        visitor: Visitor | None = scope[VISITOR]

        async def send_while_valid(message: Scope) -> None:
            if message["type"] == "websocket.send" and visitor and not self._access.still(visitor):
                await send({"type": "websocket.close", "code": LOGGED_OUT, "reason": "logged out"})
                raise WebSocketDisconnect(LOGGED_OUT)
            if message.get("more_body") and visitor and not self._access.still(visitor):
                raise _SessionEndedError
            await send(message)

        try:
            await self._app(scope, receive, send_while_valid)
        except _SessionEndedError:
            await send({"type": "http.response.body", "body": b"", "more_body": False})


def visitor_of(request: Request) -> Visitor | None:
    """Who asks, as the guard has found."""
    return cast("Visitor | None", request.scope.get(VISITOR))


def may(request: Request, right: Right) -> bool:
    """Whether the visitor has a right."""
    visitor = visitor_of(request)
    return visitor is not None and visitor.right.includes(right)


def insist_on(request: Request, right: Right) -> None:
    """Raise 403 if the visitor has not a right that only one action of a route needs."""
    if not may(request, right):
        raise HTTPException(403, f"this needs the role {right}; log in with another token")


def _lacking(path: str, visitor: Visitor, right: Right) -> Response | None:
    """What a visitor may not do."""
    if path == TOKENS and visitor.session is None and visitor.bearer is None:
        return refusal_of(403, "tokens are managed after a login; `obu token show-link` prints a link for it")
    if not visitor.right.includes(right):
        return refusal_of(403, f"this needs the role {right}, and {visitor.name} has {visitor.right}; log in with "
                       "another token")  # fmt: skip
    return None


def _is_from_page(visitor: Visitor | None, right: Right, headers: Mapping[str, str]) -> bool:
    """Whether a change has the header that a page from elsewhere cannot send."""
    if visitor is None or right is Right.PUBLIC:  # nothing is entrusted to a login: any value is enough
        return CSRF_HEADER in headers
    return csrf_agrees(visitor, headers)


def _unknown(method: str, path: str, headers: Mapping[str, str]) -> Response:
    """Send a browser that opens a page to the login; say to everyone else what is missing."""
    if method in SAFE_METHODS and "text/html" in headers.get("accept", ""):
        address = "../" * (path.count("/") - 1) + LOGIN_PAGE  # relative: a proxy may have put the page below a path
        return Response(status_code=303, headers={"Location": address, "Cache-Control": "no-store"})
    text = "log in at /login, or send a token: `Authorization: Bearer TOKEN`; `obu token add` on the unit makes one"
    return refusal_of(401, text, {"WWW-Authenticate": 'Bearer realm="obu"'})
