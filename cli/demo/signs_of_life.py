"""A socket at which a child says that it is ready and still works, with the words of sd_notify(3)."""

import os
import socket
import struct

from shared.runtime.alive import CONNECTED, READY, WATCHDOG

MAX_LENGTH = 4096
CREDENTIALS = struct.Struct("3i")  # of Linux: process, user, group
MAX_READS = 64


class SignsOfLife:
    """Listens in the abstract name space, which needs no folder and leaves no file; other users are not heard."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.bind("")  # Linux chooses a free name
        self.is_connected = False  # whether the child has said that it is connected to the broker
        self.address = "@" + self._socket.getsockname()[1:].decode()  # for NOTIFY_SOCKET

    def heard(self) -> bool:
        """Whether a sign has come since the last call."""
        heard = False
        for _ in range(MAX_READS):
            try:
                text, sender, _, _ = self._socket.recvmsg(MAX_LENGTH, socket.CMSG_SPACE(CREDENTIALS.size))
            except BlockingIOError:
                break
            if _is_ours(sender):
                words = text.decode(errors="replace").split("\n")
                heard = heard or READY in words or WATCHDOG in words
                self.is_connected = self.is_connected or CONNECTED in words
        return heard

    def close(self) -> None:
        """Listen no more."""
        self._socket.close()


def _is_ours(sender: list[tuple[int, int, bytes]]) -> bool:
    """Whether a datagram comes from our own user, or from root."""
    for level, kind, data in sender:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS) and len(data) >= CREDENTIALS.size:
            return CREDENTIALS.unpack_from(data)[1] in (0, os.getuid())
    return False
