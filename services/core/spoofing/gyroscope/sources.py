"""Seconds of wheel speeds and readings of headings, each with the gyroscope's turn at the same times."""

from collections import Counter, deque
from collections.abc import Iterator
from math import atan2, hypot, isfinite
from typing import NamedTuple, Protocol

from shared.inertial.increments import SECOND_NS
from shared.maths.rotation import Vector
from shared.messages.vehicle import WheelSpeeds

from ..settings import UNKNOWN_AXLE_M, Settings
from .axle import AxleSecond
from .track import GyroscopeTrack, Turn

HISTORY_SECONDS = 330  # seconds: the longest window, and what is late
MAX_PENDING = 50  # samples and readings that the increments have not reached yet, 5 s
MIN_SAMPLES = 4  # of a second
MAX_SPEED_M_S = 100.0
FRONT_CURVATURE = 0.07  # [1/m] up to which the cosine of the steering angle is above 0.98 (wheelbase of 2.8 m)
MIN_SPEED_M_S = 0.5  # speed of the wheels below which they may turn unseen
MIN_COURSE_M_S = 5.0  # GNSS speed that has a course
# [rad s²/m] Sideslip of the rear axle per lateral acceleration: cornering compliance of passenger cars, 2 to 4 deg/g.
SIDESLIP = 5e-3


class Track(Protocol):
    """Yaw by the gyroscope over the last seconds."""

    @property
    def newest_ns(self) -> int | None:
        """End of the track, None without one."""
        ...

    def at(self, time_ns: int) -> Turn | None:
        """Turn at a time, None where it is not known."""
        ...


class Course(NamedTuple):
    """Course of the antenna at a time, and what a yaw rate adds to it."""

    time_ns: int
    angle: float  # [rad]
    variance: float  # [rad²] of the velocity's accuracy
    ahead_s: float  # [s] times the yaw rate: angle by the lever arm between rear axle and antenna
    slip_s: float  # [s] times the yaw rate: standard deviation by sideslip and an unknown axle


def course_of(settings: Settings, time_ns: int, velocity_n: Vector, sd_m_s: float) -> Course | None:
    """Course of a GNSS velocity [m/s, NED] with its standard deviation per axis, None of one that is too slow."""
    speed = hypot(*velocity_n[:2])
    if speed < MIN_COURSE_M_S:
        return None
    arm, axle = settings.vehicle.gnss.lever_arm_body_m, settings.vehicle.rear_axle_body_m
    ahead_m = arm[0] - (axle[0] if axle is not None else 0.0)
    ahead_sd_m = UNKNOWN_AXLE_M if axle is None else 0.1
    slip_s = hypot(SIDESLIP * speed, ahead_sd_m / speed)
    return Course(time_ns, atan2(velocity_n[1], velocity_n[0]), (sd_m_s / speed) ** 2, ahead_m / speed, slip_s)


class Second(NamedTuple):
    """One second of wheel speeds, with the gyroscope's rate at their stamps."""

    number: int
    rate: float  # [rad/s] about the vertical, bias not removed
    axis: Vector  # down in body axes
    rear: AxleSecond | None
    front: AxleSecond | None
    still: bool  # all wheels stand, and the inertial sensors are at standstill

    def rate_less(self, bias: Vector) -> float:
        """Rate [rad/s] without a bias [rad/s, body]."""
        return self.rate - (self.axis[0] * bias[0] + self.axis[1] * bias[1] + self.axis[2] * bias[2])


class Reading(NamedTuple):
    """Heading by another source, with the gyroscope's at the same time."""

    angle: float  # [rad]
    variance: float  # [rad²] not in common with other readings
    turn: Turn


class WheelSeconds:
    """Means over seconds of the wheel speeds; newest last."""

    def __init__(self, rejected: Counter[str]) -> None:
        self.seconds: deque[Second] = deque(maxlen=HISTORY_SECONDS)
        self.newest_ns: int | None = None
        self.stationary_since_ns: int | None = None  # by the inertial sensors
        self._rejected = rejected
        self._waiting: deque[tuple[int, WheelSpeeds]] = deque(maxlen=MAX_PENDING)
        self._open: list[tuple[Turn, WheelSpeeds]] = []
        self._number = 0

    def add(self, time_ns: int, speeds: WheelSpeeds) -> None:
        """Keep wheel speeds until the increments have reached their stamp."""
        if self.newest_ns is not None and time_ns <= self.newest_ns:
            self._rejected["wheel speeds: stamp is not after the one before"] += 1
            return
        wheels = [value for value in _wheels(speeds) if value is not None]
        if not all(isfinite(value) and abs(value) < MAX_SPEED_M_S for value in wheels):
            self._rejected["wheel speeds: implausible"] += 1
            return
        self.newest_ns = time_ns
        if pair(speeds, rear=True) is not None or pair(speeds, rear=False) is not None:
            self._waiting.append((time_ns, speeds))

    def clear(self) -> None:
        """Forget the seconds: the gyroscope's track is broken."""
        self.seconds.clear()
        self._waiting.clear()
        self._open.clear()

    def advance(self, track: GyroscopeTrack) -> Iterator[Second]:
        """Complete the seconds that increments and wheel speeds have passed."""
        reached = track.newest_ns
        while reached is not None and self._waiting and self._waiting[0][0] <= reached:
            time_ns, speeds = self._waiting.popleft()
            turn = track.at(time_ns)
            if turn is None:
                continue
            number = time_ns // SECOND_NS
            if number != self._number:
                yield from self._completed()
                self._number = number
            self._open.append((turn, speeds))

    def _completed(self) -> Iterator[Second]:
        """Complete the open second, if it has enough samples."""
        samples, self._open = self._open, []
        if len(samples) < MIN_SAMPLES:
            return
        turned = any(fastest(speeds) > 0.0 for _, speeds in samples)
        since_ns = self.stationary_since_ns
        still = not turned and since_ns is not None and since_ns <= self._number * SECOND_NS
        n = len(samples)
        rate = sum(turn.rate for turn, _ in samples) / n
        rear, front = mean_of(samples, rear=True), mean_of(samples, rear=False)
        if front is not None and abs(rate) > FRONT_CURVATURE * abs(front.speed):
            front = None
        if not still:
            rear, front = (
                None if axle_second is None or axle_second.speed < MIN_SPEED_M_S else axle_second
                for axle_second in (rear, front)
            )
        if rear is None and front is None:
            return
        second = Second(self._number, rate, samples[n // 2][0].axis, rear, front, still)
        self.seconds.append(second)
        yield second


def _wheels(speeds: WheelSpeeds) -> tuple[float | None, ...]:
    return speeds.rear_left_m_s, speeds.rear_right_m_s, speeds.front_left_m_s, speeds.front_right_m_s


def fastest(speeds: WheelSpeeds) -> float:
    """Speed of the fastest wheel [m/s]."""
    return max((abs(value) for value in _wheels(speeds) if value is not None), default=0.0)


def pair(speeds: WheelSpeeds, *, rear: bool) -> tuple[float, float] | None:
    """Left and right wheel [m/s] of an axle, None without both."""
    wheels = _wheels(speeds)
    left, right = wheels[:2] if rear else wheels[2:]
    return None if left is None or right is None else (left, right)


def mean_of(samples: list[tuple[Turn, WheelSpeeds]], *, rear: bool) -> AxleSecond | None:
    """Mean of an axle over the samples of a second, None where a sample has not both wheels."""
    pairs = [pair(speeds, rear=rear) for _, speeds in samples]
    known = [pair for pair in pairs if pair is not None]
    if len(known) < len(samples):
        return None
    left, right = (sum(wheel) / len(known) for wheel in zip(*known, strict=True))
    return AxleSecond(left - right, 0.5 * (left + right))


class Headings:
    """Headings of one source, one a second; newest last."""

    def __init__(self) -> None:
        self.readings: deque[Reading] = deque(maxlen=HISTORY_SECONDS)
        self._waiting: deque[tuple[int, float, float, float, float]] = deque(maxlen=MAX_PENDING)

    def add(self, time_ns: int, angle: float, variance: float, *, ahead_s: float = 0.0, slip_s: float = 0.0) -> None:
        """Keep a heading [rad] and its variance [rad²] until the increments have reached its time.

        Parameters
        ----------
        time_ns, angle, variance : int, float, float
            When it was true, [rad], [rad²].
        ahead_s, slip_s : float
            [s] What the yaw rate adds to the angle, and to its standard deviation.
        """
        if not self._waiting or time_ns > self._waiting[-1][0]:
            self._waiting.append((time_ns, angle, variance, ahead_s, slip_s))

    def clear(self) -> None:
        """Forget the readings: the gyroscope's track is broken."""
        self.readings.clear()
        self._waiting.clear()

    def advance(self, track: Track) -> None:
        """Take the readings that the increments have passed; the newest of a second stays."""
        reached = track.newest_ns
        while reached is not None and self._waiting and self._waiting[0][0] <= reached:
            time_ns, angle, variance, ahead_s, slip_s = self._waiting.popleft()
            turn = track.at(time_ns)
            if turn is None:
                continue
            if self.readings and self.readings[-1].turn.time_ns // SECOND_NS == time_ns // SECOND_NS:
                self.readings.pop()
            spread = hypot(variance**0.5, slip_s * turn.rate) ** 2
            self.readings.append(Reading(angle - ahead_s * turn.rate, spread, turn))

    def pair(self, end_ns: int, length_s: float) -> tuple[Reading, Reading] | None:
        """First and last reading of a window that ends about a time, None where readings are missing."""
        if not self.readings or not -SECOND_NS <= end_ns - self.readings[-1].turn.time_ns <= 1.5 * SECOND_NS:
            return None
        last = self.readings[-1]
        limit_ns = last.turn.time_ns - round((length_s - 0.5) * SECOND_NS)
        first = next((reading for reading in reversed(self.readings) if reading.turn.time_ns <= limit_ns), None)
        if first is None or last.turn.time_ns - first.turn.time_ns > (1.3 * length_s + 0.5) * SECOND_NS:
            return None
        return first, last
