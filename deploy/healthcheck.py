"""Health check of a container, result as exit status: `python -S deploy/healthcheck.py [PORT]`.

A process touches the file OBU_ALIVE with each heartbeat, while its main loop runs and the broker is connected.
With a port, a web server must respond there as well.
"""

import os
import socket
import sys
import time

SILENT_AFTER_S = 5.0


def age_s(path: str) -> float:
    """Age of the last heartbeat [s]; infinite without one."""
    try:
        return abs(time.time() - os.stat(path).st_mtime)  # noqa: PTH116  # pathlib would triple the time of a check
    except OSError:
        return float("inf")


def answers(port: int) -> bool:
    """Whether the web server of this container responds to a health request."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=2.0) as connection:
            connection.sendall(b"GET /api/alive HTTP/1.0\r\nHost: localhost\r\n\r\n")
            return connection.recv(64).startswith((b"HTTP/1.1 200", b"HTTP/1.0 200"))
    except OSError:
        return False


def main(arguments: list[str]) -> str | None:
    """Return the fault, or None."""
    age = age_s(os.environ.get("OBU_ALIVE", "/tmp/alive"))
    if age > SILENT_AFTER_S:
        return f"no heartbeat for {age:.0f} s"
    if arguments and not answers(int(arguments[0])):
        return f"no response on port {arguments[0]}"
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
