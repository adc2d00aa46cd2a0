"""Recognises that UTC of a receiver steps by whole seconds, as when it learns the leap seconds."""

from collections import deque
from statistics import median

from shared.maths.dates import NS

TOLERANCE_NS = NS // 4  # of an interval, by which its arrival may differ
INTERVALS = 8  # that the usual one is the median of
MIN_STEPS = 2


class UtcSteps:
    """Makes times of day continuous over steps by whole seconds.

    A step is an interval that is wrong by whole seconds in the receiver's time while it is the usual one in the
    arrivals. After lost or late epochs both are long, or the arrivals alone.
    """

    def __init__(self) -> None:
        self._before: tuple[int, int] | None = None  # time and arrival of the epoch before [ns]
        self._usual_ns: deque[int] = deque(maxlen=INTERVALS)
        self._total_ns = 0

    def continuous(self, time_ns: int, received_ns: int) -> tuple[int, int]:
        """Give the time without the steps so far, and by how many seconds it stepped at this epoch."""
        step_s = 0
        if self._before is not None:
            told_ns, arrived_ns = time_ns - self._before[0], received_ns - self._before[1]
            usual_ns = round(median(self._usual_ns)) if len(self._usual_ns) >= MIN_STEPS else None
            if usual_ns is not None and abs(arrived_ns - usual_ns) <= min(TOLERANCE_NS, usual_ns // 2):
                step_s = _whole_seconds(told_ns - usual_ns)
            if told_ns > 0 and step_s == 0:
                self._usual_ns.append(told_ns)
        self._before = time_ns, received_ns
        self._total_ns += step_s * NS
        return time_ns - self._total_ns, step_s


def _whole_seconds(difference_ns: int) -> int:
    """The seconds of a difference; 0 if it is not of whole seconds, to within the resolution of NMEA."""
    seconds = round(difference_ns / NS)
    return seconds if abs(difference_ns - seconds * NS) <= 20_000_000 else 0
