"""Stands before every route: host, origin, who asks, what the route needs; and headers that keep a browser safe."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from typing import Any, cast

from fastapi import HTTPException, Request, Response, WebSocketDisconnect
from pydantic_core import to_json

from .. import assets
from ..told import readable
from . import hosts
from .access import CSRF_HEADER, Access, Visitor, csrf_agrees
from .peer import Peer
from .rights import Right
from .table import SAFE_METHODS, WEBSOCKET, needed

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Scope]]
Send = Callable[[Scope], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
TOKENS = "/api/tokens"  # every program of the machine is a visitor of a simulated unit, and a token outlives that
VISITOR = "obu.visitor"  # in the scope of a request
PEER = "obu.peer"
LOGGED_OUT = 4401  # close code of a WebSocket whose session has ended
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


def headers_of(scope: Mapping[str, Any]) -> dict[str, str]:
    """Headers by their name; those that are repeated are joined."""
    found: dict[str, str] = {}
    for name, value in scope["headers"]:
        key, text = name.decode("latin-1").lower(), value.decode("latin-1")
        found[key] = f"{found[key]}, {text}" if key in found else text
    return found


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


def refusal_of(status: int, detail: str, headers: Mapping[str, str] | None = None) -> Response:
    """Answer with a status and what to try."""
    head = {"Cache-Control": "no-store", **(headers or {})}
    return Response(to_json({"detail": detail}), status, head, "application/json")


async def answer_head(app: App, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer HEAD by the head of the answer to GET; a stream ends with it."""
    ended = asyncio.Event()

    async def send_head(message: Scope) -> None:
        if message["type"] == "http.response.start":
            await send(message)
            await send({"type": "http.response.body", "body": b"", "more_body": False})
            ended.set()

    answer = asyncio.ensure_future(app({**scope, "method": "GET"}, receive, send_head))
    end = asyncio.ensure_future(ended.wait())
    await asyncio.wait((answer, end), return_when=asyncio.FIRST_COMPLETED)
    end.cancel()
    if answer.done():
        answer.result()
    else:
        answer.cancel()


def with_headers(send: Send) -> Send:
    """Add the headers that keep a browser safe to what has none."""

    async def send_guarded(message: Scope) -> None:
        if message["type"] in ("http.response.start", "websocket.http.response.start"):
            present = {name for name, _ in message["headers"]}
            extra = {"Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'", **assets.HEADERS}
            rest = [(n.lower().encode(), v.encode()) for n, v in extra.items() if n.lower().encode() not in present]
            message["headers"] = [*message["headers"], *rest]
        await send(message)

    return send_guarded
