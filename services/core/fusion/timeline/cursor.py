"""A cursor on the log: an engine that has used everything up to its time, and snapshots from which it starts again.

A measurement behind the cursor takes it back to the last snapshot before it; from there samples and entries are used
again in the order of their stamps. So the result is that of a measurement that came in time. A cursor that leaves
sources out starts from a snapshot of another one.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from ..aids.base import Measurement, Outcome
from ..smoothing.history import HistoryRecorder
from ..start.heading import Prior
from .engine import Engine
from .events import Event
from .log import Key, Log, key_of, order

PERIOD_NS = 1_000_000_000  # between two snapshots
BATCH_SAMPLES = 100  # samples that are processed at once: the largest distance of a snapshot from its period's begin


class Snapshot(NamedTuple):
    """The engine after a sample, and how many records its history had."""

    time_ns: int
    engine: Engine
    records: int


class Cursor:
    """An engine at a place of the log.

    Parameters
    ----------
    engine : Engine
        At the place from which it goes on.
    own : sequence of Event
        Events of this cursor alone. Verdicts of the log on the same source are not its own: it leaves GNSS or the
        odometer out or not by these.
    """

    def __init__(self, engine: Engine, own: Sequence[Event] = ()) -> None:
        self.engine = engine
        self.own = tuple(own)
        self._snapshots: deque[Snapshot] = deque()
        self._outcomes: list[Outcome] = []  # not reported yet
        self._late_ns: int | None = None  # stamp of the first entry that came behind the cursor
        self._new: set[Key] = set()  # entries that came behind it and have no outcome yet

    def fork(self, time_ns: int, own: Sequence[Event] = ()) -> "Cursor":
        """Start another cursor from the newest snapshot of a time or earlier, or the oldest one, with own events."""
        forked = Cursor(self.before(time_ns).engine.unrecorded(), own)
        forked._keep()
        return forked

    def before(self, time_ns: int) -> Snapshot:
        """Newest snapshot of a time or earlier; the oldest without one."""
        earlier = [snapshot for snapshot in self._snapshots if snapshot.time_ns <= time_ns]
        return earlier[-1] if earlier else self._snapshots[0]

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest snapshot; None before the first sample."""
        return self._snapshots[0].time_ns if self._snapshots else None

    def forget(self, until_ns: int) -> None:
        """Drop snapshots that are not needed to start from a time on."""
        while len(self._snapshots) > 1 and self._snapshots[1].time_ns <= until_ns:
            self._snapshots.popleft()

    def forget_all(self) -> None:
        """Drop all snapshots but one of now."""
        self._snapshots.clear()
        self._keep()

    def use_prior(self, prior: Prior) -> None:
        """Take a saved position and heading, now and in all snapshots."""
        for engine in (self.engine, *(snapshot.engine for snapshot in self._snapshots)):
            engine.use_prior(prior)

    def carry(self, other: "Cursor") -> None:
        """Take over counts and history of another cursor; snapshots begin anew."""
        engine = self.engine
        engine.counts, engine.recorder = other.engine.counts, other.engine.recorder
        self.own = ()
        if engine.recorder is not None and engine.filter is not None:
            engine.recorder.start(engine.filter)
        self.forget_all()

    def insert(self, entry: Measurement, *, is_new: bool) -> None:
        """Note an entry of the log; one that is behind the cursor is used when it advances."""
        if entry.time_ns > self.engine.time_ns:
            return
        self._late_ns = entry.time_ns if self._late_ns is None else min(self._late_ns, entry.time_ns)
        if is_new:
            self._new.add(key_of(entry))

    def advance(self, log: Log, until_ns: int, most: int | None = None) -> int:
        """Use samples and entries up to a time, at most so many samples; returns how many samples."""
        if self._late_ns is not None:
            self._replay(log, self._late_ns)
        return self._run(log, until_ns, most)

    def outcomes(self) -> list[Outcome]:
        """Outcomes since the last call, each only once."""
        outcomes, self._outcomes = self._outcomes, []
        return outcomes

    def _replay(self, log: Log, late_ns: int) -> None:
        """Go back to the snapshot before the late entries, and use everything since then again."""
        reported, reported_ns, new = self._outcomes, self.engine.time_ns, self._new
        self._late_ns, self._new, self._outcomes = None, set(), []
        while len(self._snapshots) > 1 and self._snapshots[-1].time_ns >= late_ns:
            self._snapshots.pop()
        snapshot = self._snapshots[-1]
        self.engine = snapshot.engine.copy()
        if self.engine.recorder is not None:
            self.engine.recorder.truncate(snapshot.records)
        self._run(log, reported_ns, None)
        self._outcomes = reported + [o for o in self._outcomes if (o.time_ns, o.source, o.measurement) in new]

    def _run(self, log: Log, until_ns: int, most: int | None) -> int:
        used = 0
        while most is None or used < most:
            begin_ns = self.engine.time_ns
            wanted = BATCH_SAMPLES if most is None else min(BATCH_SAMPLES, most - used)
            samples = log.samples(begin_ns, until_ns, wanted)
            if not len(samples.times_ns):
                break
            end_ns = int(samples.times_ns[-1])
            self._outcomes += self.engine.process(samples, self.entries(log, begin_ns, end_ns))
            used += len(samples.times_ns)
            if not self._snapshots or end_ns // PERIOD_NS > self._snapshots[-1].time_ns // PERIOD_NS:
                self._keep()
            if len(samples.times_ns) < wanted:
                break
        return used

    def entries(self, log: Log, after_ns: int, until_ns: int) -> list[Measurement]:
        """Entries of the log, and own ones, with stamps after one time and up to another."""
        entries = log.entries(after_ns, until_ns)
        if not self.own:
            return entries
        own = [event for event in self.own if after_ns < event.time_ns <= until_ns]
        excluded = {event.excludes for event in self.own}
        others = [entry for entry in entries if not (isinstance(entry, Event) and entry.excludes in excluded)]
        return sorted((*others, *own), key=order)

    def _keep(self) -> None:
        recorder: HistoryRecorder | None = self.engine.recorder
        records = recorder.size if recorder is not None else 0
        self._snapshots.append(Snapshot(self.engine.time_ns, self.engine.copy(), records))
