"""Converts columns with units and axes to the vectors of messages."""

import numpy as np

from shared.maths.earth import FloatArray
from shared.messages.base import Vector3

from ..mapping import units
from ..mapping.schema import Coordinate, Height
from ..readers.table import Table

AXES = {"n": (0, 1.0), "e": (1, 1.0), "d": (2, 1.0), "u": (2, -1.0)}
HALF_TURN_DEG = 180.0
Rows = list[Vector3]


def degrees_of(spec: Coordinate, table: Table) -> FloatArray:
    """Latitude or longitude [deg] of each row."""
    return table[spec.column] * units.COORDINATE[spec.unit]


def longitudes_of(spec: Coordinate, table: Table) -> FloatArray:
    """Longitude [deg] of each row from -180 to 180; some systems write 0 to 360."""
    east = degrees_of(spec, table)
    return np.where((east > HALF_TURN_DEG) & (east <= 2.0 * HALF_TURN_DEG), east - 2.0 * HALF_TURN_DEG, east)


def heights(spec: Height, table: Table) -> tuple[list[float] | None, list[float] | None]:
    """Heights above the ellipsoid and above mean sea level [m]; None if unknown."""
    height = table[spec.column] * units.LENGTH[spec.unit]
    separation = spec.geoid_separation_m
    if spec.kind == "ellipsoid":
        return height.tolist(), None if separation is None else (height - separation).tolist()
    return None if separation is None else (height + separation).tolist(), height.tolist()


def as_ned(values: FloatArray, axes: str, *, signed: bool = True) -> FloatArray:
    """Reorder columns to north, east, down; `signed=False` for standard deviations."""
    ned = np.empty_like(values)
    for column, letter in enumerate(axes):
        place, sign = AXES[letter]
        ned[:, place] = values[:, column] * (sign if signed else 1.0)
    return ned


def triples(values: FloatArray) -> Rows:
    """Rows of three columns as the tuples that messages hold."""
    return [(x, y, z) for x, y, z in values.tolist()]
