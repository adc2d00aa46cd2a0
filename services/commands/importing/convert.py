"""The table of a CSV file becomes messages: SI units, body axes, stamps on one time line."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from shared.messages import GnssFix, ImuSamples, TruthState, VehicleSpeed, WheelSpeeds

from . import units
from .fixes import fixes, usable_fixes
from .quantities import triples
from .schema import CsvFile, Gnss, Imu, Speed, Truth, Wheels
from .stamps import Stamps, stamped
from .table import Table
from .truth import true_states

MAXIMUM_IMU_MESSAGES_HZ = 100.0  # faster sensors travel in batches, as they do on the bus
SCALARS = ("column", "arrival_column", "satellites_used", "front_left", "front_right", "rear_left", "rear_right")
Imported: TypeAlias = ImuSamples | GnssFix | VehicleSpeed | WheelSpeeds | TruthState


@dataclass(frozen=True)
class Converted:
    """The messages of one file, in the order of their arrival, and what became of its rows."""

    messages: Sequence[Imported]
    rows: int
    rejects: Counter[str]


def wanted_columns(spec: CsvFile) -> list[str]:
    """List every column that a table of the mapping names."""
    return list(dict.fromkeys(_columns(spec.model_dump(exclude_none=True))))


def _columns(document: dict[str, object]) -> Iterator[str]:
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _columns(value)
        elif isinstance(value, tuple) and key in ("columns", "only_changes_of"):
            yield from value
        elif isinstance(value, str) and key in SCALARS:
            yield value


def convert(spec: CsvFile, table: Table, *, start_s: float = 0.0) -> Converted:
    """Turn the rows of one file into messages.

    Parameters
    ----------
    spec : CsvFile
        The table of the mapping that describes the file.
    table : Table
        Its columns.
    start_s : float
        [s] Unix time at which the clock of the file shows zero.

    Returns
    -------
    Converted
        Rows that say nothing (repeated, of no listed quality, not later than the row before) are left
        out and counted.
    """
    rows = len(table) + table.rejects.total()
    if isinstance(spec, Gnss):
        table = usable_fixes(spec, table)
    table, sampled, received = stamped(spec, table, start_s)
    return Converted(list(_messages(spec, table, sampled, received)), rows, table.rejects)


def _messages(spec: CsvFile, table: Table, sampled: Stamps, received: Stamps) -> Iterator[Imported]:
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


def _imu(spec: Imu, table: Table, sampled: Stamps, received: Stamps) -> Iterator[ImuSamples]:
    sensor_from_body = spec.matrix().T
    force = table.many(spec.specific_force.columns) * units.FORCE[spec.specific_force.unit] @ sensor_from_body
    rate = table.many(spec.angular_rate.columns) * units.RATE[spec.angular_rate.unit] @ sensor_from_body
    forces, rates, stamps, size = triples(force), triples(rate), sampled.tolist(), _batch(sampled)
    for first in range(0, len(stamps), size):
        part = slice(first, first + size)
        yield ImuSamples(
            received_ns=int(received[part][-1]),
            source=spec.source,
            sampled_ns=tuple(stamps[part]),
            specific_force_body_m_s2=tuple(forces[part]),
            angular_rate_body_rad_s=tuple(rates[part]),
        )


def _batch(sampled: Stamps) -> int:
    """How many samples one message holds."""
    if len(sampled) < 2:
        return 1
    return max(1, round(1e9 / float(np.median(np.diff(sampled))) / MAXIMUM_IMU_MESSAGES_HZ))


def _speeds(spec: Speed, table: Table, sampled: Stamps, received: Stamps) -> Iterator[VehicleSpeed]:
    speeds = (table[spec.column] * units.SPEED[spec.unit]).tolist()
    for stamp, arrival, speed in zip(sampled.tolist(), received.tolist(), speeds, strict=True):
        yield VehicleSpeed(
            sampled_ns=stamp,
            received_ns=arrival,
            source=spec.source,
            speed_m_s=speed,
            resolution_m_s=spec.resolution_m_s,
        )


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
