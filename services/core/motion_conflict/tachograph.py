"""Smart-tachograph motion conflict: trimmed mean and median of R = |S_odo - S_gnss| over 30 samples at 10 s.

References
----------
D. Borio et al., "Speed verification for the Smart Tachograph", Sensors 18, 1583, 2018 (statistics, instant verdict).
Regulation (EU) 2016/799, Annex IC, Appendix 12 (window of movement, event, distance rule, motion-sensor rule).
"""

from collections import deque
from collections.abc import Sequence
from enum import StrEnum
from math import dist, floor

import numpy as np

from shared.maths.earth import Geodetic, ecef_from_geodetic

SECOND_NS = 1_000_000_000
KM_H = 1.0 / 3.6  # [m/s]
PERIOD_S = 10.0  # between two samples
SAMPLES = 30  # five minutes
TRIMMED_SHARE = 0.8  # 24 of 30: the six largest are dropped
THRESHOLD_M_S = 10.0 * KM_H
EVENT_S = 300.0  # of movement; the condition has held for it without interruption at the 31st sample
DISTANCE_PERIOD_S = 900.0
FERRY_SPEED_M_S = 200.0 * KM_H
MOTION_SENSOR_WINDOW_S = 10800.0  # three hours, in which the contradiction has to be detected
MOVING_AFTER_S = 5.0  # [s] of uninterrupted movement before a vehicle counts as moving


def trimmed_mean(differences: Sequence[float], kept_share: float = TRIMMED_SHARE) -> float:
    """Mean of the smallest values: trimmed on one side.

    Parameters
    ----------
    differences : sequence of float, length n
        [any unit] Absolute speed differences R.
    kept_share : float
        [-] Share of the values that is kept; floor(share n + 1e-9) of them.

    Returns
    -------
    float
        [unit of `differences`] MT.

    Raises
    ------
    ValueError
        No value would be kept.

    Notes
    -----
    With r sorted in ascending order and N80 = floor(0.8 N)::

        MT = 1/N80 · Σ_{i<N80} r(i)

    References
    ----------
    Borio et al. 2018, trimmed mean; the same statistic as "trimmed mean" of Appendix 12.
    """
    kept = floor(kept_share * len(differences) + 1e-9)
    if kept < 1:
        raise ValueError(f"no value is left of {len(differences)} when {kept_share:g} of them are kept")
    return float(np.sort(differences)[:kept].mean())


def median(differences: Sequence[float]) -> float:
    """Median; the mean of the two central values if their number is even."""
    if not differences:
        raise ValueError("the median of no value")
    return float(np.median(differences))


class WindowMode(StrEnum):
    """What a window of 30 samples counts."""

    MOVING = "moving"  # samples in which at least one speed is not zero (the regulation)
    WALL = "wall"  # every sample time (the paper); one without both speeds leaves the window incomplete


class SpeedWindow:
    """The last 30 differences of speed, and for how long their trimmed mean has been above the threshold."""

    def __init__(self, mode: WindowMode, *, still_m_s: float = 1.0 * KM_H) -> None:
        self.mode = mode
        self.still_m_s = still_m_s  # GNSS speed that counts as zero
        self.slots: deque[tuple[int, float | None]] = deque(maxlen=SAMPLES)
        self.exceeded_s = 0.0  # of movement since the trimmed mean exceeds the threshold, 10 s a sample

    def add(self, time_ns: int, gnss: float | None, odometer: float | None) -> None:
        """Add the sample of one sample time; a speed [m/s] that is not available is None, never zero."""
        moving = False
        if gnss is not None and odometer is not None:
            moving = gnss > self.still_m_s or odometer > 0.0
            if moving or self.mode is WindowMode.WALL:
                self._add(time_ns, abs(odometer - gnss), moving)
        elif self.mode is WindowMode.WALL:
            self._add(time_ns, None, moving)

    def _add(self, time_ns: int, difference: float | None, moving: bool) -> None:
        self.slots.append((time_ns, difference))
        if not self.complete or self.trimmed_mean() <= THRESHOLD_M_S:
            self.exceeded_s = 0.0
        elif moving:
            self.exceeded_s += PERIOD_S

    @property
    def differences(self) -> list[float]:
        """The values [m/s] in the window, oldest first."""
        return [value for _, value in self.slots if value is not None]

    @property
    def complete(self) -> bool:
        """Whether all 30 values are there; before, there is no verdict."""
        return len(self.differences) == SAMPLES

    def trimmed_mean(self) -> float:
        """Trimmed mean [m/s] of a complete window."""
        return trimmed_mean(self.differences)

    def median(self) -> float:
        """Median [m/s] of a complete window."""
        return median(self.differences)

    @property
    def suspect_since_ns(self) -> int | None:
        """Stamp of the sample before the first one in the window that is above the threshold."""
        before = None
        for time_ns, value in self.slots:
            if value is not None and value > THRESHOLD_M_S:
                return before if before is not None else time_ns - int(PERIOD_S * SECOND_NS)
            before = time_ns
        return None


def distance_limit(odometer_m: float, ferry_s: float = 0.0) -> float:
    """Largest distance [m] between two GNSS positions that the odometer's distance allows.

    Parameters
    ----------
    odometer_m : float
        [m] Odometer distance between the two positions.
    ferry_s : float
        [s] Time aboard a ferry or train between them.

    Notes
    -----
    Exceeding it is the event::

        limit = 1.1 · odo + min(10 km, 0.2 · odo) + 1 km + 200 km/h · t_ferry
    """
    return 1.1 * odometer_m + min(10_000.0, 0.2 * odometer_m) + 1000.0 + FERRY_SPEED_M_S * ferry_s


class DistanceRule:
    """Every 15 minutes: distance between two GNSS positions against the distance that the odometer counted."""

    def __init__(self, *, gap_s: float) -> None:
        self.gap_s = gap_s  # longest time between two odometer speeds over which distance is integrated
        self.travelled_m: float | None = 0.0  # None: the odometer was interrupted
        self.compared: tuple[float, float, int, int] | None = (
            None  # GNSS distance, limit, start and end of the interval
        )
        self._start: tuple[int, Geodetic] | None = None
        self._last: tuple[int, float] | None = None
        self._ferry_s = 0.0  # time of crossings since the interval's start
        self._ferry_ns: int | None = None  # begin of the crossing that is open, or the interval's start within it

    def crossing(self, time_ns: int, is_open: bool) -> None:
        """Begin or end a crossing by ferry or train, whose time lengthens the limit."""
        if self._ferry_ns is not None:
            self._ferry_s += max(0, time_ns - self._ferry_ns) / SECOND_NS
        self._ferry_ns = time_ns if is_open else None

    def odometer(self, time_ns: int, speed: float) -> None:
        """Integrate a speed [m/s] by the trapezoidal rule."""
        before_ns = self._last[0] if self._last is not None else self._start[0] if self._start is not None else None
        if before_ns is not None and (time_ns - before_ns) / SECOND_NS > self.gap_s:
            self.travelled_m = None
        elif self._last is not None and self.travelled_m is not None:
            self.travelled_m += 0.5 * (speed + self._last[1]) * (time_ns - self._last[0]) / SECOND_NS
        self._last = (time_ns, speed)

    def position(self, time_ns: int, latitude: float, longitude: float) -> None:
        """Use a GNSS position [rad]; the first one after 15 minutes closes the interval."""
        here = Geodetic(latitude, longitude, 0.0)  # on the ellipsoid: the distance is a horizontal one
        if self._start is not None:
            if time_ns - self._start[0] < DISTANCE_PERIOD_S * SECOND_NS:
                return
            self.compared = None
            interrupted = self._last is None or abs(time_ns - self._last[0]) > self.gap_s * SECOND_NS
            if self.travelled_m is not None and not interrupted:
                chord_m = dist(ecef_from_geodetic(here), ecef_from_geodetic(self._start[1]))
                self.crossing(time_ns, self._ferry_ns is not None)
                limit_m = distance_limit(self.travelled_m, self._ferry_s)
                self.compared = (chord_m, limit_m, self._start[0], time_ns)
        self._start, self.travelled_m, self._ferry_s = (time_ns, here), 0.0, 0.0
        self._ferry_ns = None if self._ferry_ns is None else time_ns


class MotionSensorRule:
    """Time within the last three hours in which the odometer read zero while GNSS moved.

    The first five seconds of each such interval are not counted: braking, driving off and delays make them.
    """

    def __init__(self, *, moving_m_s: float, gap_s: float) -> None:
        self.moving_m_s = moving_m_s
        self.gap_s = gap_s
        self.suspect_since_ns: int | None = None
        self._minutes: deque[list[float]] = deque(maxlen=int(MOTION_SENSOR_WINDOW_S / 60.0))  # [minute, seconds]
        self._run: tuple[int, int] | None = None  # start and end of the interval that lasts

    def update(self, time_ns: int, gnss: float | None, odometer: float | None) -> None:
        """Use two speeds [m/s] of one time."""
        if gnss is None or odometer is None or odometer > 0.0 or gnss <= self.moving_m_s:
            self._run = None
        elif self._run is None or time_ns - self._run[1] > self.gap_s * SECOND_NS:
            self._run = (time_ns, time_ns)
        else:
            start, end = self._run
            counted_s = (time_ns - max(end, start + MOVING_AFTER_S * SECOND_NS)) / SECOND_NS
            if counted_s > 0.0:
                self._count(time_ns, counted_s, start)
            self._run = (start, time_ns)

    def _count(self, time_ns: int, counted_s: float, start_ns: int) -> None:
        if self.contradiction_s(time_ns) == 0.0:
            self.suspect_since_ns = start_ns
        minute = time_ns // (60 * SECOND_NS)
        if not self._minutes or self._minutes[-1][0] != minute:
            self._minutes.append([minute, 0.0])
        self._minutes[-1][1] += counted_s

    def contradiction_s(self, time_ns: int) -> float:
        """Time [s] of contradiction within three hours before `time_ns`, to the minute."""
        oldest = (time_ns - MOTION_SENSOR_WINDOW_S * SECOND_NS) / (60 * SECOND_NS)
        return sum(seconds for minute, seconds in self._minutes if minute >= oldest)
