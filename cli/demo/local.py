"""A broker and a state folder on this machine, for the demo."""

import contextlib
import errno
import fcntl
import itertools
import json
import os
import random
import shutil
import socket
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from broker import keys, local_config
from shared.errors import UserError
from shared.processes import Role
from shared.runtime.config import INSTALLED_SOCKET, BrokerAddress, Table, VehicleFile, load_vehicle
from shared.runtime.credentials import FOLDER, note_addresses
from shared.runtime.warm.client import WarmStart

from .supervisor import Supervisor

SERVICE = Path("/etc/systemd/system/obu-broker.service")
ROADSIDE = Path(__file__).parents[2] / "deploy" / "vehicles" / "rsu.toml"


# Below the ports that Linux gives outgoing connections (ip_local_port_range): one of those is taken before a program
# that is told its number has started.
PORTS = range(20_000, 32_000)
_counter = itertools.count(random.randrange(len(PORTS)))


def free_port() -> int:
    """A loopback port that is not in use, for TCP and UDP; the same one again only after all others."""
    for number in itertools.islice(_counter, len(PORTS)):
        port = PORTS[number % len(PORTS)]
        with contextlib.suppress(OSError), socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", port))
            udp.bind(("127.0.0.1", port))
            return port
    raise UserError(f"no port from {PORTS[0]} to {PORTS[-1]} is free: end a program that listens there (ss -lntup)")


def port_or_free(wanted: int) -> tuple[int, str | None]:
    """The wanted loopback port, or a free one and the reason why the wanted one cannot be used."""
    if wanted == 0:
        return free_port(), None
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", wanted))
        except OSError as error:
            in_use = error.errno == errno.EADDRINUSE
            return free_port(), "is in use" if in_use else f"cannot be opened ({error.strerror})"
        return wanted, None


@contextlib.contextmanager
def only_one(lock: Path) -> Iterator[None]:
    """Lock a folder for this demo: a second one would delete the files of the first."""
    try:
        file = lock.open("w")
    except OSError as error:
        raise UserError(f"cannot write {lock}: {error.strerror}; set OBU_STATE to a folder of yours") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UserError(
                f"another demo runs in {lock.parent}; end it, or set OBU_STATE to another folder"
            ) from error
        yield


def fresh_folder(path: Path) -> Path:
    """Make an empty folder; files of an earlier run are deleted."""
    try:
        if path.exists():
            shutil.rmtree(path)
        path.mkdir(parents=True)
    except OSError as error:
        raise UserError(f"cannot empty {path}: {error.strerror}; remove it, or set OBU_STATE to another") from error
    return path


@dataclass(frozen=True)
class LocalBroker:
    """Command of a broker on this machine, the address for the unit's own processes, and what is to be said of it."""

    command: list[str]
    address: BrokerAddress
    remark: str | None = None


def local_broker(folder: Path, port: int, kind: str, vehicle: VehicleFile, *, replay: bool = False) -> LocalBroker:
    """A broker on a loopback port and a socket in `folder`: Mosquitto if installed, otherwise the simulated one.

    `kind` is "auto", "mosquitto" or "simulated". The secrets of the unit and the broker's rules are made in `folder`,
    where they are missing. Where its path is too long for a socket, the unit's own processes take the port too.
    """
    mosquitto = local_config.executable()
    if not mosquitto and kind == "mosquitto":
        raise UserError("Mosquitto is not installed: `apt-get install mosquitto`, or take `--broker simulated`")
    credentials, rules = folder / FOLDER, folder / keys.RULES
    passwords, acl = keys.make(credentials, vehicle, keys.KeyFileOwners(vehicle.path, str(rules), replay=replay))
    by_port, socket_path = BrokerAddress(port=port), local_config.socket_in(folder)
    address, remark = by_port, None
    if socket_path is None:
        remark = (
            f"{folder} is too long a path for a Unix socket: the unit's own processes take the port as well, where any "
            "program of this machine can occupy the connections; set OBU_STATE to a shorter one"
        )
    else:
        address = BrokerAddress.at(socket_path)
    note_addresses(credentials, *dict.fromkeys((by_port.place, address.place)))
    if mosquitto and kind != "simulated":
        command = local_config.command(mosquitto, local_config.write(folder, port, rules, socket_path))
    else:
        command = [
            sys.executable, "-m", "broker.simulated", "--port", str(port), "--acl", str(acl),
            "--passwords", str(passwords), *([] if socket_path is None else ["--socket", str(socket_path)]),
        ]  # fmt: skip
    return LocalBroker(command, address, remark)


def how_to_listen(broker: str, state: Path, keys_folder: Path | None = None) -> str:
    """The environment with which another terminal receives the messages of a unit that runs here."""
    signed_by = f" OBU_KEYS={keys_folder}" if keys_folder else ""  # with which `obu verify` accepts its recordings
    return (
        "to listen in another terminal:\n"
        f"export OBU_BROKER={broker} OBU_STATE={state} OBU_VEHICLE={state / 'vehicle.toml'}{signed_by}"
    )


def reaches_broker(address: BrokerAddress) -> None:
    """Connect to a broker and disconnect; raises `OSError` if none responds."""
    if address.socket is not None:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(2.0)
            connection.connect(address.socket)
        return
    socket.create_connection((address.host, address.port), timeout=2.0).close()


def start_of_broker(address: BrokerAddress) -> str:
    """How to start the broker of an address, as a clause."""
    if address.socket is None and address.host not in ("127.0.0.1", "localhost", "::1"):
        return f"start the broker on {address.host}"
    if SERVICE.exists() and address.socket in (None, str(INSTALLED_SOCKET)):
        return "start it with `sudo systemctl start obu-broker`"
    port = "" if address.port == BrokerAddress.port else f" --port {address.port}"
    return f"start one with `obu broker{port}`"


def as_toml(tables: Mapping[str, Table]) -> str:
    """Format sections as TOML."""
    return "\n".join(
        line
        for name, table in tables.items()
        for line in (f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items()), "")
    )


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return json.dumps(value)  # strings, numbers and booleans are written alike in JSON and TOML


def unit_file(path: Path | None, role: Role | None) -> VehicleFile:
    """Read the file of a unit; raises `UserError` if it is of another role."""
    if path is None and role is Role.RSU and "OBU_VEHICLE" not in os.environ:
        path = ROADSIDE
    file = load_vehicle(path)
    if role not in (None, file.role):
        raise UserError(f'{file.path} is of role {file.role}: write role = "{role}" in [vehicle], or take another file')
    return file


def unit(
    vehicle: VehicleFile,
    environment: dict[str, str],
    logs: Path | None = None,
    broker: list[str] | None = None,
    *,
    forked: bool = True,
) -> Supervisor:
    """Put every process of a vehicle, and its broker if given, under one supervisor.

    Consumers start before producers, and the recorder listens before the others start and ends after them, so that a
    recording is complete and can be verified. Its processes are `forked` from one parent, or each starts by itself.
    """
    warm = None
    if forked:
        modules = ["shared.runtime.live", *(f"services.{name}.process" for name in vehicle.processes)]
        warm = WarmStart(modules, "cli.__main__:main")
    supervisor = Supervisor({**os.environ, **environment}, logs, warm=warm)
    if broker:
        supervisor.add("broker", broker, throughout=True)
    for name in reversed(vehicle.processes):
        supervisor.add_process(name, throughout=name == "monitoring.recorder")
    return supervisor
