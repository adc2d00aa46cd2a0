"""`obu doctor`: checks the installation, the configuration and a running unit, and names the remedy of each fault."""

import os
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from shared.bus.bus import Bus
from shared.errors import BadPayload, UserError
from shared.messages.operation import ProcessHealth, ProcessState
from shared.runtime.config import VehicleFile, broker_address, load_vehicle, state_dir
from shared.runtime.live import load_process
from shared.topics import TOPICS

ENOUGH_BYTES = 1_000_000_000
LISTEN_S = 2.0
OTHER_BROKER = "set OBU_BROKER=mqtt://host:port (a demo prints the line to copy)"
SILENT_NS = 3_000_000_000
STORE_REMEDY = "what was retained has been published again; check the disk, and delete the file"
LIBRARIES = Path(__file__).parents[1] / "services" / "monitoring" / "status" / "dashboard" / "node_modules"


@dataclass(frozen=True)
class Finding:
    """The result of one check, and the remedy if it failed."""

    ok: bool
    what: str
    remedy: str = ""


def examine(vehicle_path: Path | None) -> int:
    """Print every finding; return 0 if all checks passed, otherwise 1."""
    findings = list(_findings(vehicle_path))
    for finding in findings:
        print(f"{'ok ' if finding.ok else 'NO '} {finding.what}")
        if not finding.ok:
            print(f"    -> {finding.remedy}")
    return 0 if all(finding.ok for finding in findings) else 1


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
    yield from _v2x(vehicle)
    yield from _broker_stores(folder)
    broker = _broker()
    yield broker
    if broker.ok:
        yield from _unit(vehicle)


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
            accessible = os.access(path, os.R_OK | os.W_OK)
            remedy = "connect it" if not Path(path).exists() else "add your user to the group `dialout`, log in again"
            yield Finding(accessible, f"{name}: {path}", remedy)


def _broker_stores(folder: Path) -> Iterator[Finding]:
    """Name a store that the broker could not read and set aside, as after a power cut (broker/start.sh)."""
    for store in (Path("/var/lib/obu-broker"), folder / "broker", folder / "demo" / "broker"):
        aside = store / "mosquitto.db.unreadable"
        if aside.exists():
            what = f"the broker could not read its store, and started without it: {aside}"
            yield Finding(
                False, what, "what was retained has been published again; check the disk, and delete the file"
            )


def _v2x(vehicle: VehicleFile) -> Iterator[Finding]:
    """Check that the sections of the processes that V2X consists of fit together."""
    radio, parser, sender = (name in vehicle.processes for name in ("sensors.v2x", "parsers.v2x", "controller.cam"))
    if radio or sender:
        yield Finding(parser, "CAM codec", "add the section [parsers.v2x]: it decodes and encodes the frames")
    if sender:
        table = vehicle.tables.get("sensors.v2x", {})
        sends = radio and (str(table.get("device", "")).startswith("mqtt:") or "send_to" in table)
        yield Finding(sends, "own CAM is sent", "set send_to in [sensors.v2x] to the URL of the radio")


def _unit(vehicle: VehicleFile) -> Iterator[Finding]:
    """Check the health messages that the processes of a running unit publish within `LISTEN_S`."""
    topics = [topic for topic in TOPICS if topic.name == "health/+"]
    bus = Bus("observer", vehicle.name, broker_address(), topics, state_dir(), observer=True)
    newest: dict[str, ProcessHealth] = {}
    until = time.monotonic() + LISTEN_S
    while time.monotonic() < until:
        for envelope in bus.receive(0.1):
            try:
                message = envelope.decode()
            except BadPayload:
                continue  # a process without a valid health message is reported as not running
            if isinstance(message, ProcessHealth):
                newest[message.process] = message
    now_ns = bus.now_ns()
    bus.close()
    if not newest:
        yield Finding(False, f"processes of {vehicle.name!r}", "start them, or set OBU_VEHICLE to the running vehicle")
        return
    for name in vehicle.processes:
        health = newest.get(name)
        if health is None:
            yield Finding(False, f"{name} runs", "no health message received; see its log")
        elif health.state is not ProcessState.READY or now_ns - health.sent_ns > SILENT_NS:
            state = "no heartbeat" if health.state is ProcessState.READY else health.state
            yield Finding(False, f"{name} runs", f"state: {state}; see its log")
        else:
            yield Finding(not health.last_error, f"{name} runs", f"last error: {health.last_error}")


def _broker() -> Finding:
    address = broker_address()
    what = f"broker at {address.host}:{address.port}"
    try:
        socket.create_connection((address.host, address.port), timeout=2.0).close()
    except OSError as error:
        return Finding(False, f"{what}: {error.strerror or error}", f"start it, or {OTHER_BROKER}")
    return Finding(True, what)
