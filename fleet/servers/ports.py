"""Ports of this machine: whether one is free, and whose it is."""

import errno
import socket
from pathlib import Path

from shared.errors import UserError

LISTEN_STATE = "0A"  # state of a socket in /proc/net/tcp


def must_be_free(host: str, port: int, setting: str) -> None:
    """Raise `UserError` if nobody can listen there; `setting` names the port in centre.toml."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # of connections that have just ended
            probe.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise UserError(
                f"port {port} of {host} is in use: end the program that has it (ss -ltnp names it), or state another "
                f"{setting} in centre.toml"
            ) from error
        raise UserError(f"cannot listen at port {port} of {host} ({setting}): {error.strerror}; change it") from error


def is_of(pid: int | None, port: int) -> bool:
    """Whether a process, which the caller may look into, is the one that listens at a port."""
    sockets = {f"socket:[{inode}]" for inode in _listening(port)}
    try:
        return any(_target(path) in sockets for path in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return False  # it has ended


def _target(path: Path) -> str | None:
    try:
        return str(path.readlink())
    except OSError:
        return None  # closed meanwhile


def _listening(port: int) -> list[str]:
    """Inodes of the sockets that listen at a port."""
    found = []
    for table in ("tcp", "tcp6"):
        try:
            lines = Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]
        except FileNotFoundError:
            continue  # a kernel without IPv6
        for words in map(str.split, lines):
            if words[3] == LISTEN_STATE and int(words[1].rpartition(":")[2], 16) == port:
                found.append(words[9])
    return found
