"""Oscillators of neighbours that publish no offset of their own, as a CAM does: learned of their carrier frequency.

The offset of a sender is what its carrier frequency has beside the range-rate that the own estimate predicts::

    c y_t = (c/f0) CFO + rdot + c y_r

with y_r the own radio's offset by that estimate: only the difference of both shows in a measurement. 1 m/s is 19.7 Hz,
and 20 ppm are 6 km/s or 118 kHz, which the first measurements take off. What is left is a random walk of both
oscillators, of which a range-rate is known as well as this offset: changes of seconds, and no lasting error.
"""

from collections import OrderedDict
from dataclasses import dataclass
from math import sqrt

LEARNED_S = 10.0  # [s] from the first measurement of a sender until its offset is used
WALK_M_S = 0.1  # [m/s per sqrt(s)] of both oscillators: 0.3 ppb of temperature-compensated ones
JUMP_SDS = 10.0  # [-] beyond which an offset is learned from its beginning
MAX_SENDERS = 256
FORGET_S = 30.0
SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class SenderOffset:
    """Offset c y_t [m/s] of a sender, with its variance."""

    first_ns: int
    time_ns: int
    value: float
    variance: float
    own_variance: float  # [m²/s²] of the own velocity, which all measurements share: no mean takes it away

    @property
    def sd(self) -> float:
        """Standard deviation [m/s]."""
        return sqrt(self.variance + self.own_variance)


class SenderOscillators:
    """Learns the offset of each sender by a Kalman filter of one state."""

    def __init__(self) -> None:
        self._senders: OrderedDict[str, SenderOffset] = OrderedDict()

    def clear(self) -> None:
        """Forget all of them: the estimate that they were learned by has restarted."""
        self._senders.clear()

    def known(self, name: str, time_ns: int) -> SenderOffset | None:
        """Offset of a sender at a time, of measurements before it; None until it has been learned."""
        sender = self._senders.get(name)
        if sender is None or not 0 <= time_ns - sender.time_ns <= FORGET_S * SECOND_NS:
            return None
        return _later(sender, time_ns) if time_ns - sender.first_ns >= LEARNED_S * SECOND_NS else None

    def learn(self, name: str, time_ns: int, offset: float, sd: float, own_sd: float) -> None:
        """Use a measurement of c y_t [m/s] with its noise [m/s] and the deviation of the own velocity [m/s]."""
        self._senders[name] = _learned(self._senders.pop(name, None), time_ns, offset, sd, own_sd)
        while len(self._senders) > MAX_SENDERS:
            self._senders.popitem(last=False)


def _learned(before: SenderOffset | None, time_ns: int, offset: float, sd: float, own_sd: float) -> SenderOffset:
    """Offset after a measurement; of a sender that was silent, or jumps, it begins again with this one."""
    begun = SenderOffset(time_ns, time_ns, offset, sd**2, own_sd**2)
    if before is None or not 0 <= time_ns - before.time_ns <= FORGET_S * SECOND_NS:
        return begun
    prior, shared = _later(before, time_ns), max(before.own_variance, own_sd**2)
    if abs(offset - prior.value) > JUMP_SDS * sqrt(prior.variance + sd**2 + shared):
        return begun
    gain = prior.variance / (prior.variance + sd**2)
    value, variance = prior.value + gain * (offset - prior.value), (1.0 - gain) * prior.variance
    return SenderOffset(before.first_ns, time_ns, value, variance, shared)


def _later(sender: SenderOffset, time_ns: int) -> SenderOffset:
    walked = WALK_M_S**2 * (time_ns - sender.time_ns) / SECOND_NS
    return SenderOffset(sender.first_ns, time_ns, sender.value, sender.variance + walked, sender.own_variance)
