"""Imports files that devices wrote, alone or several of one drive, with their clocks aligned."""

import hashlib
import json
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from services.parsers.gnss.process import Config as GnssConfig
from services.parsers.imu.process import Config as ImuConfig
from shared.bounded import LINE_BYTES, SizeExceeded, lines
from shared.devices.can_device import frame_of
from shared.errors import UserError
from shared.messages.corrections import CorrectionBytes
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.vehicle import CanRaw
from shared.protocols.recognition import recognise
from shared.protocols.registry import BY_NAME
from shared.runtime.config import VehicleFile, load_vehicle, parse_vehicle

from ...progress import progress_on
from ..conversion.convert import Conversion, Imported
from ..output import Part, print_summary, write
from .alignment import Device, aligned
from .can_log import ASC_BASE, read_asc, read_candump
from .receiver import read_receiver
from .stamped import NS, ClockKind, FileKind, Portion, StampedFile
from .tracker import read_tracker

HEAD_BYTES = 64 * 1024
CHUNK_BYTES = 1 << 20
MAX_BYTES = 1 << 31  # of a file, whose frames are held in memory
RECEIVER, TRACKER = frozenset(("UBX", "NMEA", "RTCM")), "Xbus"
SOURCES = {FileKind.RECEIVER: "gnss", FileKind.CORRECTIONS: "corrections", FileKind.TRACKER: "imu", FileKind.CAN: "can"}
MAX_SHIFT_S = 1e10


@dataclass(frozen=True)
class Form:
    """What a file is by its beginning; `asc` of a CAN log: one of Vector's tools."""

    kind: FileKind
    asc: bool = False


def kind_of(path: Path) -> Form | None:
    """Recognise a file that a device wrote, by its first bytes; None for another one. Raises `UserError`."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; give the file that the device wrote") from error
    lines = head.decode("ascii", errors="replace").splitlines()[:200]
    if any(ASC_BASE.match(line.strip()) for line in lines[:10]):
        return Form(FileKind.CAN, asc=True)
    if sum(frame_of(line[:512]) is not None for line in lines) > len(lines) // 2:
        return Form(FileKind.CAN)
    for start in range(0, len(head), 8192):  # the beginning may be of one protocol, such as text before the bytes
        names = recognise(head[start : start + 8192]).names
        if names and names[0] == TRACKER:
            return Form(FileKind.TRACKER)
        if names and names[0] in RECEIVER:
            return Form(FileKind.RECEIVER)
    return None


def shifts_of(texts: Sequence[str], files: Sequence[Path]) -> dict[Path, int]:
    """Read `FILE=SECONDS` of each --shift; raises `UserError` for another form, or a file that is not there."""
    found: dict[Path, int] = {}
    for text in texts:
        name, _, seconds = text.rpartition("=")
        named = [path for path in files if name in (path.name, str(path))]
        try:
            value = float(seconds)
        except ValueError:
            value = float("nan")
        if len(named) != 1 or not abs(value) <= MAX_SHIFT_S:
            raise UserError(f"--shift {text}: give the name of one of the files and seconds, such as mti.bin=12.5")
        found[named[0]] = round(value * NS)
    return found


def import_devices(
    files: Sequence[Path], output: Path, vehicle: Path | None, shifts: dict[Path, int], console: Console | None = None
) -> int:
    """Convert device files of one drive to a recording; returns the exit code.

    Raises
    ------
    UserError
        A file is none of a device, or its clock cannot be aligned with the others'.
    """
    forms = [(path, _known(path)) for path in files]
    file = load_vehicle(vehicle) if vehicle is not None else parse_vehicle("", "<no vehicle file>")
    with progress_on(console or Console(stderr=True)) as progress:
        devices = _read_all(forms, shifts, progress)
        devices, sentences = aligned(devices, file, _messages_of(file), progress)
        parts = [
            Part(
                device.path.name,
                _digest(device.path),
                Conversion(device.messages, device.stamped.rows, device.stamped.rejects),
            )
            for device in devices
        ]
        if not any(part.converted.messages for part in parts):
            raise UserError(f"{files[0]} holds no message with a valid checksum; give the file as the device wrote it")
        write(output, parts, file, _provenance(parts, sentences), progress)
    print_summary(output, parts)
    for sentence in sentences:
        print(sentence)
    return 0


def _known(path: Path) -> Form:
    form = kind_of(path)
    if form is None:
        insist_on_decoded(path)
        raise UserError(
            f"{path} is none of UBX, NMEA, RTCM 3, Xbus, candump and ASC; convert it to one of these, or describe its "
            "columns in a mapping: docs/how-to/import-a-drive.md"
        )
    return form


def _read_all(forms: Sequence[tuple[Path, Form]], shifts: dict[Path, int], progress: Progress) -> list[Device]:
    """Read all files; corrections last, whose times of week take the week of the others."""
    found: dict[Path, Device] = {}
    week_of_ns: int | None = None
    numbers: dict[str, int] = {}
    for path, form in sorted(forms, key=lambda pair: _is_of_rtcm(pair[0])):
        stamped = _read(path, form, week_of_ns, progress)
        if week_of_ns is None and stamped.clock is ClockKind.UTC and stamped.portions:
            week_of_ns = stamped.portions[0].time_ns
        if stamped.kind is FileKind.CORRECTIONS and week_of_ns is None:
            raise UserError(
                f"{path} holds corrections of a base (RTCM 3), which tell no date and no position of the vehicle; "
                "give the file of its receiver as well"
            )
        kind = SOURCES[stamped.kind]
        source = f"{kind}{numbers.get(kind, 0)}"
        numbers[kind] = numbers.get(kind, 0) + 1
        found[path] = Device(path, source, stamped, shift_ns=shifts.get(path))
    return [found[path] for path, _ in forms]


def insist_on_decoded(path: Path) -> None:
    """Raise `UserError` for a file of a protocol that is recognised and not decoded."""
    with path.open("rb") as file:
        names = recognise(file.read(8192)).names
    if other := next((BY_NAME[name] for name in names if not BY_NAME[name].read_at), None):
        raise UserError(
            f"{path} holds {other.title}, which is not decoded; convert it to UBX or NMEA with the maker's program; "
            f"for the next drive, {other.remedy}"
        )


def _is_of_rtcm(path: Path) -> bool:
    with path.open("rb") as file:
        return recognise(file.read(8192)).names == ("RTCM",)


def _read(path: Path, form: Form, week_of_ns: int | None, progress: Progress) -> StampedFile:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise UserError(f"{path} is larger than {MAX_BYTES >> 30} GB; cut it into drives first, as with `split`")
    task = progress.add_task(f"reading {path.name}", total=size)

    def chunks() -> Iterator[bytes]:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                progress.advance(task, len(chunk))
                yield chunk

    if form.kind is FileKind.TRACKER:
        return read_tracker(chunks())
    if form.kind is FileKind.RECEIVER:
        return read_receiver(chunks(), week_of_ns=week_of_ns)
    if form.asc:
        _insist_on_lines(path)
        return read_asc(path)
    with path.open(encoding="ascii", errors="replace") as file:
        return read_candump(iter(lambda: file.readline(LINE_BYTES), ""))  # without lines it is read in pieces


def _insist_on_lines(path: Path) -> None:
    with path.open("rb") as file:
        try:
            deque(lines(file), maxlen=0)
        except SizeExceeded as error:
            raise UserError(f"{path} is no ASC log: {error}; give the file as the tool wrote it") from error


class _Messages:
    """Makes the messages of a device from its portions, stamped so that the parsers of a vehicle find their times."""

    def __init__(self, vehicle: VehicleFile) -> None:
        self._gnss_ns = round(vehicle.section("parsers.gnss", GnssConfig).minimum_delay_s * NS)
        self._imu_ns = round(vehicle.section("parsers.imu", ImuConfig).minimum_delay_s * NS)

    def __call__(self, device: Device) -> list[Imported]:
        return [self._message(device, portion) for portion in device.stamped.portions]

    def _message(self, device: Device, portion: Portion) -> Imported:
        at_ns, data, source = portion.time_ns, portion.data, device.source
        match device.stamped.kind:
            case FileKind.RECEIVER:
                return GnssRaw(received_ns=at_ns + self._gnss_ns, source=source, data=data, recorded=True)
            case FileKind.CORRECTIONS:
                return CorrectionBytes(received_ns=at_ns, source=source, data=data)
            case FileKind.TRACKER:
                return ImuRaw(received_ns=at_ns + self._imu_ns, source=source, data=data)
            case FileKind.CAN:
                return CanRaw(received_ns=at_ns, source=source, data=data)


def _messages_of(vehicle: VehicleFile) -> _Messages:
    return _Messages(vehicle)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _provenance(parts: Sequence[Part], sentences: Sequence[str]) -> dict[str, str]:
    return {
        "name": Path(parts[0].name).stem,
        "files": json.dumps({part.name: part.sha256 for part in parts}),
        "truth_is": "none",
        "truth_quantities": "",
        "made": "",
        "clocks": " ".join(sentences),
    }
