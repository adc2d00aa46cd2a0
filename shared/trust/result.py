"""Result of one test of an integrity monitor, since when it lasts, and the messages that publish it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

from ..messages.explanation import Explanation
from ..messages.trust import MonitorTest, Outcome, TrustMonitor
from ..words.words import reason, said

SATELLITE_LEFT_OUT = "cooperative.left_out"  # code of the test of one that the others are evaluated without
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


NO_TESTS: Mapping[str, Test] = MappingProxyType({})


def judged(base: Test, statistic: float, threshold: float, *, accuses: bool | None = None) -> Test:
    """Complete a test that has been evaluated; without `accuses` it accuses above its threshold."""
    above = statistic > threshold if accuses is None else accuses
    return replace(
        base, outcome=Outcome.ACCUSES if above else Outcome.PASS, statistic=statistic, threshold=threshold
    )  # fmt: skip


def lasting(new: Test, old: Test | None, time_ns: int) -> Test:
    """Carry over since when an outcome lasts."""
    lasts = old is not None and new.outcome is old.outcome and old.since_ns is not None
    return replace(new, since_ns=old.since_ns if lasts and old is not None else time_ns)


def dated(new: Test, old: Test | None, time_ns: int) -> Test:
    """Carry over since when an outcome lasts and, while a test accuses, the earliest suspect time."""
    found = lasting(new, old, time_ns)
    if old is None or not (new.accuses and old.accuses):
        return found
    suspect = [t for t in (old.suspect_since_ns, new.suspect_since_ns) if t is not None]
    return replace(found, suspect_since_ns=min(suspect, default=None))


def deciding(tests: Collection[Test]) -> Test:
    """Sum up tests of which each may accuse: the one of the largest weight, accused as narrowly as one of them does."""
    first = max(tests, key=lambda test: test.weight)
    same = [test.since_ns for test in tests if test.outcome is first.outcome and test.since_ns is not None]
    accusing = [test for test in tests if test.accuses]
    suspect = [test.suspect_since_ns for test in accusing if test.suspect_since_ns is not None]
    return replace(
        first, since_ns=min(same, default=None), suspect_since_ns=min(suspect, default=None),
        accused=min((test.accused for test in accusing), key=len, default=()),
        doubtful=any(test.doubtful for test in tests),
    )  # fmt: skip


def complete(why: Explanation, of: Test | MonitorTest | TrustMonitor) -> Explanation:
    """Add the statistic, the threshold and the window of a test, which are not repeated in its explanation."""
    figures = {"statistic": of.statistic, "threshold": of.threshold, "window_s": of.window_s}
    known = {name: value for name, value in figures.items() if value is not None}
    return why.model_copy(update={"values": {**known, **why.values}})


def told(message: MonitorTest | TrustMonitor) -> str:
    """Say why a test or a monitor has its outcome: by its code, and by its own text where it has none."""
    code = message.reason_code
    return said(message.reason, None if code is None else complete(code, message))


def published(name: str, test: Test) -> MonitorTest:
    """Message of one of the tests of a monitor; its code says it without a text."""
    return MonitorTest(
        name=name, outcome=test.outcome, reason_code=test.why, statistic=test.statistic, threshold=test.threshold,
        unit=test.unit, false_alarm_rate=test.false_alarm_rate, window_s=test.window_s, since_ns=test.since_ns,
    )  # fmt: skip


def statement(monitor: str, decides: Test, time_ns: int, tests: Mapping[str, Test] = NO_TESTS) -> TrustMonitor:
    """Message of a monitor: its deciding test, and all of them by name."""
    return TrustMonitor(
        sampled_ns=time_ns, monitor=monitor, outcome=decides.outcome, reason=reason(complete(decides.why, decides)),
        reason_code=decides.why, accused=decides.accused if decides.accuses else (), doubtful=decides.doubtful,
        suspect_since_ns=decides.suspect_since_ns if decides.accuses else None, since_ns=decides.since_ns,
        statistic=decides.statistic, threshold=decides.threshold, false_alarm_rate=decides.false_alarm_rate,
        window_s=decides.window_s, tests=tuple(published(name, test) for name, test in tests.items()),
    )  # fmt: skip
