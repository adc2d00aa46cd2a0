"""When the accusation of a long window ends."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

from services.core.spoofing.codes import Code
from services.core.spoofing.monitor import InertialMonitor
from services.core.spoofing.windows.long_window import LENGTHS_S, LongWindow
from shared.messages.explanation import explain
from shared.messages.trust import Outcome
from shared.trust.result import Test


def test_an_accusation_ends_when_a_window_passes_or_no_free_propagation_is_left_and_not_before() -> None:
    monitor, undecided = InertialMonitor(), Test(Outcome.NOT_EVALUATED, explain(Code.PAUSED))
    monitor._known = {f"long_{length}": undecided for length in LENGTHS_S}
    assert monitor._acquitted(), "no free propagation runs"
    monitor.long = cast(LongWindow, SimpleNamespace(oldest_s=12.0))
    assert not monitor._acquitted(), "one runs that is too young to decide"
    monitor._known[f"long_{LENGTHS_S[0]}"] = replace(undecided, outcome=Outcome.PASS)
    assert monitor._acquitted()
