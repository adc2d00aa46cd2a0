"""The horizon: the time on the log before which nothing more can arrive, and up to which the filter runs in order."""

from bisect import bisect_left

STEPS_NS = tuple(round(step_s * 1e9) for step_s in (0.0, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5))


class Horizon:
    """Lag of the filter behind the newest sample: the largest delay of a measurement, and an allowance for the bus.

    The lag depends on stamps and arrival stamps alone, so that a live unit and a solution of its recording agree. It
    grows in steps and never shrinks; while it grows the horizon waits.

    Parameters
    ----------
    allowance_ns : int
        [ns] Time after its arrival at the driver within which a measurement reaches the filter.
    longest_ns : int
        [ns] Delay of measurements beyond which they are rejected, and do not count.
    """

    def __init__(self, allowance_ns: int, longest_ns: int) -> None:
        self._allowance_ns, self._longest_ns = allowance_ns, longest_ns
        self.lag_ns = 0
        self.see(0, 0)

    def see(self, time_ns: int, received_ns: int) -> None:
        """Note a measurement that was true at one time and received at another."""
        delay_ns = received_ns - time_ns
        if delay_ns <= self._longest_ns and delay_ns + self._allowance_ns > self.lag_ns:
            step = bisect_left(STEPS_NS, delay_ns + self._allowance_ns)
            self.lag_ns = STEPS_NS[min(step, len(STEPS_NS) - 1)]

    def behind(self, newest_ns: int) -> int:
        """Horizon at a newest sample."""
        return newest_ns - self.lag_ns
