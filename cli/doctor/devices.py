"""What is at the ports of the vehicle's file: permissions, rates, and what each device speaks."""

import contextlib
import grp
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from services.sensors.can.process import SPEED_REQUEST
from services.sensors.can.process import Config as CanDriver
from services.sensors.gnss.process import Config as GnssDriver
from services.sensors.imu.process import Config as ImuDriver
from shared.devices.can_device import CanDevice, only_answers, open_can
from shared.devices.device import Device, DeviceBusy, DeviceLost
from shared.devices.elm327_device import ElmDevice
from shared.devices.recognising import Port, RateRecognition
from shared.devices.search import LISTEN_S, Search
from shared.errors import UserError
from shared.messages.operation import DeviceFound
from shared.protocols.recognition import recognise
from shared.protocols.registry import PROTOCOLS
from shared.runtime.config import VehicleFile

from .finding import Finding

BUSY = "another program has it open"
MAX_DURATION_S = 30.0  # a port
WAIT_TIMEOUT_S = 0.1
LINE_END = b"\n"
NOT_DECODED = tuple(protocol.title for protocol in PROTOCOLS if not protocol.read_at)
RATE_S = 2.0  # over which bytes and messages are counted once a device is found
DRIVERS: dict[str, type[GnssDriver | ImuDriver | CanDriver]] = {
    "sensors.gnss": GnssDriver, "sensors.imu": ImuDriver, "sensors.can": CanDriver,
}  # fmt: skip
NETWORK_DEVICES = Path("/sys/class/net")


def devices(vehicle: VehicleFile, *, probe: bool) -> Iterator[Finding]:
    """Open the device of each driver as the driver does, and say what it speaks.

    Parameters
    ----------
    vehicle : VehicleFile
        The vehicle's file.
    probe : bool
        Whether questions are written to a device that is silent.
    """
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
                yield from _can(config, what)
            else:
                yield listen(config.device, name.split(".")[1], what, may_write=probe)
        except DeviceLost as error:
            busy = BUSY in str(error)
            known = f"{what} (open in another program: the unit, if it runs)" if busy else what
            yield Finding(busy, known, f"{error}{_permission(config.device)}")
        except UserError as error:
            yield Finding(False, what, str(error))


def other_ports(vehicle: VehicleFile) -> Iterator[Finding]:
    """Find out what is at every serial port of this computer that the vehicle's file does not name."""
    from serial.tools.list_ports_linux import comports

    named = set()
    for name, kind in DRIVERS.items():
        with contextlib.suppress(UserError):
            named.add(os.path.realpath(urlsplit(vehicle.section(name, kind).device).path))
    ports = comports()  # type: ignore[no-untyped-call]  # pyserial publishes no types
    for port in sorted(str(port.device) for port in ports):
        if os.path.realpath(port) in named:
            continue
        url, other = f"serial://{port}", ""
        for kind_of_device in ("gnss", "imu"):
            what = f"{port}, which the vehicle file does not name"
            try:
                finding = listen(url, kind_of_device, what, may_write=True)
            except DeviceLost as error:
                yield Finding(BUSY in str(error), what, f"{error}{_permission(url)}")
                break
            if finding.ok:
                rate = f'device = "{url}" in [sensors.{kind_of_device}]'
                yield Finding(True, f"{finding.what}: write {rate}")
                break
            other = other or next((f": {finding.remedy}" for name in NOT_DECODED if name in finding.remedy), "")
        else:
            yield Finding(True, f"{what}: nothing that the unit reads{other}")


def listen(url: str, kind: str, what: str, *, may_write: bool) -> Finding:
    """Listen to one device until it is known what it speaks, at most 30 s.

    Raises
    ------
    DeviceLost
        It cannot be opened, or was unplugged meanwhile.
    UserError
        Its URL is invalid.
    """
    with contextlib.closing(Port(url, kind).open(may_write=may_write)) as device:
        search = device.search
        until = time.monotonic() + MAX_DURATION_S
        if url.startswith("file:"):
            device.read(WAIT_TIMEOUT_S)
            return Finding(True, what)
        with _progress(what, search):
            while search.found is DeviceFound.SEARCHING and time.monotonic() < until:
                device.read(WAIT_TIMEOUT_S)
        if search.found is not DeviceFound.WORKING:
            asked = "" if may_write else "; `obu doctor --probe` also asks it, which writes to the port"
            return Finding(False, what, f"{search.sentence()}{asked}")
        return Finding(True, f"{what}: {search.sentence()}, {_rates(device)}")


def _rates(device: RateRecognition) -> str:
    """Bytes and messages a second."""
    sample, start = b"", time.monotonic()
    while (passed := time.monotonic() - start) < RATE_S:
        sample += device.read(WAIT_TIMEOUT_S)
    messages = sum(recognise(sample).frames.values())
    return f"{len(sample) / passed:.0f} bytes and {messages / passed:.1f} messages a second"


@contextlib.contextmanager
def _progress(what: str, search: Search) -> Iterator[None]:
    """Say on a terminal that it takes a while."""
    shown = sys.stderr.isatty()
    if shown:
        steps = "" if search.rate_baud is None else f", {LISTEN_S:g} s a rate"
        print(f"... {what}: listening{steps}", end="\r", file=sys.stderr, flush=True)
    yield
    if shown:
        print("\033[K", end="", file=sys.stderr, flush=True)


def _permission(url: str) -> str:
    """Which group may open a port that this user may not."""
    path = Path(urlsplit(url).path)
    if (
        not url.startswith(("serial:///", "elm327:///", "slcan:///"))
        or not path.exists()
        or os.access(path, os.R_OK | os.W_OK)
    ):
        return ""
    try:
        group = grp.getgrgid(path.stat().st_gid).gr_name
    except (KeyError, OSError):
        return ""
    return f"; it belongs to the group {group}: `sudo usermod -aG {group} $USER`, and log in again"


def _can(config: CanDriver, what: str) -> Iterator[Finding]:
    parts = urlsplit(config.device)
    if parts.scheme == "socketcan" and (remedy := socketcan_fault(parts.netloc)) is not None:
        yield Finding(False, what, remedy)
        return
    with contextlib.closing(open_can(config.device, config.obd_identifier, time.time_ns)) as device:
        got, asks = b"", only_answers(config.device)
        until = time.monotonic() + (MAX_DURATION_S if asks else RATE_S)
        while time.monotonic() < until and parts.scheme != "file" and not (asks and _is_found(device)):
            if asks:
                with contextlib.suppress(DeviceBusy):  # it is still being set up
                    device.write(SPEED_REQUEST)
            got += device.read(WAIT_TIMEOUT_S)
        yield _can_finding(device, what, got)


def _can_finding(device: Device, what: str, got: bytes) -> Finding:
    """What follows from the lines of a CAN device."""
    if isinstance(device, ElmDevice):
        working, said = device.search.found is DeviceFound.WORKING, device.search.sentence()
        return Finding(True, f"{what}: {said}") if working else Finding(False, what, said)
    if not isinstance(device, CanDevice):
        return Finding(True, what)  # a log
    if not got:
        remedy = "no frame in 2 s: the bus sleeps (switch the ignition on), its bitrate differs, or H and L are open"
        return Finding(False, what, remedy)
    if device.search.found is DeviceFound.NOISE:
        return Finding(False, what, device.search.sentence())
    return Finding(True, f"{what}: {got.count(LINE_END) / RATE_S:.0f} frames a second")


def _is_found(device: Device) -> bool:
    """Whether an adapter has come to a result."""
    return isinstance(device, ElmDevice) and device.search.found is not DeviceFound.SEARCHING


def socketcan_fault(name: str, root: Path = NETWORK_DEVICES) -> str | None:
    """What is wrong with a CAN interface of the kernel, and the remedy; None: it is up."""
    folder = root / name
    up = f"`sudo ip link set {name} up type can bitrate 500000`"
    if not folder.exists():
        return f"there is no interface {name}: plug in the adapter, load its driver, then {up}"
    try:
        flags = int((folder / "flags").read_text(), 16)
    except (OSError, ValueError):
        return None
    return None if flags & 1 else f"the interface {name} is down: {up}"
