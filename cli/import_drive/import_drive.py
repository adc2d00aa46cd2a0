"""`obu import`: converts a folder of tables (CSV, text, NumPy arrays) to a recording of typed messages."""

import csv
import hashlib
import heapq
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console
from rich.progress import Progress

from shared.bounded import TOML_BYTES, SizeExceeded, read_bytes, read_text
from shared.bounded import lines as lines_of
from shared.errors import UserError
from shared.messages.explanation import QUOTED_LENGTH, QuotedText, explain
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import NO_TEXT, VehicleFile, load_vehicle, parse_vehicle
from shared.topics import BY_MESSAGE
from shared.unpacked import compression_of

from ..progress import progress_on
from .codes import Code
from .conversion.convert import Accelerometer, Conversion, convert, wanted_columns
from .devices.device_files import import_devices, insist_on_decoded, kind_of, shifts_of
from .draft import draft_of
from .estimates.agreement import Motion, motion_of, told
from .estimates.clocks import offset_of, shifted
from .estimates.delay import Delay, delay_of_fixes, delay_of_reference
from .estimates.mounting import mounting_of, rotated
from .mapping import units
from .mapping.mapping import Mapping, parse_mapping
from .mapping.schema import Gnss, Imu, PositionColumns, Sensor, Speed, TableFile, Time
from .output import Part, arrival_ns, print_summary, stamps_of, write
from .readers.arrays import FORMATS, arrays_of
from .readers.dates import checked_dates, is_day, is_time_of_day
from .readers.gnss_logger import contents, is_log, messages_of, read_log
from .readers.rtklib import SCALES, Header, header_of, mapping_of
from .readers.table import Forms, Table, arrays_table, read_table

T = TypeVar("T")
BEGINNING_BYTES = 40_000  # by which a file is recognised
MAX_WHOLE_FILE_BYTES = 500_000_000  # of a file that is read as a whole: a log of GnssLogger, or arrays


def import_drive(
    mapping: Annotated[
        Path,
        typer.Argument(
            help="TOML file that defines the columns, a log of Android's GnssLogger, a solution of RTKLIB (.pos), or a "
            "file that a device wrote: UBX, NMEA, RTCM 3, Xbus, a candump or ASC log."
        ),
    ],
    folder: Annotated[
        Path | None,
        typer.Argument(
            help="Folder with the files named in the mapping, or one file for all tables; with device files, the next "
            "one of the same drive."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Output recording.")] = Path(
        "drive.mcap"
    ),
    vehicle: Annotated[
        Path | None,
        typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the one named in the mapping."),
    ] = None,
    axes: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z",
            help="Axes of the phone (x right, y top, z out of the screen) that point forward, right and down in the "
            "vehicle, of a GnssLogger log; default: flat, top ahead.",
        ),
    ] = "y,x,-z",
    shift: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE=SECONDS",
            help="Seconds to add to the stamps of a device file, in place of an estimate; may be repeated.",
        ),
    ] = None,
    draft: Annotated[
        bool,
        typer.Option(
            "--draft",
            help="Guess the mapping of a table from the names and values of its columns, and write it beside the "
            "table, with reasons and with what you have to check.",
        ),
    ] = False,
    more: Annotated[
        list[Path] | None, typer.Argument(help="Further device files of the same drive.", show_default=False)
    ] = None,
) -> int:
    """Convert files of devices or tables (CSV, text, NumPy .npz, MATLAB .mat) of a drive to a recording.

    Examples:
    [bold]obu import benchmarks/recordings/mappings/rtkexp_drive.toml ~/drives/0708 -o drive.mcap[/]
    [bold]obu import benchmarks/recordings/mappings/phone_drives_1hz.toml 2023-08-09_16-37-41.csv -o phone.mcap[/]
    [bold]obu import gnss_log_2026_11_22.txt -o phone.mcap[/]
    [bold]obu import rover.pos -o fixes.mcap[/]
    [bold]obu import rover.ubx mti.bin candump.log --vehicle car.toml -o drive.mcap[/]
    [bold]obu import rover.nmea mti.bin --shift mti.bin=12.5 -o drive.mcap[/]
    [bold]obu import gnss_log_2026_11_22.txt --axes "z,-x,-y" -o phone.mcap[/]
    [bold]obu import logger.csv --draft[/]   (then check logger.toml, and import with it)
    """
    if draft:
        return _draft(mapping)
    if output.exists():
        raise UserError(f"{output} already exists; choose another file with --output, or remove it")
    beginning = [] if mapping.suffix == ".toml" else _beginning(mapping)
    if is_log(beginning):
        return _import_log(mapping, output, vehicle, body_from_phone(axes))
    files = [mapping, *([folder] if folder else []), *(more or [])]
    if (header := header_of(beginning)) is None and mapping.suffix != ".toml" and kind_of(mapping) is not None:
        return import_devices(files, output, vehicle, shifts_of(shift or (), files))
    if more or shift:
        raise UserError("several files, or --shift, go with files of devices only; see `obu import --help`")
    if header is not None:
        folder = folder or mapping.parent
        text = mapping_of(header, next(iter(beginning[header.lines :]), ""), mapping.name)
    elif folder is None:
        insist_on_decoded(mapping)
        raise UserError(
            f"{mapping} is no file of a device that is known, no log of GnssLogger and no solution of RTKLIB; give a "
            "mapping (TOML) and the folder of its files: `obu import --help`"
        )
    else:
        text = _text(mapping)
    return _import_tables(mapping, text, folder, output, vehicle)


def _draft(table: Path) -> int:
    """Write the draft of a mapping beside its table, and print it with a preview of the first minute."""
    path = table.with_suffix(".toml")
    if path.exists():
        raise UserError(f"{path} exists already; remove it for another draft, or import with it")
    found = draft_of(table)
    try:
        path.write_text(found.text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; copy the table to a folder of yours") from error
    for line in (*found.preview, "", "guessed:", *(f"  {one}" for one in found.reasons), "to be checked by you:",
                 *(f"  {one}" for one in found.open)):  # fmt: skip
        print(line)
    print(f"wrote {path}; check it, then: obu import {path} {table.parent} -o drive.mcap")
    return 0


def _import_tables(mapping: Path, text: str, folder: Path, output: Path, vehicle: Path | None) -> int:
    """Convert the files that a mapping describes."""
    spec = parse_mapping(text, str(mapping))
    file = _vehicle(spec, mapping, vehicle)
    tables = list(spec.files())
    if folder.is_file():  # one file for all tables
        folder, tables = folder.parent, [table.model_copy(update={"file": folder.name}) for table in tables]
    tables = [table for table in tables if not table.optional or (folder / table.file).is_file()]
    for table in tables:
        if not (folder / table.file).is_file():
            raise UserError(f"{folder} holds no file {table.file!r}; give the folder that holds it, or edit {mapping}")
    console = Console(stderr=True)
    with progress_on(console) as progress:
        read = [_read(table, folder, progress) for table in tables]
        tables = [table for table, _, _ in read]
        parts = _converted(read, spec.start_utc_s)
        parts = _corrected(tables, parts, file, progress)
        write(output, parts, file, _provenance(spec, text, parts), progress)
    print_summary(output, parts)
    notes = [note for part in parts for note in part.converted.notes]
    corrections = [part.correction.text for part in parts if part.correction]
    for sentence in (*notes, *corrections, *_clocks(parts), *spec.made()):
        print(sentence)
    return 0


def _beginning(path: Path) -> list[str]:
    """First lines of a file, which may be anything."""
    try:
        with path.open("rb") as file:
            return file.read(BEGINNING_BYTES).decode("utf-8", errors="replace").splitlines(keepends=True)[:20]
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; give a mapping (TOML) or a GnssLogger log") from error


def body_from_phone(axes: str) -> npt.NDArray[np.float64]:
    """Rotation to body axes from signed letters of the phone's axes, as in "y,x,-z"."""
    rows = [name.strip().lower() for name in axes.split(",")]
    matrix = np.array([[float(row.lstrip("-+") == axis) for axis in "xyz"] for row in rows]).reshape(len(rows), 3)
    matrix *= np.array([[-1.0 if row.startswith("-") else 1.0] for row in rows])
    if matrix.shape != (3, 3) or round(float(np.linalg.det(matrix))) != 1:
        raise UserError(
            f"--axes {axes!r} are not three axes of a right-handed system; try y,x,-z (phone flat, its top ahead) or "
            "z,-x,-y (upright, screen ahead)"
        )
    return matrix


def _import_log(path: Path, output: Path, vehicle: Path | None, axes: npt.NDArray[np.float64]) -> int:
    """Convert a log of GnssLogger."""
    data = _read_whole(path)
    log = read_log(data.decode("utf-8", errors="replace").splitlines())
    messages = messages_of(log, axes)
    if not messages:
        raise UserError(f"{path} holds nothing that can be used: {contents(log)}; log `Fix` or `Raw`, and the sensors")
    digest = hashlib.sha256(data).hexdigest()
    kinds = dict.fromkeys(type(message) for message in messages)
    parts = [
        Part(
            BY_MESSAGE[kind].name, digest,
            Conversion([message for message in messages if type(message) is kind], log.lines if number == 0 else 0,
                      log.rejects if number == 0 else Counter()),
        )
        for number, kind in enumerate(kinds)
    ]  # fmt: skip
    file = load_vehicle(vehicle) if vehicle is not None else parse_vehicle("", "<no vehicle file>")
    provenance = {
        "name": path.stem, "files": json.dumps({path.name: digest}), "truth_is": "none", "truth_quantities": "",
        "made": "",
    }  # fmt: skip
    with progress_on(Console(stderr=True)) as progress:
        write(output, parts, file, provenance, progress)
    print_summary(output, parts)
    return 0


def _corrected(tables: Sequence[TableFile], parts: list[Part], vehicle: VehicleFile, progress: Progress) -> list[Part]:
    """Correct axes, delays (of the fixes, then of the truth) and clocks that the mapping asks to estimate."""
    for place, table in enumerate(tables):
        if isinstance(table, Sensor) and table.estimate_axes and parts[place].converted.messages:
            parts[place] = _in_body_axes(parts[place], _all(GnssFix, parts))
    for place, table in enumerate(tables):
        if isinstance(table, PositionColumns) and table.estimate_delay:
            if isinstance(table, Gnss):
                merged = heapq.merge(*(part.converted.messages for part in parts), key=arrival_ns)
                inputs = [message for message in merged if not isinstance(message, TruthState)]
                shown = progress.track(inputs, description=f"estimating the delay of {table.file}")
                delay, against = delay_of_fixes(shown, vehicle), "imu"
            else:
                delay, against = delay_of_reference(_all(TruthState, parts), _all(GnssFix, parts)), "fixes"
            parts[place] = _without_delay(parts[place], delay, against)
    for place, table in enumerate(tables):
        if isinstance(table, Speed) and table.clock_by_speed:
            parts[place] = _on_clock_of_fixes(parts[place], _all(GnssFix, parts))
    return parts


def _all(kind: type[T], parts: Sequence[Part]) -> list[T]:
    return [message for part in parts for message in part.converted.messages if isinstance(message, kind)]


def _quoted(name: str) -> QuotedText:
    return QuotedText(quoted=name[-QUOTED_LENGTH:])


def _in_body_axes(part: Part, fixes: Sequence[GnssFix]) -> Part:
    imu = _all(ImuSamples, [part])
    found = mounting_of(imu, fixes)
    return part.corrected(
        rotated(imu, found.body_from_sensor),
        explain(Code.AXES_ESTIMATED, file=_quoted(part.name), correlation_statistic=float(found.correlation)),
        f"body_from_sensor = {found.body_from_sensor.round(3).tolist()}",
    )


def _without_delay(part: Part, delay: Delay, against: str) -> Part:
    step_ns = round(delay.seconds * 1e9)
    return part.corrected(
        [m.model_copy(update={"sampled_ns": stamps_of(m)[0] - step_ns}) for m in part.converted.messages],
        explain(
            Code.DELAY_ESTIMATED,
            file=_quoted(part.name),
            reference=against,
            late_s=delay.seconds,
            late_sd_s=float(delay.sd_s),
        ),
        f"stamps_late_s = {delay.seconds:.3f}",
    )


def _on_clock_of_fixes(part: Part, fixes: Sequence[GnssFix]) -> Part:
    speeds = _all(VehicleSpeed, [part])
    offset = offset_of(speeds, fixes)
    return part.corrected(
        shifted(speeds, offset.seconds),
        explain(
            Code.CLOCK_SHIFTED, file=_quoted(part.name), shift_s=offset.seconds, difference_m_s=float(offset.rms_m_s)
        ),
    )


def _read_whole(path: Path) -> bytes:
    try:
        return read_bytes(path, MAX_WHOLE_FILE_BYTES)
    except SizeExceeded as error:
        raise UserError(f"{path} cannot be read: {error}; cut it into drives first") from error


def _text(path: Path) -> str:
    try:
        return read_text(path, TOML_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error if isinstance(error, SizeExceeded) else NO_TEXT
        raise UserError(
            f"cannot read the mapping {path}: {reason}; see benchmarks/recordings/mappings/ for examples"
        ) from error


def _clocks(parts: Sequence[Part]) -> list[str]:
    """Compare the clocks of the files: with that of the IMU, or else of the first one."""
    motions: dict[str, Motion] = {}
    for part in parts:
        if (motion := motion_of(part.converted.messages)) is not None:
            kind = BY_MESSAGE[type(part.converted.messages[0])].name
            motions[f"{part.name} ({kind})" if part.name in motions else part.name] = motion
    return told(motions)


def _vehicle(spec: Mapping, mapping: Path, vehicle: Path | None) -> VehicleFile:
    """Read the vehicle file, which is stored in the recording."""
    if vehicle is not None:
        return load_vehicle(vehicle)
    if spec.vehicle_file is not None:
        return load_vehicle(mapping.parent / spec.vehicle_file)
    return parse_vehicle("", "<no vehicle file>")


def _read(spec: TableFile, folder: Path, progress: Progress) -> tuple[TableFile, str, Table]:
    """Read the columns of a file, and compute its SHA-256; what the file states of its clock is in its table."""
    path = folder / spec.file
    task = progress.add_task(f"reading {spec.file}", total=path.stat().st_size)
    digest = hashlib.sha256()
    if path.suffix in FORMATS:
        data = _read_whole(path)
        digest.update(data)
        progress.advance(task, len(data))
        return spec, digest.hexdigest(), arrays_table(arrays_of(data, spec.file), wanted_columns(spec), spec.file)

    with path.open("rb") as file:
        compression = compression_of(file.read(8))
    if compression is not None:
        raise UserError(f"{spec.file} is packed with {compression}; unpack it, and name the file that comes of it")

    def lines() -> Iterator[str]:
        with path.open("rb") as file:
            for line in lines_of(file):
                digest.update(line)
                progress.advance(task, len(line))
                yield line.decode("utf-8", errors="replace")

    spec, table = _table(spec, lines())
    return spec, digest.hexdigest(), table


def _converted(read: Sequence[tuple[TableFile, str, Table]], start_s: float) -> list[Part]:
    """Convert every file; the accelerometer of an IMU in two files is converted with its gyroscope."""
    parts, accelerometer = [], None
    for spec, digest, table in read:
        if start_s == 0.0 and spec.time.unit == units.DATE and spec.time.column and not spec.time.date_column:
            checked_dates(float(table[spec.time.column][0]), spec.file, spec.time.column)
        if isinstance(spec, Imu) and spec.angular_rate is None:
            accelerometer = Accelerometer(spec, table)
            converted = Conversion([], len(table) + table.rejects.total(), table.rejects)
        else:
            converted = convert(spec, table, start_s=start_s, accelerometer=accelerometer)
        parts.append(Part(spec.file, digest, converted))
    return parts


def _table(spec: TableFile, lines: Iterator[str]) -> tuple[TableFile, Table]:
    skipped = header_of(list(islice(lines, spec.skip_rows)))
    rows = _rows(spec, lines)
    try:
        # Spreadsheets write a byte order mark, which is not part of the first name.
        header = list(spec.header) or [name.strip().lstrip("\ufeff") for name in next(rows, [])]
        first = next(rows, [])
        spec, notes = _with_what_the_file_states(spec, skipped, header, first)
        first_line = spec.skip_rows + (1 if spec.header else 2)
        forms = Forms(_dates(spec.time), spec.decimal, first_line)
        table = read_table(chain([first] if first else [], rows), header, wanted_columns(spec), spec.file, forms)
        table.notes.extend(notes)
        return spec, table
    except (csv.Error, SizeExceeded) as error:
        raise UserError(
            f"{spec.file} is not a CSV file ({error}); check `file` and `separator` of the mapping"
        ) from error


def _with_what_the_file_states(
    spec: TableFile, rtklib: Header | None, header: Sequence[str], first: Sequence[str]
) -> tuple[TableFile, list[str]]:
    """Add what the file says of its clock where the mapping does not: its time scale, and the column of the dates."""
    time, notes, found = spec.time, list[str](), dict[str, object]()
    if rtklib is not None and time.scale is None and time.offset_s == 0.0:
        found |= SCALES[rtklib.scale]
        notes.append(f"{spec.file}: its header says {rtklib.scale}; the stamps were converted to UTC.")
    if time.unit == units.DATE and time.date_column is None and time.column in header:
        place = header.index(time.column)
        if 0 < place < len(first) and is_time_of_day(first[place]) and is_day(first[place - 1]):
            found["date_column"] = header[place - 1]
            notes.append(f"{spec.file}: the dates of the times {time.column!r} are those of {header[place - 1]!r}.")
    return spec.model_copy(update={"time": time.model_copy(update=found)}), notes


def _dates(time: Time) -> tuple[str, ...]:
    """Columns that hold dates instead of numbers."""
    clocks = (time.column, time.arrival_column) if time.unit == units.DATE else ()
    return tuple(name for name in (*clocks, time.date_column) if name)


def _rows(spec: TableFile, lines: Iterator[str]) -> Iterator[list[str]]:
    if spec.separator == "whitespace":
        return (line.split() for line in lines)
    return csv.reader(lines, delimiter=spec.separator, skipinitialspace=True)


def _provenance(spec: Mapping, text: str, parts: list[Part]) -> dict[str, str]:
    """Origin of the messages, and the reference that `obu solve` uses as truth."""
    held = spec.truth.quantities if spec.truth else spec.truth_quantities
    return {
        "name": spec.name,
        "mapping": text,
        "files": json.dumps({part.name: part.sha256 for part in parts}),
        "truth_is": spec.truth_is,
        "truth_quantities": ",".join(quantity for quantity in spec.truth_quantities if quantity in held),
        "truth_at": spec.truth.at if spec.truth else "imu",
        "made": " ".join(spec.made()),
    }
