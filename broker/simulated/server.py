"""TCP server of the broker."""

import asyncio

from .broker import Broker
from .connection import Connection

FLUSH_S = 0.05  # for the last bytes to reach the clients


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
        """End `serve`."""
        self._stopping.set()

    async def serve(self) -> None:
        """Serve until `stop`, then close every connection; as in Mosquitto, wills are not published."""
        try:
            await self._stopping.wait()
        finally:
            await self._close()

    async def _close(self) -> None:
        self._server.close()
        for connection in tuple(self._connections):
            connection.end(will=False)
        await asyncio.sleep(FLUSH_S)
        for connection in tuple(self._connections):
            connection.abort()
        await asyncio.sleep(0)  # an aborted transport reports it in the next round of the loop
