"""Estimates how late stamps are: those of fixes relative to the IMU, and those of a reference relative to the fixes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationState, TruthState
from shared.runtime.config import VehicleFile
from shared.runtime.offline import OfflineUnit

from ...solve.overrides import with_settings

LONGEST_S = 400.0  # of a drive, over which the filter estimates a delay
WORST_SD_S = 0.1  # standard deviation above which the delay of fixes is not known
LARGEST_S, STEP_S = 3.0, 0.02  # range and step of the delays of a reference
SLOWEST_M_S = 2.0  # the delay is not observable at standstill
GAP_S = 2.5  # longest time between two fixes that is interpolated
LEAST_ROWS = 30


@dataclass(frozen=True)
class Delay:
    """Delay of stamps [s]: positive if they are late; and its standard deviation."""

    seconds: float
    sd_s: float


def delay_of_fixes(messages: Iterable[Message], vehicle: VehicleFile) -> Delay:
    """Estimate the delay of the fixes relative to the inertial samples by the filter itself.

    Parameters
    ----------
    messages : iterable of Message
        Inertial samples, fixes and speeds in the order of arrival.
    vehicle : VehicleFile
        Its lever arm and noise; the delay found is that beyond `gnss.delay_s`.

    Returns
    -------
    Delay
        The estimate of `core.fusion` with `estimate_delays`, after at most 400 s.

    Raises
    ------
    UserError
        The standard deviation of the estimate is above 0.1 s.
    """
    unit = OfflineUnit(with_settings(vehicle, ("core.fusion.estimate_delays=true",)), ["core.fusion"])
    states = (message for message in unit.run(messages) if isinstance(message, NavigationState))
    last = first = next(states, None)
    for last in states:
        if first is not None and last.sampled_ns - first.sampled_ns > LONGEST_S * 1e9:
            break
    if last is None or last.gnss_delay_s is None or last.gnss_delay_sd_s is None or last.gnss_delay_sd_s > WORST_SD_S:
        raise UserError(
            "the delay of the fixes cannot be estimated: the drive has too few turns and changes of speed; give it as "
            "`stamps_late_s`"
        )
    return Delay(round(last.gnss_delay_s, 3), last.gnss_delay_sd_s)


def delay_of_reference(states: Sequence[TruthState], fixes: Sequence[GnssFix]) -> Delay:
    """Estimate the delay of a reference relative to fixes that were stamped correctly.

    Parameters
    ----------
    states : sequence of TruthState
        Positions with the delay to estimate.
    fixes : sequence of GnssFix
        Positions of a receiver.

    Returns
    -------
    Delay
        That of the least sum of squares S of the horizontal differences while the vehicle drives, after removal of
        their mean (another point of the vehicle, or a constant error). Its variance is 2 S / n over the second
        derivative of S, as if the differences were white.
    """
    time_s, path = _path([(s.sampled_ns, s.latitude_deg, s.longitude_deg) for s in states])
    known = [(f.sampled_ns, f.latitude_deg, f.longitude_deg) for f in fixes if f.latitude_deg and f.longitude_deg]
    fix_time_s, fix_path = _path(known, states)
    if min(len(time_s), len(fix_time_s)) < LEAST_ROWS:
        raise UserError("the delay of the reference cannot be estimated from so few positions; give `stamps_late_s`")
    speed = np.hypot(*np.gradient(path, time_s, axis=0).T)
    after = np.clip(np.searchsorted(fix_time_s, time_s), 1, len(fix_time_s) - 1)
    near = fix_time_s[after] - fix_time_s[after - 1] < GAP_S
    inside = (time_s > fix_time_s[0] + LARGEST_S) & (time_s < fix_time_s[-1] - LARGEST_S)
    rows = near & inside & (speed > SLOWEST_M_S)
    if rows.sum() < LEAST_ROWS:
        raise UserError("the delay of the reference cannot be estimated at standstill; give `stamps_late_s`")

    def squares(delay_s: float) -> float:
        at = time_s[rows] - delay_s
        difference = path[rows] - np.column_stack([np.interp(at, fix_time_s, axis) for axis in fix_path.T])
        return float(np.mean(((difference - difference.mean(axis=0)) ** 2).sum(axis=1)))

    delays = np.arange(-LARGEST_S, LARGEST_S + STEP_S, STEP_S)
    costs = np.array([squares(delay) for delay in delays.tolist()])
    least = int(costs.argmin())
    near_least = slice(max(0, least - 15), least + 16)
    curvature, slope, _ = np.polyfit(delays[near_least], costs[near_least], 2)
    if curvature <= 0.0 or not 0 < least < len(delays) - 1:
        raise UserError(f"the delay of the reference is not within {LARGEST_S:g} s; give it as `stamps_late_s`")
    return Delay(round(float(-0.5 * slope / curvature), 3), float(np.sqrt(costs[least] / rows.sum() / curvature)))


def _path(
    points: Sequence[tuple[int, float, float]], around: Sequence[TruthState] = ()
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and horizontal positions [m, north and east]; `around` holds the origin."""
    if not points:
        return np.zeros(0), np.zeros((0, 2))
    place = np.array([[np.radians(latitude), np.radians(longitude), 0.0] for _, latitude, longitude in points])
    first = np.radians([around[0].latitude_deg, around[0].longitude_deg]) if around else place[0, :2]
    path: FloatArray = ned_track(place, Geodetic(float(first[0]), float(first[1]), 0.0))[:, :2]
    return np.array([stamp for stamp, _, _ in points], dtype=float) * 1e-9, path
