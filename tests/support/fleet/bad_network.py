"""A mobile network on loopback: it delays, throttles, is away for a time, and resets connections within a packet."""

import contextlib
import random
import select
import socket
import struct
import threading
import time
from dataclasses import dataclass

from tests.support.patience import HANGS_S

CHUNK_BYTES = 2048
ACCEPT_S = 0.05


@dataclass
class Weather:
    """What the network does now; may be changed while it runs."""

    delay_s: float = 0.0  # one way
    bytes_per_s: float | None = None  # each way and connection
    is_away: bool = False  # bytes are held back, and new connections are refused
    reset_after_bytes: int | None = None  # of both ways together; resets in the middle of a packet


class BadNetwork:
    """A TCP proxy. TCP neither loses nor reorders bytes: what does that to messages is `Courier` of the test centre."""

    def __init__(self, port: int) -> None:
        self.weather = Weather()
        self.carried_bytes = self.connections = self.resets = 0
        self._target = port
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(ACCEPT_S)
        self.port: int = self._server.getsockname()[1]
        self._stopping = threading.Event()
        self._random = random.Random(34)
        self._open: set[socket.socket] = set()
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def __enter__(self) -> "BadNetwork":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def cut(self) -> None:
        """Reset every connection."""
        for connection in list(self._open):
            self._reset(connection)

    def close(self) -> None:
        self._stopping.set()
        self.cut()
        for thread in self._threads:
            thread.join(HANGS_S)
        self._server.close()

    def _accept(self) -> None:
        while not self._stopping.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            if self.weather.is_away:
                self._reset(client)
                continue
            try:
                centre = socket.create_connection(("127.0.0.1", self._target), 5.0)
            except OSError:
                self._reset(client)
                continue
            self.connections += 1
            self._open |= {client, centre}
            thread = threading.Thread(target=self._carry, args=(client, centre), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _carry(self, client: socket.socket, centre: socket.socket) -> None:
        other = {client: centre, centre: client}
        most, carried = self.weather.reset_after_bytes, 0
        with contextlib.suppress(OSError, ValueError):
            while not self._stopping.is_set():
                if self.weather.is_away:
                    time.sleep(ACCEPT_S)
                    continue
                for source in select.select(list(other), [], [], ACCEPT_S)[0]:
                    data = source.recv(CHUNK_BYTES)
                    if not data:
                        return self._end(client, centre)
                    if most is not None and carried + len(data) > most:
                        with contextlib.suppress(OSError):
                            other[source].sendall(data[: most - carried])
                        self.resets += 1
                        self._reset(client)
                        self._reset(centre)
                        return None
                    self._wait(len(data))
                    other[source].sendall(data)
                    carried += len(data)
                    self.carried_bytes += len(data)
        self._end(client, centre)
        return None

    def _wait(self, size: int) -> None:
        weather = self.weather
        wait_s = weather.delay_s * self._random.uniform(0.5, 1.5)
        if weather.bytes_per_s is not None:
            wait_s += size / weather.bytes_per_s
        self._stopping.wait(wait_s)

    def _end(self, *sockets: socket.socket) -> None:
        for item in sockets:
            self._open.discard(item)
            item.close()

    def _reset(self, one: socket.socket) -> None:
        """Close with RST, and not with FIN."""
        self._open.discard(one)
        with contextlib.suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            one.shutdown(socket.SHUT_RDWR)
        one.close()
