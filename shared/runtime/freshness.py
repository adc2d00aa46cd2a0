"""How old is too old, and how late is usual: the one rule by which all who watch the unit judge what they see.

A value is *late* after max(3 periods, 0.5 s) and *stale* after the deadline of its topic, or max(10 periods, 5 s)
where the contract sets none. A topic without a rate is *quiet*: silence says nothing about it.
"""

from collections.abc import Collection
from dataclasses import dataclass
from math import ceil

from ..messages.operation import Freshness
from ..topics import Topic

STARTUP_GRACE_S = 120.0  # what has not yet been seen is no alert before


@dataclass(frozen=True)
class Limits:
    """Ages [s] from which a value is late, and from which it must not be shown as live."""

    late_after_s: float
    stale_after_s: float


def limits_of(topic: Topic) -> Limits | None:
    """Derive the limits of a topic from its row in the contract; None if it has no rate."""
    if topic.rate_hz is None:
        return None
    period_s = 1.0 / topic.rate_hz
    stale_after_s = topic.silent_after_s or max(10.0 * period_s, 5.0)
    return Limits(min(max(3.0 * period_s, 0.5), stale_after_s), stale_after_s)


def freshness_of(age_s: float | None, limits: Limits | None) -> Freshness:
    """Classify an age; None if nothing was received."""
    if age_s is None:
        return Freshness.NEVER
    if limits is None:
        return Freshness.QUIET
    if age_s >= limits.stale_after_s:
        return Freshness.STALE
    return Freshness.LATE if age_s >= limits.late_after_s else Freshness.FRESH


def percentile(values: Collection[float], share: float) -> float | None:
    """The quantile of values; None without values."""
    if not values:
        return None
    return sorted(values)[max(ceil(share * len(values)) - 1, 0)]
