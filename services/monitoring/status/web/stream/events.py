"""Server-sent events: the verdict, the solution and outages, for programs that want no WebSocket.

`verdict` on opening and when the state or the deciding row changes; `solution` once a second; `outage` when one begins
or ends. A comment every five seconds shows that the connection is open.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager

from fastapi import HTTPException
from fastapi.responses import StreamingResponse
from pydantic_core import to_json
from starlette.types import Receive, Scope, Send

from shared.page.stream.clients import Client, Clients, Frame

from ...state import State
from ...views import reports
from ...views.models.unit import OutageRow
from ...views.position import solution

PERIOD_S = 0.2
SOLUTION_NS, HEARTBEAT_NS = 1_000_000_000, 5_000_000_000
RETRY_MS = 2000  # after which a client connects again


class Events:
    """Encodes each event once, and sends it to all clients."""

    def __init__(
        self, state: State, lock: AbstractContextManager[object], now_ns: Callable[[], int], clients_maximum: int
    ) -> None:
        self._state, self._lock, self._now_ns = state, lock, now_ns
        self.clients = Clients(clients_maximum)
        self._verdict: tuple[object, ...] = ()
        self._outages: dict[tuple[str, int], int | None] = {}
        self._solution_ns = self._heartbeat_ns = 0

    async def run(self) -> None:
        """Send the events while there are clients."""
        while True:
            await asyncio.sleep(PERIOD_S)
            if len(self.clients):
                for frame in self._due():
                    self.clients.broadcast(frame)

    def stream(self) -> StreamingResponse:
        """Open a stream of events; 503 if there are as many readers as allowed."""
        client = self.clients.enter()
        if client is None:
            text = f"too many readers: {len(self.clients)} are connected; try again"
            raise HTTPException(503, text, {"Retry-After": "10"})
        with self._lock:
            now_ns = self._now_ns()
            if len(self.clients) == 1:
                self._notice()  # what is known now is no event
            first = [_event("verdict", self._position(now_ns)), _event("solution", solution(self._state, now_ns))]
        client.put(Frame(f"retry: {RETRY_MS}\n\n".encode() + b"".join(frame.plain for frame in first)))
        return _Stream(self.clients, client)

    def _position(self, now_ns: int) -> object:
        return reports.health(self._state, now_ns)["position"]

    def _notice(self) -> tuple[bool, list[OutageRow]]:
        """Compare with what was sent: whether the verdict changed, and the outages that began or ended."""
        verdict = self._state.verdict
        before, self._verdict = self._verdict, (verdict.state, verdict.row)
        shown = reports.outages(self._state)
        rows = [*shown["open"], *shown["closed"]]
        known, self._outages = self._outages, {(row["what"], row["since_ns"]): row["until_ns"] for row in rows}
        new = [row for row in rows if known.get((row["what"], row["since_ns"]), 0) != row["until_ns"]]
        return before != self._verdict, new

    def _due(self) -> list[Frame]:
        with self._lock:
            now_ns = self._now_ns()
            changed, outages = self._notice()
            frames = [_event("verdict", self._position(now_ns))] if changed else []
            frames += [_event("outage", row) for row in outages]
            if now_ns - self._solution_ns >= SOLUTION_NS - PERIOD_S * 0.5e9:
                self._solution_ns = now_ns
                frames.append(_event("solution", solution(self._state, now_ns)))
        if now_ns - self._heartbeat_ns >= HEARTBEAT_NS:
            self._heartbeat_ns = now_ns
            frames.append(Frame(b": heartbeat\n\n"))
        return frames


class _Stream(StreamingResponse):
    """One client's answer, which ends when the client leaves or falls behind."""

    def __init__(self, clients: Clients, client: Client) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(_frames(client), media_type="text/event-stream", headers=headers)
        self._clients, self._client = clients, client

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until the end, and remove the client."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._clients.leave(self._client)


async def _frames(client: Client) -> AsyncIterator[bytes]:
    while (frame := await client.frames.get()) is not None:
        yield frame.plain


def _event(kind: str, content: object) -> Frame:
    return Frame(b"event: %s\ndata: %s\n\n" % (kind.encode(), to_json(content)))
