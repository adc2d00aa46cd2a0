"""Functions shared by the commands on recordings: open one, read its vehicle, print its problems, await a broker."""

import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from shared.bus.bus import Bus
from shared.errors import BadRecording, ConfigError, UserError
from shared.recording import Recording
from shared.recording.writer import VEHICLE_FILE
from shared.runtime.config import VehicleFile, load_vehicle, parse_vehicle
from shared.runtime.migration import migrated, mounting_of_samples

PATIENCE_S = 5.0


def open_recording(path: Path) -> Recording:
    """Open a recording; raises `UserError` with one sentence."""
    if path.is_file() and path.stat().st_size == 0:
        raise UserError(f"{path} is empty; give a file written by `obu record`, `obu import` or the unit's recorder")
    try:
        recording = Recording(path)
    except BadRecording as error:
        raise UserError(f"{error}; give a file written by `obu record`, `obu import` or the unit's recorder") from error
    if not recording.recognised:
        recording.close()
        raise UserError(
            f"{path} is no recording, not even a damaged one; give a file written by `obu record` or the unit's "
            "recorder, or make one of other data with `obu import`"
        )
    return recording


def vehicle_of(recording: Recording, path: Path | None) -> VehicleFile:
    """Read the vehicle's file that was given, otherwise the recorded one, with the keys of this version."""
    name = f"{recording.path}: {VEHICLE_FILE}"
    text = recording.attachments.get(VEHICLE_FILE, b"").decode(errors="replace")
    if path is None:
        try:
            recorded = parse_vehicle(migrated(text, name)[0], name)
        except ConfigError as error:
            raise ConfigError(f"{error}{recording.newer}") from error
        return replace(recorded, samples_mounting=mounting_of_samples(text, name))
    given = load_vehicle(path)
    try:
        return replace(given, samples_mounting=mounting_of_samples(text, name))
    except ConfigError:  # what replaces the recorded file need not be told how that was wrong
        return given


def print_problems(recording: Recording, console: Console) -> None:
    """Print what could not be read."""
    for problem in recording.problems:
        console.print(f"{recording.path.name}: {problem}", markup=False, highlight=False)


def await_broker(bus: Bus) -> None:
    """Wait for the connection; raises `UserError` after five seconds."""
    started = time.monotonic()
    while not bus.connected:
        bus.receive(0.1)
        if time.monotonic() - started > PATIENCE_S:
            raise UserError(
                f"{bus.last_error or 'no broker answers'}; is the unit running? Set OBU_BROKER to its broker"
            )
