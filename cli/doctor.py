"""`obu doctor`: checks the installation, the configuration and a running unit, and names the remedy of each fault."""

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from services.controller.mode.process import Config as Controller
from services.sensors.can.process import Config as CanDriver
from services.sensors.gnss.process import Config as GnssDriver
from services.sensors.imu.process import Config as ImuDriver
from shared.bus.bus import Bus
from shared.devices.can_device import open_can
from shared.devices.device import DeviceLost, open_device
from shared.errors import BadPayload, UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssConfiguration, GnssFix, GnssReceiver
from shared.messages.operation import ModeState, ProcessHealth, ProcessState
from shared.runtime.config import VehicleFile, broker_address, load_vehicle, state_dir
from shared.runtime.live import load_process
from shared.topics import TOPICS

from .demo.local import reaches_broker, start_of_broker
from .doctor_corrections import corrections, corrections_set_up

HEARD = ("health/+", "gnss/fix", "gnss/receiver", "gnss/configuration", "mode/state", "corrections/state")
PATIENCE_S = 1.0
BUSY = "another program has it open"
DRIVERS: dict[str, type[GnssDriver | ImuDriver | CanDriver]] = {
    "sensors.gnss": GnssDriver, "sensors.imu": ImuDriver, "sensors.can": CanDriver,
}  # fmt: skip
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
    yield from (Finding(*one) for one in corrections_set_up(vehicle))
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
    """Open the device of each driver as the driver does, and close it again."""
    for name, kind in DRIVERS.items():
        if name not in vehicle.processes:
            continue
        try:
            config = vehicle.section(name, kind)
        except UserError:
            continue  # its section has a finding of its own
        what = f"{name}: {config.device}"
        try:
            if isinstance(config, CanDriver):
                device = open_can(config.device, config.obd_identifier, time.time_ns)
            else:
                device = open_device(config.device)
            with contextlib.closing(device):
                device.read(PATIENCE_S)  # a connection may fail later than its opening
        except DeviceLost as error:
            busy = BUSY in str(error)
            yield Finding(busy, f"{what} (open in another program: the unit, if it runs)" if busy else what, str(error))
        except UserError as error:
            yield Finding(False, what, str(error))
        else:
            yield Finding(True, what)


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
    """Check what the processes of a running unit publish within `LISTEN_S`, and have published before."""
    topics = [topic for topic in TOPICS if topic.name in HEARD]
    bus = Bus("observer", vehicle.name, broker_address(), topics, state_dir(), observer=True)
    newest: dict[str, ProcessHealth] = {}
    heard: list[Message] = []
    until = time.monotonic() + LISTEN_S
    while time.monotonic() < until:
        for envelope in bus.receive(0.1):
            try:
                message = envelope.decode()
            except BadPayload:
                continue  # a process without a valid health message is reported as not running
            if isinstance(message, ProcessHealth):
                newest[message.process] = message
            else:
                heard.append(message)
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
    if {"sensors.gnss", "sensors.simulator"} & set(vehicle.processes):
        yield from receiver(heard, configured=vehicle.section("controller.mode", Controller).configure_gnss)
    yield from (Finding(*one) for one in corrections(vehicle, heard))


def receiver(heard: Sequence[Message], *, configured: bool) -> Iterator[Finding]:
    """Check that the GNSS receiver has a position and, if it should, has taken its configuration.

    Parameters
    ----------
    heard : sequence of Message
        Messages on the topics `HEARD` of the last seconds, and those that the broker has kept.
    configured : bool
        Whether the unit configures the receiver.
    """
    fixes = [message for message in heard if isinstance(message, GnssFix)]
    located = [fix for fix in fixes if fix.latitude_deg is not None]
    modes = [message for message in heard if isinstance(message, ModeState)]
    said = [message for message in heard if isinstance(message, GnssReceiver)]
    sends = f"; {said[-1].source} sends {', '.join(said[-1].messages) or 'no message'}" if said else ""
    why = f"{modes[-1].reason}{sends if said and said[-1].source not in modes[-1].reason else ''}" if modes else (
        "nothing is heard of it; see the log of parsers.gnss"
    )  # fmt: skip
    yield Finding(bool(located), "the GNSS receiver has a position", why)
    if not configured:
        return
    answers = [message for message in heard if isinstance(message, GnssConfiguration)]
    reason = (answers[-1].reason or "no reason given") if answers else "it has not answered yet"
    yield Finding(
        bool(answers) and answers[-1].accepted, "the GNSS receiver has taken its configuration",
        f"{reason}; of a receiver that cannot be configured, write configure_gnss = false in [controller.mode]",
    )  # fmt: skip


def _broker() -> Finding:
    address = broker_address()
    what = f"broker at {address.host}:{address.port}"
    try:
        reaches_broker(address)
    except OSError as error:
        return Finding(False, f"{what}: {error.strerror or error}", f"{start_of_broker(address)}, or {OTHER_BROKER}")
    return Finding(True, what)
