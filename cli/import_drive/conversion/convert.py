"""Converts the table of a file to messages: SI units, body axes, stamps on one time line."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray
from shared.messages.corrections import CorrectionBytes
from shared.messages.gnss import GnssFix, GnssRaw, GnssRawEpoch, GnssSatellites
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.vehicle import CanRaw, VehicleSpeed, WheelSpeeds

from ..mapping import units
from ..mapping.schema import Force, Gnss, Gyroscope, Imu, Rate, Speed, TableFile, Truth, Velocity, Wheels
from ..readers.table import Table
from .fixes import fixes, usable_fixes
from .quantities import triples
from .stamps import Stamps, stamped
from .truth import true_states

MAXIMUM_IMU_MESSAGES_HZ = 100.0  # samples at higher rates are batched, as on the bus
MAX_STEPS = 3.0  # median intervals of an accelerometer, over which its specific force is interpolated
GRAVITY_RANGE_M_S2 = (7.0, 13.0)  # plausible median magnitude of a vehicle's specific force
SCALARS = ("column", "arrival_column", "date_column", "week_column", "satellites_used", "front_left", "front_right",
           "rear_left", "rear_right", "hdop", "vdop")  # fmt: skip
Imported: TypeAlias = (
    ImuSamples | GnssFix | GnssRawEpoch | GnssSatellites | VehicleSpeed | WheelSpeeds | TruthState
    | GnssRaw | ImuRaw | CanRaw | CorrectionBytes
)  # fmt: skip


@dataclass(frozen=True)
class Conversion:
    """The messages of one file in the order of arrival, and the numbers of read and rejected rows."""

    messages: Sequence[Imported]
    rows: int
    rejects: Counter[str]
    notes: Sequence[str] = ()  # what was found of the clock and of rejected rows, one sentence each


def wanted_columns(spec: TableFile) -> list[str]:
    """All columns used by a table of the mapping."""
    return list(dict.fromkeys(_columns(spec.model_dump(exclude_none=True))))


def _columns(document: dict[str, object]) -> Iterator[str]:
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _columns(value)
        elif isinstance(value, tuple) and key in ("columns", "only_changes_of"):
            yield from value
        elif isinstance(value, str) and key in SCALARS:
            yield value


@dataclass(frozen=True)
class Accelerometer:
    """An accelerometer in a file of its own."""

    spec: Imu
    table: Table


def convert(
    spec: TableFile, table: Table, *, start_s: float = 0.0, accelerometer: Accelerometer | None = None
) -> Conversion:
    """Convert the rows of one file to messages.

    Parameters
    ----------
    spec : TableFile
        The table of the mapping that describes the file.
    table : Table
        Its columns.
    start_s : float
        [s] Unix time of zero of the file's clock.
    accelerometer : Accelerometer, optional
        That of a gyroscope.

    Returns
    -------
    Converted
        Rows without information (repeated, of an unlisted quality, not later than the previous row) are
        omitted and counted.
    """
    rows = len(table) + table.rejects.total()
    table = _changes(spec, table)
    if isinstance(spec, Gnss | Truth):
        table = usable_fixes(spec, table)
    table, sampled, received = stamped(spec, table, start_s)
    if isinstance(spec, Gyroscope):
        if accelerometer is None:
            raise ValueError("a gyroscope without accelerometer")
        return _both(spec, accelerometer, Rows(table, sampled, received), start_s, rows)
    return Conversion(list(_messages(spec, table, sampled, received)), rows, table.rejects, table.notes)


def _changes(spec: TableFile, table: Table) -> Table:
    """Omit rows that equal the previous row in all columns of `only_changes_of`."""
    if not spec.only_changes_of:
        return table
    watched = table.many(spec.only_changes_of)
    # The first row is omitted: its value may be older than the file, so its time is unknown.
    return table.keep(np.r_[False, np.any(np.diff(watched, axis=0) != 0.0, axis=1)], "unchanged")


def _messages(spec: TableFile, table: Table, sampled: Stamps, received: Stamps) -> Iterator[Imported]:
    match spec:
        case Imu():
            return _imu(spec, table, sampled, received)
        case Gnss():
            return fixes(spec, table, sampled, received)
        case Speed():
            return _speeds(spec, table, sampled, received)
        case Wheels():
            return _wheels(spec, table, sampled, received)
        case Truth():
            return true_states(spec, table, sampled)
        case _:
            raise ValueError(f"no messages for {type(spec).__name__}")


@dataclass(frozen=True)
class Rows:
    """Stamped rows of a file."""

    table: Table
    sampled: Stamps
    received: Stamps


def _imu(spec: Imu, table: Table, sampled: Stamps, received: Stamps) -> Iterator[ImuSamples]:
    if spec.angular_rate is None:
        raise ValueError("an accelerometer alone")
    return _samples(spec.source, _force(spec, table, sampled), _rate(spec, spec.angular_rate, table, sampled),
                    sampled, received)  # fmt: skip


def _force(spec: Imu, table: Table, sampled: Stamps) -> FloatArray:
    """Specific force [m/s², body], shape (rows, 3)."""
    force = _means(spec.specific_force, units.FORCE, units.FORCE_INCREMENT, table, sampled) @ spec.matrix().T
    _check_gravity(spec, force)
    return -force if spec.specific_force.opposite else force


def _rate(axes: Imu | Gyroscope, rate: Rate, table: Table, sampled: Stamps) -> FloatArray:
    """Angular rate [rad/s, body], shape (rows, 3)."""
    return _means(rate, units.RATE, units.RATE_INCREMENT, table, sampled) @ axes.matrix().T


def _both(spec: Gyroscope, accelerometer: Accelerometer, gyroscope: Rows, start_s: float, rows: int) -> Conversion:
    """Interpolate the specific force to the stamps of the gyroscope; rows far from any specific force are omitted."""
    imu = accelerometer.spec
    table, stamps, _ = stamped(imu, _changes(imu, accelerometer.table), start_s)
    force, at = _force(imu, table, stamps), gyroscope.sampled
    if len(stamps) < 2:
        raise UserError(f"{imu.file} holds a single row; the specific force between rows is interpolated: add rows")
    after = np.clip(np.searchsorted(stamps, at), 1, len(stamps) - 1)
    longest = MAX_STEPS * float(np.median(np.diff(stamps)))
    near = (at >= stamps[0]) & (at <= stamps[-1]) & (stamps[after] - stamps[after - 1] <= longest)
    kept = gyroscope.table.keep(near, f"no specific force of {imu.file} near")
    at, received = at[near], gyroscope.received[near]
    between = np.column_stack([np.interp(at, stamps, axis) for axis in force.T])
    messages = _samples(spec.source, between, _rate(spec, spec.angular_rate, kept, at), at, received)
    return Conversion(list(messages), rows, kept.rejects, [*table.notes, *kept.notes])


def _samples(
    source: str, force: FloatArray, rate: FloatArray, sampled: Stamps, received: Stamps
) -> Iterator[ImuSamples]:
    forces, rates, stamps, size = triples(force), triples(rate), sampled.tolist(), _batch(sampled)
    for first in range(0, len(stamps), size):
        part = slice(first, first + size)
        yield ImuSamples(
            received_ns=int(received[part][-1]),
            source=source,
            sampled_ns=tuple(stamps[part]),
            specific_force_body_m_s2=tuple(forces[part]),
            angular_rate_body_rad_s=tuple(rates[part]),
        )


def _means(
    spec: Force | Rate, means: Mapping[str, float], increments: Mapping[str, float], table: Table, sampled: Stamps
) -> FloatArray:
    """Mean over each sample, shape (rows, 3): the measured value, or the increment divided by the sample interval."""
    values = table.many(spec.columns)
    if spec.unit in means:
        return values * means[spec.unit]
    return values * increments[spec.unit] / _lengths_s(sampled)[:, None]


def _lengths_s(sampled: Stamps) -> FloatArray:
    """Interval of each sample [s]; for the first, and after lost samples, the median interval."""
    if len(sampled) < 2:
        raise UserError("the interval of a single inertial sample is unknown, so increments are unusable; add rows")
    steps = np.diff(sampled) * 1e-9
    usual = float(np.median(steps))
    lengths: FloatArray = np.r_[usual, np.where(steps > 1.5 * usual, usual, steps)]
    return lengths


def _check_gravity(spec: Imu, force: FloatArray) -> None:
    """Raise UserError for an implausible unit: the median specific force must be close to gravity."""
    least, most = GRAVITY_RANGE_M_S2
    found = float(np.median(np.linalg.norm(force, axis=1)))
    if not least < found < most:
        raise UserError(
            f"{spec.file}: a median specific force of {found:.3g} m/s2 is implausible (gravity is 9.8); check "
            f"the unit {spec.specific_force.unit!r} (means: {', '.join(units.FORCE)}; increments: m/s)"
        )


def _batch(sampled: Stamps) -> int:
    """Number of samples per message."""
    if len(sampled) < 2:
        return 1
    return max(1, round(1e9 / float(np.median(np.diff(sampled))) / MAXIMUM_IMU_MESSAGES_HZ))


def _speeds(spec: Speed, table: Table, sampled: Stamps, received: Stamps) -> Iterator[VehicleSpeed]:
    if spec.made_from is not None:
        speeds = _made_speeds(spec, spec.made_from, table)
    else:
        factor = units.SPEED[spec.unit] if spec.wheel_radius_m is None else units.RATE[spec.unit] * spec.wheel_radius_m
        speeds = (table[spec.column or ""] * (-factor if spec.opposite else factor)).tolist()
    for stamp, arrival, speed in zip(sampled.tolist(), received.tolist(), speeds, strict=True):
        yield VehicleSpeed(
            sampled_ns=stamp,
            received_ns=arrival,
            source=spec.source,
            speed_m_s=speed,
            resolution_m_s=spec.resolution_m_s,
        )


def _made_speeds(spec: Speed, velocity: Velocity, table: Table) -> list[float]:
    """Speed [m/s] computed from the velocity of a reference, with added white noise."""
    exact = np.linalg.norm(table.many(velocity.columns) * units.SPEED[velocity.unit], axis=1)
    noise = np.random.default_rng(spec.noise_seed).normal(0.0, spec.noise_sd_m_s, len(exact))
    speeds: list[float] = (exact + noise).tolist()
    return speeds


def _wheels(spec: Wheels, table: Table, sampled: Stamps, received: Stamps) -> Iterator[WheelSpeeds]:
    names = (spec.front_left, spec.front_right, spec.rear_left, spec.rear_right)
    factor = units.SPEED[spec.unit]
    wheels = [(table[name] * factor).tolist() if name else [None] * len(table) for name in names]
    for stamp, arrival, *speeds in zip(sampled.tolist(), received.tolist(), *wheels, strict=True):
        yield WheelSpeeds(
            sampled_ns=stamp,
            received_ns=arrival,
            source=spec.source,
            front_left_m_s=speeds[0],
            front_right_m_s=speeds[1],
            rear_left_m_s=speeds[2],
            rear_right_m_s=speeds[3],
        )
