"""A clock that has nothing to do with the others is put onto them by what both files saw: the speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.gnss import GnssFix
from shared.messages.vehicle import VehicleSpeed

COARSE_S, FINE_S = 0.2, 0.005
LONGEST_STEP_S = 2.0  # between fixes whose distance says something of the speed
LEAST_OVERLAP = 0.5  # of the shorter of the two
SMALLEST_SPREAD_M_S = 0.5  # a speed that hardly changes fits everywhere


@dataclass(frozen=True)
class Offset:
    """What to add to a clock, and how well the speeds then agree."""

    seconds: float
    rms_m_s: float


def offset_of(speeds: Sequence[VehicleSpeed], fixes: Sequence[GnssFix]) -> Offset:
    """Find the offset of a clock at which its speeds agree best with those of the fixes.

    Parameters
    ----------
    speeds : sequence of VehicleSpeed
        Stamped by the clock in question.
    fixes : sequence of GnssFix
        Stamped by the clock that counts.

    Returns
    -------
    Offset
        The smallest root mean square difference over all shifts in which at least half of the shorter series lies in
        the other: first in steps of 0.2 s, then of 5 ms.

    Raises
    ------
    UserError
        One of the two says too little.
    """
    time, speed = _arrays([s.sampled_ns for s in speeds], [abs(s.speed_m_s) for s in speeds])
    true_time, true_speed = _speeds_of(fixes)
    if len(time) < 2 or len(true_time) < 2 or min(np.std(speed), np.std(true_speed)) < SMALLEST_SPREAD_M_S:
        raise UserError("the clocks cannot be put together by the speed, which is known too seldom or hardly changes")
    start = true_time[0] - time[0]
    span, true_span = time[-1] - time[0], true_time[-1] - true_time[0]
    shifts = start + np.arange(-span, true_span, COARSE_S)
    least = LEAST_OVERLAP * min(span, true_span)

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
    """Give the same speeds by another clock."""
    step_ns = round(seconds * 1e9)
    return [
        speed.model_copy(update={"sampled_ns": speed.sampled_ns + step_ns, "received_ns": speed.received_ns + step_ns})
        for speed in speeds
    ]


def _arrays(stamps_ns: Sequence[int], values: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    return np.array(stamps_ns, dtype=float) * 1e-9, np.array(values, dtype=float)


def _speeds_of(fixes: Sequence[GnssFix]) -> tuple[FloatArray, FloatArray]:
    """Speed over ground [m/s] with its time [s]: as told, or between successive positions."""
    told = [(f.sampled_ns, np.hypot(*f.velocity_ned_m_s[:2])) for f in fixes if f.velocity_ned_m_s is not None]
    if told:
        return _arrays([stamp for stamp, _ in told], [speed for _, speed in told])
    places = np.array([[f.latitude_deg, f.longitude_deg, 0.0] for f in fixes], dtype=float).reshape(-1, 3)
    places[:, :2] = np.radians(places[:, :2])
    stamps = np.array([f.sampled_ns for f in fixes], dtype=float) * 1e-9
    if len(fixes) < 2:
        return stamps, stamps
    way = np.hypot(*np.diff(ned_track(places, Geodetic(*places[0].tolist()))[:, :2], axis=0).T)
    steps = np.diff(stamps)
    near = steps < LONGEST_STEP_S
    middle: FloatArray = 0.5 * (stamps[1:] + stamps[:-1])
    speed: FloatArray = way / steps
    return middle[near], speed[near]
