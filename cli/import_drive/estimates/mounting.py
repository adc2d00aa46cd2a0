"""Estimates the axes of an IMU in a vehicle from gravity and from the changes of the speed of the fixes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples

from ..conversion.quantities import triples

MIN_CORRELATION = 0.5  # of the forward acceleration with the changes of speed
MIN_STEPS = 30
MAX_STEP_S = 1.5  # time between two fixes of which the change of speed is used


@dataclass(frozen=True)
class Mounting:
    """Rotation from sensor to body axes, and the correlation of forward acceleration and changes of speed."""

    body_from_sensor: FloatArray  # shape (3, 3)
    correlation: float


def mounting_of(imu: Sequence[ImuSamples], fixes: Sequence[GnssFix]) -> Mounting:
    """Estimate the axes of the sensor.

    Parameters
    ----------
    imu : sequence of ImuSamples
        Specific forces in sensor axes; at standstill they point up with 1 g.
    fixes : sequence of GnssFix
        With a velocity, or with a ground speed.

    Returns
    -------
    Mounting
        Up is the mean specific force. Forward is the horizontal direction d of least squares of::

            v_{k+1} - v_k = d . (mean of the horizontal specific force between the fixes k and k+1) (t_{k+1} - t_k)

    Raises
    ------
    UserError
        The speed changes too little, or does not correlate with the forces.
    """
    stamps = np.array([stamp for message in imu for stamp in message.sampled_ns]) * 1e-9
    force = np.array([row for message in imu for row in message.specific_force_body_m_s2])
    up = force.mean(axis=0) / np.linalg.norm(force.mean(axis=0))
    horizontal = (force - force.mean(axis=0)) @ (np.eye(3) - np.outer(up, up))
    known = [(fix.sampled_ns * 1e-9, found) for fix in fixes if (found := _speed(fix)) is not None]
    time_s, speed = np.array(known).reshape(-1, 2).T
    steps = np.diff(time_s)
    # Means between fixes by differences of the integral.
    integral = np.vstack([np.zeros(3), np.cumsum(0.5 * (horizontal[1:] + horizontal[:-1])
                                                 * np.diff(stamps)[:, None], axis=0)])  # fmt: skip
    at = np.column_stack([np.interp(time_s, stamps, column) for column in integral.T])
    inside = (time_s[:-1] >= stamps[0]) & (time_s[1:] <= stamps[-1]) & (steps < MAX_STEP_S)
    gained, change = np.diff(at, axis=0)[inside], np.diff(speed)[inside]
    if len(change) < MIN_STEPS or np.std(change) == 0.0:
        raise UserError("`estimate_axes` requires a drive with changes of speed; give `axes` or `body_from_sensor`")
    direction, *_ = np.linalg.lstsq(gained, change, rcond=None)
    forward = direction - (direction @ up) * up
    forward /= np.linalg.norm(forward)
    correlation = float(np.corrcoef(gained @ forward, change)[0, 1])
    if not correlation > MIN_CORRELATION:
        raise UserError(
            f"`estimate_axes`: forces and changes of speed correlate by {correlation:.2f} only; was the sensor fixed "
            "to the vehicle? Give `axes` or `body_from_sensor`"
        )
    return Mounting(np.array([forward, np.cross(forward, up), -up]), correlation)


def rotated(imu: Sequence[ImuSamples], body_from_sensor: FloatArray) -> list[ImuSamples]:
    """Turn samples from sensor to body axes."""

    def turned(rows: Sequence[tuple[float, float, float]]) -> tuple[tuple[float, float, float], ...]:
        return tuple(triples(np.array(rows) @ body_from_sensor.T))

    return [
        message.model_copy(update={
            "specific_force_body_m_s2": turned(message.specific_force_body_m_s2),
            "angular_rate_body_rad_s": turned(message.angular_rate_body_rad_s),
        })
        for message in imu
    ]  # fmt: skip


def _speed(fix: GnssFix) -> float | None:
    if fix.velocity_ned_m_s is not None:
        return float(np.hypot(*fix.velocity_ned_m_s[:2]))
    return fix.ground_speed_m_s
