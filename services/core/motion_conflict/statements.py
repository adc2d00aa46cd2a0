"""Statements of the verdicts: the tachograph's tests, the fast test, and the common scale of both speeds."""

from dataclasses import fields

from shared.messages.trust import MonitorTest, Outcome, TrustMonitor

from .inertial_speed.monitor import ScaleVerdict
from .inertial_speed.scale_change import FALSE_ALARM_RATE
from .verdicts import MotionVerdicts, State, Verdict

# Order in which an accusing test gives the reason and the accused: tests that name one sensor first.
PRIORITY = (
    "held_speed", "motion_sensor", "calibrated", "trimmed_mean", "event", "distance", "scale_step", "scale_range",
)  # fmt: skip


def statements(verdicts: MotionVerdicts, time_ns: int) -> tuple[TrustMonitor, TrustMonitor]:
    """Give the statements of the monitors `motion` and `motion_fast`.

    `motion` accuses when one of the tests of `PRIORITY` does, and is not evaluated while no window is complete. The
    median is published for comparison and decides nothing: the regulation uses the trimmed mean.
    """
    named = {field.name: getattr(verdicts, field.name) for field in fields(verdicts)}
    accusing = [name for name in PRIORITY if named[name].state is State.ACCUSES]
    if accusing:
        deciding: Verdict = named[accusing[0]]
    else:
        deciding = verdicts.calibrated if verdicts.calibrated.state is State.PASS else verdicts.trimmed_mean
    tests = tuple(_test(name, verdict) for name, verdict in named.items() if name != "fast")
    return _statement("motion", deciding, time_ns, tests), _statement("motion_fast", verdicts.fast, time_ns, ())


def _test(name: str, verdict: Verdict) -> MonitorTest:
    return MonitorTest(
        name=name, outcome=Outcome(verdict.state.value), reason=verdict.reason, statistic=verdict.statistic,
        threshold=verdict.threshold, unit=verdict.unit, false_alarm_rate=verdict.false_alarm_rate,
        window_s=verdict.window_s, since_ns=verdict.since_ns,
    )  # fmt: skip


def _statement(monitor: str, verdict: Verdict, time_ns: int, tests: tuple[MonitorTest, ...]) -> TrustMonitor:
    return TrustMonitor(
        sampled_ns=time_ns, monitor=monitor, outcome=Outcome(verdict.state.value), reason=verdict.reason,
        accused=tuple(accused.value for accused in verdict.accused), suspect_since_ns=verdict.suspect_since_ns,
        since_ns=verdict.since_ns, statistic=verdict.statistic, threshold=verdict.threshold,
        false_alarm_rate=verdict.false_alarm_rate, window_s=verdict.window_s, tests=tests,
    )  # fmt: skip


class ScaleStatement:
    """The statement `coherent_scale`, with the time since which its outcome lasts."""

    def __init__(self) -> None:
        self._outcome: Outcome | None = None
        self._since_ns = 0

    def of(self, verdict: ScaleVerdict, time_ns: int) -> TrustMonitor:
        """Give the statement of a verdict."""
        outcome = Outcome.ACCUSES if verdict.accused else Outcome.PASS
        outcome = outcome if verdict.evaluated else Outcome.NOT_EVALUATED
        if outcome is not self._outcome:
            self._outcome, self._since_ns = outcome, time_ns
        return TrustMonitor(
            sampled_ns=time_ns, monitor="coherent_scale", outcome=outcome, reason=verdict.reason,
            accused=verdict.accused, suspect_since_ns=verdict.suspect_since_ns, since_ns=self._since_ns,
            statistic=verdict.difference, threshold=verdict.limit, false_alarm_rate=FALSE_ALARM_RATE,
            window_s=verdict.window_s,
        )  # fmt: skip
