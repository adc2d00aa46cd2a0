"""Server of the broker: a TCP port, and a Unix socket for the processes of the unit."""

import asyncio
from pathlib import Path

from .broker import Broker
from .connection import Connection

FLUSH_S = 0.05  # for the last bytes to reach the clients


class Server:
    """A broker on a port, and a Unix socket; use `listen`, then `serve` until it is cancelled or `stop` is called."""

    def __init__(self, broker: Broker) -> None:
        self.broker = broker
        self.port = 0
        self._connections: tuple[set[Connection], ...] = (set(), set())  # of the port, and of the socket
        self._servers: list[asyncio.Server] = []
        self._stopping = asyncio.Event()

    async def listen(self, host: str, port: int, socket: Path | None = None) -> None:
        """Open the port; with port 0 the system chooses a free one. Raises OSError where it is taken."""
        loop = asyncio.get_running_loop()
        by_port, by_socket = self._connections
        if socket is not None:  # first: who finds the port finds the socket too
            self._servers = [
                await loop.create_unix_server(lambda: Connection(self.broker, by_socket), socket, backlog=100)
            ]
            socket.chmod(0o660)  # who may enter its folder may connect
        server = await loop.create_server(lambda: Connection(self.broker, by_port), host, port, backlog=100)
        self._servers.append(server)
        self.port = server.sockets[0].getsockname()[1]

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
        for server in self._servers:
            server.close()
        for connection in (*self._connections[0], *self._connections[1]):
            connection.end(will=False)
        await asyncio.sleep(FLUSH_S)
        for connection in (*self._connections[0], *self._connections[1]):
            connection.abort()
        await asyncio.sleep(0)  # an aborted transport reports it in the next round of the loop
