"""The engine with a memory: a measurement that comes late is used at the time at which it was true.

The engine is kept as it was every few samples. A late measurement takes it back to before the measurement's stamp;
from there all samples and measurements are taken again, in the order of their stamps. The result is that of a
measurement that came in time.
"""

from bisect import bisect_right, insort
from collections import deque
from collections.abc import Sequence
from itertools import takewhile

from shared.maths.rotation import Vector

from .aiding import Measurement, Outcome
from .engine import Engine
from .heading import Prior
from .runner import Kept, Runner
from .samples import Sample
from .settings import Settings
from .stretch import Stretch
from .timing import Timing
from .trail import Trail

KEPT_EVERY = 16  # samples between two copies of the engine; more of ordinary ones, where a copy is dear beside them
COPIES = 1000  # what a device with a clock of its own kind may make of the history; 1 kHz for ten seconds needs 625
Newest = tuple[int, Vector, Vector, str | None]  # a `Sample`, or what becomes one


def order(measurement: Measurement) -> tuple[int, int, str]:
    """Key by which measurements are used."""
    return measurement.time_ns, measurement.received_ns, measurement.source


class DelayedEngine:
    """Engine for samples in order and measurements in any order, up to a time back."""

    def __init__(self, settings: Settings, runner: Runner | None = None) -> None:
        self._settings = settings
        self._runner = runner or Runner()
        self.settled = Engine(settings)  # the estimator without ordinary samples that the runner is ahead by
        self._horizon_ns = int(settings.history_s * 1e9)
        self._samples: deque[Newest] = deque()
        self._copies: deque[Kept] = deque()  # engines after a sample
        self._measurements: list[Measurement] = []  # of the horizon and of the future
        self._late: list[Measurement] = []  # of them, not used yet
        self._fresh = 0  # samples since the newest copy
        self._timing = Timing(settings)
        # What is decided of delays must not depend on who runs the loop.
        self._kept_every = KEPT_EVERY if settings.estimate_delays else self._runner.kept_every

    @property
    def engine(self) -> Engine:
        """The estimator as of the newest sample."""
        if self._runner.engine is not None:
            self._runner.end()
        return self.settled

    @property
    def seen(self) -> Engine:
        """The same, to be looked at only."""
        self._runner.show()
        return self.settled

    @property
    def newest(self) -> Newest | None:
        """The newest sample."""
        return self._samples[-1] if self._samples else self.settled.last

    def knows(self, sample: Sample) -> bool:
        """Whether a sample of the past came before, to the last bit, or its time was bridged."""
        samples = self._samples
        bridged = len(samples) > 1 and samples[-2][0] < sample.time_ns
        return bridged or any(one[:3] == sample[:3] for one in reversed(samples))

    def take(self, time_ns: int, force: Vector, rate: Vector, *, checked: bool) -> bool:
        """Advance by one sample if it is ordinary; False, and nothing has happened, if it has to be looked at.

        One that is not `checked` must also be inconspicuous: see `Runner.take`.
        """
        runner = self._runner
        if runner.engine is None and not runner.follow(self.settled):
            return False
        waiting = self._measurements
        if waiting and waiting[-1].time_ns > runner.last_ns and self._between(runner.last_ns, time_ns):
            return False
        if not runner.take(time_ns, force, rate, checked=checked):
            return False
        self._samples.append((time_ns, force, rate, None))
        if self._settings.estimate_delays:
            self._timing.sample(time_ns, force, rate)
        self._fresh += 1
        if self._fresh >= self._kept_every:
            self._keep(time_ns)
        return True

    def remember(self, prior: Prior) -> None:
        """Take a saved position and heading, now and wherever a late measurement may lead back to."""
        for engine in (self.engine, *(copy.engine for copy in self._copies)):
            engine.remember(prior)

    def leave(self, trail: Trail) -> None:
        """Keep a trail for a smoother, from the first sample on."""
        self.engine.trail = trail

    def restarted(self, why: str) -> "DelayedEngine":
        """Begin again from nothing, with the counts kept."""
        counts, fresh = self.engine.counts, DelayedEngine(self._settings, self._runner)
        fresh.settled = Engine(self._settings, counts._replace(resets=counts.resets + 1), why)
        if self.engine.trail is not None:
            self.engine.trail.seal()
            fresh.engine.trail = self.engine.trail
        return fresh

    def carry(self, sample: Sample) -> list[Outcome]:
        """Advance by one sample, newer than all before, as far as a solution needs it; `attend` does the rest."""
        engine = self.engine
        due: Sequence[Measurement] = ()
        if self._measurements:
            due = self._between(engine.last.time_ns if engine.last else sample.time_ns, sample.time_ns)
        self._runner.serve(engine)
        outcomes = engine.carry(sample, due)
        self._samples.append(sample)
        self._timing.sample(sample.time_ns, sample.force, sample.rate)
        self._fresh += 1
        return outcomes

    def attend(self) -> list[Outcome]:
        """Do what is left of the last step; one that was taken as ordinary has left nothing."""
        if self._runner.engine is not None:
            return []
        outcomes = self.settled.attend()
        if self._samples and (self._fresh >= KEPT_EVERY or not self._copies):
            self._keep(self._samples[-1][0])
        return outcomes

    def insert(self, measurement: Measurement) -> None:
        """Have a measurement used at its stamp: in the future once it comes, in the past by `catch_up`, which is due.

        Raises
        ------
        LookupError
            It is older than the memory.
        """
        measurement = self._timing.corrected(measurement)
        reached_ns = self.engine.last.time_ns if self.engine.last else None
        if reached_ns is not None and measurement.time_ns <= reached_ns:
            if self._copies[0].time_ns >= measurement.time_ns:
                raise LookupError("older than the memory")
            self._late.append(measurement)
        insort(self._measurements, measurement, key=order)

    def catch_up(self) -> list[Outcome]:
        """Go back, once, to before all late measurements, and come again with them.

        Returns
        -------
        list of Outcome
            Of these measurements only; what else the way back to now brings again has been told before.
        """
        late, self._late = self._late, []
        if not late:
            return []
        first_ns = min(measurement.time_ns for measurement in late)
        while self._copies[-1].time_ns >= first_ns:
            self._copies.pop()
        stamp = self._copies[-1].time_ns
        self.settled = self._copies[-1].restored()
        if self.settled.trail is not None:
            self.settled.trail.rewind(stamp)
        self._fresh = 0
        again = list(takewhile(lambda sample: sample[0] > stamp, reversed(self._samples)))[::-1]
        doubts = {place: doubt for place, (_, _, _, doubt) in enumerate(again) if doubt}
        stamps, rows = [stamp, *(s[0] for s in again)], [[*force, *rate] for _, force, rate, _ in again]
        stretch = Stretch(stamps, rows, self._measurements, self._runner, doubts)
        outcomes: list[Outcome] = []
        for here in range(0, len(again), self._kept_every):
            stop = min(here + self._kept_every, len(again))
            outcomes += stretch.through(self.settled, here, stop)
            self._fresh = stop - here
            if self._fresh >= KEPT_EVERY:
                self._copies.append(Kept(again[stop - 1][0], self.settled.fork()))
                self._fresh = 0
        news = {(measurement.time_ns, measurement.source, type(measurement)) for measurement in late}
        return [o for o in outcomes if (o.time_ns, o.source, o.measurement) in news]

    def _between(self, after_ns: int, until_ns: int) -> list[Measurement]:
        if not self._measurements or self._measurements[-1].time_ns <= after_ns:
            return []
        first = bisect_right(self._measurements, after_ns, key=lambda m: m.time_ns)
        last = bisect_right(self._measurements, until_ns, key=lambda m: m.time_ns)
        return self._measurements[first:last]

    def _keep(self, stamp: int) -> None:
        """Keep a copy, and forget what is beyond the horizon."""
        ahead = self._runner.engine is not None
        self._copies.append(self._runner.keep() if ahead else Kept(stamp, self.settled.fork()))
        self._fresh = 0
        oldest = stamp - self._horizon_ns
        while len(self._copies) > 1 and (self._copies[1].time_ns <= oldest or len(self._copies) > COPIES):
            self._copies.popleft()
        begin, samples = self._copies[0].time_ns, self._samples
        while samples and samples[0][0] <= begin:
            samples.popleft()
        while self._measurements and self._measurements[0].time_ns <= begin:
            self._measurements.pop(0)
        if begin <= oldest and self._settings.estimate_delays:
            news = self._timing.learn(stamp, self._copies[0].restored().filter)
            if news is not None:
                insort(self._measurements, news, key=order)
