"""Stamps samples that carry no time: evenly spaced, by how many of them had arrived at which time."""

from collections import deque
from itertools import pairwise

from shared.maths.clock_mapping import NS, lower_hull

WINDOW_NS = 10 * NS  # over which the period is measured
MIN_SPACING_NS = NS // 10  # at least, between arrivals that are kept
FIRST_PERIOD_NS = NS // 100  # of samples in the very first read, before anything is known of the period
GAP_NS = NS // 10
GAP_PERIODS = 3.0  # an arrival so many times later than its samples explain follows a gap
MAX_STEP_BACK_NS = NS // 2  # by which arrivals go back with another recording


class SampleClock:
    """The times of a device that sends at a constant rate, and whose bytes are handed over several samples at once.

    Parameters
    ----------
    minimum_delay_s : float
        [s] Minimum delay from a sample to its arrival.

    Notes
    -----
    With k samples received up to the arrival t, each read is a point (k, t). A late read lies above the line of the
    least delay, none lies below it, so that the line is an edge of the lower convex hull of the points of the last ten
    seconds: its slope is the period, and sample k was taken at its value less the minimum delay.
    """

    def __init__(self, minimum_delay_s: float) -> None:
        self._delay_ns = round(minimum_delay_s * NS)
        self._reads: deque[tuple[int, int]] = (
            deque()
        )  # samples so far and arrival [ns], at least `MIN_SPACING_NS` apart
        self._count = 0
        self._last_received_ns: int | None = None
        self._last_stamp_ns = 0
        self._period_ns = float(FIRST_PERIOD_NS)

    def stamp(self, number: int, received_ns: int) -> tuple[int, ...]:
        """Times of validity [ns, OBU time line] of samples that arrived together; they increase strictly."""
        before_ns = self._last_received_ns
        waited_ns = 0 if before_ns is None else received_ns - before_ns
        if before_ns is not None and waited_ns < -MAX_STEP_BACK_NS:
            self._last_stamp_ns = 0
        gap = waited_ns > max(GAP_NS, GAP_PERIODS * number * self._period_ns)
        if gap or waited_ns < -MAX_STEP_BACK_NS:
            self._reads.clear()
        first, self._count = self._count + 1, self._count + number
        self._note(received_ns)
        line_ns = min(at_ns - count * self._period_ns for count, at_ns in (*self._reads, (self._count, received_ns)))
        stamps = [self._place(round(line_ns + k * self._period_ns), received_ns) for k in range(first, self._count + 1)]
        self._last_received_ns = received_ns
        return tuple(stamps)

    def _place(self, expected_ns: int, received_ns: int) -> int:
        """Bound a time by its arrival and by half a period behind the sample before."""
        least_ns = self._last_stamp_ns + max(round(self._period_ns / 2), 1)
        stamp_ns = min(max(expected_ns - self._delay_ns, least_ns), received_ns)
        self._last_stamp_ns = max(stamp_ns, self._last_stamp_ns + 1)
        return self._last_stamp_ns

    def _note(self, received_ns: int) -> None:
        reads = self._reads
        while reads and reads[0][1] < received_ns - WINDOW_NS:
            reads.popleft()
        points = [*reads, (self._count, received_ns)]
        if len(points) > 1:
            self._period_ns = _slope([(float(count), float(at_ns - points[0][1])) for count, at_ns in points])
        if not reads or received_ns - reads[-1][1] >= MIN_SPACING_NS:
            reads.append((self._count, received_ns))


def _slope(points: list[tuple[float, float]]) -> float:
    """Slope of the edge of the lower hull below the middle; at least that of one ns a sample."""
    middle = (points[0][0] + points[-1][0]) / 2.0
    for (k0, t0), (k1, t1) in pairwise(lower_hull(points)):
        if k1 >= middle:
            return max((t1 - t0) / (k1 - k0), 1.0)
    return 1.0
