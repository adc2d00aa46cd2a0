"""Pairs of a GNSS speed and the odometer speed of the same instant, by interpolation between odometer samples."""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

SECOND_NS = 1_000_000_000
SLOPE_NS = SECOND_NS  # half the span over which the odometer's acceleration is taken
MAX_SAMPLES = 2048  # of the odometer


@dataclass(frozen=True)
class AlignedPair:
    """GNSS speed at `time_ns` and odometer speed at `time_ns` + delay, which is the same instant of the vehicle."""

    time_ns: int
    gnss: float  # [m/s]
    gnss_sd: float  # [m/s]
    odometer: float  # [m/s] raw
    slope: float  # [m/s²] of the odometer's speed
    resolution: float  # [m/s] step of the odometer's speed


class OdometerTrack:
    """The odometer's last speeds, with linear interpolation between them.

    Parameters
    ----------
    gap_s : float
        [s] Longest time between two samples that is interpolated.
    """

    def __init__(self, *, gap_s: float) -> None:
        self._gap_ns = int(gap_s * SECOND_NS)
        self._times: deque[int] = deque(maxlen=MAX_SAMPLES)
        self._speeds: deque[float] = deque(maxlen=MAX_SAMPLES)
        self.resolution = 0.0  # [m/s] of the newest sample

    def add(self, time_ns: int, speed: float, resolution: float) -> None:
        """Append a speed [m/s], newer than all before."""
        while self._times and time_ns - self._times[0] > 20 * SECOND_NS:
            self._times.popleft()
            self._speeds.popleft()
        self._times.append(time_ns)
        self._speeds.append(speed)
        self.resolution = resolution

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return self._times[-1] if self._times else None

    def newest(self, time_ns: int) -> float | None:
        """Newest speed [m/s] if it is not older than the gap."""
        return self._speeds[-1] if self._times and time_ns - self._times[-1] <= self._gap_ns else None

    def at(self, time_ns: int) -> float | None:
        """Interpolated speed [m/s]; None outside the samples and in gaps."""
        k = bisect_left(self._times, time_ns)
        if k < len(self._times) and self._times[k] == time_ns:
            return self._speeds[k]
        if k in (0, len(self._times)) or self._times[k] - self._times[k - 1] > self._gap_ns:
            return None
        before_ns, after_ns = self._times[k - 1], self._times[k]
        share = (time_ns - before_ns) / (after_ns - before_ns)
        return self._speeds[k - 1] + share * (self._speeds[k] - self._speeds[k - 1])

    def series(self, time_ns: int, delays_s: FloatArray) -> FloatArray | None:
        """Interpolated speeds [m/s] at a time plus each of ascending delays; None outside the samples and in gaps."""
        times_s = (np.array(self._times) - time_ns) / SECOND_NS
        first = int(np.searchsorted(times_s, delays_s[0], side="right")) - 1
        last = int(np.searchsorted(times_s, delays_s[-1]))
        if first < 0 or last >= len(times_s) or np.diff(times_s[first : last + 1]).max() > self._gap_ns / SECOND_NS:
            return None
        speeds: FloatArray = np.interp(delays_s, times_s, np.array(self._speeds))
        return speeds

    def pair(self, time_ns: int, delay_s: float, gnss: tuple[float, float]) -> AlignedPair | None:
        """Align a GNSS speed and its standard deviation [m/s]; None where the odometer does not cover it."""
        instant_ns = time_ns + round(delay_s * SECOND_NS)
        speed, before, after = self.at(instant_ns), self.at(instant_ns - SLOPE_NS), self.at(instant_ns + SLOPE_NS)
        if speed is None or before is None or after is None:
            return None
        slope = (after - before) * SECOND_NS / (2.0 * SLOPE_NS)
        return AlignedPair(time_ns, *gnss, speed, slope, self.resolution)

    def reaches(self, time_ns: int, ahead_s: float) -> bool:
        """Whether the odometer's samples go beyond a time by so much."""
        return bool(self._times) and self._times[-1] >= time_ns + round(ahead_s * SECOND_NS)
