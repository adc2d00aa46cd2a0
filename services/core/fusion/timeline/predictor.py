"""The predictor: the engine at the horizon, carried to the newest sample by the inertial sensors alone.

What is published is this state. Its covariance over that span is propagated in one step, or in several of half a second
where the lag is longer. Gaps and suspect samples are handled as by the engine itself.
"""

from math import inf

from ..inertial.filter import ErrorStateFilter
from ..inertial.propagation import Intervals
from .cursor import Cursor
from .engine import Engine
from .events import Event
from .log import Log

LONGEST_STEP_S = 0.5  # of the covariance
ALONE = Intervals(LONGEST_STEP_S, zero_velocity_s=inf, non_holonomic_s=inf)
EVERYTHING = 1_000_000  # samples


def begin(engine: Engine, lag_ns: int) -> Engine:
    """Independent engine for a prediction, which coasts no earlier than the engine at the horizon does."""
    ahead = engine.unrecorded()
    ahead.coasting_ns += lag_ns
    return ahead


def carry(ahead: Engine, log: Log, cursor: Cursor) -> None:
    """Carry the prediction of a cursor over the samples and events since its own time, and no measurement."""
    if log.newest is None:
        return
    begin_ns, end_ns = ahead.time_ns, log.newest.time_ns
    samples = log.samples(begin_ns, end_ns, EVERYTHING)
    if len(samples.times_ns):
        events = [entry for entry in cursor.entries(log, begin_ns, end_ns) if isinstance(entry, Event)]
        ahead.process(samples, events, ALONE)


def complete(ahead: Engine) -> None:
    """Propagate the covariance of a prediction to its time."""
    ahead.attempt(ErrorStateFilter.propagate_covariance)
