"""Maps the clock of a device to the OBU time line, from device times and arrival times.

Each arrival gives one offset: arrival time - device time = clock offset + drift · time + delay, delay >= 0. The
arrivals with the minimum delay lie on a line, the lower envelope of the offsets, which is the clock mapping.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from math import inf

NS = 1_000_000_000
Point = tuple[float, float]


class ClockMapping:
    """The lower envelope of (device time, received - device time) over a sliding window.

    Parameters
    ----------
    minimum_delay_s : float
        [s] Minimum delay common to all arrivals, which is not observable from the offsets.
    window_s : float
        [s] Length of the sliding window. The arrival with the smallest offset in each second is kept.
    maximum_drift : float
        [s/s] Bound of the relative drift of the two clocks. An envelope that would rise faster is one of arrivals whose
        delay has grown, and does not.
    longest_delay_s : float
        [s] Delay up to which arrivals are only late; the device clock has stepped where it lasts beyond.

    Notes
    -----
    The slope is that of the edge of the lower convex hull below the mean time of the points: of all lines below
    the points it has the least sum of vertical distances. If the points span less than a quarter of the window,
    the slope is 0, since jitter over a short time is indistinguishable from drift. The mapping is reset when the
    device clock steps back, forward by more than `STEP_S`, or when all arrivals over `STEP_S` · 10 are delayed by
    more than `longest_delay_s`.

    References
    ----------
    S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay measurements",
    IEEE INFOCOM 1999, section III.
    """

    STEP_S = 0.5

    def __init__(
        self, minimum_delay_s: float = 0.0, window_s: float = 60.0, maximum_drift: float = 200e-6,
        longest_delay_s: float = STEP_S,
    ) -> None:  # fmt: skip
        self.resets = -1  # the first arrival is not a reset
        self.late_s = 0.0  # of the last stamped sample, beyond the least delay
        self.step_s = 0.0  # by which the device clock jumped ahead at the last reset
        self._minimum_delay_ns = round(minimum_delay_s * NS)
        self._window_s, self._longest_delay_s = window_s, longest_delay_s
        self._maximum_drift = maximum_drift
        self._points: deque[Point] = deque()  # one per second: (device time, offset), both [s] relative to the origin
        self._device_origin_ns = self._offset_origin_ns = 0
        self._newest_device_ns = 0  # of the last sample added to the envelope
        self._last_device_ns = self._last_stamp_ns = 0  # of the last stamped sample
        self._slope = self._intercept = 0.0
        self._late_since: float | None = None

    def stamp(self, device_ns: int, received_ns: int) -> int:
        """Time of validity [ns, OBU time line] of one sample; see `stamp_all`."""
        return self.stamp_all((device_ns,), received_ns)[0]

    def stamp_all(self, device_ns: Sequence[int], received_ns: int) -> tuple[int, ...]:
        """Times of validity of samples that arrived together.

        Parameters
        ----------
        device_ns : sequence of int
            [ns, device clock] Time of each sample; unwrapped.
        received_ns : int
            [ns, OBU time line] Arrival time of their bytes.

        Returns
        -------
        tuple of int
            [ns, OBU time line] One per sample, not after the arrival. Stamps increase strictly; they are at least half
            the device interval apart unless that exceeds the arrival time. All samples are added to the envelope
            before the first is stamped, since the sample with the smallest delay determines the mapping.
        """
        stamps: list[int] = []
        first = 0  # first sample since the last reset
        for i, device in enumerate(device_ns):
            if self.resets < 0 or self._stepped(device, received_ns):
                stamps += [self._place(earlier, received_ns) for earlier in device_ns[first:i]]
                first = i
                self._restart(device, received_ns)
            self._add(device, received_ns)
            self._newest_device_ns = device
        stamps += [self._place(device, received_ns) for device in device_ns[first:]]
        return tuple(stamps)

    def _place(self, device_ns: int, received_ns: int) -> int:
        """Evaluate the mapping, bounded by the arrival time and the previous stamp."""
        time_s, offset_s = self._relative(device_ns, received_ns)
        self.late_s = offset_s - self._intercept - self._slope * time_s
        excess_ns = round(self.late_s * NS)
        stamp_ns = received_ns - excess_ns - self._minimum_delay_ns
        stamp_ns = max(stamp_ns, self._last_stamp_ns + (device_ns - self._last_device_ns) // 2)
        stamp_ns = max(min(stamp_ns, received_ns), self._last_stamp_ns + 1)
        self._last_device_ns, self._last_stamp_ns = device_ns, stamp_ns
        return stamp_ns

    @property
    def drift(self) -> float:
        """Drift of the OBU time line relative to the device clock [s/s]."""
        return self._slope

    def _relative(self, device_ns: int, received_ns: int) -> Point:
        time_s = (device_ns - self._device_origin_ns) / NS
        return time_s, (received_ns - device_ns - self._offset_origin_ns) / NS

    def _stepped(self, device_ns: int, received_ns: int) -> bool:
        time_s, offset_s = self._relative(device_ns, received_ns)
        excess_s = offset_s - self._intercept - self._slope * time_s
        if device_ns < self._newest_device_ns or excess_s < -self.STEP_S:
            return True
        if received_ns < self._last_stamp_ns - self.STEP_S * NS:
            return True  # the OBU time line stepped back: another recording
        if excess_s < self._longest_delay_s:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = time_s
        return time_s - self._late_since > 10 * self.STEP_S

    def _restart(self, device_ns: int, received_ns: int) -> None:
        if self.resets >= 0:
            time_s, offset_s = self._relative(device_ns, received_ns)
            self.step_s = self._intercept + self._slope * time_s - offset_s
        self.resets += 1
        self._points.clear()
        self._device_origin_ns, self._offset_origin_ns = device_ns, received_ns - device_ns
        self._last_device_ns = device_ns
        if received_ns < self._last_stamp_ns - self.STEP_S * NS:
            self._last_stamp_ns = received_ns - 1
        self._slope = self._intercept = 0.0
        self._late_since = None

    def _add(self, device_ns: int, received_ns: int) -> None:
        point = self._relative(device_ns, received_ns)
        points = self._points
        if points and int(points[-1][0]) == int(point[0]):
            if point[1] < points[-1][1]:
                points[-1] = point
            self._intercept = min(self._intercept, point[1] - self._slope * point[0])
            return
        points.append(point)
        while points[0][0] < point[0] - self._window_s:
            points.popleft()
        highest = inf  # of the line at this time
        if len(points) > 1:
            before_s = points[-2][0]
            highest = self._intercept + self._slope * before_s + self._maximum_drift * (point[0] - before_s)
        self._slope = self._best_slope()
        intercept = min(offset - self._slope * time for time, offset in points)
        self._intercept = min(intercept, highest - self._slope * point[0])

    def _best_slope(self) -> float:
        points = self._points
        if points[-1][0] - points[0][0] < self._window_s / 4:
            return 0.0
        mean = sum(time for time, _ in points) / len(points)
        hull = lower_hull(points)
        for (t0, y0), (t1, y1) in pairwise(hull):
            if t1 >= mean:
                return min(max((y1 - y0) / (t1 - t0), -self._maximum_drift), self._maximum_drift)
        return 0.0


def lower_hull(points: "deque[Point] | list[Point]") -> list[Point]:
    """Lower convex hull of points sorted by their first coordinate (Andrew's monotone chain)."""
    hull: list[Point] = []
    for point in points:
        while len(hull) >= 2 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    return hull


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
