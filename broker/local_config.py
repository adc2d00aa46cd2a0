"""Mosquitto on this machine alone: where its program is, and `mosquitto.conf` with other places.

`python -m broker.local_config --store /var/lib/obu-broker --rules /etc/obu/broker > /etc/obu/mosquitto.conf` prints it
for a unit without containers; the demo and the tests write theirs into a folder of their own.
"""

import argparse
import os
import shutil
import sys
from pathlib import Path

from shared.runtime.config import INSTALLED_SOCKET, MAX_SOCKET, SOCKET

from .keys import ACCESS_LIST, PASSWORDS

TLS_PORT = 8883
CERTIFICATE, KEY = "server.pem", "server.key"  # in the folder `tls` of the rules: broker/tls.py
HERE = Path(__file__).resolve().parent
OWN_PLACES = (
    "listener", "socket_domain", "persistence_location", "password_file", "acl_file", "log_dest", "user", "pid_file"
)  # fmt: skip


def executable() -> str | None:
    """Find Mosquitto's program; Debian keeps it where an ordinary user's PATH does not look."""
    return shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")


def command(program: str, config: Path) -> list[str]:
    """Command that starts Mosquitto, and sets aside a store that it cannot read."""
    return ["sh", str(HERE / "start.sh"), program, str(config)]


def configuration(port: int, store: Path, rules: Path, listen: str | None = None, socket: Path | None = None) -> str:
    """Keep every line of `mosquitto.conf` but its places: a loopback port, a folder of its own, and the folder `rules`.

    It holds the password file and the access list (`broker.keys.make`). With `listen`, an address of this machine or
    0.0.0.0, there is a listener that speaks TLS with the certificate in `rules / "tls"` (`broker.tls.make`); with
    `socket`, the path of a Unix socket, one for the processes of the unit.
    """
    text = (HERE / "mosquitto.conf").read_text(encoding="utf-8")
    lines = []
    if socket is None:
        text = text[: text.index("# The unit's own processes")] + text[text.index("# Address and paths") :]
    for line in text.splitlines():
        if line.startswith("listener 0 "):
            lines.append(f"listener 0 {socket}")
        elif line.startswith("listener "):
            # In its place: what follows holds for this listener, and before any it would open one on every address.
            lines += [f"listener {port} 127.0.0.1", "socket_domain ipv4"]
        elif line.split(" ")[0] not in OWN_PLACES:
            lines.append(line)
    lines += [
        "",
        "# The places on this machine.",
        f"persistence_location {store}/",
        f"password_file {rules / PASSWORDS}",
        f"acl_file {rules / ACCESS_LIST}",
        "log_dest stderr",
        "log_dest topic",
    ]
    if listen is not None:
        lines += [
            "",
            "# For other machines: by TLS.",
            f"listener {TLS_PORT} {listen}",
            f"certfile {rules / 'tls' / CERTIFICATE}",
            f"keyfile {rules / 'tls' / KEY}",
            "use_username_as_clientid true",
            "set_tcp_nodelay true",
            "max_connections 32",
        ]
    return "\n".join(lines) + "\n"


def socket_in(folder: Path) -> Path | None:
    """Make the folder of the socket in a state folder, for its owner alone; None where its path is too long."""
    path = folder / SOCKET
    if len(os.fsencode(path)) > MAX_SOCKET:
        return None
    path.parent.mkdir(mode=0o700, exist_ok=True)
    return path


def write(folder: Path, port: int, rules: Path, socket: Path | None = None) -> Path:
    """Write a configuration for a broker that is started by whoever calls this, and keeps its files in `folder`."""
    store = folder / "broker"
    store.mkdir(exist_ok=True)
    text = configuration(port, store, rules, socket=socket)
    if os.geteuid() == 0:  # started by root it would give up its rights, and with them the folder
        text += "user root\n"
    path = folder / "mosquitto.conf"
    path.write_text(text, encoding="utf-8")
    return path


def main() -> None:
    """Print the configuration for a unit without containers."""
    parser = argparse.ArgumentParser(
        prog="python -m broker.local_config", description="Print Mosquitto's configuration."
    )
    parser.add_argument("--port", type=int, default=1883, help="port on 127.0.0.1")
    parser.add_argument("--store", type=Path, default=Path("/var/lib/obu-broker"), help="folder for what is kept")
    parser.add_argument(
        "--rules", type=Path, default=Path("/etc/obu/broker"), help="folder of the password file and the access list"
    )
    parser.add_argument(
        "--listen", metavar="ADDRESS", help=f"listen for other machines as well, by TLS on port {TLS_PORT}, as 0.0.0.0"
    )
    parser.add_argument(
        "--socket", type=Path, default=INSTALLED_SOCKET, help="Unix socket for the processes of the unit"
    )
    options = parser.parse_args()
    if options.listen is not None and not (options.rules / "tls" / CERTIFICATE).exists():
        parser.error(f"there is no certificate in {options.rules / 'tls'}: `obu keys tls NAME` makes one")
    sys.stdout.write(configuration(options.port, options.store, options.rules, options.listen, options.socket))


if __name__ == "__main__":
    main()
