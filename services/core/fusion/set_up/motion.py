"""Motion of the last five minutes by inertial sensors, GNSS and wheels, separately and without a filter."""

from collections import deque
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import Vector

from ..aids.base import Measurement
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..aids.odometer import WheelSpeed
from ..inertial.propagation import GAP_S

FloatArray = npt.NDArray[np.float64]

WINDOW_S = 300.0
NODE_S = 0.05  # between two stored values of the integrals of force and rate
SHORTEST_S = 0.9  # of an interval between two velocities
SLACK_S = 1.6  # by which an interval may be longer
SIMPSON_S = 0.75  # step of means over an interval
COURSE_M_S = 3.0  # below it a course is noise
LARGEST_M_S2 = 8.0  # no tyre accelerates a car so much: GNSS has jumped
SPEED_S = 0.09  # least time between two speeds
SILENT_NS = 10_000_000_000  # after which another device is followed
MOST_EPOCHS = 6000  # 300 s at 20 Hz


class Velocities(NamedTuple):
    """Mean velocities [m/s, NED] over times [begin, end] in seconds; those of a receiver have begin = end."""

    begin: FloatArray  # shape (n,)
    end: FloatArray  # shape (n,)
    ned: FloatArray  # shape (n, 3)


@dataclass(frozen=True)
class Motion:
    """Time series of one window; stamps in seconds since its start.

    Attributes
    ----------
    nodes : ndarray, shape (n,)
        Times of the integrals.
    integrals : ndarray, shape (n, 7)
        Of specific force [m/s, body] and angular rate [rad, body], and the time [s] in gaps of samples.
    positions : ndarray, shape (m, 4)
        Time, and position against the first [m, NED].
    velocities : ndarray, shape (k, 4)
        Time, and velocity of the receiver [m/s, NED]; down is NaN where it is not measured.
    speeds : ndarray, shape (l, 2)
        Time, and speed of the odometer [m/s].
    """

    nodes: FloatArray
    integrals: FloatArray
    positions: FloatArray
    velocities: FloatArray
    speeds: FloatArray

    def of_receiver(self) -> Velocities:
        """Velocities that the receiver measures."""
        time = self.velocities[:, 0]
        return Velocities(time, time, self.velocities[:, 1:])

    def of_positions(self, shortest_s: float = SHORTEST_S, after_s: float = 0.0) -> Velocities:
        """Mean velocities between positions that are at least a time apart [s], from a time after the first on."""
        positions = self.positions[self.positions[:, 0] >= self.positions[:1, 0].sum() + after_s]
        chosen = _spaced(positions[:, 0], shortest_s)
        time, ned = positions[chosen, 0], positions[chosen, 1:]
        span = np.diff(time)
        fit = span <= shortest_s + SLACK_S
        mean = np.diff(ned, axis=0)[fit] / span[fit, np.newaxis]
        return Velocities(time[:-1][fit], time[1:][fit], mean)

    def integrals_at(self, time: FloatArray) -> FloatArray:
        """Integrals of force, rate and gaps at times, shape (*time.shape, 7)."""
        place = np.searchsorted(self.nodes, time).clip(1, len(self.nodes) - 1)
        before, after = self.nodes[place - 1], self.nodes[place]
        share = ((time - before) / (after - before))[..., np.newaxis]
        found: FloatArray = (1.0 - share) * self.integrals[place - 1] + share * self.integrals[place]
        return found


class Intervals(NamedTuple):
    """What GNSS and inertial sensors measured over the same intervals, one row each.

    `acceleration` is that of the speed, `lateral` speed times course rate; both are NaN where not known.
    """

    begin: FloatArray  # [s] shape (n,), middle of the first velocity
    span: FloatArray  # [s] shape (n,)
    speed: FloatArray  # [m/s] shape (n,)
    acceleration: FloatArray  # [m/s²] shape (n,)
    course_rate: FloatArray  # [rad/s] shape (n,), NaN below `COURSE_M_S`
    force: FloatArray  # [m/s², body] shape (n, 3)
    rate: FloatArray  # [rad/s, body] shape (n, 3)

    @property
    def lateral(self) -> FloatArray:
        """[m/s²] Acceleration to the right."""
        return self.speed * self.course_rate


@dataclass(frozen=True)
class Changes:
    """Changes between successive velocities of GNSS, one row each; `inertial` pairs them with the inertial sensors."""

    begin: FloatArray  # [s] shape (n, 2), times [begin, end] of the first velocity
    end: FloatArray  # [s] shape (n, 2), of the second
    speed: FloatArray  # [m/s] shape (n,)
    acceleration: FloatArray  # [m/s²] shape (n,)
    course_rate: FloatArray  # [rad/s] shape (n,)

    @classmethod
    def of(cls, velocities: Velocities, shortest_s: float = SHORTEST_S) -> "Changes":
        """Changes over at least a time [s], without those that no tyre makes."""
        times = np.column_stack([velocities.begin, velocities.end])
        chosen = _spaced(times.mean(axis=1), shortest_s)
        times, ned = times[chosen], velocities.ned[chosen]
        horizontal, course = np.hypot(ned[:, 0], ned[:, 1]), np.arctan2(ned[:, 1], ned[:, 0])
        span = np.diff(times.mean(axis=1))
        turn = np.remainder(np.diff(course) + np.pi, 2.0 * np.pi) - np.pi
        course_rate = np.where(np.minimum(horizontal[1:], horizontal[:-1]) > COURSE_M_S, turn, np.nan) / span
        speed, acceleration = 0.5 * (horizontal[1:] + horizontal[:-1]), np.diff(horizontal) / span
        sound = (span <= shortest_s + SLACK_S) & (np.abs(acceleration) < LARGEST_M_S2)
        sound &= ~(np.abs(speed * course_rate) > LARGEST_M_S2)
        return cls(times[:-1][sound], times[1:][sound], speed[sound], acceleration[sound], course_rate[sound])

    def within(self, motion: Motion, margin_s: float) -> "Changes":
        """Those that the inertial samples cover without a gap, moved by up to a margin."""
        first, last = motion.nodes[0] + margin_s, motion.nodes[-1] - margin_s
        covered = (self.begin[:, 0] - margin_s, self.end[:, 1] + margin_s)
        gaps = [np.interp(time, motion.nodes, motion.integrals[:, 6]) for time in covered]
        fit = (self.begin[:, 0] >= first) & (self.end[:, 1] <= last) & (gaps[0] == gaps[1])
        return Changes(self.begin[fit], self.end[fit], self.speed[fit], self.acceleration[fit], self.course_rate[fit])

    def inertial(self, motion: Motion, lag_s: float) -> FloatArray:
        """Mean force and rate over the same times, shape (n, 6), GNSS taken to be older by a lag.

        A mean velocity over [a, b] pairs with the mean over [a, b] of the inertial integral.
        """
        span = (self.end.mean(axis=1) - self.begin.mean(axis=1))[:, np.newaxis]
        gained: FloatArray = _mean_integrals(motion, self.end - lag_s) - _mean_integrals(motion, self.begin - lag_s)
        mean: FloatArray = gained[:, :6] / span
        return mean


def intervals_of(motion: Motion, velocities: Velocities, lag_s: float = 0.0) -> Intervals:
    """Pair changes of velocity with mean force and rate over the same times, with GNSS delayed by a lag."""
    changes = Changes.of(velocities).within(motion, abs(lag_s))
    inertial = changes.inertial(motion, lag_s)
    begin, end = changes.begin.mean(axis=1), changes.end.mean(axis=1)
    return Intervals(
        begin, end - begin, changes.speed, changes.acceleration, changes.course_rate, inertial[:, :3], inertial[:, 3:]
    )


def _mean_integrals(motion: Motion, times: FloatArray) -> FloatArray:
    """Means over times [begin, end] of the integrals, shape (n, 7), by Simpson's rule where they differ."""
    begin, end = times.T
    if np.array_equal(begin, end):
        return motion.integrals_at(begin)
    steps = 2 * max(1, round(0.5 * float((end - begin).max(initial=0.0)) / SIMPSON_S))
    weights = np.array([1.0, *([4.0, 2.0] * (steps // 2))[:-1], 1.0])
    mean = np.zeros((len(begin), 7))
    for share, weight in zip(np.linspace(0.0, 1.0, steps + 1).tolist(), weights.tolist(), strict=True):
        mean += weight / (3.0 * steps) * motion.integrals_at((1.0 - share) * begin + share * end)
    return mean


def _spaced(time: FloatArray, shortest_s: float) -> list[int]:
    """Indices of times that are at least a time apart [s]."""
    chosen: list[int] = []
    last = -inf
    for place, now in enumerate(time.tolist()):
        if now - last >= shortest_s - 1e-6:
            chosen.append(place)
            last = now
    return chosen


class MotionLog:
    """Collects the last `WINDOW_S` of samples and measurements, of one device of each kind."""

    def __init__(self) -> None:
        self._start_ns: int | None = None
        self._last_ns = 0
        self._sums = [0.0] * 7
        self._nodes: deque[tuple[float, ...]] = deque(maxlen=round(WINDOW_S / NODE_S))
        self._positions: deque[tuple[float, ...]] = deque(maxlen=MOST_EPOCHS)
        self._velocities: deque[tuple[float, ...]] = deque(maxlen=MOST_EPOCHS)
        self._speeds: deque[tuple[float, ...]] = deque(maxlen=MOST_EPOCHS)
        self._place: tuple[Geodetic, Vector] | None = None  # newest position, and it against the first [m, NED]
        self._followed: dict[type, tuple[str, int]] = {}  # device of each kind, and its newest stamp

    def sample(self, time_ns: int, force: Vector, rate: Vector) -> None:
        """Take the next inertial sample [m/s², rad/s; body], the mean over the step that ends at its stamp."""
        if self._start_ns is None:
            self._start_ns = self._last_ns = time_ns
            self._nodes.append((0.0,) * 8)
            return
        step = (time_ns - self._last_ns) * 1e-9
        if step <= 0.0:
            return
        sums = self._sums
        for place, value in enumerate((*force, *rate)):
            sums[place] += value * step
        if step > GAP_S:
            sums[6] += step
        self._last_ns = time_ns
        now_s = (time_ns - self._start_ns) * 1e-9
        if now_s - self._nodes[-1][0] >= NODE_S - 1e-6:
            self._nodes.append((now_s, *sums))

    def see(self, seen: Measurement) -> None:
        """Take a position, a velocity or a speed at its stamp; out-of-sequence ones are left out."""
        if self._start_ns is None or not self._follows(seen):
            return
        time_s = (seen.time_ns - self._start_ns) * 1e-9
        match seen:
            case GnssPosition():
                before, (north, east, down) = self._place or (seen.position, (0.0, 0.0, 0.0))
                n, e, d = ned_from_geodetic_difference(seen.position, before)
                self._place = seen.position, (north + n, east + e, down + d)
                self._positions.append((time_s, *self._place[1]))
            case GnssVelocity():
                north, east, down = seen.velocity
                self._velocities.append((time_s, north, east, down if seen.axes == 3 else float("nan")))
            case WheelSpeed() if not self._speeds or time_s - self._speeds[-1][0] >= SPEED_S:
                self._speeds.append((time_s, seen.speed))

    def _follows(self, seen: Measurement) -> bool:
        source, last_ns = self._followed.get(type(seen), (seen.source, seen.time_ns - 1))
        if seen.time_ns <= last_ns or (source != seen.source and seen.time_ns - last_ns < SILENT_NS):
            return False
        self._followed[type(seen)] = seen.source, seen.time_ns
        return True

    def motion(self) -> Motion | None:
        """Arrays of the window, or None without samples."""
        if len(self._nodes) < 2:
            return None
        nodes = np.array(self._nodes)
        begin = nodes[0, 0]

        def recent(rows: deque[tuple[float, ...]], width: int) -> FloatArray:
            table = np.array(rows).reshape(-1, width)
            kept: FloatArray = table[table[:, 0] >= begin]
            return kept

        return Motion(
            nodes[:, 0], nodes[:, 1:], recent(self._positions, 4), recent(self._velocities, 4), recent(self._speeds, 2)
        )
