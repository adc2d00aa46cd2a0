"""Electronic compass and barometer: attitude of gravity and the magnetic field, height of pressure."""

from math import atan2, cos, sin

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

STANDARD_PRESSURE = 101_325.0  # [Pa]
STANDARD_TEMPERATURE = 288.15  # [K]
LAPSE_RATE = -0.0065  # [K/m]
EXPONENT = 8.31432 * 0.0065 / (9.80665 * 0.0289644)  # [-] R |L| / (g0 M) of the US Standard Atmosphere 1976


def roll_pitch(gravity_b: Vector) -> tuple[float, float]:
    """Roll and pitch of gravity in body axes.

    Parameters
    ----------
    gravity_b : tuple of float
        [any unit, body: forward, right, down] Gravity, which is minus the specific force at rest.

    Returns
    -------
    tuple of float
        [rad] Roll in (-pi, pi], pitch in [-pi/2, pi/2].

    Notes
    -----
    ::

        roll = atan2(Gy, Gz),    pitch = atan(-Gx / (Gy sin(roll) + Gz cos(roll)))

    The denominator is the length of (Gy, Gz), which is not negative. The paper prints -Gy, which is wrong.
    """
    gx, gy, gz = gravity_b
    roll = atan2(gy, gz)
    return roll, atan2(-gx, gy * sin(roll) + gz * cos(roll))


def magnetic_heading(gravity_b: Vector, field_b: Vector) -> float:
    """Heading [rad, clockwise from magnetic north] of gravity and the magnetic field, both in body axes.

    Notes
    -----
    With roll r and pitch p of `roll_pitch`::

        heading = atan2(Hz sin r - Hy cos r,  Hx cos p + Hy sin p sin r + Hz sin p cos r)

    Linear acceleration corrupts it: a horizontal acceleration a perpendicular to the field gives an error of
    atan(sin(atan(a/g)) tan(dip)), 24 degrees at 2 m/s² and a dip of 66 degrees.
    """
    roll, pitch = roll_pitch(gravity_b)
    hx, hy, hz = field_b
    east = hz * sin(roll) - hy * cos(roll)
    return atan2(east, hx * cos(pitch) + hy * sin(pitch) * sin(roll) + hz * sin(pitch) * cos(roll))


def device_from_enu(force_d: FloatArray, field_d: FloatArray) -> FloatArray:
    """Rotation matrices from east, north, up to the device's axes, whatever these are.

    Parameters
    ----------
    force_d : ndarray, shape (n, 3)
        [any unit, device] Specific force, which points up at rest: Android's accelerometer.
    field_d : ndarray, shape (n, 3)
        [any unit, device] Magnetic field.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        Columns are east, north and up in device axes.

    Notes
    -----
    ::

        east = H x A,    north = A x east,    up = A,    each normalised
    """
    east = np.cross(field_d, force_d)
    north = np.cross(force_d, east)
    columns = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in (east, north, force_d)]
    return np.stack(columns, axis=-1)


def barometric_height(pressure_pa: float) -> float:
    """Height [m] in the standard atmosphere: h = T_b / L_b [(P / P_b)^(-R L_b / (g0 M)) - 1], L_b negative.

    T_b is the standard temperature of 288.15 K.
    """
    return STANDARD_TEMPERATURE / LAPSE_RATE * (float((pressure_pa / STANDARD_PRESSURE) ** EXPONENT) - 1.0)


def barometric_pressure(height_m: float) -> float:
    """Pressure [Pa] in the standard atmosphere: the inverse of `barometric_height`."""
    return STANDARD_PRESSURE * float((1.0 + LAPSE_RATE * height_m / STANDARD_TEMPERATURE) ** (1.0 / EXPONENT))
