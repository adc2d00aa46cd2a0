"""Converts rows of a GNSS receiver to fixes."""

from collections.abc import Iterator, Mapping

import numpy as np

from shared.messages.gnss import CarrierSolution, FixType, GnssFix

from ..mapping import units
from ..mapping.schema import Accuracy, Angle, Gnss, Quality, Scalar, Truth
from ..readers.table import Table
from .positions import positions_of, velocities_of
from .quantities import Rows, as_ned, degrees_of, longitudes_of, triples
from .stamps import Stamps

QUALITIES = {
    "fixed": (CarrierSolution.FIXED, True),
    "float": (CarrierSolution.FLOAT, True),
    "differential": (CarrierSolution.NONE, True),
    "single": (CarrierSolution.NONE, False),
}


def usable_fixes(spec: Gnss | Truth, table: Table) -> Table:
    """Omit rows with an invalid position or a quality that the mapping does not list."""
    if spec.latitude is not None and spec.longitude is not None:
        table = table.keep(np.abs(degrees_of(spec.latitude, table)) <= 90.0, "invalid position (latitude)")
        table = table.keep(np.abs(longitudes_of(spec.longitude, table)) <= 180.0, "invalid position (longitude)")
    if isinstance(spec.quality, Quality):
        listed = [float(number) for number in spec.quality.values]
        table = table.keep(np.isin(table[spec.quality.column], listed), "quality not listed")
    return table


def fixes(spec: Gnss, table: Table, sampled: Stamps, received: Stamps) -> Iterator[GnssFix]:
    """Yield one fix per row."""
    horizontal, ellipsoid, msl = positions_of(spec, table)
    velocity = triples(velocities_of(spec.velocity, table, horizontal, None)) if spec.velocity else None
    position_sd, velocity_sd = _accuracy(spec.position_sd, table), _accuracy(spec.velocity_sd, table)
    satellites = table[spec.satellites_used].tolist() if spec.satellites_used else None
    ground_speed, course = _known(spec.ground_speed, units.SPEED, table), _known(spec.course, units.ANGLE, table)
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
            latitude_deg=float(horizontal[i, 0]),
            longitude_deg=float(horizontal[i, 1]),
            height_ellipsoid_m=ellipsoid[i] if ellipsoid else None,
            height_msl_m=msl[i] if msl else None,
            height_sign_assumed=spec.height is not None and not spec.height.upward,
            velocity_ned_m_s=velocity[i] if velocity else None,
            ground_speed_m_s=ground_speed[i],
            course_rad=course[i],
            hdop=hdop[i] if hdop else None,
            vdop=vdop[i] if vdop else None,
            position_sd_ned_m=position_sd[i] if position_sd else None,
            velocity_sd_ned_m_s=velocity_sd[i] if velocity_sd else None,
        )


def _known(spec: Scalar | Angle | None, factors: Mapping[str, float], table: Table) -> list[float | None]:
    """Values of each row in SI units; None where the value is unknown."""
    if spec is None:
        return [None] * len(table)
    return [None if value == spec.invalid else value * factors[spec.unit] for value in table[spec.column].tolist()]


def _accuracy(spec: Accuracy | None, table: Table) -> Rows | None:
    if spec is None:
        return None
    if spec.columns is None:
        return [spec.constant_ned] * len(table) if spec.constant_ned else None
    return triples(as_ned(spec.scale * table.many(spec.columns), spec.axes, signed=False))


def _qualities(spec: Quality | str, table: Table) -> list[str]:
    if isinstance(spec, str):
        return [spec] * len(table)
    words: dict[float, str] = {float(number): word for number, word in spec.values.items()}
    return [words[number] for number in table[spec.column].tolist()]
