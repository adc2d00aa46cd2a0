"""The engine with a memory: a measurement that comes late is used at the time at which it was true.

Samples wait until somebody wants to see the estimator, or until some have come, for it gets through many in little
more time than through one. It is kept as it was every few samples: a late measurement takes it back to before the
measurement's stamp, and from there all samples and measurements are taken again, in the order of their stamps. The
result is that of a measurement that came in time.
"""

from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

from shared.maths.rotation import Vector

from ..alignment.heading import Prior
from ..alignment.warm_start import SavedState
from ..filter.runner import Runner
from ..measurements.base import Measurement, Outcome
from ..plausibility.imu_faults import Sample
from ..settings import Settings
from ..smoothing.history import Trail
from ..update.engine import Engine
from .delay_compensation import Timing
from .imu_batch import Stretch

TOGETHER = 64  # samples
APART_NS = 50_000_000  # at least, of copies that are kept for what may come
# Between two copies where delays are estimated: decided is at each of them, and so none may depend on who looks when.
EVENLY = 16
# Measurements at most that are expected; what is beyond is of a device that stamps what it says with nonsense.
EXPECTED = 100
COPIES = 1000  # what a device with a clock of its own kind may make of the history; ten seconds at 1 kHz need some 400
BEFORE_ALL_NS, AFTER_ALL_NS = -(2**64), 2**64
Newest = tuple[int, Vector, Vector, str | None]  # a `Sample`, or what becomes one
Key = tuple[int, str, type]


class Kept(NamedTuple):
    """A copy of the estimator after a sample, and how much of a trail was written."""

    time_ns: int
    engine: Engine
    written: int


def key_of(measurement: Measurement) -> Key:
    """What a measurement has in common with another that tells the same."""
    return measurement.time_ns, measurement.source, type(measurement)


def order(measurement: Measurement) -> tuple[int, int, str]:
    """Key by which measurements are used."""
    return measurement.time_ns, measurement.received_ns, measurement.source


class DelayedEngine:
    """Engine for samples in order and measurements in any order, up to a time back."""

    def __init__(self, settings: Settings, runner: Runner | None = None) -> None:
        self._settings = settings
        self._runner = runner or Runner()
        self._engine = Engine(settings)  # as of the newest sample that does not wait
        self._horizon_ns = int((settings.history_s + settings.merge_delay_s) * 1e9)
        self._samples: deque[Newest] = deque()
        self.newest: Newest | None = None  # sample
        self._waiting = 0  # samples, the newest
        self._copies: deque[Kept] = deque()
        self._fresh = 0  # samples since the newest copy, without those that wait
        self._together = EVENLY if settings.estimate_delays else TOGETHER
        self._learns = settings.estimate_delays
        self._expected: list[int] = []  # stamps of measurements that will be inserted, ascending
        self._hurried = False  # something of the newest sample is left to do
        self._measurements: list[Measurement] = []  # of the horizon and of the future
        self._late: list[Measurement] = []  # of them, of the past of the estimator, and not used yet
        self._repeated: set[Key] = set()  # of these, what was told before
        self._due = False  # whether one is of a sample that waits
        self._ahead_ns = AFTER_ALL_NS  # stamp of the first that is of a sample to come
        self._outcomes: list[Outcome] = []  # not told yet
        self._timing = Timing(settings)
        self._decided_ns = BEFORE_ALL_NS  # stamp of the newest copy that was the newest sample's

    @property
    def engine(self) -> Engine:
        """The estimator as of the newest sample."""
        if self._waiting:
            self._go_on()
        return self._engine

    @property
    def has_news(self) -> bool:
        """Whether `attend` or `catch_up` have something to do or to tell."""
        return self._hurried or bool(self._outcomes)

    def knows(self, sample: Sample) -> bool:
        """Whether a sample of the past came before, to the last bit, or its time was bridged."""
        samples = self._samples
        bridged = len(samples) > 1 and samples[-2][0] < sample.time_ns
        return bridged or (sample.time_ns > self._oldest_ns and any(one[:3] == sample[:3] for one in reversed(samples)))

    def add(self, time_ns: int, force: Vector, rate: Vector, doubt: str | None = None) -> None:
        """Take a sample, newer than all before."""
        if self._engine.filter is None or self._engine.trail is not None:  # whose reader does not look here
            self._carry(Sample(time_ns, force, rate, doubt))
            self.attend()
            return
        self._note((time_ns, force, rate, doubt))
        self._waiting += 1
        if self._waiting >= self._together - self._fresh or time_ns >= self._ahead_ns:
            self._go_on()

    def remember(self, prior: Prior) -> None:
        """Take a saved position and heading, now and wherever a late measurement may lead back to."""
        for engine in (self.engine, *(copy.engine for copy in self._copies)):
            engine.remember(prior)

    def restore(self, saved: SavedState) -> None:
        """Go on from a saved state with the first sample, which must be the next."""
        self._engine.restore(saved)

    def leave(self, trail: Trail) -> None:
        """Keep a trail for a smoother, from the first sample on."""
        self.engine.trail = trail

    def restarted(self, why: str) -> "DelayedEngine":
        """Begin again from nothing, with the counts kept."""
        counts, fresh = self.engine.counts, DelayedEngine(self._settings, self._runner)
        fresh._engine = Engine(self._settings, counts._replace(resets=counts.resets + 1), why)
        fresh._outcomes = self._outcomes
        fresh._engine.trail = self._engine.trail
        return fresh

    def carry(self, sample: Sample) -> None:
        """Advance by one sample, newer than all before, as far as a solution needs it; `attend` does the rest."""
        if self._waiting:
            self._go_on()
        if self._copies and self._reached_ns - self._copies[-1].time_ns >= APART_NS and not self._learns:
            self._keep()  # what was measured at the time of this sample may come next
        self._carry(sample)

    def _carry(self, sample: Sample) -> None:
        engine = self._engine
        due: Sequence[Measurement] = ()
        if self._measurements:
            due = self._between(engine.last.time_ns if engine.last else sample.time_ns, sample.time_ns)
        self._runner.serve(engine)
        self._outcomes += engine.carry(sample, due)
        self._note(sample)
        self._fresh += 1
        self._hurried = True

    def attend(self) -> None:
        """Do what `carry` has left."""
        if not self._hurried:
            return
        self._hurried = False
        self._outcomes += self._engine.attend()
        if self._fresh >= self._together or not self._copies:
            self._keep()

    def expect(self, time_ns: int) -> None:
        """Be told of a measurement that will be inserted: the way back to its stamp shall be short."""
        if not self._learns:
            insort(self._expected, time_ns)
            del self._expected[EXPECTED:]

    def insert(self, measurement: Measurement) -> None:
        """Have a measurement used at its stamp: in the future once it comes, in the past by `catch_up`, which is due.

        Raises
        ------
        LookupError
            It is older than the memory.
        """
        if measurement.time_ns in self._expected:
            self._expected.remove(measurement.time_ns)
        measurement = self._timing.corrected(measurement)
        if self.newest is not None and measurement.time_ns <= max(self._oldest_ns, self._copies[0].time_ns):
            raise LookupError("older than the memory")
        if measurement.time_ns <= self._reached_ns:
            key, there = key_of(measurement), self._between(measurement.time_ns - 1, measurement.time_ns)
            if key in map(key_of, there) and key not in map(key_of, self._late):
                self._repeated.add(key)
            self._late.append(measurement)
        elif self._waiting and self.newest and measurement.time_ns <= self.newest[0]:
            self._due = True
        else:
            self._ahead_ns = min(self._ahead_ns, measurement.time_ns)
        insort(self._measurements, measurement, key=order)

    def catch_up(self) -> list[Outcome]:
        """Use the measurements that have come, and tell what became of all that were used since this was asked last.

        Late ones take the estimator back, once, to before all of them; what else the way back to now brings again has
        been told before.
        """
        if self._late:
            self._go_back()
        elif self._due:
            self._go_on()
        told, self._outcomes = self._outcomes, []
        return told

    @property
    def _oldest_ns(self) -> int:
        """What is no newer than this is forgotten: by the stamps, since copies lie where somebody has looked."""
        return self.newest[0] - self._horizon_ns if self.newest else BEFORE_ALL_NS

    @property
    def _reached_ns(self) -> int:
        return self._engine.last.time_ns if self._engine.last else BEFORE_ALL_NS

    def _go_on(self, kept: Sequence[int] = ()) -> None:
        """Give the estimator the samples that wait for it, and keep it again where it was kept before."""
        self.attend()
        count, self._waiting, self._due = self._waiting, 0, False
        if not count:
            return
        samples = list(islice(reversed(self._samples), count))[::-1]
        doubts = {place: doubt for place, (_, _, _, doubt) in enumerate(samples) if doubt}
        stamps, rows = [self._reached_ns, *(s[0] for s in samples)], [[*force, *rate] for _, force, rate, _ in samples]
        due = self._between(stamps[0], stamps[-1])
        stretch = Stretch(stamps, rows, due, self._runner, doubts)
        if self._ahead_ns <= stamps[-1]:
            to_come = self._between(stamps[-1], AFTER_ALL_NS)
            self._ahead_ns = to_come[0].time_ns if to_come else AFTER_ALL_NS
        keep = {bisect_left(stamps, stamp) - 1 for stamp in self._expected if stamp <= stamps[-1]}
        keep |= {bisect_left(stamps, stamp) for stamp in kept}
        here = 0
        while here < count:
            most = min(here + self._together - self._fresh, count)
            stop = min((place for place in keep if here < place < most), default=most)
            self._outcomes += stretch.through(self._engine, here, stop)
            self._fresh, here = self._fresh + stop - here, stop
            if self._fresh >= self._together or here in keep:
                self._keep()

    def _go_back(self) -> None:
        """Go back to before all late measurements, and come again with them."""
        self.attend()
        late, self._late = self._late, []
        first_ns = min(measurement.time_ns for measurement in late)
        kept: list[int] = []
        while self._copies[-1].time_ns >= first_ns:
            kept.append(self._copies.pop().time_ns)
        told, told_ns = self._outcomes, self._reached_ns
        copy = self._copies[-1]
        self._engine, self._outcomes, self._fresh = copy.engine.fork(), [], 0
        if self._engine.trail is not None:
            self._engine.trail.rewind(copy.written)
        self._waiting = len(self._samples) - bisect_right(self._samples, copy.time_ns, key=lambda sample: sample[0])
        self._go_on(kept)
        news = {key_of(measurement) for measurement in late} - self._repeated
        self._repeated = set()
        fresh = [o for o in self._outcomes if o.time_ns > told_ns or (o.time_ns, o.source, o.measurement) in news]
        self._outcomes = told + fresh

    def _note(self, sample: Newest) -> None:
        self.newest = sample
        self._samples.append(sample)
        if self._learns:
            self._timing.sample(*sample[:3])

    def _between(self, after_ns: int, until_ns: int) -> list[Measurement]:
        if not self._measurements or self._measurements[-1].time_ns <= after_ns:
            return []
        first = bisect_right(self._measurements, after_ns, key=lambda m: m.time_ns)
        last = bisect_right(self._measurements, until_ns, key=lambda m: m.time_ns)
        return self._measurements[first:last]

    def _keep(self) -> None:
        """Keep a copy; if it is newer than any before, forget what is beyond the horizon."""
        stamp, trail = self._reached_ns, self._engine.trail
        self._copies.append(Kept(stamp, self._engine.fork(), trail.written if trail is not None else 0))
        self._fresh = 0
        if stamp <= self._decided_ns:
            return  # on the way back to now
        self._decided_ns = stamp
        oldest = stamp - self._horizon_ns
        while len(self._copies) > 1 and (self._copies[1].time_ns <= oldest or len(self._copies) > COPIES):
            self._copies.popleft()
        begin, samples = self._copies[0].time_ns, self._samples
        while samples and samples[0][0] <= begin:
            samples.popleft()
        while self._measurements and self._measurements[0].time_ns <= begin:
            self._measurements.pop(0)
        while self._expected and self._expected[0] <= begin:
            self._expected.pop(0)
        if begin <= oldest and self._learns:
            news = self._timing.learn(stamp, self._copies[0].engine.filter)
            if news is not None:
                insort(self._measurements, news, key=order)
