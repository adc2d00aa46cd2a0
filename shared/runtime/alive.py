"""Tells whoever started this process that its loop turns: systemd, the supervisor of `obu up`, or a container's.

systemd and `obu up` listen at the socket in NOTIFY_SOCKET, with the words of sd_notify(3). A container's supervisor
(deploy/supervise.sh) and its health check look at two files beside each other: OBU_ALIVE is touched while the broker is
connected, the one with `.loop` behind its name at each turn.
"""

import os
import socket
from collections.abc import Mapping
from pathlib import Path

LOOP_SUFFIX = ".loop"
READY, WATCHDOG, STOPPING = "READY=1", "WATCHDOG=1", "STOPPING=1"
CONNECTED, WAITING = "STATUS=connected to the broker", "STATUS=waiting for the broker"


class LivenessSignal:
    """Signs of life of one process; nobody may listen."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self.fault: str | None = None  # why a file could not be touched
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if environment.get("NOTIFY_SOCKET") else None
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self._file = environment.get("OBU_ALIVE")
        self._told: bool | None = None  # whether the broker was connected, as last said
        if self._socket is not None:
            self._socket.setblocking(False)

    def beat(self, *, connected: bool) -> None:
        """Say that the loop turns; a process is ready with its first turn, also while there is no broker."""
        words = [WATCHDOG]
        if connected is not self._told:
            words = [READY, CONNECTED if connected else WAITING, WATCHDOG]
        if self._send("\n".join(words)):
            self._told = connected  # one that did not arrive is said again: systemd waits for it
        if self._file:
            self._touch(self._file + LOOP_SUFFIX)
            if connected:
                self._touch(self._file)

    def stopping(self) -> None:
        """Say that the process ends on request."""
        self._send(STOPPING)
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> bool:
        if self._socket is None:
            return True
        try:
            self._socket.sendto(text.encode(), self._address)
        except BlockingIOError:
            return False  # the listener has not read the ones before: it is late, and no one here is
        except OSError as error:
            self.fault = f"cannot tell the service manager: {error.strerror}"
            return False
        return True

    def _touch(self, path: str) -> None:
        try:
            Path(path).touch()
        except OSError as error:
            self.fault = f"cannot write {path}: {error.strerror}"


def _address(text: str) -> str | bytes:
    """Address of a socket; one that begins with @ is in the abstract name space."""
    return b"\0" + text[1:].encode() if text.startswith("@") else text
