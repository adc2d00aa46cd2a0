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

MAX_STEP_S = 0.5  # of the covariance
ALONE = Intervals(MAX_STEP_S, zero_velocity_s=inf, non_holonomic_s=inf, covariance_at_end=True)
ALL_SAMPLES = 1_000_000  # samples


def predicted(cursor: Cursor, log: Log, lag_ns: int) -> Engine:
    """Engine of a cursor at the newest sample, by the samples and events since its time, and no measurement.

    It coasts no earlier than the engine at the horizon does. Nothing of the cursor changes.
    """
    ahead = cursor.engine.unrecorded()
    ahead.coasting_ns += lag_ns
    if log.newest is not None:
        begin_ns, end_ns = ahead.time_ns, log.newest.time_ns
        samples = log.samples(begin_ns, end_ns, ALL_SAMPLES)
        if len(samples.times_ns):
            events = [entry for entry in cursor.entries(log, begin_ns, end_ns) if isinstance(entry, Event)]
            ahead.process(samples, events, ALONE)
    ahead.attempt(ErrorStateFilter.propagate_covariance)
    return ahead
