"""The motion of a recorded drive, and how large the innovations of the filter are over it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from rich.console import Console

from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.messages import samples_of
from services.core.fusion.process import Process
from services.core.fusion.set_up.motion import Motion, MotionLog
from services.core.fusion.settings import Settings
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingKind, AidingUpdate
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

from ..recordings.common import open_recording, print_problems, vehicle_of
from ..solve.inputs import Inputs, inputs_of

LONGEST_S = 7200.0  # of a drive of which the newest part is surveyed
PARSERS = ("parsers.gnss", "parsers.imu", "parsers.can")
KINDS = (AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY, AidingKind.ODOMETER, AidingKind.NON_HOLONOMIC)

Shown = Callable[[Iterable[Message], int], Iterable[Message]]  # shows how far the reading of messages is


@dataclass(frozen=True)
class Drive:
    """A recording with the settings of its vehicle."""

    name: str
    vehicle: VehicleFile
    inputs: Inputs

    @property
    def settings(self) -> Settings:
        """Of the filter."""
        return self.vehicle.section("core.fusion", Settings)


def read(path: Path, vehicle: Path | None, console: Console) -> Drive:
    """Read a recording; raises `UserError`."""
    with open_recording(path) as recording:
        drive = Drive(path.name, vehicle_of(recording, vehicle), inputs_of(recording))
    print_problems(recording, console)
    return drive


def motion_of(messages: Iterable[Message], settings: Settings) -> Motion | None:
    """Motion by inertial sensors, GNSS and wheels, stamps and speeds corrected by settings; None without samples.

    Parameters
    ----------
    messages : iterable of Message
        Measurements in the order of arrival, inertial samples in the axes of the settings.
    settings : Settings
        Of the filter.
    """
    log = MotionLog(LONGEST_S)
    for message in messages:
        if isinstance(message, ImuSamples):
            stamps, forces, rates = zip(*samples_of(message), strict=True)
            log.samples(stamps, forces, rates)
        else:
            for measurement in measurements_of(message, settings):
                log.see(measurement)
    return log.motion()


def motion_of_drive(drive: Drive, shown: Shown) -> Motion:
    """Motion of a recording; raises `UserError` without inertial samples."""
    unit = OfflineUnit(drive.vehicle, PARSERS)
    messages = unit.run(shown(drive.inputs.messages(drive.vehicle), len(drive.inputs)))
    motion = motion_of(messages, drive.settings)
    if motion is None:
        raise UserError(f"{drive.name} holds no inertial samples; record the IMU as well")
    return motion


def innovations_of(drive: Drive, vehicle: VehicleFile, shown: Shown) -> dict[str, float]:
    """Root mean square of the innovations of the filter over a drive, on ground, by kind [m, m/s].

    Parameters
    ----------
    drive : Drive
        The recording.
    vehicle : VehicleFile
        Settings that are tried on it.
    shown : callable
        Shows how far it is.
    """
    unit = OfflineUnit(vehicle, (*PARSERS, "core.fusion"))
    squares: dict[AidingKind, list[float]] = {kind: [] for kind in KINDS}
    messages = unit.run(shown(drive.inputs.messages(vehicle), len(drive.inputs)))
    for update in _updates(messages, cast(Process, unit.process("core.fusion"))):
        if update.kind in squares:
            squares[update.kind].append(float(np.square(update.innovation[:2]).sum()))
    return {kind.value: float(np.sqrt(np.mean(found))) for kind, found in squares.items() if found}


def _updates(messages: Iterable[Message], fusion: Process) -> Iterator[AidingUpdate]:
    for message in messages:
        if isinstance(message, AidingUpdate):
            yield message
    yield from fusion.finish()
