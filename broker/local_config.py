"""Mosquitto on a loopback port of this machine: where its program is, and `mosquitto.conf` with other places."""

import os
import shutil
from pathlib import Path

HERE = Path(__file__).parent
OWN_PLACES = ("listener", "persistence_location", "acl_file", "log_dest", "user", "pid_file")


def executable() -> str | None:
    """Find Mosquitto's program; Debian keeps it where an ordinary user's PATH does not look."""
    return shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")


def write(folder: Path, port: int, acl: Path = HERE / "acl.conf") -> Path:
    """Write a configuration that keeps every limit of `mosquitto.conf` but stays on this machine."""
    lines = [
        line
        for line in (HERE / "mosquitto.conf").read_text(encoding="utf-8").splitlines()
        if line.split(" ")[0] not in OWN_PLACES
    ]
    store = folder / "broker"
    store.mkdir(exist_ok=True)
    lines += [
        f"listener {port} 127.0.0.1",
        "socket_domain ipv4",
        f"persistence_location {store}/",
        f"acl_file {acl}",
        "log_dest stderr",
    ]
    if os.geteuid() == 0:  # started by root it would give up its rights, and with them the folder
        lines.append("user root")
    path = folder / "mosquitto.conf"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
