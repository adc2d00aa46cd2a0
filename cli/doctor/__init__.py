"""`obu doctor`: checks the installation, the configuration and a running unit, and names the remedy of each fault."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from shared import shipped
from shared.errors import UserError
from shared.runtime.config import VehicleFile, broker_address, load_vehicle, state_dir
from shared.runtime.live import load_process
from shared.v2x.security.trust import load as load_trust

from ..demo.local import reaches_broker, start_of_broker
from .corrections import corrections_set_up
from .devices import devices, other_ports
from .finding import Finding
from .host import host
from .unit import unit

OTHER_BROKER = "set OBU_BROKER to its address (a demo prints the line to copy)"
STORE_REMEDY = "what was retained has been published again; check the disk, and delete the file"
LIBRARIES = Path(__file__).parents[2] / "services" / "monitoring" / "status" / "dashboard" / "node_modules"


def examine(vehicle_path: Path | None, *, probe: bool = False) -> int:
    """Print every finding as it is made; return 0 if all checks passed, otherwise 1."""
    healthy = True
    for finding in findings(vehicle_path, probe=probe):
        healthy &= finding.ok
        print(f"{'ok ' if finding.ok else 'NO '} {finding.what}", flush=True)
        if not finding.ok:
            print(f"    -> {finding.remedy}")
    return 0 if healthy else 1


def findings(vehicle_path: Path | None, *, probe: bool) -> Iterator[Finding]:
    """Yield every finding, in the order in which a fault leads to the next."""
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
    yield from host(folder)
    yield Finding(os.access(folder, os.W_OK), f"{folder} is writable", f"change the owner of {folder} or set OBU_STATE")
    yield from devices(vehicle, probe=probe)
    if probe:
        yield from other_ports(vehicle)
    yield from _v2x(vehicle)
    yield from (Finding(*pair) for pair in corrections_set_up(vehicle))
    yield from _broker_stores(folder)
    broker = _broker()
    yield broker
    if broker.ok:
        yield from unit(vehicle)


def _process(name: str, vehicle: VehicleFile) -> Finding:
    try:
        load_process(name, vehicle)
    except UserError as error:
        return Finding(False, f"[{name}]", str(error))
    return Finding(True, f"[{name}]")


def _broker_stores(folder: Path) -> Iterator[Finding]:
    """Name a store that the broker could not read and set aside, as after a power cut (broker/start.sh)."""
    for store in (Path("/var/lib/obu-broker"), folder / "broker", folder / "demo" / "broker"):
        aside = store / "mosquitto.db.unreadable"
        if aside.exists():
            what = f"the broker could not read its store, and started without it: {aside}"
            yield Finding(False, what, STORE_REMEDY)


def _v2x(vehicle: VehicleFile) -> Iterator[Finding]:
    """Check that the sections of the processes that V2X consists of fit together."""
    radio, parser, sender = (name in vehicle.processes for name in ("sensors.v2x", "parsers.v2x", "controller.cam"))
    if radio or sender:
        yield Finding(parser, "CAM codec", "add the section [parsers.v2x]: it decodes and encodes the frames")
    security = vehicle.tables.get("parsers.v2x", {}).get("security", {})
    if parser and (folder := security.get("trust_folder") if isinstance(security, dict) else None):
        faults = load_trust(shipped(Path(str(folder)))).faults
        yield Finding(not faults, f"trust folder {folder}", f"{'; '.join(faults[:3])}: mend it, or remove the file")
    if sender:
        table = vehicle.tables.get("sensors.v2x", {})
        sends = radio and (str(table.get("device", "")).startswith("mqtt:") or "send_to" in table)
        yield Finding(sends, "own CAM is sent", "set send_to in [sensors.v2x] to the URL of the radio")


def _broker() -> Finding:
    address = broker_address()
    what = f"broker at {address.place}"
    try:
        reaches_broker(address)
    except OSError as error:
        return Finding(False, f"{what}: {error.strerror or error}", f"{start_of_broker(address)}, or {OTHER_BROKER}")
    return Finding(True, what)
