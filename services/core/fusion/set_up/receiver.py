"""Checks signs and axes of the receiver: velocity against positions, heights against the pitch of the road.

On a road the specific force along the vehicle is f = a + g sin(slope), so that the climb over a window of speed v is::

    climb = sum(v f dt) / g + c1 way + c2 v²/2 + noise

with c1 the pitch of the mount and the bias, and c2 the acceleration and the pitch that goes with it.
"""

from bisect import bisect_left

import numpy as np
import numpy.typing as npt

from shared.maths.earth import STANDARD_GRAVITY
from shared.messages.explanation import explain

from ..codes import Code, Direction
from .findings import Check, Verdict
from .motion import Intervals, Motion, Velocities
from .regression import Fit, least_squares, nearest_permutation

FloatArray = npt.NDArray[np.float64]

WINDOW_S = 8.0
MIN_WINDOWS = 12  # windows, or velocities
GAIN_SD = 0.25
AXES_SD = 0.15
SIGNIFICANCE_SDS = 5.0
WRONG_GAIN = 0.5  # below it a sign is wrong
COMPASS = {(1, 0): Direction.NORTH, (0, 1): Direction.EAST, (-1, 0): Direction.SOUTH, (0, -1): Direction.WEST}
OF_HEIGHT = Code.HEIGHT_AGREES, Code.HEIGHT_SIGN_WRONG
OF_VELOCITY = Code.VERTICAL_VELOCITY_AGREES, Code.VERTICAL_VELOCITY_SIGN_WRONG


def check_velocity_axes(motion: Motion) -> Check:
    """Compare the receiver's horizontal velocity with the difference of its positions, as a 2x2 matrix."""
    name = "gnss_velocity_axes"
    track = motion.of_positions()
    seen = _mean_velocity(motion.velocities, track)
    both = np.isfinite(seen).all(axis=1)
    if both.sum() < MIN_WINDOWS:
        return Check(name)
    fit = least_squares(track.ned[both, :2], seen[both])
    if fit is None or float(fit.sd.max()) > AXES_SD:
        return Check(name)
    best, gap = nearest_permutation(fit.coefficients.T)
    sd = float(fit.sd.max())
    values = gap, sd, 0.0, 0.8
    if np.array_equal(best, np.eye(2)):
        return Check(name, Verdict.AGREES, explain(Code.VELOCITY_AXES_AGREE), *values)
    if gap < max(0.8, SIGNIFICANCE_SDS * sd):
        return Check(name)
    north, east = (COMPASS[(round(best[0, place]), round(best[1, place]))] for place in (0, 1))
    return Check(name, Verdict.CONTRADICTS, explain(Code.VELOCITY_AXES_WRONG, north=north, east=east), *values)


def check_vertical(motion: Motion, intervals: Intervals | None, ahead: FloatArray | None) -> tuple[Check, Check]:
    """Compare heights and vertical velocity with the pitch of the road, and with each other.

    Parameters
    ----------
    motion : Motion
        Of the window.
    intervals : Intervals or None
        Of velocities.
    ahead : ndarray, shape (3,), or None
        [-, body] Direction forward in published axes; None while it is not known.
    """
    height, velocity = Check("gnss_height"), Check("gnss_vertical_velocity")
    by_height = by_velocity = None
    if intervals is not None and ahead is not None:
        by_height = _gain(motion, intervals, ahead, motion.positions[:, 0], -motion.positions[:, 3])
        if (climbed := _integrated(motion.velocities)) is not None:
            by_velocity = _gain(motion, intervals, ahead, climbed[:, 0], climbed[:, 1])
    each_other = _heights_against_velocity(motion)
    if by_velocity is not None:
        velocity = _verdict("gnss_vertical_velocity", by_velocity, "pitch", OF_VELOCITY)
    if by_height is not None:
        height = _verdict("gnss_height", by_height, "pitch", OF_HEIGHT)
    elif each_other is not None and velocity.verdict is Verdict.AGREES:
        height = _verdict("gnss_height", each_other, "vertical_velocity", OF_HEIGHT)
    if by_velocity is None and each_other is not None and height.verdict is Verdict.AGREES:
        velocity = _verdict("gnss_vertical_velocity", each_other, "height", OF_VELOCITY)
    return height, velocity


def _verdict(name: str, fit: tuple[float, float], against: str, codes: tuple[Code, Code]) -> Check:
    gain, sd = fit
    agrees, wrong = (explain(code, ratio=gain, sd_ratio=sd, against=against) for code in codes)
    values = gain, sd, 1.0, 1.5
    if gain > WRONG_GAIN:
        return Check(name, Verdict.AGREES, agrees, *values)
    if gain > -WRONG_GAIN or 1.0 - gain < SIGNIFICANCE_SDS * sd:
        return Check(name)
    return Check(name, Verdict.CONTRADICTS, wrong, *values)


def _gain(
    motion: Motion, intervals: Intervals, ahead: FloatArray, time: FloatArray, climb: FloatArray
) -> tuple[float, float] | None:
    """Factor of a climb [m] on that of pitch and speed, with its standard deviation."""
    if len(time) < MIN_WINDOWS or not np.isfinite(climb).any():
        return None
    first = _windows(intervals.begin)
    last = np.append(first[1:], len(intervals.begin)) - 1
    begin, end = intervals.begin[first], intervals.begin[last] + intervals.span[last]
    v, span = intervals.speed, intervals.span
    work = v * (intervals.force @ ahead) / STANDARD_GRAVITY
    rates = np.column_stack([work, v, v * intervals.acceleration, np.ones_like(v)])
    *rows, spans = np.add.reduceat(rates * span[:, np.newaxis], first).T
    whole = (last - first >= 3) & (np.abs(spans - (end - begin)) < 0.3) & _covered(time, begin, end)
    if whole.sum() < MIN_WINDOWS:
        return None
    climbs = np.interp(end[whole], time, climb) - np.interp(begin[whole], time, climb)
    return _known(least_squares(np.column_stack(rows)[whole], climbs[:, np.newaxis]))


def _windows(starts: FloatArray) -> npt.NDArray[np.intp]:
    """Place of the first interval of each window of `WINDOW_S`."""
    found, times, place = [], starts.tolist(), 0
    while place < len(times):
        found.append(place)
        place = bisect_left(times, times[place] + WINDOW_S)
    return np.array(found, dtype=np.intp)


def _covered(time: FloatArray, begin: FloatArray, end: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether times of measurements surround and fill each time from begin to end, without a gap of 3 s."""
    first, last = np.searchsorted(time, begin), np.searchsorted(time, end)
    gaps = np.concatenate([[0], np.cumsum(np.diff(time) >= 3.0)])  # until each time
    inside = (first > 0) & (last < len(time))
    found: npt.NDArray[np.bool_] = inside & (gaps[np.minimum(last, len(time) - 1)] == gaps[np.maximum(first - 1, 0)])
    return found


def _heights_against_velocity(motion: Motion) -> tuple[float, float] | None:
    """Factor of changes of height on the climb by the receiver's vertical velocity."""
    climbed = _integrated(motion.velocities)
    if climbed is None or len(motion.positions) < MIN_WINDOWS:
        return None
    edges = np.arange(climbed[0, 0], climbed[-1, 0], WINDOW_S)
    if len(edges) < MIN_WINDOWS:
        return None
    by_height = np.diff(np.interp(edges, motion.positions[:, 0], -motion.positions[:, 3]))
    by_velocity = np.diff(np.interp(edges, climbed[:, 0], climbed[:, 1]))
    way = np.full_like(by_height, WINDOW_S)
    return _known(least_squares(np.column_stack([by_velocity, way]), by_height[:, np.newaxis]))


def _known(fit: Fit | None) -> tuple[float, float] | None:
    if fit is None or float(fit.sd[0, 0]) > GAIN_SD:
        return None
    return float(fit.coefficients[0, 0]), float(fit.sd[0, 0])


def _integrated(velocities: FloatArray) -> FloatArray | None:
    """Time and climb [m] by the receiver's vertical velocity, shape (n, 2)."""
    known = velocities[np.isfinite(velocities[:, 3])]
    if len(known) < MIN_WINDOWS:
        return None
    up = -known[:, 3]
    step = np.diff(known[:, 0])
    climb = np.concatenate([[0.0], np.cumsum(0.5 * (up[1:] + up[:-1]) * step)])
    return np.column_stack([known[:, 0], climb])


def _mean_velocity(velocities: FloatArray, track: Velocities) -> FloatArray:
    """Mean horizontal velocity of the receiver over each time of a track [m/s], NaN where it has gaps, shape (n, 2)."""
    if len(velocities) < 2:
        return np.full((len(track.begin), 2), np.nan)
    time = velocities[:, 0]
    gap = np.interp(0.5 * (track.begin + track.end), 0.5 * (time[1:] + time[:-1]), np.diff(time))
    way = [np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(time))]) for v in velocities[:, 1:3].T]
    span = track.end - track.begin
    mean = np.column_stack([(np.interp(track.end, time, w) - np.interp(track.begin, time, w)) / span for w in way])
    inside = (track.begin >= time[0]) & (track.end <= time[-1]) & (gap < 1.5)
    return np.where(inside[:, np.newaxis], mean, np.nan)
