"""What guards do with a request and its answer: headers, refusals, HEAD, and headers that keep a browser safe."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from typing import Any

from fastapi import Response
from pydantic_core import to_json

from ..assets import HEADERS

Scope = MutableMapping[str, Any]  # of ASGI, as are the next three
Receive = Callable[[], Awaitable[Scope]]
Send = Callable[[Scope], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
CSRF_HEADER = "x-obu-csrf"  # of each change: a page from elsewhere cannot send it
LOGGED_OUT = 4401  # close code of a WebSocket whose session has ended


def headers_of(scope: Mapping[str, Any]) -> dict[str, str]:
    """Headers by their name; those that are repeated are joined."""
    found: dict[str, str] = {}
    for name, value in scope["headers"]:
        key, text = name.decode("latin-1").lower(), value.decode("latin-1")
        found[key] = f"{found[key]}, {text}" if key in found else text
    return found


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
            extra = {"Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'", **HEADERS}
            rest = [(n.lower().encode(), v.encode()) for n, v in extra.items() if n.lower().encode() not in present]
            message["headers"] = [*message["headers"], *rest]
        await send(message)

    return send_guarded
