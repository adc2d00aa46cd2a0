"""Mosquitto on this machine alone: where its program is, and `mosquitto.conf` with other places.

`python -m broker.local_config --store /var/lib/obu-broker > /etc/obu/mosquitto.conf` prints it for a unit without
containers; the demo and the tests write theirs into a folder of their own.
"""

import argparse
import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
OWN_PLACES = ("listener", "socket_domain", "persistence_location", "acl_file", "log_dest", "user", "pid_file")


def executable() -> str | None:
    """Find Mosquitto's program; Debian keeps it where an ordinary user's PATH does not look."""
    return shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")


def command(program: str, config: Path) -> list[str]:
    """Command that starts Mosquitto, and sets aside a store that it cannot read."""
    return ["sh", str(HERE / "start.sh"), program, str(config)]


def configuration(port: int, store: Path, acl: Path = HERE / "acl.conf") -> str:
    """Keep every line of `mosquitto.conf` but its places: a loopback port, a folder of its own, the access list."""
    lines = [
        line
        for line in (HERE / "mosquitto.conf").read_text(encoding="utf-8").splitlines()
        if line.split(" ")[0] not in OWN_PLACES
    ]
    lines += [
        "",
        "# The places on this machine.",
        f"listener {port} 127.0.0.1",
        "socket_domain ipv4",
        f"persistence_location {store}/",
        f"acl_file {acl}",
        "log_dest stderr",
    ]
    return "\n".join(lines) + "\n"


def write(folder: Path, port: int, acl: Path = HERE / "acl.conf") -> Path:
    """Write a configuration for a broker that is started by whoever calls this, and keeps its files in `folder`."""
    store = folder / "broker"
    store.mkdir(exist_ok=True)
    text = configuration(port, store, acl)
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
    parser.add_argument("--acl", type=Path, default=HERE / "acl.conf", help="the access list")
    options = parser.parse_args()
    sys.stdout.write(configuration(options.port, options.store, options.acl))


if __name__ == "__main__":
    main()
