"""Fixes that arrive late: the receiver's own time says when they were true."""

from shared.maths.clock_mapping import ClockMapping
from shared.messages.gnss import GnssFix

# [s] Delay up to which the receiver's time is believed against the arrivals; beyond it, that time has stepped.
MAX_DELAY_S = 2.0
MIN_DELAY_S = 0.2  # arrivals vary by 0.1 s with the number of messages


def with_lateness(fix: GnssFix, clock: ClockMapping) -> GnssFix:
    """Fix that says by how much it arrived later than the fastest ones, where that is more than they vary."""
    if clock.late_s < MIN_DELAY_S:
        return fix
    return fix.model_copy(update={"late_s": round(clock.late_s, 3)})
