"""Outcome of one test at one time."""

from typing import NamedTuple

from shared.messages.trust import Outcome

EITHER = ("gnss", "imu")  # one difference of the two says the same of both
GNSS = ("gnss",)


class Verdict(NamedTuple):
    """Outcome of one test; it accuses when the statistic is strictly greater than the threshold."""

    outcome: Outcome
    reason: str
    unit: str = "-"
    statistic: float | None = None
    threshold: float | None = None
    false_alarm_rate: float | None = None
    window_s: float | None = None
    suspect_since_ns: int | None = None
    since_ns: int | None = None
    accused: tuple[str, ...] = EITHER  # where it accuses
    doubtful: bool = False  # it passes, but by little


def dated(new: Verdict, old: Verdict | None, time_ns: int) -> Verdict:
    """Carry over since when an outcome lasts and, while a test accuses, the earliest suspect time."""
    if old is None or new.outcome is not old.outcome or old.since_ns is None:
        return new._replace(since_ns=time_ns)
    suspect = [t for t in (old.suspect_since_ns, new.suspect_since_ns) if t is not None]
    if new.outcome is Outcome.ACCUSES and suspect:
        return new._replace(suspect_since_ns=min(suspect), since_ns=old.since_ns)
    return new._replace(since_ns=old.since_ns)
