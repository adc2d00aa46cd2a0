"""What the windows compare: fixes, odometer speeds and heights of the last minutes, checked and in order."""

from bisect import bisect_left
from collections import Counter, deque
from dataclasses import dataclass
from math import hypot, isfinite

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import SECOND_NS
from shared.maths.earth import Geodetic, ned_from_geodetic_difference

from .compass import barometric_height

FloatArray = npt.NDArray[np.float64]

LEAST_DIFFERENCE_S, LONGEST_DIFFERENCE_S = 0.9, 1.6  # between two positions that make a velocity
UNKNOWN_VERTICAL_SD = 10.0  # [m/s] of a vehicle
BIN_NS = 200_000_000  # of heights, whose newest mean is complete that much later


@dataclass(frozen=True)
class VelocityFix:
    """Velocity of the antenna by GNSS, and its position where there is one."""

    time_ns: int  # when it was true: the receiver's delay is subtracted
    velocity_n: FloatArray  # shape (3,) [m/s, NED]
    sd: FloatArray  # shape (3,) [m/s, NED]
    position: Geodetic | None = None
    position_sd: float = 0.0  # [m] horizontal
    of_positions: bool = False  # the velocity is a difference of positions
    position_ns: int | None = None  # when the position was true

    @property
    def speed(self) -> float:
        """Horizontal speed [m/s]."""
        return hypot(*self.velocity_n[:2].tolist())


class PositionDifferences:
    """Velocities from positions about a second apart, for a receiver that measures none that could be compared."""

    def __init__(self) -> None:
        self._known: deque[tuple[int, Geodetic, float]] = deque(maxlen=50)

    def after(self, time_ns: int, position: Geodetic, sd: float) -> VelocityFix | None:
        """Add a position with its horizontal standard deviation [m]; the velocity holds half-way between the two.

        Notes
        -----
        v = (p_2 - p_1) / dt, with the standard deviation of independent errors: sqrt(s_1² + s_2²) / dt. The vertical
        velocity is unknown.
        """
        found = None
        for then_ns, before, before_sd in reversed(self._known):
            span_s = (time_ns - then_ns) / SECOND_NS
            if span_s > LONGEST_DIFFERENCE_S:
                break
            if span_s >= LEAST_DIFFERENCE_S:
                moved = ned_from_geodetic_difference(position, before)
                speed_sd = float(np.hypot(sd, before_sd)) / span_s
                velocity = np.array([moved[0] / span_s, moved[1] / span_s, 0.0])
                sds = np.array([speed_sd, speed_sd, UNKNOWN_VERTICAL_SD])
                middle_ns = (time_ns + then_ns) // 2
                found = VelocityFix(middle_ns, velocity, sds, position, sd, of_positions=True, position_ns=time_ns)
                break
        self._known.append((time_ns, position, sd))
        return found


@dataclass(frozen=True)
class OdometerSpeed:
    """Speed of the vehicle by its wheels."""

    time_ns: int
    speed: float  # [m/s]
    resolution: float  # [m/s]


class Series:
    """Stamped numbers of one source, newest last; gives a value at a time by linear interpolation."""

    def __init__(self, length: int, gap_s: float) -> None:
        self._times: deque[int] = deque(maxlen=length)
        self._values: deque[float] = deque(maxlen=length)
        self._gap_ns = int(gap_s * SECOND_NS)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest number."""
        return self._times[-1] if self._times else None

    def add(self, time_ns: int, value: float) -> None:
        """Append a number with a later stamp."""
        self._times.append(time_ns)
        self._values.append(value)

    def at(self, time_ns: int) -> float | None:
        """Value at a time; None where the two neighbours are too far apart, or one is missing."""
        after = bisect_left(self._times, time_ns)
        if after == len(self._times) or (after == 0 and self._times[0] != time_ns):
            return None
        if self._times[after] == time_ns:
            return self._values[after]
        begin, end = self._times[after - 1], self._times[after]
        if end - begin > self._gap_ns:
            return None
        share = (time_ns - begin) / (end - begin)
        return self._values[after - 1] + share * (self._values[after] - self._values[after - 1])


class Heights:
    """Barometric heights, as means over 200 ms."""

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self._means = Series(100, 3.0)
        self._sum, self._count, self._bin = 0.0, 0, 0

    def pressure(self, time_ns: int, pressure_pa: float) -> None:
        """Use a pressure."""
        if not (isfinite(pressure_pa) and 30_000.0 <= pressure_pa <= 115_000.0):
            self.rejected["imu: pressure is not within 300 to 1150 hPa"] += 1
            return
        number = time_ns // BIN_NS
        if number > self._bin and self._count:
            self._means.add(self._bin * BIN_NS + BIN_NS // 2, self._sum / self._count)
            self._sum, self._count = 0.0, 0
        if number >= self._bin:
            self._bin = number
            self._sum, self._count = self._sum + barometric_height(pressure_pa), self._count + 1

    def rate(self, start_ns: int, end_ns: int) -> float | None:
        """Mean rate of the height [m/s] between two times, both 200 ms ago; None where it is not known."""
        start, end = self._means.at(start_ns - BIN_NS), self._means.at(end_ns - BIN_NS)
        return None if start is None or end is None else (end - start) * SECOND_NS / (end_ns - start_ns)
