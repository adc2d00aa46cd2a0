"""What the level holds, as a message for a start after a power cut: on each change, and every 5 s while it is open."""

from collections.abc import Iterator

from shared.messages.navigation import ConflictRecord, FilterState

from .integrity.disagreement import NO_DISAGREEMENT, NONE, ZERO_VECTOR, Disagreement
from .integrity.over_a_cut import MAX_DISTANCE_M, GrowthRate, RememberedConflict
from .navigator import Navigator
from .timeline.conflict import Verdicts

PERIOD_NS = 5_000_000_000  # of records while something is held
CHANGE_RATIO = 1.5  # [-] ratio of two bounds that is a change
MIN_DISTANCE_M = 1.0  # [m] and their least difference
REJECTING_S = 3.0  # [s] since the last used position, from which rejected ones are a contradiction
HELD_NUMBERS = 7  # of a disagreement in a message


def held_numbers(held: Disagreement) -> tuple[float, ...]:
    """Numbers of a disagreement in a message; none of one that is closed."""
    if not held.is_open:
        return ()
    return tuple(
        max(-MAX_DISTANCE_M, min(MAX_DISTANCE_M, value)) for value in (*held.vector_n, *held.spread, *held.slack)
    )


def held_of(message: FilterState | ConflictRecord) -> Disagreement:
    """Disagreement in a message."""
    if len(message.held_m) != HELD_NUMBERS:
        return NO_DISAGREEMENT
    north, east, down, spread_h, spread_v, slack_h, slack_v = message.held_m
    return Disagreement(
        (north, east, down), (abs(spread_h), abs(spread_v)), message.held_grew, (abs(slack_h), abs(slack_v)),
        at_start=message.held_at_start,
    )  # fmt: skip


def remembered(record: ConflictRecord) -> RememberedConflict:
    """What an earlier process held, of its record."""
    return RememberedConflict(record.sampled_ns, held_of(record), record.growth_m_s)


def _held_at_a_start(verdicts: Verdicts, time_ns: int) -> Disagreement:
    """What a filter would have to hold that starts at the newest position, which this one may reject."""
    held, monitor = verdicts.held, verdicts.main.engine.aids.error_monitor
    if monitor.rejected_n == ZERO_VECTOR or (time_ns - monitor.used_ns) * 1e-9 < REJECTING_S:
        return held
    return held.after(monitor.rejected_n, monitor.rejected_sd, time_ns, grew=monitor.rejected_grew)


class ConflictRecorder:
    """Yields a record on each change of what is held, and every 5 s while it is open."""

    def __init__(self) -> None:
        self._growth = GrowthRate()
        self._last: ConflictRecord | None = None
        self._bound_m = 0.0  # horizontal, of the last record

    def resume(self, record: ConflictRecord) -> None:
        """Go on with the record of an earlier process, so that it is overwritten when nothing is held any more."""
        self._last, self._bound_m = record, held_of(record).bound[0]
        self._growth.largest = record.growth_m_s

    def update(self, navigator: Navigator, time_ns: int) -> Iterator[ConflictRecord]:
        """Use the state of the navigator, once a second while it has a filter."""
        conflict, held = navigator.verdicts.conflict, _held_at_a_start(navigator.verdicts, time_ns)
        # While the solution without GNSS decides: later it is that one which moves away.
        contradicted = conflict is not None and conflict.found.is_any
        self._growth.update(time_ns, conflict.found.vector_n if conflict is not None and contradicted else None)
        is_open, last = conflict is not None or held.is_open, self._last
        was_open = last is not None and (last.conflict_since_ns is not None or last.held_m != ())
        grows = conflict is not None or held.growth_m_s > 0.0
        if not grows:  # what a conflict has left stays as it is, for however long the unit is off
            self._growth.forget()
        if not (is_open or was_open):
            return
        since_ns = None if conflict is None else conflict.since_ns
        if last is not None and was_open and is_open:
            grown = held.bound[0] > CHANGE_RATIO * self._bound_m + MIN_DISTANCE_M
            same = held.is_open == (last.held_m != ()) and since_ns == last.conflict_since_ns and not grown
            if same and 0 <= time_ns - last.sampled_ns < PERIOD_NS:
                return
        self._bound_m = held.bound[0]
        self._last = ConflictRecord(
            sampled_ns=time_ns, held_m=held_numbers(held), held_grew=held.grew, held_at_start=held.at_start,
            growth_m_s=self._growth.largest if grows else NONE, conflict_since_ns=since_ns,
        )  # fmt: skip
        yield self._last
