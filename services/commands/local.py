"""A broker and a state folder on this machine, for the demo."""

import os
import shutil
import socket
import sys
from pathlib import Path

from broker import local_config
from shared.config import VehicleFile
from shared.errors import UserError

from .supervisor import Supervisor


def free_port() -> int:
    """Ask the kernel for a loopback port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def port_or_free(wanted: int) -> int:
    """Take the wanted loopback port if nobody listens on it, otherwise any free one."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", wanted))
        except OSError:
            return free_port()
        return int(probe.getsockname()[1])


def fresh_folder(path: Path) -> Path:
    """Make an empty folder, throwing away what an earlier run left there."""
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    return path


def broker_command(folder: Path, port: int, kind: str) -> list[str]:
    """Say how to start a broker on a loopback port: Mosquitto where there is one, else our own.

    `kind` is "auto", "mosquitto" or "simulated".
    """
    mosquitto = local_config.executable()
    if not mosquitto and kind == "mosquitto":
        raise UserError("Mosquitto is not installed: `apt-get install mosquitto`, or take `--broker simulated`")
    if mosquitto and kind != "simulated":
        return [mosquitto, "-c", str(local_config.write(folder, port))]
    acl = Path(__file__).parents[2] / "broker" / "acl.conf"
    return [sys.executable, "-m", "broker.simulated", "--port", str(port), "--acl", str(acl)]


def unit(
    vehicle: VehicleFile, environment: dict[str, str], logs: Path | None = None, broker: list[str] | None = None
) -> Supervisor:
    """Put every process of a vehicle under one supervisor, and the broker if it is ours to start.

    Who listens starts before who speaks, so that a recording misses nothing and can be verified whole.
    """
    supervisor = Supervisor({**os.environ, **environment}, logs)
    if broker:
        supervisor.add("broker", broker, outlives_others=True)
    for name in reversed(vehicle.processes):
        supervisor.add_process(name)
    return supervisor
