"""Positions and rotations of a file in any of the accepted forms, converted to geodetic coordinates and to NED."""

from math import degrees, radians

import numpy as np
from scipy.spatial.transform import Rotation

from shared.maths.earth import FloatArray, Geodetic, ecef_from_geodetic, geodetic_from_ecef, ned_from_ecef

from ..mapping import units
from ..mapping.schema import PositionColumns, Quaternion, Velocity
from ..readers.table import Table
from .quantities import as_ned, degrees_of, heights, longitudes_of

NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])


def positions_of(spec: PositionColumns, table: Table) -> tuple[FloatArray, list[float] | None, list[float] | None]:
    """Compute the positions of all rows.

    Parameters
    ----------
    spec : Positioned
        Latitude, longitude and height; or Cartesian coordinates: ECEF, or local with an origin.
    table : Table
        The columns of the file.

    Returns
    -------
    horizontal : ndarray, shape (rows, 2)
        [deg] WGS-84 latitude and longitude.
    ellipsoid, msl : list of float or None
        [m] Heights above the ellipsoid and above mean sea level; None if unknown.
    """
    if spec.latitude is not None and spec.longitude is not None and spec.height is not None:
        return np.column_stack([degrees_of(spec.latitude, table), longitudes_of(spec.longitude, table)]), *heights(
            spec.height, table
        )
    points = np.array([(degrees(p.latitude), degrees(p.longitude), p.height) for p in _cartesian(spec, table)])
    points = points.reshape(-1, 3)
    return points[:, :2], points[:, 2].tolist(), None


def _cartesian(spec: PositionColumns, table: Table) -> list[Geodetic]:
    if spec.position_ecef is not None:
        ecef = table.many(spec.position_ecef.columns) * units.LENGTH[spec.position_ecef.unit]
    elif (local := spec.position_local) is not None:
        # The axes are those of the tangent plane at the origin: r = r_origin + C_en (north, east, down).
        origin = Geodetic(
            radians(local.origin.latitude_deg), radians(local.origin.longitude_deg), local.origin.height_m
        )
        ned = as_ned(table.many(local.columns) * units.LENGTH[local.unit], local.axes)
        ecef = np.array(ecef_from_geodetic(origin)) + ned @ ned_from_ecef(origin.latitude, origin.longitude)
    else:
        raise ValueError("no position")
    return [geodetic_from_ecef((x, y, z)) for x, y, z in ecef.tolist()]


def velocities_of(spec: Velocity, table: Table, horizontal: FloatArray, attitude: FloatArray | None) -> FloatArray:
    """Velocities [m/s, NED], shape (rows, 3), from ECEF by the position and from body axes by the attitude [rad]."""
    velocity = table.many(spec.columns) * units.SPEED[spec.unit]
    match spec.axes:
        case "ecef":
            return np.array([
                ned_from_ecef(latitude, longitude) @ v
                for (latitude, longitude), v in zip(np.radians(horizontal).tolist(), velocity, strict=True)
            ]).reshape(-1, 3)  # fmt: skip
        case "body":
            if attitude is None:
                raise ValueError("a velocity in body axes without attitude")
            turned: FloatArray = Rotation.from_euler("ZYX", attitude[:, ::-1]).apply(velocity)
            return turned
        case axes:
            return as_ned(velocity, axes)


def angles_of(spec: Quaternion, table: Table) -> FloatArray:
    """Roll, pitch and yaw [rad] of the body (forward, right, down) relative to NED, shape (rows, 3)."""
    values = table.many(spec.columns)
    scalar_last = values if spec.order == "xyzw" else values[:, [1, 2, 3, 0]]
    found = Rotation.from_quat(scalar_last)
    to, _, _ = spec.direction.partition("_from_")
    if to == "body":
        found = found.inv()
    if "enu" in spec.direction:
        found = Rotation.from_matrix(NED_FROM_ENU) * found
    if spec.body == "flu":
        found = found * Rotation.from_matrix(FLU_FROM_FRD)
    angles: FloatArray = found.as_euler("ZYX")[:, ::-1]
    return angles
