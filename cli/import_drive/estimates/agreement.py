"""Compares the clocks of files by when they were recorded and by the motion that each of them saw."""

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import cos, nan, sin

import numpy as np

from shared.maths.earth import FloatArray, Geodetic, ned_track
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

GRID_S = 0.2
MAX_DURATION_S = 6 * 3600.0  # of a file, of which the motion is compared
MIN_SPEED_M_S = 1.5  # below which the course of a receiver is noise
LEAST_OVERLAP_S, LEAST_OVERLAP = 20.0, 0.5  # seconds, and fraction of the shorter file, that a comparison needs
AGREES, CLEARLY = 0.7, 0.2  # correlation of two that agree, and by how much it exceeds that of the clocks as they are
MIN_SHIFT_S = 0.9  # smaller ones are delays, which `obu solve` estimates
MIN_SPREAD = 1e-3  # [m/s, m/s2, rad/s] standard deviation of a channel below which nothing moved
OFFSET_TOLERANCE_S = 0.7  # of a named offset
HALF_SHARED = 0.5  # fraction of the shorter file below which an overlap is told
OFFSETS_S: dict[float, str] = {
    18.0: "the leap seconds between GPS time and UTC",
    19.0: "the seconds between TAI and GPS time",
    37.0: "the leap seconds between TAI and UTC",
    14.0: "the seconds between GPS time and BeiDou time",
    4.0: "the leap seconds between BeiDou time and UTC",
    86_400.0: "one day",
    604_800.0: "one week",
    619_315_200.0: "1024 weeks, after which GPS weeks begin anew",
    315_964_800.0: "the seconds from 1970 to 1980, where GPS time begins",
    315_964_782.0: "the seconds from 1970 to 1980, where GPS time begins, less the leap seconds",
}
ZONE_S, WIDEST_ZONE_S = 1800.0, 14 * 3600.0


@dataclass
class Motion:
    """When a file was recorded [s], and the motion that it saw on a grid of `GRID_S`."""

    first_s: float
    last_s: float
    channels: dict[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class Agreement:
    """The shift of the second clock at which both motions agree best."""

    shift_s: float  # to add to the stamps of the second
    correlation: float
    correlation_unshifted: float  # 0 without overlap


class MotionLog:
    """Collects what the messages of one device say of the motion."""

    def __init__(self) -> None:
        self._rows, self._width = array("d"), 1
        self._names: tuple[str, ...] = ()

    def add(self, message: Message) -> None:
        """Add a message; one of another kind than the first is ignored."""
        for names, row in _said(message):
            if not self._names:
                self._names, self._width = names, len(row)
            if names == self._names:
                self._rows.extend(row)

    def motion(self) -> Motion | None:
        """When the messages were made, and the motion that they say; None without a stamp."""
        if not self._rows:
            return None
        values = np.frombuffer(self._rows).reshape(-1, self._width)
        values = values[np.r_[True, np.diff(values[:, 0]) > 0.0]]
        motion = Motion(float(values[0, 0]), float(values[-1, 0]))
        values = values[values[:, 0] < motion.first_s + MAX_DURATION_S]
        if len(values) > 2 and motion.last_s - motion.first_s >= LEAST_OVERLAP_S:
            positions = self._names[0] == "north"
            motion.channels = _of_positions(values) if positions else _of_sensor(values, self._names)
        return motion


def motion_of(messages: Iterable[Message]) -> Motion | None:
    """The motion that some messages of one device say; None without a stamp."""
    log = MotionLog()
    for message in messages:
        log.add(message)
    return log.motion()


def _said(message: Message) -> Iterator[tuple[tuple[str, ...], tuple[float, ...]]]:
    """Names of the quantities, and rows of a stamp [s] and their values."""
    match message:
        case ImuSamples():
            forces, rates = message.specific_force_body_m_s2, message.angular_rate_body_rad_s
            for stamp, force, rate in zip(message.sampled_ns, forces, rates, strict=True):
                yield ("acceleration", "rate"), (stamp * 1e-9, force[0], rate[2])
        case VehicleSpeed():
            yield ("speed",), (message.sampled_ns * 1e-9, abs(message.speed_m_s))
        case WheelSpeeds() if known := [speed for speed in _wheels(message) if speed is not None]:
            yield ("speed",), (message.sampled_ns * 1e-9, abs(sum(known)) / len(known))
        case GnssFix() | TruthState() if message.latitude_deg is not None and message.longitude_deg is not None:
            position = message.latitude_deg, message.longitude_deg
            yield ("north", "east"), (message.sampled_ns * 1e-9, *position, *_velocity(message))


def _wheels(message: WheelSpeeds) -> tuple[float | None, ...]:
    return message.front_left_m_s, message.front_right_m_s, message.rear_left_m_s, message.rear_right_m_s


def _velocity(message: GnssFix | TruthState) -> tuple[float, float]:
    """Velocity to north and east [m/s]; not a number where it is unknown."""
    if message.velocity_ned_m_s is not None:
        return message.velocity_ned_m_s[:2]
    if isinstance(message, GnssFix) and message.ground_speed_m_s is not None and message.course_rad is not None:
        return (message.ground_speed_m_s * cos(message.course_rad), message.ground_speed_m_s * sin(message.course_rad))
    return nan, nan


def _of_positions(values: FloatArray) -> dict[str, FloatArray]:
    """Speed, acceleration and rate of turn from velocities, or where they are rare from positions."""
    grid = np.arange(values[0, 0], values[-1, 0], GRID_S)
    moving = values[np.isfinite(values[:, 3])]
    if len(moving) > LEAST_OVERLAP * len(values):
        velocity_n, velocity_e = (np.interp(grid, moving[:, 0], moving[:, column]) for column in (3, 4))
    else:
        places = np.column_stack([np.radians(values[:, 1:3]), np.zeros(len(values))])
        track = ned_track(places, Geodetic(*places[0].tolist()))
        velocity_n, velocity_e = (_slope(np.interp(grid, values[:, 0], track[:, axis])) for axis in (0, 1))
    speed = np.hypot(velocity_n, velocity_e)
    course = np.unwrap(np.arctan2(velocity_e, velocity_n))
    return {"speed": speed, "acceleration": _slope(speed), "rate": np.where(speed > MIN_SPEED_M_S, _slope(course), 0.0)}


def _of_sensor(values: FloatArray, names: Sequence[str]) -> dict[str, FloatArray]:
    """Channels of a sensor as means over about the same time as those of positions."""
    grid = np.arange(values[0, 0], values[-1, 0], GRID_S)
    channels = {}
    for name, column in zip(names, values[:, 1:].T, strict=True):
        middle = 0.5 * (column[1:] + column[:-1])
        total = np.r_[0.0, np.cumsum(middle * np.diff(values[:, 0]))]
        channels[name] = _slope(np.interp(grid, values[:, 0], total))
    if "speed" in channels:
        channels["acceleration"] = _slope(channels["speed"])
    return channels


def _slope(values: FloatArray) -> FloatArray:
    """Rate of change over about a second, of the length of the values."""
    reach = round(0.5 / GRID_S)
    places = np.arange(len(values))
    before, after = np.maximum(places - reach, 0), np.minimum(places + reach, len(values) - 1)
    slope: FloatArray = (values[after] - values[before]) / (np.maximum(after - before, 1) * GRID_S)
    return slope


def agreement_of(first: Motion, second: Motion) -> Agreement | None:
    """Find the shift of the second clock at which the motions agree best.

    Returns
    -------
    Agreement or None
        None if one of them hardly moved, or has no quantity of the other.

    Notes
    -----
    The normalised cross-correlation over all common channels, each divided by its standard deviation::

        r(s) = sum a(t) b(t - s) / sqrt(sum a(t)^2 sum b(t - s)^2)

    with sums over the time in which both are known after the shift: at least half of the shorter file.
    """
    from scipy.signal import fftconvolve  # which takes 0.4 s to import

    common = [name for name in ("speed", "acceleration", "rate") if name in first.channels and name in second.channels]
    pairs = []
    for name in common:
        a, b = first.channels[name], second.channels[name]
        spread_a, spread_b = float(np.std(a)), float(np.std(b))
        if min(spread_a, spread_b) > MIN_SPREAD:
            pairs.append(((a - np.mean(a)) / spread_a, (b - np.mean(b)) / spread_b))
    if not pairs:
        return None
    of_first, of_second = (len(pair) for pair in pairs[0])
    shorter = min(of_first, of_second)
    ends = np.arange(1, of_first + of_second)
    counts = np.minimum(np.minimum(ends, ends[::-1]), shorter)
    enough = counts * GRID_S >= max(LEAST_OVERLAP_S, LEAST_OVERLAP * shorter * GRID_S)
    if not enough.any():
        return None
    products = np.sum([fftconvolve(a, b[::-1]) for a, b in pairs], axis=0)
    energies_a = np.sum([fftconvolve(a**2, np.ones(of_second)) for a, _ in pairs], axis=0)
    energies_b = np.sum([fftconvolve(np.ones(of_first), b[::-1] ** 2) for _, b in pairs], axis=0)
    correlation = np.where(enough, products / np.sqrt(np.maximum(energies_a * energies_b, 1e-12)), -1.0)
    shifts = (ends - of_second) * GRID_S + first.first_s - second.first_s
    best = int(np.argmax(correlation))
    here = int(np.argmin(np.abs(shifts)))
    unshifted = float(correlation[here]) if abs(shifts[here]) <= GRID_S and enough[here] else 0.0
    return Agreement(float(shifts[best]), float(correlation[best]), unshifted)


def told(motions: Mapping[str, Motion]) -> list[str]:
    """Compare the clocks of all files with that of the first; one sentence for each that does not fit.

    Parameters
    ----------
    motions : mapping of str to Motion
        By the name of the file or device, the reference first.
    """
    names = list(motions)
    return [said for name in names[1:] if (said := _told(names[0], motions[names[0]], name, motions[name]))]


def _told(first: str, a: Motion, second: str, b: Motion) -> str:
    shared_s = min(a.last_s, b.last_s) - max(a.first_s, b.first_s)
    shortest_s = min(a.last_s - a.first_s, b.last_s - b.first_s)
    shift_s, why = _likely(a, b)
    if shift_s is None:
        if shared_s >= HALF_SHARED * shortest_s:
            return ""
        return f"{_overlap(first, a, second, b, shared_s)} Check the clock of each, and `offset_s` in `time`."
    said = "" if shared_s >= HALF_SHARED * shortest_s else _overlap(first, a, second, b, shared_s) + " "
    return (
        f"{said}The clocks of {first} and {second} are probably {abs(shift_s):.10g} s apart ({why}){_named(shift_s)}. "
        f"Add {shift_s:+.10g} to `offset_s` in `time` of {second}{_scale(shift_s, first, second)}."
    )


def _likely(a: Motion, b: Motion) -> tuple[float | None, str]:
    """The shift of the second clock that is likely, and why; None if the clocks may well agree."""
    found = agreement_of(a, b)
    if found is not None and found.correlation >= AGREES:
        if abs(found.shift_s) < MIN_SHIFT_S or found.correlation < found.correlation_unshifted + CLEARLY:
            return None, ""
        near = _nearest(found.shift_s)
        shift_s = found.shift_s if near is None else float(np.copysign(near, found.shift_s))
        return round(shift_s, 1), (
            f"their motions correlate by {found.correlation:.2f} after that shift, and by "
            f"{found.correlation_unshifted:.2f} as they are"
        )
    begin_s, end_s = a.first_s - b.first_s, a.last_s - b.last_s
    near = _nearest(begin_s)
    if near is not None and near == _nearest(end_s):
        return float(np.copysign(near, begin_s)), "one begins and ends that much after the other"
    return None, ""


def _nearest(seconds: float) -> float | None:
    """The named offset that a shift is close to, without its sign."""
    size = abs(seconds)
    zones = [round(size / ZONE_S) * ZONE_S] if ZONE_S / 2 < size < WIDEST_ZONE_S + ZONE_S / 2 else []
    return next((known for known in (*OFFSETS_S, *zones) if abs(size - known) <= OFFSET_TOLERANCE_S), None)


def _named(shift_s: float) -> str:
    near = _nearest(shift_s)
    if near is None:
        return ""
    return f": {OFFSETS_S.get(near) or f'a time zone of {near / 3600.0:g} h, or daylight saving time'}"


def _scale(shift_s: float, first: str, second: str) -> str:
    if abs(abs(shift_s) - 18.0) > OFFSET_TOLERANCE_S:
        return ""
    return f', or set `scale = "gps"` in that of {second if shift_s < 0.0 else first}'


def _overlap(first: str, a: Motion, second: str, b: Motion, shared_s: float) -> str:
    spans = (
        f"{first} from {_date(a.first_s)} to {_date(a.last_s)}, {second} from {_date(b.first_s)} to {_date(b.last_s)}"
    )
    if shared_s <= 0.0:
        return f"{first} and {second} do not overlap in time: {spans}."
    return f"{first} and {second} overlap by {shared_s:.1f} s only: {spans}."


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").removesuffix("+00:00")
