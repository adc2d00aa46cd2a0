"""What the evidence is compared with: slow means, the clock's own prediction, and the offset of GNSS time."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import exp

NS = 1_000_000_000
JUMP_S = 1e-3  # a receiver keeps its clock near GPS time by jumps of whole milliseconds
MAX_STEP_S = 2.5  # between two clock messages, over which the drift predicts the bias
RECENT_S, EARLIER_S = 10, 60  # windows of the offset of GNSS time
MIN_OFFSETS = 5
GROWTH_SHARE = 0.3  # share of a growth that shows before the last seconds


class SlowMean:
    """Exponential mean of a level, which is known after a learning time and does not learn while it is in doubt."""

    def __init__(self, time_constant_s: float, learning_s: float) -> None:
        self._time_constant_s, self._learning_s = time_constant_s, learning_s
        self._mean = self._learned_s = 0.0
        self._last_ns: int | None = None

    @property
    def value(self) -> float | None:
        """The mean, None while it is being learned."""
        return self._mean if self._learned_s >= self._learning_s else None

    def update(self, time_ns: int, value: float) -> None:
        """Use a value: mean += (1 - exp(-dt / T)) (value - mean), with the plain mean until T has passed."""
        step_s = 0.0 if self._last_ns is None else min(max((time_ns - self._last_ns) / NS, 0.0), MAX_STEP_S)
        self._last_ns = time_ns
        if self._learned_s == 0.0:
            self._mean = value
        else:
            weight = max(1.0 - exp(-step_s / self._time_constant_s), step_s / (self._learned_s + step_s))
            self._mean += weight * (value - self._mean)
        self._learned_s = min(self._learned_s + step_s, self._time_constant_s) or 1e-9


@dataclass(frozen=True)
class ClockChange:
    """How far a clock is from where its drift had predicted it."""

    bias_s: float
    drift_ratio: float
    sd_s: float


class ClockPrediction:
    """Predicts the bias of a receiver's clock from one message to the next."""

    def __init__(self) -> None:
        self._last: tuple[int, float, float, float] | None = None

    def update(self, time_ns: int, bias_s: float, drift_ratio: float, sd_s: float) -> ClockChange | None:
        """Use a message; None for the first one, and after a pause.

        Notes
        -----
        With bias b, drift d, and jumps of whole milliseconds removed::

            change = wrap(b_k - b_{k-1} - (d_k + d_{k-1}) / 2 · dt)
        """
        last, self._last = self._last, (time_ns, bias_s, drift_ratio, sd_s)
        if last is None or not 0.0 < (step_s := (time_ns - last[0]) / NS) <= MAX_STEP_S:
            return None
        change = bias_s - last[1] - 0.5 * (drift_ratio + last[2]) * step_s
        wrapped = (change + 0.5 * JUMP_S) % JUMP_S - 0.5 * JUMP_S
        return ClockChange(wrapped, drift_ratio - last[2], max(sd_s, last[3]))


class TimeOffset:
    """Offset of GNSS time from the OBU time line, by the arrivals with the least delay."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[int, int]] = deque(maxlen=25 * (RECENT_S + EARLIER_S))

    def step(self, received_ns: int, utc_ns: int) -> float | None:
        """Use an arrival; give the jump [s] of GNSS time within the last seconds, None while there are too few.

        Notes
        -----
        jump = min(arrival - UTC of the minute before) - min(arrival - UTC of the last 10 s): positive when GNSS time
        jumped ahead. A jump ahead shows at once, one back when it is 10 s old; arrivals that become late little by
        little look like time that runs back, and are none.
        """
        if self._offsets and received_ns < self._offsets[-1][0]:
            self._offsets.clear()
        self._offsets.append((received_ns, received_ns - utc_ns))
        while self._offsets[0][0] < received_ns - (RECENT_S + EARLIER_S) * NS:
            self._offsets.popleft()
        recent, earlier = self.recent_ns(), self._least(lambda time_ns: time_ns <= received_ns - RECENT_S * NS)
        if recent is None or earlier is None:
            return None
        step_ns = earlier - recent
        if step_ns < 0 and self._grows(received_ns, -step_ns):
            return 0.0
        return step_ns / NS

    def _grows(self, now_ns: int, by_ns: int) -> bool:
        """Whether offsets had grown before the last seconds as well, by a share of what they have in the end."""
        begin_ns, end_ns = now_ns - 2 * RECENT_S * NS, now_ns - RECENT_S * NS
        before, between = self._least(lambda ns: ns <= begin_ns), self._least(lambda ns: begin_ns < ns <= end_ns)
        return before is not None and between is not None and between - before > GROWTH_SHARE * by_ns

    def recent_ns(self) -> int | None:
        """Least offset of the last seconds [ns], arrival minus UTC; None while there are too few."""
        limit_ns = self._offsets[-1][0] - RECENT_S * NS if self._offsets else 0
        return self._least(lambda time_ns: time_ns > limit_ns)

    def _least(self, within: Callable[[int], bool]) -> int | None:
        offsets = [offset_ns for time_ns, offset_ns in self._offsets if within(time_ns)]
        return min(offsets) if len(offsets) >= MIN_OFFSETS else None
