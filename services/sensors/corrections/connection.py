"""Connections that never block: TCP, TLS over TCP, and a serial port."""

import contextlib
import os
import select
import socket
import threading
import time
from typing import TYPE_CHECKING, Protocol

from shared.devices.device import Device, DeviceBusy, DeviceLost, open_device
from shared.errors import UserError

from .address import Address
from .fault import RETRY_S, ConnectionEnded, SourceFault

if TYPE_CHECKING:
    import ssl

READ_BYTES = 4096
MAX_CONCURRENT = 16384  # [bytes] read in one turn
MAX_WAITING = 8192  # [bytes] not sent yet: the longest request is a tenth of it
MAX_ADDRESSES = 3  # of one host that are tried
ADDRESS_S = 4.0  # for each of them, so that all have their turn: IPv6 may lead nowhere where IPv4 works


class Connection(Protocol):
    """A connection that is being made or open; its methods raise `SourceFault` when it is lost."""

    sock: socket.socket | None  # to wait for; None: to be read by the clock
    wants_write: bool

    def opened(self) -> bool:
        """Go on with connecting; whether the connection is open."""
        ...

    def read(self) -> bytes:
        """Return the received bytes, empty without any."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes, now or when the peer takes them."""
        ...

    def close(self) -> None:
        """Close it; may be called twice."""
        ...


class _Resolver(threading.Thread):
    """Looks up the addresses of a host, which may take longer than a driver may be silent."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(daemon=True, name="resolver")
        self._host, self._port = host, port
        self.found: list[tuple[int, tuple[object, ...]]] | None = None
        self.fault: str | None = None

    def run(self) -> None:
        """Look up; either `found` or `fault` is set at the end."""
        try:
            rows = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM)
            self.found = [(row[0], row[4]) for row in rows[:MAX_ADDRESSES]]
        except (OSError, UnicodeError) as error:
            self.fault = error.strerror if isinstance(error, OSError) and error.strerror else str(error)


class TcpConnection:
    """A TCP connection, with TLS if there is a context for it."""

    def __init__(self, address: Address, context: "ssl.SSLContext | None" = None) -> None:
        self.sock: socket.socket | None = None
        self.wants_write = False
        self._name, self._host, self._context = f"{address.host}:{address.port}", address.host, context
        self._tls: ssl.SSLSocket | None = None
        self._resolver = _Resolver(address.host, address.port)
        self._resolver.start()
        self._open = False
        self._waiting = b""
        self._tried_s = 0.0  # since when the present address is tried

    def opened(self) -> bool:
        """Go on with connecting: look-up, TCP, then TLS."""
        if self._open:
            return True
        if self.sock is None:
            self._begin()
            return False
        if self._tls is None and not self._connected():
            return False
        self._open = self._context is None or self._greeted()
        return self._open

    def read(self) -> bytes:
        """Return the received bytes, and send what waits."""
        self._send()
        connection = self._tls or self.sock
        data = b""
        while connection is not None and len(data) < MAX_CONCURRENT:
            try:
                part = connection.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                if _would_block(error) or data:
                    break  # the fault is found again at the next call, as an end of the connection
                raise self._lost(error) from error
            if not part:
                if data:
                    break  # the end is found again at the next call
                raise ConnectionEnded(f"{self._name} closed the connection")
            data += part
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; raises `SourceFault` if the peer takes none for long."""
        self._waiting += data
        if len(self._waiting) > MAX_WAITING:
            raise SourceFault(f"{self._name} does not read what is sent to it")
        self._send()

    def close(self) -> None:
        """Close the socket."""
        for connection in (self._tls, self.sock):
            if connection is not None:
                connection.close()
        self.sock = self._tls = None

    def _lost(self, error: OSError) -> SourceFault:
        """The fault of an open connection; what TLS refuses behind its handshake has no answer of the caster."""
        if self._tls is not None and not isinstance(error, ConnectionError):
            from shared.tls import reason_of

            return SourceFault(
                f"no TLS with {self._name}: {reason_of(error)}; check certificate_file and key_file", wait_s=RETRY_S
            )
        return ConnectionEnded(f"lost {self._name}: {error.strerror or error}")

    def _begin(self) -> None:
        """Connect to the next address of the host, once they are known."""
        resolver = self._resolver
        if resolver.fault is not None:
            raise SourceFault(f"cannot find {self._host}: {resolver.fault}; check the network and the name")
        if not resolver.found:
            return
        family, address = resolver.found.pop(0)
        made = socket.socket(family, socket.SOCK_STREAM)
        made.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            try:
                made.connect(address)
            except OSError as error:
                if not isinstance(error, BlockingIOError):
                    made.close()
                    self._next(error.strerror or str(error))
                    return
        self.sock, self.wants_write, self._tried_s = made, True, time.monotonic()

    def _connected(self) -> bool:
        assert self.sock is not None
        if not select.select([], [self.sock], [], 0.0)[1]:
            if self._resolver.found and time.monotonic() - self._tried_s > ADDRESS_S:
                self.sock.close()
                self.sock = None
            return False
        if fault := self.sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self.sock.close()
            self.sock = None
            self._next(os.strerror(fault))
            return False
        self.wants_write = False
        if self._context is not None:
            self._tls = self._context.wrap_socket(self.sock, server_hostname=self._host, do_handshake_on_connect=False)
            self.sock = self._tls
        return True

    def _next(self, reason: str) -> None:
        """Go on with the next address of the host, or give up."""
        if not self._resolver.found:
            raise SourceFault(f"cannot connect to {self._name}: {reason}; check the network, host and port")

    def _greeted(self) -> bool:
        import ssl

        from shared.tls import reason_of

        assert self._tls is not None
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            self.wants_write = False
            return False
        except ssl.SSLWantWriteError:
            self.wants_write = True
            return False
        except ssl.SSLCertVerificationError as error:
            raise SourceFault(
                f"{self._name} is not who it should be: {error.verify_message}; check the date of this machine, "
                "or name the authority's certificate as ca_file",
                wait_s=RETRY_S,
            ) from error
        except OSError as error:
            raise SourceFault(f"no TLS with {self._name}: {reason_of(error)}; is it the port for TLS?") from error
        self.wants_write = False
        return True

    def _send(self) -> None:
        connection = self._tls or self.sock
        if not self._waiting or connection is None or not self._open:
            return
        try:
            self._waiting = self._waiting[connection.send(self._waiting) :]
        except BlockingIOError:
            pass  # sent when the peer takes it
        except OSError as error:
            if not _would_block(error):
                raise self._lost(error) from error
        self.wants_write = bool(self._waiting)


def _would_block(error: OSError) -> bool:
    """Whether TLS waits for the network; its module is only there when it is used."""
    return type(error).__name__ in ("SSLWantReadError", "SSLWantWriteError")


class SerialConnection:
    """A serial port, as the other drivers open it."""

    sock: socket.socket | None = None
    wants_write = False

    def __init__(self, address: Address) -> None:
        self._url = address.url
        self._device: Device | None = None

    def opened(self) -> bool:
        """Open the port."""
        if self._device is None:
            try:
                self._device = open_device(self._url)
            except (DeviceLost, UserError) as error:
                raise SourceFault(str(error)) from error
        return True

    def read(self) -> bytes:
        """Return the bytes that the port has received."""
        data = b""
        try:
            while self._device and len(data) < MAX_CONCURRENT and (part := self._device.read(0.0)):
                data += part
        except DeviceLost as error:
            raise SourceFault(str(error)) from error
        return data

    def write(self, data: bytes) -> None:
        """Send bytes to the port."""
        with contextlib.suppress(DeviceBusy, DeviceLost):  # nothing is sent to a source on a serial port
            if self._device:
                self._device.write(data)

    def close(self) -> None:
        """Close the port."""
        if self._device is not None:
            self._device.close()
            self._device = None


def context_of(address: Address) -> "ssl.SSLContext | None":
    """Make the TLS context of a source: the authorities of this system, or those of `ca_file`.

    Raises
    ------
    SourceFault
        A file cannot be read.
    """
    if not address.tls:
        return None
    import ssl

    try:
        context = ssl.create_default_context(cafile=address.ca_file)
        if address.certificate_file:
            context.load_cert_chain(address.certificate_file, address.key_file)
    except (OSError, ValueError) as error:
        files = ", ".join(filter(None, (address.ca_file, address.certificate_file, address.key_file)))
        reason = getattr(error, "strerror", None) or error
        raise SourceFault(f"cannot use {files or 'the certificates'}: {reason}", wait_s=RETRY_S) from error
    return context
