"""Motion of the last five minutes by inertial sensors, GNSS and wheels, separately and without a filter."""

from array import array
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import inf, nan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import Vector

from ..aids.base import Measurement
from ..inertial.propagation import GAP_S

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Samples = tuple[Sequence[int], Sequence[Vector], Sequence[Vector]]  # stamps [ns], forces and rates of a batch

WINDOW_S = 300.0
NODE_S = 0.05  # between two stored values of the integrals of force and rate
MIN_DURATION_S = 0.9  # of an interval between two velocities
SLACK_S = 1.6  # by which an interval may be longer
SIMPSON_S = 0.75  # step of means over an interval
COURSE_M_S = 3.0  # below it a course is noise
MAX_M_S2 = 8.0  # no tyre accelerates a car so much: GNSS has jumped
SPEED_S = 0.09  # least time between two speeds
SILENCE_TIMEOUT_NS = 10_000_000_000  # after which another device is followed
MAX_EPOCHS = 6000  # 300 s at 20 Hz
MAX_WAITING = 4000  # batches of samples, more than those between two evaluations


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
    integrals : ndarray, shape (6, n)
        Of specific force [m/s, body] and angular rate [rad, body].
    gaps : ndarray, shape (n,)
        Time [s] in gaps of samples.
    positions : ndarray, shape (m, 4)
        Time, and position against the first [m, NED].
    velocities : ndarray, shape (k, 4)
        Time, and velocity of the receiver [m/s, NED]; down is NaN where it is not measured.
    speeds : ndarray, shape (l, 2)
        Time, and speed of the odometer [m/s].
    place : Geodetic, optional
        Newest position.
    """

    nodes: FloatArray
    integrals: FloatArray
    gaps: FloatArray
    positions: FloatArray
    velocities: FloatArray
    speeds: FloatArray
    place: Geodetic | None = None

    def of_receiver(self) -> Velocities:
        """Velocities that the receiver measures."""
        time = self.velocities[:, 0]
        return Velocities(time, time, self.velocities[:, 1:])

    def of_positions(self, shortest_s: float = MIN_DURATION_S, after_s: float = 0.0) -> Velocities:
        """Mean velocities between positions that are at least a time apart [s], from a time after the first on."""
        positions = self.positions[self.positions[:, 0] >= self.positions[:1, 0].sum() + after_s]
        chosen = _spaced(positions[:, 0], shortest_s)
        time, ned = positions[chosen, 0], positions[chosen, 1:]
        span = np.diff(time)
        fit = span <= shortest_s + SLACK_S
        mean = np.diff(ned, axis=0)[fit] / span[fit, np.newaxis]
        return Velocities(time[:-1][fit], time[1:][fit], mean)

    def integrals_at(self, time: FloatArray) -> FloatArray:
        """Integrals of force and rate at times, shape (6, *time.shape)."""
        place = np.searchsorted(self.nodes, time).clip(1, len(self.nodes) - 1)
        before, after = self.nodes[place - 1], self.nodes[place]
        share = (time - before) / (after - before)
        found: FloatArray = self.integrals.take(place - 1, axis=1) * (1.0 - share)
        found += self.integrals.take(place, axis=1) * share
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

    times: FloatArray  # [s] shape (m, 2), [begin, end] of each velocity
    rows: IntArray  # shape (n,), the first velocity of each change; the second one follows it
    speed: FloatArray  # [m/s] shape (n,)
    acceleration: FloatArray  # [m/s²] shape (n,)
    course_rate: FloatArray  # [rad/s] shape (n,)

    @classmethod
    def of(cls, velocities: Velocities, shortest_s: float = MIN_DURATION_S) -> "Changes":
        """Changes over at least a time [s], without those that no tyre makes."""
        times = np.column_stack([velocities.begin, velocities.end])
        chosen = _spaced(times.mean(axis=1), shortest_s)
        times, ned = times[chosen], velocities.ned[chosen]
        horizontal, course = np.hypot(ned[:, 0], ned[:, 1]), np.arctan2(ned[:, 1], ned[:, 0])
        span = np.diff(times.mean(axis=1))
        turn = np.remainder(np.diff(course) + np.pi, 2.0 * np.pi) - np.pi
        course_rate = np.where(np.minimum(horizontal[1:], horizontal[:-1]) > COURSE_M_S, turn, np.nan) / span
        speed, acceleration = 0.5 * (horizontal[1:] + horizontal[:-1]), np.diff(horizontal) / span
        sound = (span <= shortest_s + SLACK_S) & (np.abs(acceleration) < MAX_M_S2)
        sound &= ~(np.abs(speed * course_rate) > MAX_M_S2)
        return cls(times, np.flatnonzero(sound), speed[sound], acceleration[sound], course_rate[sound])

    @property
    def begin(self) -> FloatArray:
        """Times [begin, end] of the first velocity of each [s], shape (n, 2)."""
        return self.times[self.rows]

    @property
    def end(self) -> FloatArray:
        """Times [begin, end] of the second velocity of each [s], shape (n, 2)."""
        return self.times[self.rows + 1]

    def within(self, motion: Motion, margin_s: float) -> "Changes":
        """Those that the inertial samples cover without a gap, moved by up to a margin."""
        first, last = motion.nodes[0] + margin_s, motion.nodes[-1] - margin_s
        begin, end = self.begin[:, 0], self.end[:, 1]
        gaps = [np.interp(time, motion.nodes, motion.gaps) for time in (begin - margin_s, end + margin_s)]
        fit = (begin >= first) & (end <= last) & (gaps[0] == gaps[1])
        return Changes(self.times, self.rows[fit], self.speed[fit], self.acceleration[fit], self.course_rate[fit])

    def inertial(self, motion: Motion, lags_s: FloatArray) -> FloatArray:
        """Mean force and rate over the same times, GNSS taken to be older by each of some lags.

        A mean velocity over [a, b] pairs with the mean over [a, b] of the inertial integral.

        Parameters
        ----------
        motion : Motion
            Of the window.
        lags_s : ndarray, shape (l,)
            [s] Lags.

        Returns
        -------
        ndarray, shape (6, l, n)
            [m/s², rad/s, body]
        """
        used, places = np.unique(np.stack([self.rows, self.rows + 1]), return_inverse=True)
        means = _mean_integrals(motion, self.times[used], lags_s)
        first, second = places
        middle = self.times[used].mean(axis=1)
        gained: FloatArray = means.take(second, axis=2) - means.take(first, axis=2)
        gained /= middle[second] - middle[first]
        return gained


def intervals_of(motion: Motion, velocities: Velocities, lag_s: float = 0.0) -> Intervals:
    """Pair changes of velocity with mean force and rate over the same times, with GNSS delayed by a lag."""
    changes = Changes.of(velocities).within(motion, abs(lag_s))
    inertial = changes.inertial(motion, np.array([lag_s]))[:, 0].T
    begin, end = changes.begin.mean(axis=1), changes.end.mean(axis=1)
    return Intervals(
        begin, end - begin, changes.speed, changes.acceleration, changes.course_rate, inertial[:, :3], inertial[:, 3:]
    )


def _mean_integrals(motion: Motion, times: FloatArray, lags_s: FloatArray) -> FloatArray:
    """Means of the integrals over times [begin, end] less lags, shape (6, l, n), by Simpson's rule if they differ."""
    begin, end = (time - lags_s[:, np.newaxis] for time in times.T)
    if np.array_equal(begin, end):
        return motion.integrals_at(begin)
    steps = 2 * max(1, round(0.5 * float((end - begin).max(initial=0.0)) / SIMPSON_S))
    weights = np.array([1.0, *([4.0, 2.0] * (steps // 2))[:-1], 1.0])
    mean = np.zeros((6, *begin.shape))
    for share, weight in zip(np.linspace(0.0, 1.0, steps + 1).tolist(), weights.tolist(), strict=True):
        mean += weight / (3.0 * steps) * motion.integrals_at((1.0 - share) * begin + share * end)
    return mean


def _spaced(time: FloatArray, shortest_s: float, last: float = -inf) -> list[int]:
    """Indices of sorted times that are at least a time apart [s], also from a last one before."""
    chosen, times = list[int](), time.tolist()
    place = bisect_left(times, last + shortest_s - 1e-6)
    while place < len(times):
        chosen.append(place)
        place = bisect_left(times, times[place] + shortest_s - 1e-6, place + 1)
    return chosen


class _Rows:
    """The newest rows of numbers, each with its time [s] first."""

    def __init__(self, width: int, most: int) -> None:
        self._numbers, self._width, self._most = array("d"), width, width * most

    def extend(self, rows: FloatArray) -> None:
        """Append rows, shape (n, width)."""
        self._numbers.frombytes(rows.tobytes())
        if len(self._numbers) > 2 * self._most:
            del self._numbers[: -self._most]

    def append(self, *row: float) -> None:
        """Append one row."""
        self.extend(np.array(row))

    def table(self, begin_s: float = -inf) -> FloatArray:
        """The rows from a time on, shape (n, width)."""
        rows = np.frombuffer(self._numbers).reshape(-1, self._width)[-self._most // self._width :]
        return rows[np.searchsorted(rows[:, 0], begin_s) :].copy()


class MotionLog:
    """Collects the last `window_s` of samples and measurements, of one device of each kind."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        epochs = round(MAX_EPOCHS * window_s / WINDOW_S)
        self._start_ns: int | None = None
        self._waiting: list[Samples] = []  # not yet integrated
        self._last_ns, self._sums = 0, np.zeros(7)  # stamp of the newest sample, and the integrals until then
        self._nodes, self._node_s = _Rows(8, round(window_s / NODE_S)), 0.0  # and time of the newest
        self._positions, self._velocities = _Rows(4, epochs), _Rows(4, epochs)
        self._speeds = _Rows(2, epochs)
        self._place: tuple[Geodetic, Vector] | None = None  # newest position, and it against the first [m, NED]
        self._speed_s = -inf  # time of the newest speed
        self._seen_s = 0.0  # stamp of the measurement that is told
        self._followed: dict[type, tuple[str, int]] = {}  # device of each kind, and its newest stamp

    def samples(self, stamps_ns: Sequence[int], forces: Sequence[Vector], rates: Sequence[Vector]) -> None:
        """Take inertial samples [m/s², rad/s; body], each the mean over the step that ends at its stamp."""
        if self._start_ns is None:
            self._start_ns = self._last_ns = stamps_ns[0]
            self._nodes.append(0.0, *self._sums)
        self._waiting.append((stamps_ns, forces, rates))
        if len(self._waiting) >= MAX_WAITING:
            self._integrate()

    def see(self, seen: Measurement) -> None:
        """Take a position, a velocity or a speed at its stamp; out-of-sequence ones are left out."""
        if self._start_ns is None or not self._follows(seen):
            return
        self._seen_s = (seen.time_ns - self._start_ns) * 1e-9
        seen.show(self)

    def see_position(self, position: Geodetic) -> None:
        """Take a position."""
        before, (north, east, down) = self._place or (position, (0.0, 0.0, 0.0))
        n, e, d = ned_from_geodetic_difference(position, before)
        self._place = position, (north + n, east + e, down + d)
        self._positions.append(self._seen_s, *self._place[1])

    def see_velocity(self, velocity: Vector, axes: int) -> None:
        """Take a velocity [m/s, NED], of which so many axes were measured."""
        north, east, down = velocity
        self._velocities.append(self._seen_s, north, east, down if axes == 3 else nan)

    def see_speed(self, speed: float) -> None:
        """Take a speed [m/s]."""
        if self._seen_s - self._speed_s >= SPEED_S:
            self._speed_s = self._seen_s
            self._speeds.append(self._seen_s, speed)

    def _follows(self, seen: Measurement) -> bool:
        source, last_ns = self._followed.get(type(seen), (seen.source, seen.time_ns - 1))
        if seen.time_ns <= last_ns or (source != seen.source and seen.time_ns - last_ns < SILENCE_TIMEOUT_NS):
            return False
        self._followed[type(seen)] = seen.source, seen.time_ns
        return True

    def motion(self) -> Motion | None:
        """Arrays of the window, or None without samples."""
        self._integrate()
        nodes = self._nodes.table()
        if len(nodes) < 2:
            return None
        begin_s = float(nodes[0, 0])
        positions, velocities, speeds = (
            rows.table(begin_s) for rows in (self._positions, self._velocities, self._speeds)
        )
        times, *integrals, gaps = nodes.T
        place = None if self._place is None else self._place[0]
        return Motion(times, np.array(integrals), gaps, positions, velocities, speeds, place)

    def _integrate(self) -> None:
        """Add the waiting samples to the integrals; those out of order are left out."""
        if self._start_ns is None or not self._waiting:
            return
        batches, *vectors = (chain.from_iterable(part) for part in zip(*self._waiting, strict=True))
        stamps = np.fromiter(batches, np.int64)
        force, rate = (np.fromiter(chain.from_iterable(part), np.float64).reshape(-1, 3) for part in vectors)
        self._waiting.clear()
        newer = stamps > np.maximum.accumulate(np.concatenate([[self._last_ns], stamps]))[:-1]
        if not newer.any():
            return
        ends = stamps[newer]
        step = np.diff(ends, prepend=self._last_ns) * 1e-9
        gained = np.hstack([force, rate])[newer] * step[:, np.newaxis]
        in_gaps = np.where(step > GAP_S, step, 0.0)
        sums = np.cumsum(np.vstack([self._sums, np.column_stack([gained, in_gaps])]), axis=0)[1:]
        self._last_ns, self._sums = int(ends[-1]), sums[-1]
        times = np.asarray((ends - self._start_ns) * 1e-9, dtype=np.float64)
        if chosen := _spaced(times, NODE_S, self._node_s):
            self._node_s = float(times[chosen[-1]])
            self._nodes.extend(np.column_stack([times[chosen], sums[chosen]]))
