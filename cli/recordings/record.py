"""`obu record`: records a running unit, and repairs a damaged recording."""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from shared.bus.bus import Bus
from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile, keys_folder
from shared.recording import Recording, RecordingWriter
from shared.recording.seals import COPY, SEAL, Sealer
from shared.recording.writer import VEHICLE_FILE
from shared.runtime.config import broker_address, load_vehicle, state_dir
from shared.topics import TOPICS

from ..progress import progress_on
from .common import await_broker, open_recording, print_problems

FLUSH_S = 0.5
STEP = 2000  # messages between two updates of the progress


def record(output: Path | None, duration: float | None, vehicle: Path | None) -> int:
    """Record all messages of a running unit until Ctrl-C or for `duration` seconds."""
    file = load_vehicle(vehicle)
    bus = Bus("observer", file.name, broker_address(), TOPICS, state_dir(), observer=True)
    await_broker(bus)
    path = output or Path(time.strftime(f"%Y%m%dT%H%M%SZ_{file.name}.mcap", time.gmtime()))
    writer = _create(path, file.name, file.text, sealer=_sealer(file.name))
    until = time.monotonic() + duration if duration is not None else float("inf")
    try:
        _listen(bus, writer, until)
    except KeyboardInterrupt:
        pass  # Ctrl-C ends a recording
    except OSError as error:
        writer.abandon()
        raise UserError(
            f"cannot write {path}: {error.strerror}; what came before is in it, make room for more"
        ) from error
    finally:
        bus.close()
    _finish(writer)
    print(f"recorded {writer.messages} messages, {writer.bytes_written / 1e6:.1f} MB, to {path}")
    if bus.dropped:
        print(f"{bus.dropped} messages arrived faster than they could be written, and are missing")
    if not writer.messages:
        raise UserError(f"vehicle {file.name!r} published nothing; check its name (OBU_VEHICLE or --vehicle)")
    return 0


def repair(
    file: Annotated[Path, typer.Argument(help="A recording that was cut or damaged.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="The whole recording to write.")],
) -> int:
    """Write what can be read of a damaged recording into a new one that every MCAP tool opens.

    Example: [bold]obu record repair cut.mcap -o whole.mcap[/]
    """
    console = Console(stderr=True)
    with open_recording(file) as recording:
        writer = repair_into(recording, output, console)
    print(f"wrote {writer.messages} messages, {writer.bytes_written / 1e6:.1f} MB, to {output}")
    return 0


def repair_into(recording: Recording, output: Path, console: Console) -> RecordingWriter:
    """Copy the readable messages of a recording, print what is damaged, and return the closed writer."""
    metadata = recording.metadata
    writer = _create(
        output,
        metadata.get("obu", {}).get("vehicle", ""),
        recording.attachments.get(VEHICLE_FILE, b"").decode(errors="replace"),
        metadata.get("provenance"),
        copied_by="`obu record repair`" if SEAL in metadata or COPY in metadata else "",
    )
    _copy(recording, writer, console)
    if not writer.messages:
        output.unlink()
        raise UserError(f"{recording.path} holds no message that can be read; there is nothing to repair")
    print_problems(recording, console)
    return writer


def _listen(bus: Bus, writer: RecordingWriter, until: float) -> None:
    flush = time.monotonic() + FLUSH_S
    while (now := time.monotonic()) < until:
        for envelope in bus.receive(min(0.1, max(until - now, 0.0))):
            writer.write(envelope)
        if time.monotonic() >= flush:
            flush = time.monotonic() + FLUSH_S
            writer.flush()


def _sealer(vehicle: str) -> Sealer | None:
    """Make what signs the recording with the key of this unit; without a key that can be used it is not signed."""
    try:
        return Sealer(KeyFile(keys_folder(state_dir())).signer(), vehicle=vehicle, started_ns=time.time_ns())
    except EvidenceError as error:
        Console(stderr=True).print(f"recording without signatures: {error}", markup=False, highlight=False)
        return None


def _create(
    path: Path,
    vehicle: str,
    text: str,
    provenance: dict[str, str] | None = None,
    *,
    copied_by: str = "",
    sealer: Sealer | None = None,
) -> RecordingWriter:
    try:
        return RecordingWriter(
            path, vehicle=vehicle, vehicle_toml=text, provenance=provenance, copied_by=copied_by, sealer=sealer
        )
    except FileExistsError as error:
        raise UserError(f"{path} exists already; name another file with --output, or remove it") from error
    except OSError as error:
        raise UserError(f"cannot create {path}: {error.strerror}; name another file with --output") from error


def _copy(recording: Recording, writer: RecordingWriter, console: Console) -> None:
    try:
        with progress_on(console) as progress:
            task = progress.add_task(recording.path.name, total=recording.size)
            for count, envelope in enumerate(recording):
                writer.write(envelope)
                if count % STEP == 0:
                    progress.update(task, completed=recording.position)
    except OSError as error:
        writer.abandon()
        raise UserError(f"cannot write {writer.path}: {error.strerror}; make room or name another file") from error
    _finish(writer)


def _finish(writer: RecordingWriter) -> None:
    try:
        writer.close()
    except OSError as error:
        raise UserError(
            f"cannot finish {writer.path}: {error.strerror}; make room and use `obu record repair`"
        ) from error
