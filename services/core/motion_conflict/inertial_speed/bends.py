"""Finds bends in levelled increments, and measures the scale of GNSS and odometer speed in each."""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shared.inertial.increments import PERIOD_NS, SECOND_NS

from .bend_fit import Arm, BendSeries, FittedScale, filled_speed, fit_scale
from .levelling import LevelIncrement

FloatArray = npt.NDArray[np.float64]

LATERAL_M_S2 = 0.7  # yaw rate times speed that is a bend: below it tilt decides, 0.1 deg are 2 %
SMOOTHED = 5  # increments over which it is averaged
MIN_INCREMENTS = 10  # increments of a bend, 1 s
MAX_LENGTH = 200  # 20 s: over longer ones the gyroscope's tilt errors grow without a straight
MARGIN = 30  # increments of the straights before and after a bend, 3 s
HISTORY_INCREMENTS = MAX_LENGTH + 4 * MARGIN
SETTLING_TIME_NS = 15 * SECOND_NS  # after a gap in the inertial samples: three time constants of the lateral correction
MIN_SPEED_M_S = 2.0  # least speed within a bend
GAP_NS = int(2.1 * SECOND_NS)  # between two speeds, beyond which the speed between them is not known
MAX_SD = 0.15  # [-] of a scale that is worth keeping: five of them would not tell 10 %
CORRELATION_S = 2.0  # of errors of a GNSS speed


class Bend(NamedTuple):
    """Scale of the speeds in one bend: indicated over centripetal speed."""

    start_ns: int
    end_ns: int
    scale: float  # of GNSS
    sd: float
    odometer: float | None  # scale of the odometer, whose error of the inertial sensors is the same


@dataclass(frozen=True)
class Geometry:
    """IMU and antenna relative to the rear axle; the antenna's offset is None where it is not known."""

    imu: Arm = field(default_factory=Arm)
    antenna_forward_m: float | None = None
    antenna_right_m: float = 0.0


class SpeedSeries:
    """Samples of one speed over the longest bend."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=2000)
        self._values: deque[tuple[float, float]] = deque(maxlen=2000)

    def add(self, time_ns: int, speed: float, sd: float) -> None:
        """Append a speed and its standard deviation [m/s]; one that is not newer is left out."""
        if self._times and time_ns <= self._times[-1]:
            return
        self._times.append(time_ns)
        self._values.append((speed, sd))
        while time_ns - self._times[0] > (HISTORY_INCREMENTS + 50) * PERIOD_NS:
            self._times.popleft()
            self._values.popleft()

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return self._times[-1] if self._times else None

    def at(self, time_ns: int) -> tuple[float, float] | None:
        """Speed and acceleration [m/s, m/s²] between the samples around a time, None in a gap.

        The search begins at the newest: increments are used as soon as the samples reach them.
        """
        k = len(self._times) - 1
        if k < 1 or self._times[k] < time_ns:
            return None
        while k > 0 and self._times[k - 1] >= time_ns:
            k -= 1
        if k == 0 or self._times[k] - self._times[k - 1] > GAP_NS:
            return None
        step_s = (self._times[k] - self._times[k - 1]) / SECOND_NS
        before, after = self._values[k - 1][0], self._values[k][0]
        slope = (after - before) / step_s
        return before + slope * (time_ns - self._times[k - 1]) / SECOND_NS, slope

    def between(self, start_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Times [s] since the start, speeds and standard deviations [m/s], that cover a time; None with a gap."""
        times = np.array(self._times, dtype=np.int64)
        first = int(np.searchsorted(times, start_ns, side="right")) - 1
        last = int(np.searchsorted(times, end_ns))
        if first < 0 or last >= len(times) or np.diff(times[first : last + 1]).max() > GAP_NS:
            return None
        values = np.array([self._values[k] for k in range(first, last + 1)])
        return (times[first : last + 1] - start_ns) / SECOND_NS, values[:, 0], values[:, 1]


class BendRecorder:
    """Takes levelled increments in order of time, and gives each bend 3 s after its end."""

    def __init__(self, geometry: Geometry | None = None) -> None:
        self.geometry = geometry or Geometry()
        self.gnss, self.odometer = SpeedSeries(), SpeedSeries()
        self.left_out: Counter[str] = Counter()  # bends that could not be measured
        self._rows: deque[LevelIncrement] = deque(maxlen=HISTORY_INCREMENTS)
        self._recent: deque[float] = deque(maxlen=SMOOTHED)
        self._bend: tuple[int, int, int] | None = None  # first and last increment by number, direction
        self._ended: deque[tuple[int, int]] = deque(maxlen=8)  # bends whose straight is not complete
        self._count = 0  # number of the newest increment
        self._usable_ns = 0

    def add(self, row: LevelIncrement, speed: float | None) -> list[Bend]:
        """Use an increment with the speed [m/s] at its time; give the bends that it completes."""
        if row.after_gap or (self._rows and row.start_ns - self._rows[-1].end_ns > PERIOD_NS):
            self._clear(row.start_ns)
        self._rows.append(row)
        self._count += 1
        self._recent.append(row.yaw_rate * speed if speed is not None else 0.0)
        lateral = sum(self._recent) / len(self._recent)
        self._follow(lateral)
        found = []
        while self._ended and self._count - self._ended[0][1] >= MARGIN:
            bend = self._measured(*self._ended.popleft())
            found += [] if bend is None else [bend]
        return found

    def _clear(self, time_ns: int) -> None:
        self._rows.clear()
        self._recent.clear()
        self._ended.clear()
        self._bend, self._usable_ns = None, time_ns + SETTLING_TIME_NS

    def _follow(self, lateral: float) -> None:
        """Follow the bend that is driven, or begin one."""
        direction = 0 if abs(lateral) < LATERAL_M_S2 else 1 if lateral > 0.0 else -1
        if self._bend is not None:
            first, _, old = self._bend
            if direction == old:
                self._bend = (first, self._count, old)
                return
            length = self._count - first
            if MIN_INCREMENTS <= length <= MAX_LENGTH:
                self._ended.append((first, self._count))
            elif length > MAX_LENGTH:
                self.left_out["longer than 20 s"] += 1
        self._bend = (self._count, self._count, direction) if direction else None

    def _measured(self, first: int, last: int) -> Bend | None:
        """Fit the scales of a bend, given by the numbers of its increments."""
        oldest = self._count - len(self._rows) + 1
        begin = max(first - MARGIN, oldest) - oldest
        rows = list(self._rows)[begin:]
        start_ns, end_ns = rows[0].start_ns, rows[-1].end_ns
        if start_ns < self._usable_ns:
            self.left_out["less than 15 s after a gap of the inertial samples"] += 1
            return None
        table = np.array([row[2:5] for row in rows])
        series = BendSeries(PERIOD_NS / SECOND_NS, table[:, 1], table[:, 0], table[:, 2])
        times_s = np.array([(row.start_ns + row.end_ns) // 2 - start_ns for row in rows]) / SECOND_NS
        within = slice(first - oldest - begin, last - oldest - begin)
        fitted = self._fitted(self.gnss, series, (start_ns, end_ns), times_s, within, of_antenna=True)
        if fitted is None:
            return None
        by_wheels = self._fitted(self.odometer, series, (start_ns, end_ns), times_s, within, of_antenna=False)
        return Bend(
            rows[within.start].start_ns, rows[within.stop - 1].end_ns, fitted.scale, fitted.sd,
            None if by_wheels is None else by_wheels.scale,
        )  # fmt: skip

    def _fitted(
        self, source: SpeedSeries, series: BendSeries, span_ns: tuple[int, int], times_s: FloatArray, within: slice,
        *, of_antenna: bool,
    ) -> FittedScale | None:  # fmt: skip
        samples = source.between(*span_ns)
        if samples is None:
            self._count_left_out("a gap in the speeds", of_antenna)
            return None
        sampled_s, speeds, sds = samples
        speed = filled_speed(times_s, series.forward, series.step_s, sampled_s, speeds)
        if of_antenna:
            speed = self._of_axle(speed, series.yaw_rate)
        slowest = float(speed[within].min())
        if slowest < MIN_SPEED_M_S:
            self._count_left_out("slower than 2 m/s", of_antenna)
            return None
        fitted = fit_scale(series, speed, self.geometry.imu)
        if fitted is None:
            return None
        # Errors of the speed over the bend: those of a GNSS speed are correlated.
        shared = min(1.0, 2.0 * CORRELATION_S / float(times_s[within.stop - 1] - times_s[within.start]))
        noise = float((sds**2).mean()) * shared / float(speed[within].mean()) ** 2
        sd = float(np.sqrt(fitted.sd**2 + noise))
        if sd > MAX_SD:
            self._count_left_out("not determined to 15 %", of_antenna)
            return None
        return FittedScale(fitted.scale, sd)

    def _count_left_out(self, reason: str, counted: bool) -> None:
        """Count a bend that GNSS does not give a scale for."""
        if counted:
            self.left_out[reason] += 1

    def _of_axle(self, speed: FloatArray, yaw_rate: FloatArray) -> FloatArray:
        """Speed of the rear axle from that of the antenna: v = sqrt(v_a² - (r x)²) + r y."""
        if self.geometry.antenna_forward_m is None:
            return speed
        across = yaw_rate * self.geometry.antenna_forward_m
        axle: FloatArray = np.sqrt(np.maximum(speed**2 - across**2, 0.0)) + yaw_rate * self.geometry.antenna_right_m
        return axle
