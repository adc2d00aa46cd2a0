"""Asks the broker of this machine for a sign of life, for the service manager: `python -I -S probe.py ADDRESS [FILE]`.

One connection stays open and sends a ping every few seconds. The loop that answers it is the one that passes messages
on, so a broker that hangs answers none. Any answer counts, also a refusal to connect: no right on any topic is needed.
The probe is the user `broker.watch`; start.sh names the file of its secret, which is beside the password file, and the
socket of the unit's own processes as the address, or else a port: others can occupy that.

Each answer is passed on as WATCHDOG=1 to the socket in NOTIFY_SOCKET. The program ends with its parent, the broker. It
reads the standard library alone, and is started without the project: it shall take little memory.
"""

import os
import socket
import sys
import time

PERIOD_S = 3.0
ANSWER_S = 5.0  # longest wait for one
KEEP_ALIVE_S = 60
USER = "broker.watch"
CONNACK, PINGREQ = 0x20, b"\xc0\x00"


def connect_packet(secret: str | None) -> bytes:
    """Write the first packet of a connection (MQTT 3.1.1, section 3.1)."""
    clean, user, password = 0x02, 0x80, 0x40
    flags = clean | user | (password if secret else 0)
    fields = [USER, USER, *([secret] if secret else [])]  # client identifier, user, password
    body = b"\x00\x04MQTT\x04" + bytes([flags]) + KEEP_ALIVE_S.to_bytes(2, "big")
    body += b"".join(len(text.encode()).to_bytes(2, "big") + text.encode() for text in fields)
    return b"\x10" + _length(len(body)) + body


def _length(count: int) -> bytes:
    digits = bytearray()
    while True:
        count, digit = divmod(count, 128)
        digits.append(digit | (0x80 if count else 0))
        if not count:
            return bytes(digits)


def _connected(address: int | str) -> socket.socket:
    if isinstance(address, int):
        return socket.create_connection(("127.0.0.1", address), ANSWER_S)
    connection = socket.socket(socket.AF_UNIX)
    try:
        connection.settimeout(ANSWER_S)
        connection.connect(address)
    except OSError:
        connection.close()
        raise
    return connection


class Probe:
    """A connection that is asked; `ask` opens it anew where it is gone."""

    def __init__(self, address: int | str, secret: str | None = None) -> None:
        self._address, self._secret = address, secret  # a port of this machine, or the path of a Unix socket
        self._connection: socket.socket | None = None

    def ask(self) -> bool:
        """Whether the broker answers."""
        try:
            if self._connection is None:
                self._connection = _connected(self._address)
                answered = self._answer(connect_packet(self._secret))
            else:
                answered = self._answer(PINGREQ)
        except OSError:
            answered = False  # nothing listens, or it took too long
        if not answered:
            self.close()
        return answered

    def _answer(self, packet: bytes) -> bool:
        connection = self._connection
        if connection is None:
            return False
        connection.sendall(packet)
        answer = connection.recv(4)
        if len(answer) == 4 and answer[0] == CONNACK and answer[3]:
            self.close()  # refused, by a broker that works
        return bool(answer)

    def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def secret_in(path: str | None) -> str | None:
    """Read the secret of the probe; None without one."""
    if not path:
        return None
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123  # pathlib would double the memory
            return file.read(4096).strip() or None
    except (OSError, UnicodeDecodeError) as error:
        sys.stderr.write(f"the probe of the broker has no secret: {error}\n")
        return None


def tell(words: str) -> None:
    """Send words to the service manager."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    name = b"\0" + address[1:].encode() if address.startswith("@") else address
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        try:
            notify.sendto(words.encode(), name)
        except OSError as error:
            sys.stderr.write(f"the service manager cannot be told: {error}\n")


def main(arguments: list[str]) -> None:
    """Ask until the parent ends."""
    address = int(arguments[0]) if arguments[0].isdigit() else arguments[0]
    broker, probe = os.getppid(), Probe(address, secret_in(arguments[1] if len(arguments) > 1 else None))
    ready = False
    while os.getppid() == broker:
        if probe.ask():
            tell("WATCHDOG=1" if ready else "READY=1\nWATCHDOG=1")
            ready = True
        time.sleep(PERIOD_S if ready else 0.2)


if __name__ == "__main__":
    main(sys.argv[1:])
