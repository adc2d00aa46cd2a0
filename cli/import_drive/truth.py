"""Converts rows of a reference system to true states."""

from collections.abc import Iterator
from math import degrees

import numpy as np
from scipy.spatial.transform import Rotation

from shared.maths.earth import FloatArray, geodetic_from_ecef
from shared.messages.navigation import TruthState

from . import units
from .quantities import Rows, as_ned, degrees_of, heights, triples
from .schema import Rate, Truth
from .stamps import Stamps
from .table import Table


def true_states(spec: Truth, table: Table, sampled: Stamps) -> Iterator[TruthState]:
    """Yield one true state per row."""
    positions = _positions(spec, table)
    attitude = table.many(spec.attitude.columns) * units.ANGLE[spec.attitude.unit]
    rates = _rates(spec.angular_rate, table)
    velocities = triples(_velocity_ned(spec, table, attitude))
    for i, (roll, pitch, yaw) in enumerate(attitude.tolist()):
        latitude, longitude, height = positions[i]
        yield TruthState(
            sampled_ns=int(sampled[i]),
            latitude_deg=latitude,
            longitude_deg=longitude,
            height_ellipsoid_m=height,
            velocity_ned_m_s=velocities[i],
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            angular_rate_body_rad_s=rates[i] if rates else None,
        )


def _rates(spec: Rate | None, table: Table) -> Rows | None:
    return None if spec is None else triples(table.many(spec.columns) * units.RATE[spec.unit])


def _velocity_ned(spec: Truth, table: Table, attitude: FloatArray) -> FloatArray:
    velocity = table.many(spec.velocity.columns) * units.SPEED[spec.velocity.unit]
    if spec.velocity.axes != "body":
        return as_ned(velocity, spec.velocity.axes)
    turned: FloatArray = Rotation.from_euler("ZYX", attitude[:, ::-1]).apply(velocity)
    return turned


def _positions(spec: Truth, table: Table) -> Rows:
    """Latitude and longitude [deg], and height above the ellipsoid [m]."""
    if spec.position_ecef is not None:
        ecef = table.many(spec.position_ecef.columns) * units.LENGTH[spec.position_ecef.unit]
        points = [geodetic_from_ecef((x, y, z)) for x, y, z in ecef.tolist()]
        return [(degrees(p.latitude), degrees(p.longitude), p.height) for p in points]
    if spec.latitude is None or spec.longitude is None or spec.height is None:
        raise ValueError("truth without a position")
    height = np.array(heights(spec.height, table)[0])
    return triples(np.column_stack([degrees_of(spec.latitude, table), degrees_of(spec.longitude, table), height]))
