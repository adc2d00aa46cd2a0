"""Listens for clients and ends on request."""

import asyncio
import contextlib

from shared.bus.mqtt.wire import Reason

from .broker import Broker
from .connection import Connection

SWEEP_PERIOD_S = 1.0
FAREWELL_S = 0.05  # for clients to read why the connection ends


class Server:
    """A broker on a TCP port; use `listen`, then `serve` until it is cancelled or `stop` is called."""

    def __init__(self, broker: Broker) -> None:
        self.broker = broker
        self.port = 0
        self._connections: set[Connection] = set()
        self._stopping = asyncio.Event()

    async def listen(self, host: str, port: int) -> None:
        """Open the port; with port 0 the system chooses a free one. Raises OSError where it is taken."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            lambda: Connection(self.broker, self._connections), host, port, backlog=100
        )
        self.port = self._server.sockets[0].getsockname()[1]

    def stop(self) -> None:
        """Let `serve` come to its end."""
        self._stopping.set()

    async def serve(self) -> None:
        """Sweep once a second until told to stop, then bid every client farewell; no wills, as Mosquitto."""
        try:
            while not self._stopping.is_set():
                self.broker.sweep()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), SWEEP_PERIOD_S)
        finally:
            await self._close()

    async def _close(self) -> None:
        self._server.close()
        for connection in tuple(self._connections):
            connection.end(Reason.SERVER_SHUTTING_DOWN, will=False)
        await asyncio.sleep(FAREWELL_S)
        for connection in tuple(self._connections):
            connection.abort()
        await asyncio.sleep(0)  # an aborted transport reports it in the next round of the loop
