"""Estimates the offset of an independent clock by correlating the speeds of two files."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.gnss import GnssFix
from shared.messages.vehicle import VehicleSpeed

COARSE_S, FINE_S = 0.2, 0.005
MAX_STEP_S = 2.0  # longest time between two fixes whose distance gives a speed
MIN_OVERLAP = 0.5  # fraction of the shorter series
MIN_SPREAD_M_S = 0.5  # standard deviation of the speed below which the offset is not observable


@dataclass(frozen=True)
class Offset:
    """Offset to add to a clock, and the RMS difference of the speeds with it."""

    seconds: float
    rms_m_s: float


def offset_of(speeds: Sequence[VehicleSpeed], fixes: Sequence[GnssFix]) -> Offset:
    """Estimate the clock offset at which the speeds agree best with those of the fixes.

    Parameters
    ----------
    speeds : sequence of VehicleSpeed
        Stamped by the clock whose offset is estimated.
    fixes : sequence of GnssFix
        Stamped by the reference clock.

    Returns
    -------
    Offset
        The offset of the least root mean square difference, over all offsets at which at least half of the shorter
        series overlaps the other: first in steps of 0.2 s, then of 5 ms.

    Raises
    ------
    UserError
        One of the speeds is known too rarely or is nearly constant.
    """
    time, speed = _arrays([s.sampled_ns for s in speeds], [abs(s.speed_m_s) for s in speeds])
    true_time, true_speed = _speeds_of(fixes)
    if len(time) < 2 or len(true_time) < 2 or min(np.std(speed), np.std(true_speed)) < MIN_SPREAD_M_S:
        raise UserError("the clocks cannot be aligned by the speed: it is known too rarely or nearly constant")
    start = true_time[0] - time[0]
    span, true_span = time[-1] - time[0], true_time[-1] - true_time[0]
    shifts = start + np.arange(-span, true_span, COARSE_S)
    least = MIN_OVERLAP * min(span, true_span)

    def cost(shift: float) -> float:
        inside = (true_time >= time[0] + shift) & (true_time <= time[-1] + shift)
        covered = true_time[inside]
        if len(covered) < 2 or covered[-1] - covered[0] < least:
            return float("inf")
        difference = np.interp(covered - shift, time, speed) - true_speed[inside]
        return float(np.sqrt(np.mean(difference**2)))

    coarse = min(shifts.tolist(), key=cost)
    fine = min((coarse + np.arange(-COARSE_S, COARSE_S, FINE_S)).tolist(), key=cost)
    return Offset(round(fine, 3), cost(fine))


def shifted(speeds: Sequence[VehicleSpeed], seconds: float) -> list[VehicleSpeed]:
    """Copy the speeds with their stamps shifted."""
    step_ns = round(seconds * 1e9)
    return [
        speed.model_copy(update={"sampled_ns": speed.sampled_ns + step_ns, "received_ns": speed.received_ns + step_ns})
        for speed in speeds
    ]


def _arrays(stamps_ns: Sequence[int], values: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    return np.array(stamps_ns, dtype=float) * 1e-9, np.array(values, dtype=float)


def _speeds_of(fixes: Sequence[GnssFix]) -> tuple[FloatArray, FloatArray]:
    """Time [s] and speed over ground [m/s]: measured, otherwise from successive positions."""
    measured = [(f.sampled_ns, np.hypot(*f.velocity_ned_m_s[:2])) for f in fixes if f.velocity_ned_m_s is not None]
    if measured:
        return _arrays([stamp for stamp, _ in measured], [speed for _, speed in measured])
    places = np.array([[f.latitude_deg, f.longitude_deg, 0.0] for f in fixes], dtype=float).reshape(-1, 3)
    places[:, :2] = np.radians(places[:, :2])
    stamps = np.array([f.sampled_ns for f in fixes], dtype=float) * 1e-9
    if len(fixes) < 2:
        return stamps, stamps
    distance = np.hypot(*np.diff(ned_track(places, Geodetic(*places[0].tolist()))[:, :2], axis=0).T)
    steps = np.diff(stamps)
    near = steps < MAX_STEP_S
    middle: FloatArray = 0.5 * (stamps[1:] + stamps[:-1])
    speed: FloatArray = distance / steps
    return middle[near], speed[near]
