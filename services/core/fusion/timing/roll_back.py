"""Roll-back over minutes: the filter as it was before GNSS became suspect, propagated again without GNSS.

A monitor accuses GNSS 6 to 120 s after the error began. A snapshot of the engine is kept once a second for two minutes,
with all samples and measurements since the oldest. On an exclusion a second engine starts from the last snapshot before
the suspect time and processes everything again without GNSS, a part with each new sample, while the first goes on.
When the second has caught up it takes the place of the first.
"""

from collections import deque
from operator import attrgetter

from ..measurements.base import Measurement, Outcome
from ..plausibility.imu_faults import Sample
from ..settings import Settings
from ..update.exclusion import GnssExcluded, GnssReadmitted, OdometerExclusion
from .out_of_sequence import OutOfSequenceEngine, Snapshot

MEMORY_S = 120.0
PERIOD_NS = 1_000_000_000  # between two snapshots
PART = 40  # samples that are processed again with each new one: two minutes at 100 Hz take 3 s
LONGEST_DELAY_NS = 3_000_000_000  # by which the stamp of a measurement may still be moved


class Memory:
    """Snapshots, samples and measurements of the last two minutes."""

    def __init__(self) -> None:
        self._snapshots: deque[Snapshot] = deque()
        self._samples: deque[Sample] = deque()
        self._measurements: deque[Measurement] = deque()  # in order of use

    def sample(self, sample: Sample) -> None:
        """Keep a sample, and drop what is too old."""
        self._samples.append(sample)
        begin_ns = sample.time_ns - round(MEMORY_S * 1e9)
        while len(self._snapshots) > 1 and self._snapshots[1].time_ns <= begin_ns:
            self._snapshots.popleft()
        begin_ns = self._snapshots[0].time_ns if self._snapshots else begin_ns
        while self._samples and self._samples[0].time_ns <= begin_ns:
            self._samples.popleft()
        while self._measurements and self._measurements[0].time_ns <= begin_ns - LONGEST_DELAY_NS:
            self._measurements.popleft()

    def measurement(self, measurement: Measurement) -> None:
        """Keep a measurement that is used or waits for its time."""
        self._measurements.append(measurement)

    def snapshot(self, snapshot: Snapshot) -> None:
        """Keep the first snapshot of each period."""
        if not self._snapshots or snapshot.time_ns // PERIOD_NS > self._snapshots[-1].time_ns // PERIOD_NS:
            self._snapshots.append(snapshot)

    def rewind(self, time_ns: int) -> Snapshot:
        """Drop the snapshots after a time, but not the oldest; returns the newest that is left."""
        while len(self._snapshots) > 1 and self._snapshots[-1].time_ns > time_ns:
            self._snapshots.pop()
        return self._snapshots[-1]

    def since(self, time_ns: int) -> deque[Sample | Measurement]:
        """Samples and measurements after a time in the order of their stamps, measurements first where they agree.

        Earlier exclusions of GNSS are left out: another one replaces them.
        """
        together: list[Sample | Measurement] = [
            measurement
            for measurement in self._measurements
            if measurement.time_ns > time_ns - LONGEST_DELAY_NS
            and not isinstance(measurement, GnssExcluded | GnssReadmitted)
        ]
        together += [sample for sample in self._samples if sample.time_ns > time_ns]
        return deque(sorted(together, key=attrgetter("time_ns")))


class Replay:
    """An engine that processes the samples and measurements since a snapshot again, without GNSS."""

    def __init__(self, main: OutOfSequenceEngine, memory: Memory, suspect_since_ns: int) -> None:
        snapshot = memory.rewind(suspect_since_ns)
        self.engine = main.resumed(snapshot)
        self._memory = memory
        self._pending = memory.since(snapshot.time_ns)
        contaminated_s = max(0.0, (snapshot.time_ns - suspect_since_ns) * 1e-9)
        begin_ns = max(snapshot.time_ns, suspect_since_ns) + 1
        self.engine.insert(GnssExcluded(begin_ns, suspect_since_ns, contaminated_s))

    @property
    def is_over(self) -> bool:
        """Whether everything has been processed."""
        return not self._pending

    def take(self, one: Sample | Measurement) -> None:
        """Add what has arrived meanwhile."""
        self._pending.append(one)

    def advance(self) -> None:
        """Process a part."""
        samples = 0
        while self._pending and samples < PART:
            one = self._pending.popleft()
            if isinstance(one, Sample):
                self.engine.add(one)
                self._memory.snapshot(self.engine.settled)
                samples += 1
            else:
                insert_if_remembered(self.engine, one)
        self.engine.outcomes()  # the late ones are used, and all were reported before


def insert_if_remembered(engine: OutOfSequenceEngine, measurement: Measurement) -> bool:
    """Use a measurement; False if it is older than the oldest snapshot."""
    try:
        engine.insert(measurement)
    except LookupError:
        return False
    return True


class RollBack:
    """The engine in use, the memory of two minutes, and the replay that is to take the engine's place."""

    def __init__(self, settings: Settings) -> None:
        self.engine = OutOfSequenceEngine(settings)
        self._memory = Memory()
        self._replay: Replay | None = None
        self._outcomes: list[Outcome] = []  # of an engine that was replaced, not reported yet
        # Suspect time of excluded GNSS, and whether the odometer is excluded: as published, and as applied.
        self._wanted: tuple[int | None, bool] | None = None
        self._applied: tuple[int | None, bool] | None = None

    def restart(self, why: str) -> None:
        """Begin again from nothing, because the clock went back."""
        self.engine = self.engine.restarted(why)
        self._memory, self._replay, self._applied = Memory(), None, None

    def add(self, sample: Sample) -> None:
        """Process a sample, and a part of a replay."""
        self.engine.add(sample)
        self._memory.sample(sample)
        if self._replay is None:
            self._memory.snapshot(self.engine.settled)
            if self._applied is None:
                self._apply()
            return
        self._replay.take(sample)
        self._replay.advance()
        if self._replay.is_over:
            self._outcomes += self.engine.outcomes()
            self.engine, self._replay = self._replay.engine, None

    def insert(self, measurement: Measurement) -> bool:
        """Use a measurement at its stamp; False if it is older than the oldest snapshot."""
        if not insert_if_remembered(self.engine, measurement):
            return False
        self._memory.measurement(measurement)
        if self._replay is not None:
            self._replay.take(measurement)
        return True

    def outcomes(self) -> list[Outcome]:
        """Use late measurements, and report all outcomes since the last call, each only once."""
        outcomes, self._outcomes = self._outcomes + self.engine.outcomes(), []
        return outcomes

    def follow(self, gnss_since_ns: int | None, *, odometer_excluded: bool) -> None:
        """Follow the verdict: GNSS is excluded from a suspect time on, or used, and the odometer as well."""
        self._wanted = gnss_since_ns, odometer_excluded
        self._apply()

    def _apply(self) -> None:
        """Apply what differs from the verdict, from the newest sample on; a suspect time begins a replay.

        The first engine excludes GNSS at once. A state that was saved with GNSS excluded needs no replay.
        """
        newest = self.engine.newest
        if self._wanted is None or newest is None:
            return
        exclusions = self.engine.engine.exclusions
        known, odometer = self._applied or (exclusions.gnss_since_ns, exclusions.odometer)
        since, now_ns = self._wanted[0], newest.time_ns + 1
        self._applied = since if since is None or known is None else min(since, known), self._wanted[1]
        if odometer != self._wanted[1]:
            self.insert(OdometerExclusion(now_ns, excluded=self._wanted[1]))
        if since is None and known is not None:
            self.insert(GnssReadmitted(now_ns))
        elif since is not None and (known is None or since < known):
            self.engine.insert(GnssExcluded(now_ns, now_ns))
            self._replay = Replay(self.engine, self._memory, since)
