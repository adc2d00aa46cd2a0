"""Converts rows of a GNSS receiver to fixes."""

from collections.abc import Iterator

import numpy as np

from shared.messages.gnss import CarrierSolution, FixType, GnssFix

from . import units
from .quantities import Rows, as_ned, degrees_of, heights, triples
from .schema import Accuracy, Gnss, Quality, Velocity
from .stamps import Stamps
from .table import Table

QUALITIES = {
    "fixed": (CarrierSolution.FIXED, True),
    "float": (CarrierSolution.FLOAT, True),
    "differential": (CarrierSolution.NONE, True),
    "single": (CarrierSolution.NONE, False),
}


def usable_fixes(spec: Gnss, table: Table) -> Table:
    """Omit rows with an invalid position or a quality that the mapping does not list."""
    latitude, longitude = degrees_of(spec.latitude, table), degrees_of(spec.longitude, table)
    table = table.keep((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0), "invalid position")
    if isinstance(spec.quality, Quality):
        listed = [float(number) for number in spec.quality.values]
        table = table.keep(np.isin(table[spec.quality.column], listed), "quality not listed")
    return table


def fixes(spec: Gnss, table: Table, sampled: Stamps, received: Stamps) -> Iterator[GnssFix]:
    """Yield one fix per row."""
    latitude, longitude = degrees_of(spec.latitude, table).tolist(), degrees_of(spec.longitude, table).tolist()
    ellipsoid, msl = heights(spec.height, table)
    velocity = _velocity(spec.velocity, table) if spec.velocity else None
    position_sd, velocity_sd = _accuracy(spec.position_sd, table), _accuracy(spec.velocity_sd, table)
    satellites = table[spec.satellites_used].tolist() if spec.satellites_used else None
    ground_speed = (
        (table[spec.ground_speed.column] * units.SPEED[spec.ground_speed.unit]) if spec.ground_speed else None
    )
    course = (table[spec.course.column] * units.ANGLE[spec.course.unit]) if spec.course else None
    hdop, vdop = (table[name].tolist() if name else None for name in (spec.hdop, spec.vdop))
    words = _qualities(spec.quality, table)
    for i, stamp in enumerate(sampled.tolist()):
        carrier, differential = QUALITIES[words[i]]
        yield GnssFix(
            sampled_ns=stamp,
            received_ns=int(received[i]),
            source=spec.source,
            fix_type=FixType.THREE_D,
            carrier_solution=carrier,
            differential=differential,
            satellites_used=round(satellites[i]) if satellites else None,
            latitude_deg=latitude[i],
            longitude_deg=longitude[i],
            height_ellipsoid_m=ellipsoid[i] if ellipsoid else None,
            height_msl_m=msl[i] if msl else None,
            velocity_ned_m_s=velocity[i] if velocity else None,
            ground_speed_m_s=None if ground_speed is None else float(ground_speed[i]),
            course_rad=None if course is None else float(course[i]),
            hdop=hdop[i] if hdop else None,
            vdop=vdop[i] if vdop else None,
            position_sd_ned_m=position_sd[i] if position_sd else None,
            velocity_sd_ned_m_s=velocity_sd[i] if velocity_sd else None,
        )


def _velocity(spec: Velocity, table: Table) -> Rows:
    return triples(as_ned(table.many(spec.columns) * units.SPEED[spec.unit], spec.axes))


def _accuracy(spec: Accuracy | None, table: Table) -> Rows | None:
    if spec is None:
        return None
    if spec.columns is None:
        return [spec.constant_ned] * len(table) if spec.constant_ned else None
    return triples(as_ned(table.many(spec.columns), spec.axes, signed=False))


def _qualities(spec: Quality | str, table: Table) -> list[str]:
    if isinstance(spec, str):
        return [spec] * len(table)
    words: dict[float, str] = {float(number): word for number, word in spec.values.items()}
    return [words[number] for number in table[spec.column].tolist()]
