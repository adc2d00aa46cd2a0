"""Out-of-sequence measurements: an engine that rolls back to the instant at which a measurement was true.

A snapshot of the engine is kept every few samples, with all samples and measurements since the oldest. A measurement
that is older than the state rolls the engine back to the last snapshot before it; from there samples and measurements
are processed again in the order of their stamps. So the result is that of a measurement that came in time.
"""

from bisect import bisect_right, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

from ..start.heading import Prior
from ..start.warm_start import SavedState
from ..inertial.propagation import Samples, samples_of
from ..aids.base import Counts, Measurement, Outcome
from ..aids.gnss.fix import GnssPosition, GnssVelocity
from ..inertial.imu_faults import Sample
from ..settings import Settings
from ..smoothing.history import HistoryRecorder
from .engine import BEFORE_ALL_NS, Engine
from .exclusion import GnssExcluded, GnssReadmitted
from .delays import SuspectedDelay, Timing

PERIOD = 8  # samples from snapshot to snapshot
MOST = 1000  # snapshots, for a device whose stamps hardly advance; 2.7 s at 1 kHz are 340
Key = tuple[int, str, type]


class Snapshot(NamedTuple):
    """The engine after a sample, and how many records its history had."""

    time_ns: int
    engine: Engine
    records: int

    def unrecorded(self) -> "Snapshot":
        """The same without a history for the smoother."""
        engine = self.engine.copy()
        engine.recorder = None
        if engine.filter is not None:
            engine.filter.recorder = None
        return Snapshot(self.time_ns, engine, 0)


def key_of(measurement: Measurement) -> Key:
    """Key that a measurement shares with its repetition."""
    return measurement.time_ns, measurement.source, type(measurement)


def order(measurement: Measurement) -> tuple[int, int, str]:
    """Key by which measurements are used."""
    return measurement.time_ns, measurement.received_ns, measurement.source


class OutOfSequenceEngine:
    """Engine for samples in order, and measurements in any order up to a time back."""

    def __init__(self, settings: Settings, engine: Engine | None = None) -> None:
        self._settings = settings
        self.engine = engine or Engine(settings)  # as of the newest sample
        self.newest: Sample | None = None  # sample
        self._horizon_ns = int((settings.history_s + settings.merge_delay_s) * 1e9)
        self._snapshots: deque[Snapshot] = deque()
        self._samples: deque[Sample] = deque()  # since the oldest snapshot
        self._since_snapshot = 0  # samples
        self._learnt_ns = BEFORE_ALL_NS  # newest snapshot at which delays were estimated
        self._measurements: list[Measurement] = []  # since the oldest snapshot, and of the future
        self._late: list[Measurement] = []  # those older than the state that were not used yet
        self._repeated: set[Key] = set()  # late ones that repeat a measurement used before
        self._outcomes: list[Outcome] = []  # not reported yet
        self._timing = Timing(settings)

    def is_known(self, sample: Sample) -> bool:
        """Whether a sample of the past was used before, or falls into a bridged gap."""
        samples = self._samples
        bridged = len(samples) > 1 and samples[-2].time_ns < sample.time_ns
        return bridged or (sample.time_ns > self._oldest_ns and any(one[:3] == sample[:3] for one in reversed(samples)))

    def add(self, sample: Sample) -> None:
        """Process a sample, newer than all before, with the measurements that were stamped ahead of the last one."""
        self._samples.append(sample)
        self.newest = sample
        self._timing.sample(sample.time_ns, sample.force, sample.rate)
        self._process([sample])

    def use_prior(self, prior: Prior) -> None:
        """Take a saved position and heading, now and in all snapshots."""
        for engine in (self.engine, *(snapshot.engine for snapshot in self._snapshots)):
            engine.use_prior(prior)

    def restore(self, saved: SavedState) -> None:
        """Go on from a saved state with the first sample, which must be the next."""
        self.engine.restore(saved)

    def record_history(self, recorder: HistoryRecorder) -> None:
        """Record a history for the smoother, from the first sample on."""
        self.engine.recorder = recorder

    def restarted(self, why: str) -> "OutOfSequenceEngine":
        """New engine with an empty history; counts are kept."""
        counts = self.engine.counts
        fresh = OutOfSequenceEngine(
            self._settings, Engine(self._settings, counts._replace(resets=counts.resets + 1), why)
        )
        fresh.engine.recorder, fresh._outcomes = self.engine.recorder, self._outcomes
        aids, held = fresh.engine.aids, self.engine.aids.error_monitor.held
        aids.error_monitor = replace(aids.error_monitor, held=held)  # a clock that goes back decides nothing
        return fresh

    def resumed(self, snapshot: Snapshot) -> "OutOfSequenceEngine":
        """Make another engine that goes on from a snapshot; the samples since then must follow."""
        twin = OutOfSequenceEngine(self._settings, snapshot.engine.copy())
        twin.newest = snapshot.engine.last
        twin._snapshots.append(snapshot)
        twin._timing = self._timing.at(snapshot.time_ns)
        return twin

    def carry(self, counts: Counts, recorder: HistoryRecorder | None) -> None:
        """Take over counts and history of another engine, now and in all snapshots."""
        for engine in (self.engine, *(snapshot.engine for snapshot in self._snapshots)):
            engine.counts, engine.recorder = counts, recorder
        if recorder is not None:
            self._snapshots = deque(one._replace(records=recorder.size) for one in self._snapshots)

    @property
    def settled(self) -> Snapshot:
        """The oldest snapshot, which no late measurement changes any more."""
        return self._snapshots[0]

    def insert(self, measurement: Measurement) -> None:
        """Use a measurement at its stamp: a future one when that time is reached, a past one by `outcomes`.

        Raises
        ------
        LookupError
            It is older than the oldest snapshot.
        """
        if isinstance(measurement, GnssExcluded | GnssReadmitted):
            self._timing.freeze(frozen=isinstance(measurement, GnssExcluded))
        if isinstance(measurement, SuspectedDelay):
            self._timing.suspect(measurement)
        measurement = self._timing.corrected(measurement)
        time_ns = measurement.time_ns
        if self._snapshots and time_ns <= max(self._oldest_ns, self._snapshots[0].time_ns):
            raise LookupError("older than the oldest snapshot")
        if self._is_superseded(measurement):
            return
        if time_ns <= self.engine.time_ns:
            key = key_of(measurement)
            if key in map(key_of, self._between(time_ns - 1, time_ns)) and key not in map(key_of, self._late):
                self._repeated.add(key)
            self._late.append(measurement)
        insort(self._measurements, measurement, key=order)

    def _is_superseded(self, measurement: Measurement) -> bool:
        """Whether the fault-free fix of this epoch is known; one that comes later removes the receiver's own."""
        if not isinstance(measurement, GnssPosition | GnssVelocity):
            return False
        key, time_ns = key_of(measurement), measurement.time_ns
        same = [one for one in self._between(time_ns - 1, time_ns) if key_of(one) == key]
        if not measurement.left_out:
            return any(isinstance(one, GnssPosition | GnssVelocity) and one.left_out for one in same)
        removed = set(map(id, same))
        self._measurements = [one for one in self._measurements if id(one) not in removed]
        return False

    def outcomes(self) -> list[Outcome]:
        """Use the late measurements, and report all outcomes since the last call, each only once."""
        if self._late:
            self._roll_back()
        outcomes, self._outcomes = self._outcomes, []
        return outcomes

    @property
    def _oldest_ns(self) -> int:
        """Stamp before which measurements are rejected."""
        return self.newest.time_ns - self._horizon_ns if self.newest else BEFORE_ALL_NS

    def _roll_back(self) -> None:
        """Roll back to the snapshot before all late measurements, and process everything since then again."""
        reported, reported_ns = self._outcomes, self.engine.time_ns
        first_ns = min(measurement.time_ns for measurement in self._late)
        new_keys = {key_of(measurement) for measurement in self._late} - self._repeated
        self._late, self._repeated, self._outcomes = [], set(), []
        while self._snapshots[-1].time_ns >= first_ns:
            self._snapshots.pop()
        snapshot = self._snapshots[-1]
        self.engine, self._since_snapshot = snapshot.engine.copy(), 0
        if self.engine.recorder is not None:
            self.engine.recorder.truncate(snapshot.records)
        count = len(self._samples) - bisect_right(self._samples, snapshot.time_ns, key=lambda sample: sample.time_ns)
        again = list(islice(reversed(self._samples), count))[::-1]
        for begin in range(0, count, PERIOD):
            self._process(again[begin : begin + PERIOD])
        self._outcomes = reported + [
            o for o in self._outcomes if o.time_ns > reported_ns or (o.time_ns, o.source, o.measurement) in new_keys
        ]

    def _process(self, samples: Sequence[Sample]) -> None:
        """Process up to `PERIOD` samples, and keep a snapshot after so many."""
        begin_ns, end_ns = self.engine.time_ns, samples[-1].time_ns
        measurements = self._between(begin_ns, end_ns) if self._measurements else []
        self._outcomes += self.engine.process(_together(samples), measurements)
        self._since_snapshot += len(samples)
        if self._since_snapshot >= PERIOD or not self._snapshots:
            records = self.engine.recorder.size if self.engine.recorder is not None else 0
            self._snapshots.append(Snapshot(end_ns, self.engine.copy(), records))
            self._since_snapshot = 0
            if end_ns > self._learnt_ns:
                self._learnt_ns = end_ns
                self._drop_oldest(end_ns)

    def _drop_oldest(self, time_ns: int) -> None:
        """Drop snapshots beyond the horizon, and estimate delays by the oldest one."""
        oldest_ns, snapshots = time_ns - self._horizon_ns, self._snapshots
        while len(snapshots) > 1 and (snapshots[1].time_ns <= oldest_ns or len(snapshots) > MOST):
            snapshots.popleft()
        begin_ns = snapshots[0].time_ns
        while self._samples and self._samples[0].time_ns <= begin_ns:
            self._samples.popleft()
        while self._measurements and self._measurements[0].time_ns <= begin_ns:
            self._measurements.pop(0)
        if begin_ns <= oldest_ns:
            found = self._timing.learn(time_ns, snapshots[0].engine.filter)
            if found is not None:
                insort(self._measurements, found, key=order)

    def _between(self, after_ns: int, until_ns: int) -> list[Measurement]:
        first = bisect_right(self._measurements, after_ns, key=lambda m: m.time_ns)
        last = bisect_right(self._measurements, until_ns, key=lambda m: m.time_ns)
        return self._measurements[first:last]


def _together(samples: Sequence[Sample]) -> Samples:
    rows = [(*force, *rate) for _, force, rate, _ in samples]
    return samples_of([s.time_ns for s in samples], rows, {k: s.fault for k, s in enumerate(samples) if s.fault})
