"""Estimates the delay of position stamps relative to the gyroscope from the turns of the vehicle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import UserError
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState

EARLIEST_S, LATEST_S, STEP_S = -1.0, 3.0, 0.01
CHORD_S = (0.7, 1.6)  # time between two positions whose direction is used
SLOWEST_M_S = 2.0  # the direction of a shorter chord is noise
LEAST_TURN_RAD = 1.0  # sum of the turns: below it the delay is not observable
LEAST_CHORDS = 20


@dataclass(frozen=True)
class Delay:
    """Delay of the stamps [s], its standard deviation, and the RMS of the turns that remain [rad]."""

    seconds: float
    sd_s: float
    rms_rad: float


def delay_of(points: Sequence[GnssFix | TruthState], imu: Sequence[ImuSamples]) -> Delay:
    """Estimate by how much the stamps of positions are late, relative to those of the gyroscope.

    Parameters
    ----------
    points : sequence of GnssFix or TruthState
        Positions, about 0.5 Hz or faster.
    imu : sequence of ImuSamples
        Angular rates in body axes.

    Returns
    -------
    Delay
        Positive: the stamps of the positions are late.

    Raises
    ------
    UserError
        The vehicle does not turn enough while it drives.

    Notes
    -----
    The change of the course c between successive chords of positions is that of the heading, the integral of the yaw
    rate w about gravity, plus that of the slip at an antenna a distance l ahead of the rear axle, w l / v. For each
    delay d, yaw bias b and l minimise the sum of squares of::

        e_k = c_{k+1} - c_k - [h(t_{k+1} - d) - h(t_k - d)] - b (t_{k+1} - t_k) - l (w_{k+1} / v_{k+1} - w_k / v_k)

    with h the integral of w. The delay is that of the least sum S; its variance is 2 S / n over the second derivative
    of S.
    """
    time_s, course, speed = _chords(points)
    heading_time_s, heading, rate = _headings(imu)
    inside = (time_s[:-1] + EARLIEST_S > heading_time_s[0] - 1.0) & (time_s[1:] < heading_time_s[-1] + 1.0)
    turn = (np.diff(course) + np.pi) % (2.0 * np.pi) - np.pi
    used = inside & (np.diff(time_s) < CHORD_S[1]) & (np.minimum(speed[1:], speed[:-1]) > SLOWEST_M_S)
    if used.sum() < LEAST_CHORDS or np.abs(turn[used]).sum() < LEAST_TURN_RAD:
        raise UserError(
            "the delay of the stamps cannot be estimated: the vehicle turns too little while it drives; give it as "
            "`stamps_late_s`"
        )

    def squares(delay_s: float) -> float:
        here = np.interp(time_s - delay_s, heading_time_s, heading)
        slip = np.interp(time_s - delay_s, heading_time_s, rate) / np.maximum(speed, SLOWEST_M_S)
        left = turn - np.diff(here)
        left = ((left + np.pi) % (2.0 * np.pi) - np.pi)[used]
        columns = np.column_stack([np.diff(time_s), np.diff(slip)])[used]
        good = np.abs(left) < 0.5  # a position that jumps turns its chords by more
        solution, *_ = np.linalg.lstsq(columns[good], left[good], rcond=None)
        return float(np.mean((left[good] - columns[good] @ solution) ** 2))

    delays = np.arange(EARLIEST_S, LATEST_S, STEP_S)
    costs = np.array([squares(delay) for delay in delays.tolist()])
    near = slice(max(0, int(costs.argmin()) - 10), int(costs.argmin()) + 11)
    curvature, slope, _ = np.polyfit(delays[near], costs[near], 2)
    if curvature <= 0.0 or not 0 < costs.argmin() < len(costs) - 1:
        raise UserError(
            f"the delay of the stamps lies outside {EARLIEST_S:g} to {LATEST_S:g} s, or the drive does not determine "
            "it; give it as `stamps_late_s`"
        )
    least = float(costs.min())
    variance = least / used.sum() / curvature
    return Delay(round(float(-0.5 * slope / curvature), 3), float(np.sqrt(variance)), float(np.sqrt(least)))


def _chords(points: Sequence[GnssFix | TruthState]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middle times [s], courses [rad] and speeds [m/s] of chords of about a second."""
    known = [p for p in points if p.latitude_deg is not None and p.longitude_deg is not None]
    if len(known) < 2:
        return np.zeros(1), np.zeros(1), np.zeros(1)
    stamps = np.array([p.sampled_ns for p in known], dtype=float) * 1e-9
    place = np.array([[np.radians(p.latitude_deg or 0.0), np.radians(p.longitude_deg or 0.0), 0.0] for p in known])
    path = ned_track(place, Geodetic(*place[0].tolist()))[:, :2]
    stride = max(1, round(1.0 / float(np.median(np.diff(stamps)))))
    lengths = stamps[stride:] - stamps[:-stride]
    chords = path[stride:] - path[:-stride]
    kept = (lengths > CHORD_S[0]) & (lengths < CHORD_S[1])
    rows = np.flatnonzero(kept)[::stride]  # chords that do not overlap
    middle: FloatArray = 0.5 * (stamps[stride:] + stamps[:-stride])[rows]
    return middle, np.arctan2(chords[rows, 1], chords[rows, 0]), np.hypot(*chords[rows].T) / lengths[rows]


def _headings(imu: Sequence[ImuSamples]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times [s], integral of the yaw rate [rad], and yaw rate smoothed over a second [rad/s]."""
    stamps = np.array([stamp for message in imu for stamp in message.sampled_ns], dtype=float) * 1e-9
    rates = np.array([rate for message in imu for rate in message.angular_rate_body_rad_s])
    forces = np.array([force for message in imu for force in message.specific_force_body_m_s2])
    down = -forces.mean(axis=0) / np.linalg.norm(forces.mean(axis=0))
    yaw = rates @ down
    steps = np.diff(stamps)
    heading: FloatArray = np.r_[0.0, np.cumsum(0.5 * (yaw[1:] + yaw[:-1]) * np.minimum(steps, 1.5))]
    width = max(1, round(1.0 / float(np.median(steps))))
    smooth: FloatArray = np.convolve(yaw, np.ones(width) / width, mode="same")
    return stamps, heading, smooth
