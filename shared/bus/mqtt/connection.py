"""The bytes of one connection to a broker: writes are gathered, reads are cut into packets, both are bounded."""

import contextlib
import select
import socket
import struct
import time
from collections.abc import Iterable, Iterator

from .framing import Framer

READ_BYTES = 65_536
PATIENCE_US = 100_000  # of one read that waits by itself
MOST_READS = 64  # in one go: a broker that sends without end shall not keep us from everything else
UNSENT_BYTES = 4_194_304  # beyond them a broker that goes on talking and does not read is let go
FAREWELL_S = 0.2


class Lost(Exception):
    """The connection has ended; the text says why."""


class Connection:
    """A socket on which no call waits for longer than it says; raises OSError if nobody listens, then only `Lost`."""

    def __init__(self, host: str, port: int, *, patience_s: float, packet_bytes: int) -> None:
        self._socket = socket.create_connection((host, port), patience_s)
        # Without it bursts of small messages wait for the peer's delayed acknowledgement: 20 to 40 ms.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(True)  # reads by themselves give up after a while, writes are told not to wait
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, PATIENCE_US))
        except OSError:  # a 32-bit system that counts time in 64 bits
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@qq", 0, PATIENCE_US))
        self._framer = Framer(packet_bytes)
        self._unsent = bytearray()
        self.blocked = False  # the broker reads slower than we write
        self.sent_s = self.heard_s = time.monotonic()

    @property
    def unsent_bytes(self) -> int:
        """How much was gathered and is not written yet."""
        return len(self._unsent)

    def gather(self, frame: bytes) -> None:
        """Keep a packet for the next `flush`, which writes all of them at once."""
        self._unsent += frame
        if len(self._unsent) > UNSENT_BYTES and self.blocked:
            raise Lost("the broker does not read")

    def flush(self) -> None:
        """Write what was gathered, as far as the system takes it."""
        if not self._unsent:
            return
        try:
            sent = self._socket.send(self._unsent, socket.MSG_DONTWAIT)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise Lost(error.strerror or str(error)) from error
        if sent:
            self.sent_s = time.monotonic()
            del self._unsent[:sent]
        self.blocked = bool(self._unsent)

    def wait(self, timeout_s: float) -> bool:
        """Wait for the broker's word, and write on when it reads again; say whether to read now.

        Where there is time, reading is the wait: that saves a call between the broker's word and its reader.
        """
        if timeout_s * 1e6 >= PATIENCE_US and not self.blocked:
            return True
        writers = [self._socket] if self.blocked else []
        readable, writable, _ = select.select([self._socket], writers, [], timeout_s)
        if writable:
            self.flush()
        return bool(readable)

    def read(self) -> Iterable[tuple[int, bytes]]:
        """Give the packets that have come, as first byte and body; raises ProtocolError for what is none."""
        data = self._recv()
        return self._framer.only(data) or self._read_on(data)

    def _read_on(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        for _ in range(MOST_READS):
            yield from self._framer.feed(data)
            if len(data) < READ_BYTES:
                return
            data = self._recv(socket.MSG_DONTWAIT)

    def _recv(self, flags: int = 0) -> bytes:
        """Read once; nothing if nothing is there."""
        try:
            data = self._socket.recv(READ_BYTES, flags)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise Lost(error.strerror or str(error)) from error
        if not data:
            raise Lost("the broker closed it")
        self.heard_s = time.monotonic()
        return data

    def leave(self, farewell: bytes) -> None:
        """Write what is left and a farewell, and let the broker be the first to close, so that it reads them all."""
        with contextlib.suppress(OSError):
            self._socket.settimeout(FAREWELL_S)
            self._socket.sendall(self._unsent + farewell)
            self._socket.shutdown(socket.SHUT_WR)
            until_s = time.monotonic() + FAREWELL_S
            while time.monotonic() < until_s and self._socket.recv(READ_BYTES):
                pass
        self.close()

    def close(self) -> None:
        """Close without a word."""
        self._socket.close()
