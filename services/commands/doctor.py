"""`obu doctor`: what is wrong, and how to mend it."""

import os
import shutil
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from shared.config import VehicleFile, broker_address, load_vehicle, state_dir
from shared.errors import UserError
from shared.live import load_process

ENOUGH_BYTES = 1_000_000_000
LIBRARIES = Path(__file__).parents[1] / "monitoring" / "status" / "dashboard" / "node_modules"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: fine or not, and what to do."""

    fine: bool
    what: str
    mend: str = ""


def examine(vehicle_path: Path | None) -> int:
    """Print every finding; 0 if all is well, 1 otherwise."""
    findings = list(_findings(vehicle_path))
    for finding in findings:
        print(f"{'ok ' if finding.fine else 'NO '} {finding.what}")
        if not finding.fine:
            print(f"    -> {finding.mend}")
    return 0 if all(finding.fine for finding in findings) else 1


def _findings(vehicle_path: Path | None) -> Iterator[Finding]:
    version = ".".join(str(part) for part in sys.version_info[:3])
    yield Finding(sys.version_info >= (3, 11), f"Python {version}", "install Python 3.11 or newer")
    yield Finding(LIBRARIES.is_dir(), "libraries of the dashboard", "run `make setup`")
    try:
        vehicle = load_vehicle(vehicle_path)
        folder = state_dir()
    except UserError as error:
        yield Finding(False, "configuration", str(error))
        return
    yield Finding(True, f"vehicle {vehicle.name!r} from {vehicle.path}")
    yield from (_process(name, vehicle) for name in vehicle.processes)
    free = shutil.disk_usage(folder).free
    yield Finding(
        free > ENOUGH_BYTES, f"{free / 1e9:.1f} GB free in {folder}", "delete old recordings or set OBU_STATE"
    )
    yield Finding(os.access(folder, os.W_OK), f"{folder} is writable", f"change the owner of {folder} or set OBU_STATE")
    yield from _devices(vehicle)
    yield _broker()


def _process(name: str, vehicle: VehicleFile) -> Finding:
    try:
        load_process(name, vehicle)
    except UserError as error:
        return Finding(False, f"[{name}]", str(error))
    return Finding(True, f"[{name}]")


def _devices(vehicle: VehicleFile) -> Iterator[Finding]:
    for name in vehicle.processes:
        if not name.startswith("sensors."):
            continue
        device = str(vehicle.tables.get(name, {}).get("device", ""))
        path = device.removeprefix("serial://").split("?")[0]
        if path.startswith("/dev/"):
            there = os.access(path, os.R_OK | os.W_OK)
            mend = "plug it in" if not Path(path).exists() else "add yourself to the group `dialout` and log in again"
            yield Finding(there, f"{name}: {path}", mend)


def _broker() -> Finding:
    address = broker_address()
    what = f"broker at {address.host}:{address.port}"
    try:
        socket.create_connection((address.host, address.port), timeout=2.0).close()
    except OSError as error:
        return Finding(False, f"{what}: {error.strerror or error}", "start it, or set OBU_BROKER=mqtt://host:port")
    return Finding(True, what)
