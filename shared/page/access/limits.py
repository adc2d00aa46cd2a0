"""Limits of connections: how many a client may have, how long one may wait, and how much is written about it."""

import asyncio
import logging
import resource
import time
from collections.abc import Callable, Iterable
from typing import Any, cast

import h11
from fastapi import FastAPI
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from .peer import Network, as_address, contains

log = logging.getLogger(__name__)

HEADERS_S = 5.0  # from the first byte of a request, or the begin of the connection, to the end of the headers
IDLE_S = 15  # between two requests
BACKLOG = 64  # connections that are accepted at once, and wait in the kernel
RESERVED_FILES = 128  # of the limit of open files, which connections leave for recordings, tiles and the bus
LOGGED_PERIOD_S = 60.0
LOGGED_PER_PERIOD = 5  # of each text


class Connections:
    """The open connections by client; the oldest idle one gives way where there are too many.

    Clients on this machine, in front of a container, or behind a trusted proxy share one address. They may have half
    of all connections; requests behind a proxy are counted by the guard. `place` gives what an address is counted by.
    """

    def __init__(
        self, maximum: int, per_address: int, trusted: tuple[Network, ...] = (), published: str | None = None,
        place: Callable[[str], str] = str,
    ) -> None:  # fmt: skip
        files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        self.maximum = maximum if files == resource.RLIM_INFINITY else max(8, min(maximum, files - RESERVED_FILES))
        self._per_address = min(per_address, self.maximum)
        self._trusted, self._published, self._place = trusted, published, place
        self._open: dict[asyncio.BaseTransport, tuple[str, LimitedHttp]] = {}
        self.refused = 0

    def __len__(self) -> int:
        return len(self._open)

    def admit(self, protocol: "LimitedHttp", transport: asyncio.BaseTransport, client: str) -> bool:
        """Count a new connection; False if it is to be closed at once."""
        place = self._place(client)
        of_client = [entry for entry in self._open.items() if entry[1][0] == place]
        if len(of_client) >= self._limit_of(client):
            self._make_room([limited_http for _, (_, limited_http) in of_client])
        if sum(pair[0] == place for pair in self._open.values()) < self._limit_of(client):
            if len(self._open) >= self.maximum:
                self._make_room([limited_http for _, limited_http in self._open.values()])
            if len(self._open) < self.maximum:
                self._open[transport] = place, protocol
                return True
        self.refused += 1
        log.warning(
            "refused a connection of %s: too many are open (connections_per_client in [monitoring.status])", client[:45]
        )
        return False

    def leave(self, transport: asyncio.BaseTransport) -> None:
        """Forget a connection that has ended."""
        self._open.pop(transport, None)

    def _limit_of(self, client: str) -> int:
        address = as_address(client)
        shared = self._published is not None or address is None or address.is_loopback
        if shared or (address is not None and contains(self._trusted, address)):
            return max(self._per_address, self.maximum // 2)
        return self._per_address

    def _make_room(self, candidates: list["LimitedHttp"]) -> None:
        """Close the oldest connection without a request; they are in the order of their begin."""
        idle = next((candidate for candidate in candidates if candidate.idle), None)
        if idle is not None:
            self.leave(idle.transport)
            idle.transport.abort()


def connections_of(config: Config) -> Connections:
    """The connections of a server."""
    return cast("Connections", cast(FastAPI, config.app).state.connections)


class LimitedHttp(H11Protocol):
    """One connection: it is counted, and its headers must come in time."""

    def __init__(self, config: Config, server_state: ServerState, app_state: dict[str, Any], **more: Any) -> None:
        super().__init__(config, server_state, app_state, **more)
        self._late: asyncio.TimerHandle | None = None
        self.admitted = False

    @property
    def count(self) -> Connections:
        """The connections of the server."""
        return connections_of(self.config)

    @property
    def idle(self) -> bool:
        """Whether no request is being answered."""
        return self.conn.their_state is h11.IDLE and (self.cycle is None or self.cycle.response_complete)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as its base
        """Count the connection, or close it."""
        super().connection_made(transport)
        self.admitted = self.count.admit(self, transport, self.client[0] if self.client else "unknown")
        if not self.admitted:
            transport.abort()
            return
        self._late = self.loop.call_later(HEADERS_S, self._end_late)

    def data_received(self, data: bytes) -> None:
        """Take a part of a request, and watch for the end of its headers."""
        if not self.admitted:
            return
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._unset_late()
        elif self._late is None:
            self._late = self.loop.call_later(HEADERS_S, self._end_late)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._unset_late()
        self.count.leave(self.transport)
        super().connection_lost(exc)

    def _unset_late(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _end_late(self) -> None:
        self._late = None
        if not self.transport.is_closing():
            self.transport.close()


class CountedWebSocket(WebSocketsSansIOProtocol):
    """A connection that has become a WebSocket, and is counted on."""

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        connections_of(self.config).leave(self.transport)
        super().connection_lost(exc)

    async def send(self, message: Any) -> None:
        """Send; a handshake that was answered with a status is complete, which uvicorn 0.54 logs as an error."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body"):
            self.handshake_complete = True


class RateLimit(logging.Filter):
    """Passes the first few records of each text in a minute; the next minute begins with how many were left out."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = now_s
        self._begin_s = -LOGGED_PERIOD_S
        self._counts: dict[str, int] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is written."""
        now_s = self._now_s()
        if now_s - self._begin_s >= LOGGED_PERIOD_S:
            left_out = sum(max(0, count - LOGGED_PER_PERIOD) for count in self._counts.values())
            self._begin_s, self._counts = now_s, {}
            if left_out:
                record.msg = f"{record.msg} ({left_out} more were not written)"
        text = str(record.msg)
        self._counts[text] = self._counts.get(text, 0) + 1
        return self._counts[text] <= LOGGED_PER_PERIOD


def quiet_accept(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Write one line where the kernel gives no further file, instead of a traceback for each connection."""
    error = context.get("exception")
    if isinstance(error, OSError) and "accept" in str(context.get("message", "")):
        log.warning("cannot accept connections: %s; the page takes new ones in a second", error.strerror)
    else:
        loop.default_exception_handler(context)


def limit_logs(names: Iterable[str]) -> None:
    """Limit what clients can make this process write: by the server, and by loggers of these names."""
    for name in (__name__, "uvicorn.error", *names):
        logger = logging.getLogger(name)
        if not any(isinstance(present, RateLimit) for present in logger.filters):
            logger.addFilter(RateLimit())
