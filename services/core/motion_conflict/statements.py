"""Statements of the tests on both speeds: those of the tachograph, and the fast test."""

from collections.abc import Iterator
from dataclasses import replace

from shared.messages.trust import Outcome, TrustMonitor
from shared.trust.result import statement

from .verdicts import MotionVerdicts

# Order in which an accusing test gives the reason and the accused: tests that name one sensor first.
PRIORITY = (
    "held_speed", "motion_sensor", "calibrated", "trimmed_mean", "event", "distance", "scale_step", "scale_range",
)  # fmt: skip


def statements(verdicts: MotionVerdicts, time_ns: int) -> Iterator[TrustMonitor]:
    """Give the statements of the monitors `motion` and `motion_fast`.

    `motion` accuses when one of the tests of `PRIORITY` does, and is not evaluated while no window is complete. The
    median is published for comparison and decides nothing: the regulation uses the trimmed mean.
    """
    tests = verdicts.named()
    fast = tests.pop("fast")
    passing = verdicts.calibrated if verdicts.calibrated.outcome is Outcome.PASS else verdicts.trimmed_mean
    decides = next((tests[name] for name in PRIORITY if tests[name].accuses), passing)
    if verdicts.carried.doubtful:
        decides = replace(decides, doubtful=True)
    yield statement("motion", decides, time_ns, tests)
    yield statement("motion_fast", fast, time_ns)
