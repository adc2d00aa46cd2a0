"""Result of one test of an integrity monitor, since when it lasts, and the messages that publish it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from ..messages.explanation import Explanation
from ..messages.trust import MonitorTest, Outcome, TrustMonitor
from ..words.words import reason

ORDER = (Outcome.NOT_EVALUATED, Outcome.PASS, Outcome.ACCUSES)


@dataclass(frozen=True)
class Test:
    """Result of one test at one time; it accuses when its statistic is strictly greater than its threshold.

    `statistic` and `threshold` share `unit`. `false_alarm_rate` is that of one evaluation by design, None where a rule
    fixes the threshold. `accused` are those that a test of this kind accuses; they count where it does. Evidence may be
    wrong since `suspect_since_ns`, and `since_ns` is when the outcome was reached.
    """

    __test__: ClassVar[bool] = False  # for pytest, this is no test case

    outcome: Outcome
    why: Explanation
    unit: str = "-"
    statistic: float | None = None
    threshold: float | None = None
    false_alarm_rate: float | None = None
    window_s: float | None = None
    accused: tuple[str, ...] = ()
    suspect_since_ns: int | None = None
    since_ns: int | None = None
    doubtful: bool = False  # it passes, but by little

    @property
    def evaluated(self) -> bool:
        """Whether there is a result."""
        return self.outcome is not Outcome.NOT_EVALUATED

    @property
    def accuses(self) -> bool:
        """Whether it accuses."""
        return self.outcome is Outcome.ACCUSES

    @property
    def weight(self) -> tuple[int, float]:
        """Order of the tests of a monitor: accusing, passing, not evaluated; then by the ratio to the threshold."""
        ratio = self.statistic / self.threshold if self.statistic is not None and self.threshold else 0.0
        return ORDER.index(self.outcome), ratio


def dated(new: Test, old: Test | None, time_ns: int) -> Test:
    """Carry over since when an outcome lasts and, while a test accuses, the earliest suspect time."""
    if old is None or new.outcome is not old.outcome or old.since_ns is None:
        return replace(new, since_ns=time_ns)
    suspect = [t for t in (old.suspect_since_ns, new.suspect_since_ns) if t is not None]
    if new.accuses and suspect:
        return replace(new, suspect_since_ns=min(suspect), since_ns=old.since_ns)
    return replace(new, since_ns=old.since_ns)


def published(name: str, test: Test) -> MonitorTest:
    """Message of one of the tests of a monitor; its code says it without a text."""
    return MonitorTest(
        name=name, outcome=test.outcome, reason_code=test.why, statistic=test.statistic, threshold=test.threshold,
        unit=test.unit, false_alarm_rate=test.false_alarm_rate, window_s=test.window_s, since_ns=test.since_ns,
    )  # fmt: skip


def statement(
    monitor: str, deciding: Test, time_ns: int, tests: Mapping[str, Test] | tuple[MonitorTest, ...] = ()
) -> TrustMonitor:
    """Message of a monitor: its deciding test, and all of them by name."""
    each = tuple(published(name, test) for name, test in tests.items()) if isinstance(tests, Mapping) else tests
    return TrustMonitor(
        sampled_ns=time_ns, monitor=monitor, outcome=deciding.outcome, reason=reason(deciding.why),
        reason_code=deciding.why, accused=deciding.accused if deciding.accuses else (), doubtful=deciding.doubtful,
        suspect_since_ns=deciding.suspect_since_ns if deciding.accuses else None, since_ns=deciding.since_ns,
        statistic=deciding.statistic, threshold=deciding.threshold, false_alarm_rate=deciding.false_alarm_rate,
        window_s=deciding.window_s, tests=each,
    )  # fmt: skip
