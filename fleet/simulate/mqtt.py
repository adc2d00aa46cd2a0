"""MQTT 3.1.1 for thousands of connections in one thread: QoS 0, clean sessions, mutual TLS, never blocking."""

import errno
import os
import socket
import ssl
from collections.abc import Iterator

from shared.tls import reason_of

CONNECT, CONNACK, PUBLISH, SUBSCRIBE, SUBACK, PINGREQ = 0x10, 0x20, 0x30, 0x82, 0x90, 0xC0
KEEP_ALIVE_S = 120
MAX_PACKET_BYTES = 131_072
MAX_LENGTH_BYTES = 4
READ_BYTES = 16_384
READ, WRITE = 1, 2  # as in `selectors`


class ConnectionLost(Exception):
    """The connection has ended; the text says why."""


def tls_context(authority_pem: str, certificate_and_key: str) -> ssl.SSLContext:
    """Trust this authority and present this certificate; its key touches no disk."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_verify_locations(cadata=authority_pem)
    descriptor = os.memfd_create("tls")
    try:
        os.write(descriptor, certificate_and_key.encode())
        context.load_cert_chain(f"/proc/self/fd/{descriptor}")
    finally:
        os.close(descriptor)
    return context


class Connection:
    """One connection: `work` goes on whenever the socket is ready, and gives what has come."""

    def __init__(self, address: tuple[str, int], context: ssl.SSLContext, name: str, topics: tuple[str, ...]) -> None:
        self.is_ready = False  # the centre has taken connection and subscription
        self.bytes_out = self.bytes_in = 0  # of MQTT, without TLS
        self._name, self._topics = name, topics
        plain = socket.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET)
        try:
            plain.setblocking(False)
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            code = plain.connect_ex(address)
            if code == errno.EINPROGRESS:
                code = plain.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if code:  # on to TLS, a refused connection would be left open
                raise OSError(code, os.strerror(code))
            self.socket = context.wrap_socket(plain, server_hostname=address[0], do_handshake_on_connect=False)
        except OSError as error:
            plain.close()
            raise ConnectionLost(reason_of(error)) from error
        self._is_open = False
        self._in, self._out = bytearray(), bytearray()
        self.wants = WRITE

    def fileno(self) -> int:
        """Descriptor, for a selector."""
        return self.socket.fileno()

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message; raises `ConnectionLost`."""
        self._send(PUBLISH, _text(topic) + payload)

    def ping(self) -> None:
        """Show that this end is there; raises `ConnectionLost`."""
        self._send(PINGREQ, b"")

    def work(self) -> list[bytes]:
        """Read and write what is possible; give the payloads that have come. Raises `ConnectionLost`."""
        try:
            if not self._is_open:
                self.socket.do_handshake()
                self._is_open, self.wants = True, READ
                self._send(CONNECT, _text("MQTT") + bytes([4, 2]) + KEEP_ALIVE_S.to_bytes(2, "big") + _text(self._name))
            self._flush()
            return list(self._read())
        except ssl.SSLWantReadError:
            self.wants = READ
        except ssl.SSLWantWriteError:
            self.wants = WRITE
        except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
            raise ConnectionLost(reason_of(error)) from error
        return []

    def close(self) -> None:
        """End it."""
        self.socket.close()

    def _send(self, kind: int, body: bytes) -> None:
        packet = bytes([kind]) + _length(len(body)) + body
        self.bytes_out += len(packet)
        self._out += packet
        self._flush()

    def _flush(self) -> None:
        try:
            while self._out:
                sent = self.socket.send(self._out)
                del self._out[:sent]
            self.wants = READ
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
            self.wants = READ | WRITE
        except OSError as error:
            raise ConnectionLost(reason_of(error)) from error

    def _read(self) -> Iterator[bytes]:
        while True:
            try:
                data = self.socket.recv(READ_BYTES)
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                return
            if not data:
                raise ConnectionLost("the centre has closed the connection")
            self.bytes_in += len(data)
            self._in += data
            while (packet := self._packet()) is not None:
                yield from self._taken(*packet)

    def _packet(self) -> tuple[int, bytes] | None:
        """Take one whole packet off what has come: kind and body."""
        size = 0
        for number in range(MAX_LENGTH_BYTES):
            if len(self._in) < 2 + number:
                return None
            byte = self._in[1 + number]
            size |= (byte & 0x7F) << 7 * number
            if byte < 0x80:
                break
        else:
            raise ConnectionLost("a length of no packet")
        if size > MAX_PACKET_BYTES:
            raise ConnectionLost(f"a packet of {size} bytes")
        begin = 2 + number
        if len(self._in) < begin + size:
            return None
        kind, body = self._in[0], bytes(self._in[begin : begin + size])
        del self._in[: begin + size]
        return kind, body

    def _taken(self, kind: int, body: bytes) -> Iterator[bytes]:
        if kind == CONNACK:
            if body[1:2] != b"\0":
                raise ConnectionLost(f"the centre refuses this vehicle: code {body[1:2].hex()}")
            self._send(SUBSCRIBE, b"\0\1" + b"".join(_text(topic) + b"\0" for topic in self._topics))
        elif kind == SUBACK:
            self.is_ready = True
        elif kind & 0xF0 == PUBLISH:
            yield body[2 + int.from_bytes(body[:2], "big") :]


def _text(text: str) -> bytes:
    data = text.encode()
    return len(data).to_bytes(2, "big") + data


def _length(size: int) -> bytes:
    found = bytearray()
    while True:
        size, byte = size >> 7, size & 0x7F
        found.append(byte | (0x80 if size else 0))
        if not size:
            return bytes(found)
