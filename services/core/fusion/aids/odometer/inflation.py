"""Inflation of the velocity along the vehicle while speeds are rejected for long; for a short time wheels may spin."""

from shared.maths.compiled import compilable

from .zero_speeds import NO_TIME_NS

INFLATION_M_S_SQRT_S = 0.1  # once a second
AFTER_NS, PERIOD_NS = 2_000_000_000, 1_000_000_000


@compilable
def inflation_after(time_ns: int, inflation_ns: int, rejected: bool) -> tuple[int, bool]:
    """Time of the next inflation after a speed, and whether the velocity is inflated now."""
    if not rejected:
        return NO_TIME_NS, False
    inflation_ns = time_ns + AFTER_NS if inflation_ns == NO_TIME_NS else inflation_ns
    due = time_ns >= inflation_ns
    return time_ns + PERIOD_NS if due else inflation_ns, due
