"""Estimates the state of the IMU clock from the stamps of rejected samples."""

from .imu_gaps import MAX_BRIDGED_S
from .propagation import GAP_S

FUTURE_LIMIT_NS = 2_000_000_000  # a stamp so far ahead of the arrival is wrong
REJECTED_LIMIT = 100  # successive samples that do not follow, after which it is the clock that was set


class Clock:
    """Consecutive samples rejected for their stamps, and the time lost with them."""

    def __init__(self) -> None:
        self.rejected = 0
        self._last_ns: int | None = None  # stamp of the newest that was rejected
        self._lost_ns = 0

    def is_ahead(self, time_ns: int, newest_ns: int, received_ns: int | None) -> bool:
        """Whether a sample is from the future; after many in a row the clock is ahead for good, and they are not."""
        if received_ns is None or time_ns <= max(newest_ns, received_ns) + FUTURE_LIMIT_NS:
            return False
        self.rejected += 1
        return self.rejected <= REJECTED_LIMIT

    def goes_back(self, time_ns: int, *, known: bool) -> bool:
        """Count a sample from the past; returns whether the clock was set back by more than can be bridged.

        Stamps that advance below one that was used are a clock that was set back: their time is lost. That of `known`
        ones is not: they come twice, to the last bit, or the filter was carried over their time without them.
        """
        self.rejected += 1
        step_ns = 0 if known or self._last_ns is None else time_ns - self._last_ns
        self._lost_ns += step_ns if 0 < step_ns <= GAP_S * 1e9 else 0
        self._last_ns = None if known else time_ns
        return self.rejected > REJECTED_LIMIT or self._lost_ns > MAX_BRIDGED_S * 1e9

    @property
    def lost_s(self) -> float:
        """How much time was lost, if it is more than is integrated over."""
        return self._lost_ns * 1e-9 if self._lost_ns > GAP_S * 1e9 else 0.0
