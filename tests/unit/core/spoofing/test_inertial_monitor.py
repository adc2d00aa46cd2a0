"""When the accusation of a long window ends, and when the filter counts as started again."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

from services.core.spoofing.codes import Code
from services.core.spoofing.monitor import BREAK_NS, InertialMonitor
from services.core.spoofing.windows.long_window import LENGTHS_S, LongWindow
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.result import Test
from tests.support.drives.yaw_rates import NS, solution_of


def test_an_accusation_ends_when_a_window_passes_or_no_free_propagation_is_left_and_not_before() -> None:
    monitor, undecided = InertialMonitor(), Test(Outcome.NOT_EVALUATED, explain(Code.PAUSED))
    monitor._known = {f"long_{length}": undecided for length in LENGTHS_S}
    assert monitor._acquitted(), "no free propagation runs"
    monitor.long = cast(LongWindow, SimpleNamespace(oldest_s=12.0))
    assert not monitor._acquitted(), "one runs that is too young to decide"
    monitor._known[f"long_{LENGTHS_S[0]}"] = replace(undecided, outcome=Outcome.PASS)
    assert monitor._acquitted()


def test_solutions_that_are_missing_for_more_than_two_seconds_are_a_new_alignment() -> None:
    monitor = InertialMonitor()
    for time_ns, aligned_ns in ((NS, NS), (NS + BREAK_NS, NS), (2 * NS + 2 * BREAK_NS, 2 * NS + 2 * BREAK_NS)):
        monitor.solution(solution_of(time_ns, 0.0, stationary=False))
        assert monitor._aligned_ns == aligned_ns
