"""Statements of the integrity monitors, and the verdict that `core.trust` makes of them."""

from enum import StrEnum
from typing import Annotated

from .base import Count, Deviation, Message, Name, Nanoseconds, Ratio, Reason, unit


class MonitorOutcome(StrEnum):
    """Result of a monitor: "not evaluated" is neither passed nor failed."""

    PASS = "pass"
    ACCUSES = "accuses"
    NOT_EVALUATED = "not_evaluated"


class MonitorTest(Message):
    """One test of a monitor: it accuses when the statistic is greater than the threshold."""

    name: Name
    outcome: MonitorOutcome
    reason: Reason
    statistic: Annotated[float, unit("of the test")] | None = None
    threshold: Annotated[float, unit("of the test")] | None = None
    unit: Name = "-"
    false_alarm_rate: Ratio | None = None  # by design, of one evaluation; None where a rule fixes the threshold
    window_s: float | None = None
    since_ns: Nanoseconds | None = None  # when this outcome was reached


class TrustMonitor(Message):
    """Latest result of one integrity monitor, with the tests behind it."""

    sampled_ns: Nanoseconds
    monitor: Name
    outcome: MonitorOutcome
    reason: Reason
    accused: tuple[Name, ...] = ()  # gnss, odometer, the ID of a satellite or of a neighbour
    suspect_since_ns: Nanoseconds | None = None  # earliest time from which the evidence may be wrong
    since_ns: Nanoseconds | None = None  # when this outcome was reached
    statistic: Annotated[float, unit("of the test")] | None = None
    threshold: Annotated[float, unit("of the test")] | None = None
    false_alarm_rate: Ratio | None = None
    window_s: float | None = None
    tests: tuple[MonitorTest, ...] = ()


class TrustLevel(StrEnum):
    """Whether the position can be used."""

    SAFE = "safe"
    CAUTION = "caution"
    UNSAFE = "unsafe"
    DEAD_RECKONING = "dead_reckoning"
    NO_FIX = "no_fix"
    INITIALISING = "initialising"


class TrustState(Message):
    """The verdict on the position, with its reasons and the statement of every monitor."""

    sampled_ns: Nanoseconds
    state: TrustLevel
    since_ns: Nanoseconds
    row: Count  # of the verdict table that decided
    reasons: tuple[Reason, ...]  # that of the deciding row first
    findings: tuple[Reason, ...] = ()  # accused or excluded sources that do not lower the verdict
    gnss_excluded: bool = False
    suspect_since_ns: Nanoseconds | None = None  # of the exclusion of GNSS
    odometer_excluded: bool = False
    protection_level_horizontal_m: Deviation | None = None
    protection_level_vertical_m: Deviation | None = None
    alert_limit_horizontal_m: Deviation
    alert_limit_vertical_m: Deviation
    monitors: tuple[TrustMonitor, ...] = ()


class TrustEvent(Message):
    """A change of the verdict, with the evidence at that time."""

    sampled_ns: Nanoseconds
    before: TrustLevel
    after: TrustLevel
    reasons: tuple[Reason, ...]
    monitors: tuple[TrustMonitor, ...] = ()
