"""Drift of the receiver clock over a loss of all signals: an oscillator changes slowly, a transmitter has its own."""

from dataclasses import dataclass

from shared.maths.gnss_signals import SPEED_OF_LIGHT

from .baselines import MAX_STEP_S, NS

STEP_M_S = 1.0  # [m/s] of drift that two statements of a receiver differ by
RATE_M_S2 = 0.3  # [m/s²] of a crystal whose temperature changes
MIN_SATELLITES = 4  # of a clock that is measured and not extrapolated
RETURN_S = 5.0  # [s] after a return, in which a receiver may state its old drift once more
WARM_UP_S = 120.0  # [s] after a restart of the receiver
FRESH_FOR_S = 1.5  # [s] age of a statement of the clock that belongs to an epoch


@dataclass(frozen=True)
class DriftChange:
    """Change of the clock's drift [m/s] over a loss of a length [s], and its limit [m/s]."""

    drift_m_s: float
    gap_s: float
    limit_m_s: float


class DriftOverLoss:
    """Compares the drift after a loss with the last one before it.

    Notes
    -----
    Limit on the change over a gap of T seconds: 1 m/s + 0.3 m/s² T. A receiver states its clock during a loss too, so
    that a gap is one of the used satellites. After silence of the receiver, which is taken for its restart, the drift
    is compared once it has warmed up.
    """

    def __init__(self) -> None:
        self._clock: tuple[int, float] | None = None  # newest statement [m/s]
        self._before: tuple[int, float] | None = None  # of the newest epoch before a loss
        self._gap_s = 0.0  # of the present return
        self._returned_ns: int | None = None
        self._heard_ns: int | None = None
        self._warm_ns = 0  # end of the warm-up

    def heard(self, time_ns: int) -> None:
        """Note any message of the receiver; one after silence is that of a restart."""
        if self._heard_ns is not None and (time_ns - self._heard_ns) / NS > MAX_STEP_S:
            self._warm_ns = time_ns + round(WARM_UP_S * NS)
        self._heard_ns = time_ns

    def clock(self, time_ns: int, drift_ratio: float) -> None:
        """Use a statement of the clock."""
        self._clock = time_ns, drift_ratio * SPEED_OF_LIGHT

    def epoch(self, time_ns: int, satellites: int) -> DriftChange | None:
        """Use an epoch with a number of used satellites; returns the change while it is one after a loss."""
        if self._clock is None or satellites < MIN_SATELLITES or abs(time_ns - self._clock[0]) / NS > FRESH_FOR_S:
            return None
        before, after = self._before, self._clock
        if before is None:
            self._before = after
            return None
        gap_s = (time_ns - before[0]) / NS
        if self._returned_ns is None:
            if gap_s <= MAX_STEP_S or gap_s < 0.0:
                self._before = after
                return None
            if time_ns < self._warm_ns:
                return None
            self._returned_ns, self._gap_s = time_ns, gap_s
        if (time_ns - self._returned_ns) / NS > RETURN_S:
            self._before, self._returned_ns = after, None
        return DriftChange(after[1] - before[1], self._gap_s, STEP_M_S + RATE_M_S2 * self._gap_s)
