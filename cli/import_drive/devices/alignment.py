"""Aligns the clocks of device files of one drive: by their dates, or by the motion that each of them measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.progress import Progress

from shared.errors import UserError
from shared.maths.dates import DAY_NS
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

from ..conversion.convert import Imported
from ..estimates.agreement import AGREES, Motion, agreement_of, motion_of, told
from ..estimates.delay import delay_of_fixes
from .can_log import shifted_lines
from .stamped import NS, ClockKind, FileKind, Portion, StampedFile

PARSERS = ("parsers.gnss", "parsers.imu", "parsers.can")
GRID_TOLERANCE_S = 0.1  # half a step of the grid on which motions are compared


@dataclass(frozen=True)
class Device:
    """A device file, with its messages once its clock is known."""

    path: Path
    source: str
    stamped: StampedFile
    shift_ns: int | None = None  # asked for
    messages: Sequence[Imported] = ()
    decoded: tuple[Message, ...] = field(default=(), repr=False)  # what has motion in it

    @property
    def motion(self) -> Motion | None:
        """The motion that it measured."""
        return motion_of(self.decoded)

    def shifted(self, by_ns: int) -> "Device":
        """Add a time to its stamps; those within the lines of a CAN log follow."""
        portions = [
            Portion(
                portion.time_ns + by_ns,
                shifted_lines(portion.data, by_ns) if self.stamped.kind is FileKind.CAN else portion.data,
            )
            for portion in self.stamped.portions
        ]
        return replace(self, stamped=replace(self.stamped, portions=portions))


Maker = Callable[[Device], list[Imported]]


def aligned(
    devices: Sequence[Device], vehicle: VehicleFile, made: Maker, progress: Progress
) -> tuple[list[Device], list[str]]:
    """Bring all files to one clock, and make their messages.

    Parameters
    ----------
    devices : sequence of Device
        As read.
    vehicle : VehicleFile
        Settings of the parsers.
    made : callable
        Makes the messages of a device.
    progress : Progress
        Of the command.

    Returns
    -------
    tuple of list
        The devices with their messages, and sentences on what was done, or is doubtful.

    Raises
    ------
    UserError
        A clock without a date cannot be aligned.
    """
    sentences = [f"{device.path.name} {note}." for device in devices for note in device.stamped.notes]
    moved = [device if device.shift_ns is None else device.shifted(device.shift_ns) for device in devices]
    if len(moved) == 1:
        read = [replace(device, messages=made(device)) for device in moved]
    else:
        read = [_decoded(device, vehicle, made) for device in moved]
    reference = _reference(read)
    found = []
    for device in read:
        settled = device is reference or device.shift_ns is not None or device.stamped.kind is FileKind.CORRECTIONS
        if not settled and device.stamped.clock is not ClockKind.UTC:
            shift_ns, sentence = _shift(reference, device, vehicle, progress)
            found.append(_decoded(device.shifted(shift_ns), vehicle, made))
            sentences.append(sentence)
        else:
            found.append(device)
    if reference.stamped.clock is not ClockKind.UTC:
        sentences.append(
            f"{reference.path.name} tells no date: its clock begins on 2000-01-01. To move it: "
            f"--shift {reference.path.name}=SECONDS."
        )
    motions = {reference.path.name: reference.motion} | {device.path.name: device.motion for device in found}
    sentences += told({name: motion for name, motion in motions.items() if motion is not None})
    return found, sentences


def _decoded(device: Device, vehicle: VehicleFile, made: Maker) -> Device:
    messages = made(device)
    unit = OfflineUnit(vehicle, PARSERS)
    kept = GnssFix, ImuSamples, VehicleSpeed, WheelSpeeds
    decoded = tuple(message for message in unit.run(messages) if isinstance(message, kept))
    return replace(device, messages=messages, decoded=decoded)


def _reference(devices: Sequence[Device]) -> Device:
    """The file whose clock the others follow: one with a date before one without, a receiver before the rest."""
    return min(
        (device for device in devices if device.stamped.kind is not FileKind.CORRECTIONS),
        key=lambda device: (device.stamped.clock is not ClockKind.UTC, device.stamped.kind is not FileKind.RECEIVER),
        default=devices[0],
    )


def _shift(reference: Device, device: Device, vehicle: VehicleFile, progress: Progress) -> tuple[int, str]:
    """Find what to add to the clock of a file, and say how."""
    name, other = device.path.name, reference.path.name
    if device.stamped.clock is ClockKind.DAY and reference.stamped.clock is ClockKind.UTC:
        apart_ns = reference.stamped.portions[0].time_ns - device.stamped.portions[0].time_ns
        return round(apart_ns / DAY_NS) * DAY_NS, f"{name} tells no date: it has that of {other}."
    first, second = reference.motion, device.motion
    agreement = agreement_of(first, second) if first is not None and second is not None else None
    if agreement is None or agreement.correlation < AGREES:
        why = (
            "one of the files holds no motion that the other measured as well"
            if agreement is None
            else f"their motions correlate by {agreement.correlation:.2f} only, at {agreement.shift_s:+.1f} s"
        )
        raise UserError(
            f"the clock of {name} tells no date and cannot be aligned with {other}: {why}; give "
            f"--shift {name}=SECONDS, or record UTC with it"
        )
    shift_s, sd_s = _refined(agreement.shift_s, reference, device, vehicle, progress)
    return round(shift_s * NS), (
        f"The clock of {name} tells no date; its stamps were moved by {shift_s:+.3f} s, at which its motion agrees "
        f"with that of {other} (correlation {agreement.correlation:.2f}, to {sd_s:.3f} s). To fix the value: "
        f"--shift {name}={shift_s:.3f}."
    )


def _refined(
    shift_s: float, reference: Device, device: Device, vehicle: VehicleFile, progress: Progress
) -> tuple[float, float]:
    """Refine a shift of inertial samples against fixes by the filter, where the drive has turns enough for it.

    Returns
    -------
    tuple of float
        [s] Shift and its standard deviation.
    """
    if device.stamped.kind is not FileKind.TRACKER or reference.stamped.kind is not FileKind.RECEIVER:
        return shift_s, GRID_TOLERANCE_S
    by_ns = round(shift_s * NS)
    samples = [
        message.model_copy(update={
            "received_ns": message.received_ns + by_ns, "sampled_ns": tuple(stamp + by_ns
            for stamp in message.sampled_ns),
        })
        for message in device.decoded
        if isinstance(message, ImuSamples)
    ]  # fmt: skip
    merged: list[ImuSamples | GnssFix] = sorted(
        (*samples, *(message for message in reference.decoded if isinstance(message, GnssFix))),
        key=lambda item: item.received_ns,
    )
    shown = progress.track(merged, description=f"aligning {device.path.name}")
    try:
        delay = delay_of_fixes(shown, vehicle)
    except UserError:  # too few turns: the shift stays as coarse as it is
        return shift_s, GRID_TOLERANCE_S
    return shift_s + delay.seconds, delay.sd_s
