"""TCP servers and UDP datagrams of the outputs, without threads: every call returns at once.

Clients, bytes of a request and bytes that wait for a slow client are bounded. A port that is in use is tried again, and
the other outputs go on.
"""

import contextlib
import errno
import selectors
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast

from .gpsd_session import BadClient

RETRY_S = 5.0
QUEUE_BYTES = 64 * 1024  # for a slow client: more than ten seconds of the fastest output
SEND_BUFFER_BYTES = 32 * 1024  # of the kernel, so that a stopped client is not served old positions for long
READ_BYTES = 4096
PAUSE_S = 0.5  # after which a request without an end is taken as ended
ACKNOWLEDGE_TIMEOUT_S = 30  # a client that acknowledges nothing for so long is gone
BACKLOG = 8
Address = tuple[str, int]


class Peer(Protocol):
    """What a server knows of one client."""

    def greeting(self) -> bytes:
        """Bytes that are sent first."""
        ...

    def answer(self, data: bytes) -> bytes:
        """Answer to bytes of the client; raises `BadClient`."""
        ...

    def pause(self) -> bytes:
        """Answer to what the client has sent, once nothing more has come for `PAUSE_S`."""
        ...


class Listener:
    """A client of NMEA: it is sent sentences, and what it sends is of no meaning."""

    def greeting(self) -> bytes:
        """Nothing."""
        return b""

    def answer(self, data: bytes) -> bytes:
        """Nothing."""
        return b""

    def pause(self) -> bytes:
        """Nothing."""
        return b""


@dataclass
class Client:
    """A connection, and the bytes that wait for it."""

    socket: socket.socket
    peer: Peer
    server: "TcpServer"
    waiting: bytes = b""
    pause_at_s: float | None = None  # monotonic clock: when a request without an end is taken as ended


class Servers:
    """The open sockets of this process, and what is counted about them."""

    def __init__(self, rejects: Counter[str], clients_maximum: int) -> None:
        self.rejects = rejects
        self.clients_maximum = clients_maximum
        self.clients: list[Client] = []
        self._selector = selectors.DefaultSelector()
        self._servers: list[TcpServer] = []

    def add(self, server: "TcpServer") -> None:
        """Serve this address as well."""
        self._servers.append(server)

    def serve(self) -> None:
        """Open what is not open, accept, read, answer and send what waits; returns at once."""
        for server in self._servers:
            if server.socket is None and server.open():
                self._selector.register(cast(socket.socket, server.socket), selectors.EVENT_READ, server)
        for key, events in self._selector.select(0.0) if self._selector.get_map() else ():
            if isinstance(key.data, TcpServer):
                self._accept(key.data)
            else:
                self._exchange(cast(Client, key.data), events)
        now_s = time.monotonic()
        for client in [item for item in self.clients if item.pause_at_s is not None and item.pause_at_s <= now_s]:
            client.pause_at_s = None
            self._queue(client, client.peer.pause())

    @property
    def fault(self) -> str | None:
        """Why an address is not served; None if all are."""
        return next((server.fault for server in self._servers if server.fault), None)

    def send(self, data: bytes, wanted: Callable[[Peer], bool]) -> None:
        """Send bytes to every client whose state says so; one that is too slow is dropped."""
        for client in [client for client in self.clients if wanted(client.peer)]:
            self._queue(client, data)

    def close(self) -> None:
        """Close all sockets."""
        for client in list(self.clients):
            self._drop(client)
        for server in self._servers:
            server.close()
        self._selector.close()

    def _accept(self, server: "TcpServer") -> None:
        try:
            connection, _ = cast(socket.socket, server.socket).accept()
        except OSError:  # it is gone already, or this process has no descriptor left
            self.rejects["accept"] += 1
            return
        if len(self.clients) >= self.clients_maximum:
            self.rejects["too_many_clients"] += 1
            connection.close()
            return
        client = Client(connection, server.peer(), server)
        with contextlib.suppress(OSError):  # each only improves the connection
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, ACKNOWLEDGE_TIMEOUT_S * 1000)
        self.clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self._queue(client, client.peer.greeting())

    def _exchange(self, client: Client, events: int) -> None:
        if events & selectors.EVENT_READ:
            try:
                data = client.socket.recv(READ_BYTES)
                answer = client.peer.answer(data) if data else None
            except BlockingIOError:
                return
            except BadClient as error:
                self._drop(client, str(error))
                return
            except OSError:
                data, answer = b"", None
            if answer is None:  # it has closed the connection
                self._drop(client)
                return
            client.pause_at_s = time.monotonic() + PAUSE_S
            self._queue(client, answer)
        if client in self.clients and events & selectors.EVENT_WRITE:
            self._flush(client)

    def _queue(self, client: Client, data: bytes) -> None:
        if len(client.waiting) + len(data) > QUEUE_BYTES:
            self._drop(client, "slow_client")
            return
        client.waiting += data
        self._flush(client)

    def _flush(self, client: Client) -> None:
        try:
            while client.waiting:
                client.waiting = client.waiting[client.socket.send(client.waiting) :]
        except BlockingIOError:
            pass  # the rest waits
        except OSError:
            self._drop(client)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        if self._selector.get_key(client.socket).events != events:
            self._selector.modify(client.socket, events, client)

    def _drop(self, client: Client, reason: str | None = None) -> None:
        if reason is not None:
            self.rejects[reason] += 1
        self._selector.unregister(client.socket)
        client.socket.close()
        self.clients.remove(client)


class TcpServer:
    """One address that is listened on; `remedy` says what to do where another program has it."""

    def __init__(self, address: Address, peer: Callable[[], Peer], remedy: str) -> None:
        self.address, self.peer = address, peer
        self.socket: socket.socket | None = None
        self.fault: str | None = None
        self._remedy, self._next_attempt = remedy, 0.0

    def open(self) -> bool:
        """Listen; False, with `fault`, where that is not possible now. Tried again after `RETRY_S`."""
        if time.monotonic() < self._next_attempt:
            return False
        self._next_attempt = time.monotonic() + RETRY_S
        host, port = self.address
        try:
            self.socket = _listening(host, port)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                self.fault = f"port {port} of {host} is in use by another program; {self._remedy}"
            else:
                self.fault = f"cannot listen on port {port} of {host}: {error.strerror or error}; check `host`"
            return False
        self.address, self.fault = self.socket.getsockname()[:2], None
        return True

    def close(self) -> None:
        """Stop listening."""
        if self.socket is not None:
            self.socket.close()


def _listening(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    opened = socket.socket(family, kind, protocol)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as after a restart, with old connections closing
        opened.setblocking(False)
        opened.bind(address)
        opened.listen(BACKLOG)
    except OSError:
        opened.close()
        raise
    return opened


class UdpSender:
    """Sends datagrams to addresses, which may be broadcast addresses; losses are counted."""

    def __init__(self, addresses: tuple[Address, ...], rejects: Counter[str]) -> None:
        self._addresses, self._rejects = addresses, rejects
        self._sockets: dict[Address, tuple[socket.socket, object]] = {}

    def send(self, data: bytes) -> None:
        """Send one datagram to each address."""
        for address in self._addresses if data else ():
            try:
                opened, resolved = self._sockets.get(address) or self._open(address)
                opened.sendto(data, cast(Address, resolved))
            except OSError:  # no such host, no network yet, nobody listens: the next datagram may arrive
                self._rejects["datagram_lost"] += 1

    def close(self) -> None:
        """Close the sockets."""
        for opened, _ in self._sockets.values():
            opened.close()

    def _open(self, address: Address) -> tuple[socket.socket, object]:
        family, kind, protocol, _, resolved = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        opened = socket.socket(family, kind, protocol)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        opened.setblocking(False)
        self._sockets[address] = opened, resolved
        return opened, resolved
