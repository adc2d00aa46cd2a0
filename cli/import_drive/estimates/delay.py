"""Estimates how late stamps are: those of fixes relative to the IMU, and those of a reference relative to the fixes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from statistics import fmean

import numpy as np

from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.messages import samples_of
from services.core.fusion.navigator import Navigator
from services.core.fusion.process import Config
from services.core.fusion.set_up.delay import MAX_DURATION_S as LARGEST_LAG_S
from services.core.fusion.set_up.delay import REPEATED, lag_of, lag_of_positions
from services.core.fusion.set_up.monitor import MIN_VELOCITIES
from services.core.fusion.set_up.motion import MotionLog
from services.core.fusion.settings import Settings
from shared.errors import UserError
from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingKind, TruthState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.runtime.config import VehicleFile

Input = ImuSamples | GnssFix | VehicleSpeed | WheelSpeeds

MAX_DURATION_S = 400.0  # of a drive, over which the delay of fixes is estimated
MAX_OFFSET_S = 2.0  # delay that a setting can correct
GRID_S, AROUND = 0.06, 2  # between two delays for which the filter runs, and how many on each side of the best
CLIPPED = 9.0  # squared normalised innovation above which it counts no more: that of an outlier
MAX_SD_S = 0.1  # standard deviation above which the delay of fixes is not known
LARGEST_S, STEP_S = 3.0, 0.02  # range and step of the delays of a reference
MIN_SPEED_M_S = 2.0  # the delay is not observable at standstill
GAP_S = 2.5  # longest time between two fixes that is interpolated
MIN_ROWS = 30
UNKNOWN = (
    "the delay of the fixes cannot be estimated: the drive has too few turns and changes of speed; give it as "
    "`stamps_late_s`"
)


@dataclass(frozen=True)
class Delay:
    """Delay of stamps [s]: positive if they are late; and its standard deviation."""

    seconds: float
    sd_s: float


def delay_of_fixes(messages: Iterable[Message], vehicle: VehicleFile) -> Delay:
    """Estimate the delay of the fixes relative to the inertial samples, of the first 400 s.

    Parameters
    ----------
    messages : iterable of Message
        Inertial samples, fixes and speeds in the order of arrival.
    vehicle : VehicleFile
        Its lever arm and noise; the delay found is that beyond `gnss.delay_s`.

    Returns
    -------
    Delay
        Near the lag by the check of the set-up, that of the greatest likelihood of the filter's innovations.

    Raises
    ------
    UserError
        The drive does not show the delay, or not to 0.1 s.

    Notes
    -----
    J, the sum of the squared normalised innovations of positions and velocities, is minus twice the logarithm of the
    likelihood. Through J of filters with delays d about the lag goes a parabola J = J0 + c (d - d0)²: d0 is the
    estimate, and r / c its variance, where of r innovations in a row one is independent.
    """
    settings = vehicle.section("core.fusion", Config)
    inputs = _first(messages)
    middle = round(_lag_s(inputs, settings) / GRID_S)
    squares: dict[int, list[float]] = {}
    while abs(middle) * GRID_S <= LARGEST_LAG_S:
        near = range(middle - AROUND, middle + AROUND + 1)
        squares |= {step: _squares(inputs, settings, step * GRID_S) for step in near if step not in squares}
        means = [fmean(squares[step]) for step in near]
        least = near[int(np.argmin(means))]
        if least == middle:
            return _at_the_bottom(np.array(near) * GRID_S, np.array(means) * len(squares[middle]))
        middle = least
    raise UserError(UNKNOWN)


def _at_the_bottom(delays_s: FloatArray, costs: FloatArray) -> Delay:
    """Delay of the least cost by a parabola."""
    curvature, slope, _ = np.polyfit(delays_s, costs, 2).tolist()
    if curvature <= REPEATED / MAX_SD_S**2:
        raise UserError(UNKNOWN)
    return Delay(round(-0.5 * slope / curvature, 3), float(np.sqrt(REPEATED / curvature)))


def _first(messages: Iterable[Message]) -> list[Input]:
    """Inertial samples, fixes and speeds of the time over which a delay is estimated."""
    inputs = (message for message in messages if isinstance(message, Input))
    first = next(inputs, None)
    if first is None:
        return []
    return [first, *takewhile(lambda m: m.received_ns - first.received_ns <= MAX_DURATION_S * 1e9, inputs)]


def _lag_s(inputs: Sequence[Input], settings: Settings) -> float:
    """Lag of the fixes [s] at which changes of speed and course fit the inertial sensors best."""
    log = MotionLog()
    for message in inputs:
        if isinstance(message, ImuSamples):
            log.samples(message.sampled_ns, message.specific_force_body_m_s2, message.angular_rate_body_rad_s)
        for measurement in measurements_of(message, settings):
            log.see(measurement)
    motion = log.motion()
    if motion is None:
        raise UserError(UNKNOWN)
    by_receiver = motion.of_receiver()
    found = lag_of_positions(motion) if len(by_receiver.begin) < MIN_VELOCITIES else lag_of(motion, by_receiver)
    if found is None:
        raise UserError(UNKNOWN)
    return found[0]


def _squares(inputs: Sequence[Input], settings: Settings, delay_s: float) -> list[float]:
    """Squared normalised innovations of GNSS, clipped, of a filter with a delay of fixes [s] beyond the settings."""
    delay_s += settings.gnss.delay_s
    if abs(delay_s) > MAX_OFFSET_S:
        raise UserError(UNKNOWN)
    navigator = Navigator(settings.with_values({"gnss.delay_s": delay_s}))
    squares = [
        min((z / sd) ** 2, CLIPPED)
        for outcome in _outcomes(navigator, inputs)
        if outcome.kind in (AidingKind.GNSS_POSITION, AidingKind.GNSS_VELOCITY)
        for z, sd in zip(outcome.innovation, outcome.innovation_sd, strict=True)
    ]
    if not squares:
        raise UserError(UNKNOWN)
    return squares


def _outcomes(navigator: Navigator, inputs: Sequence[Input]) -> Iterator[Outcome]:
    for message in inputs:
        if isinstance(message, ImuSamples):
            for sampled_ns, force, rate in samples_of(message):
                yield from navigator.imu(sampled_ns, force, rate, message.received_ns)
        for measurement in measurements_of(message, navigator.settings):
            navigator.measure(measurement)
    yield from navigator.finish()


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
    if min(len(time_s), len(fix_time_s)) < MIN_ROWS:
        raise UserError("the delay of the reference cannot be estimated from so few positions; give `stamps_late_s`")
    speed = np.hypot(*np.gradient(path, time_s, axis=0).T)
    after = np.clip(np.searchsorted(fix_time_s, time_s), 1, len(fix_time_s) - 1)
    near = fix_time_s[after] - fix_time_s[after - 1] < GAP_S
    inside = (time_s > fix_time_s[0] + LARGEST_S) & (time_s < fix_time_s[-1] - LARGEST_S)
    rows = near & inside & (speed > MIN_SPEED_M_S)
    if rows.sum() < MIN_ROWS:
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
