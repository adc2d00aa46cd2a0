"""Two statements of the verdicts: `inertial_short` of the tests over 5 s, `inertial_long` of 30 and 60 s."""

from collections.abc import Iterator, Mapping

from shared.messages.trust import MonitorTest, Outcome, TrustMonitor

from .verdicts import Verdict
from .windows.metrics import Metric
from .windows.position_step import NAME

REASON_LENGTH = 400  # of a message
MONITORS = "inertial_short", "inertial_long", "gyroscope", "drift"
SHORT = (*(metric.value for metric in Metric), NAME)


def statements(
    verdicts: Mapping[str, Verdict], time_ns: int, *, warning: str = ""
) -> tuple[TrustMonitor, TrustMonitor]:
    """Give the statements of the monitors `inertial_short`, with a warning of its profile, and `inertial_long`."""
    short = {name: verdict for name, verdict in verdicts.items() if name in SHORT}
    long = {name: verdict for name, verdict in verdicts.items() if name not in SHORT}
    warned = statement("inertial_short", short, time_ns)
    if warning:
        warned = warned.model_copy(update={"reason": f"{warned.reason}; {warning}"[:REASON_LENGTH]})
    return warned, statement("inertial_long", long, time_ns)


def paused_statements(time_ns: int, reason: str) -> Iterator[TrustMonitor]:
    """Give the statements of all monitors of this process while nothing is evaluated."""
    for monitor in MONITORS:
        yield TrustMonitor(
            sampled_ns=time_ns, monitor=monitor, outcome=Outcome.NOT_EVALUATED, reason=reason, accused=()
        )


def statement(monitor: str, verdicts: Mapping[str, Verdict], time_ns: int) -> TrustMonitor:
    """Statement of the deciding test: accusing before passing before not evaluated, then the largest ratio."""
    deciding = max(verdicts.values(), key=_weight)
    suspect = [verdict.suspect_since_ns for verdict in verdicts.values() if verdict.suspect_since_ns is not None]
    return TrustMonitor(
        sampled_ns=time_ns, monitor=monitor, outcome=deciding.outcome, reason=deciding.reason,
        accused=_accused(verdicts), doubtful=any(verdict.doubtful for verdict in verdicts.values()),
        suspect_since_ns=min(suspect, default=None), since_ns=_since(verdicts, deciding.outcome),
        statistic=deciding.statistic, threshold=deciding.threshold, false_alarm_rate=deciding.false_alarm_rate,
        window_s=deciding.window_s, tests=tuple(_test(name, verdict) for name, verdict in verdicts.items()),
    )  # fmt: skip


def _accused(verdicts: Mapping[str, Verdict]) -> tuple[str, ...]:
    """GNSS alone where one of the tests can tell it from the inertial sensors."""
    accusing = [verdict.accused for verdict in verdicts.values() if verdict.outcome is Outcome.ACCUSES]
    return min(accusing, key=len, default=())


def _since(verdicts: Mapping[str, Verdict], outcome: Outcome) -> int | None:
    times = [v.since_ns for v in verdicts.values() if v.outcome is outcome and v.since_ns is not None]
    return min(times, default=None)


def _weight(verdict: Verdict) -> tuple[int, float]:
    order = (Outcome.NOT_EVALUATED, Outcome.PASS, Outcome.ACCUSES)
    ratio = verdict.statistic / verdict.threshold if verdict.statistic is not None and verdict.threshold else 0.0
    return order.index(verdict.outcome), ratio


def _test(name: str, verdict: Verdict) -> MonitorTest:
    return MonitorTest(
        name=name, outcome=verdict.outcome, reason=verdict.reason, unit=verdict.unit, statistic=verdict.statistic,
        threshold=verdict.threshold, false_alarm_rate=verdict.false_alarm_rate, window_s=verdict.window_s,
        since_ns=verdict.since_ns,
    )  # fmt: skip
