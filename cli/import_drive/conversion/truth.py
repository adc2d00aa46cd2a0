"""Converts rows of a reference system to true states."""

from collections.abc import Iterator

from shared.maths.earth import FloatArray
from shared.messages.navigation import TruthState

from ..mapping import units
from ..mapping.schema import Truth
from ..readers.table import Table
from .positions import angles_of, positions_of, velocities_of
from .quantities import triples
from .stamps import Stamps


def true_states(spec: Truth, table: Table, sampled: Stamps) -> Iterator[TruthState]:
    """Yield one true state per row; unknown quantities are None."""
    horizontal, heights, _ = positions_of(spec, table)
    if heights is None:
        raise ValueError("truth without a height above the ellipsoid")
    attitude = _attitude(spec, table)
    velocity = None if spec.velocity is None else triples(velocities_of(spec.velocity, table, horizontal, attitude))
    angles = None if attitude is None else triples(attitude)
    rate = spec.angular_rate
    rates = None if rate is None else triples(table.many(rate.columns) * units.RATE[rate.unit])
    for i, (latitude, longitude) in enumerate(horizontal.tolist()):
        roll, pitch, yaw = angles[i] if angles else (None, None, None)
        yield TruthState(
            sampled_ns=int(sampled[i]),
            latitude_deg=latitude,
            longitude_deg=longitude,
            height_ellipsoid_m=heights[i],
            velocity_ned_m_s=velocity[i] if velocity else None,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            angular_rate_body_rad_s=rates[i] if rates else None,
        )


def _attitude(spec: Truth, table: Table) -> FloatArray | None:
    """Roll, pitch and yaw [rad], shape (rows, 3)."""
    if spec.quaternion is not None:
        return angles_of(spec.quaternion, table)
    if spec.attitude is not None:
        return table.many(spec.attitude.columns) * units.ANGLE[spec.attitude.unit]
    return None
