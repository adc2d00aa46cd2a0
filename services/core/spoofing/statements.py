"""Two statements of the inertial tests: `inertial_short` of those over 5 s, `inertial_long` of 30 and 60 s."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from shared.messages.explanation import Explanation, explain
from shared.messages.trust import Outcome, TrustMonitor
from shared.trust.result import Test, deciding, statement

from .codes import Code
from .windows.metrics import Metric
from .windows.position_step import NAME

MONITORS = "inertial_short", "inertial_long", "gyroscope", "drift"
SHORT = (*(metric.value for metric in Metric), NAME)


def statements(tests: Mapping[str, Test], time_ns: int, warning: Explanation | None = None) -> Iterator[TrustMonitor]:
    """Give the statements of `inertial_short` and `inertial_long`.

    A warning of its profile explains the first one while that does not accuse; its tests say what they have found.
    """
    short = {name: test for name, test in tests.items() if name in SHORT}
    long = {name: test for name, test in tests.items() if name not in SHORT}
    decides = deciding(short.values())
    if warning is not None and not decides.accuses:
        decides = replace(decides, why=warning)
    yield statement("inertial_short", decides, time_ns, short)
    yield statement("inertial_long", deciding(long.values()), time_ns, long)


def paused_statements(time_ns: int) -> Iterator[TrustMonitor]:
    """Give the statements of all monitors of this process while nothing is evaluated."""
    for monitor in MONITORS:
        yield statement(monitor, Test(Outcome.NOT_EVALUATED, explain(Code.PAUSED)), time_ns)
