"""Roll-back over minutes, and two solutions during a conflict: with GNSS, and without it since it became suspect.

A monitor accuses GNSS 6 to 120 s after the error began. A snapshot of the engine is kept once a second for two minutes,
with all samples and measurements since the oldest. When a conflict begins a second engine starts from the last snapshot
before the suspect time and processes everything again without GNSS, a part with each new sample, while the first goes
on. From then on both run, and the level of the one that is published reaches to the other. The one without GNSS is
published only if core.trust excludes GNSS and if that solution is good: `Conflict.declined` says why not.
"""

from collections import deque
from dataclasses import replace
from math import hypot
from operator import attrgetter

from shared.maths.earth import ned_from_geodetic_difference

from ..integrity.disagreement import CLOSURE_SDS, Disagreement, Pair, Vector
from ..measurements.base import Measurement, Outcome
from ..plausibility.imu_faults import Sample
from ..settings import Settings
from ..solution import UncertaintyCache
from ..update.engine import Engine
from ..update.exclusion import GnssExcluded, GnssReadmitted, Held, OdometerExclusion
from .out_of_sequence import OutOfSequenceEngine, Snapshot

MEMORY_S = 120.0
PERIOD_NS = 1_000_000_000  # between two snapshots
PART = 40  # samples that are processed again with each new one: two minutes at 100 Hz take 3 s
LONGEST_DELAY_NS = 3_000_000_000  # by which the stamp of a measurement may still be moved
CONVERGED_S = 60.0  # of the filter before the suspect time, without which GNSS is not excluded
MOST_LIMITS = 3.0  # alert limits up to which the level of the solution without GNSS may be: beyond it decides nothing
LAST_LIMITS = 30.0  # alert limits beyond which it is given up
CLOSED_SHARE = 0.5  # of the largest distance of the two, to which a position that has come back has closed it


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

    def before(self, time_ns: int) -> Snapshot:
        """Newest snapshot of a time or earlier; the oldest without one."""
        earlier = [snapshot for snapshot in self._snapshots if snapshot.time_ns <= time_ns]
        return earlier[-1] if earlier else self._snapshots[0]

    def restart(self, snapshot: Snapshot) -> None:
        """Begin anew with a snapshot of another engine; samples and measurements since then stay."""
        self._snapshots = deque([snapshot])
        while self._samples and self._samples[0].time_ns <= snapshot.time_ns:
            self._samples.popleft()

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest snapshot."""
        return self._snapshots[0].time_ns

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
        snapshot = memory.before(suspect_since_ns).unrecorded()
        self.engine = main.resumed(snapshot)
        self.converged_s = _converged_s(snapshot.engine, suspect_since_ns)
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
                samples += 1
            else:
                insert_if_remembered(self.engine, one)
        self.engine.outcomes()  # the late ones are used, and all were reported before


def _converged_s(engine: Engine, time_ns: int) -> float:
    """For how long a filter has run at a time [s]; 0 without one."""
    return 0.0 if engine.started_ns is None else max(0.0, (time_ns - engine.started_ns) * 1e-9)


def insert_if_remembered(engine: OutOfSequenceEngine, measurement: Measurement) -> bool:
    """Use a measurement; False if it is older than the oldest snapshot."""
    try:
        engine.insert(measurement)
    except LookupError:
        return False
    return True


def distance_n(one: Engine, other: Engine) -> Vector | None:
    """Position of one engine minus that of another [m, NED]; None while one has no filter."""
    if one.filter is None or other.filter is None:
        return None
    return ned_from_geodetic_difference(one.filter.position, other.filter.position)


class Conflict:
    """GNSS against the other sensors since a suspect time: the solution without GNSS beside the one with it.

    One that begins again with an earlier suspect time goes on with what the `earlier` one had until its replay is over.
    """

    resets: int  # of the engine with GNSS when the conflict began
    held: Disagreement  # by its level at that time
    engine: OutOfSequenceEngine | None  # without GNSS; None until the first replay is over
    published: bool  # whether the solution without GNSS is published
    difference: tuple[Vector, Pair] | None  # newest: published minus other position, levels of the other

    def __init__(
        self, since_ns: int, main: OutOfSequenceEngine, memory: Memory, earlier: "Conflict | None" = None
    ) -> None:
        self.since_ns = since_ns
        self.resets = earlier.resets if earlier else main.engine.counts.resets
        self.held = earlier.held if earlier else main.engine.aids.error_monitor.held
        self.replay: Replay | None = Replay(main, memory, since_ns)
        self.engine = earlier.engine if earlier else None
        self.converged_s = self.replay.converged_s
        self.published = earlier is not None and earlier.published
        self.declined = ""  # why it is not, although core.trust excludes GNSS
        # Newest: position of the engine with GNSS minus the other, and the levels of the one without it.
        self.apart_n: Vector | None = earlier.apart_n if earlier else None
        self.levels_m: Pair = earlier.levels_m if earlier else (0.0, 0.0)
        self.difference = earlier.difference if earlier else None
        self.farthest_m: Pair = earlier.farthest_m if earlier else (0.0, 0.0)  # largest distance of the two

    def take(self, one: Sample | Measurement) -> None:
        """Pass a sample or a measurement on."""
        if self.engine is not None:
            if isinstance(one, Sample):
                self.engine.add(one)
            else:
                insert_if_remembered(self.engine, one)
        if self.replay is not None:
            self.replay.take(one)
            if isinstance(one, Sample):
                self.replay.advance()
                if self.replay.is_over:
                    self.engine, self.replay = self.replay.engine, None


class RollBack:
    """The engine with GNSS, the memory of two minutes, and the conflict with the engine without GNSS."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._main = OutOfSequenceEngine(settings)
        self._memory = Memory()
        self._of_main, self._of_other = UncertaintyCache(settings), UncertaintyCache(settings)
        self.conflict: Conflict | None = None
        # Suspect time, whether GNSS is excluded, and whether the odometer is: as core.trust published.
        self._wanted: tuple[int | None, bool, bool] | None = None
        self._odometer_excluded: bool | None = None  # as applied
        self.unresolved = ""  # why the present conflict goes on without a second solution
        self._decided_ns = 0  # second of the last decision

    @property
    def engine(self) -> OutOfSequenceEngine:
        """The engine whose solution is published."""
        conflict = self.conflict
        return conflict.engine if conflict and conflict.published and conflict.engine else self._main

    @property
    def other(self) -> OutOfSequenceEngine | None:
        """The other one, while there are two."""
        conflict = self.conflict
        if conflict is None or conflict.engine is None:
            return None
        return self._main if conflict.published else conflict.engine

    @property
    def excluded_test_ratio(self) -> float | None:
        """Test ratio of the newest position against the solution without GNSS; None without one."""
        without = self.conflict.engine if self.conflict else None
        return (without or self._main).engine.exclusions.test_ratio

    def difference(self) -> tuple[Vector, Pair] | None:
        """Published minus other position [m, NED], and the levels of the other [m]; None without another.

        While the other aligns again after a reset, its last difference stands.
        """
        other, conflict = self.other, self.conflict
        if other is None or conflict is None:
            return None
        apart = distance_n(self.engine.engine, other.engine)
        if apart is None:
            return conflict.difference
        horizontal_m, vertical_m = self._levels(other.engine)
        if other is self._main:  # a reset in this conflict holds the same difference again
            held, before = other.engine.aids.error_monitor.held.bound, conflict.held.bound
            horizontal_m -= max(0.0, held[0] - before[0])
            vertical_m -= max(0.0, held[1] - before[1])
        conflict.difference = apart, (horizontal_m, vertical_m)
        return conflict.difference

    @property
    def without_gnss_m(self) -> Pair | None:
        """Levels of the solution without GNSS in a conflict [m, horizontal and vertical]; None without one."""
        conflict = self.conflict
        return None if conflict is None or conflict.engine is None else conflict.levels_m

    @property
    def held(self) -> Disagreement:
        """What the level holds, for a later process: with the difference of an open conflict."""
        held, conflict = self.engine.engine.aids.error_monitor.held, self.conflict
        if conflict is None or conflict.apart_n is None:
            return held
        spread = conflict.levels_m[0] / CLOSURE_SDS, conflict.levels_m[1] / CLOSURE_SDS
        return held.after(conflict.apart_n, spread, self.engine.engine.time_ns, grew=False, slack=conflict.levels_m)

    def _levels(self, engine: Engine) -> Pair:
        """Protection levels of an engine with a filter."""
        assert engine.filter is not None
        cache = self._of_main if engine is self._main.engine else self._of_other
        levels = cache.of(engine.filter, engine.aids.error_monitor).levels
        return levels.horizontal, levels.vertical

    def restart(self, why: str) -> None:
        """Begin again from nothing, because the clock went back."""
        self._main = self._main.restarted(why)
        self._memory, self.conflict, self._odometer_excluded, self.unresolved = Memory(), None, None, ""

    def add(self, sample: Sample) -> None:
        """Process a sample in both engines, and a part of a replay."""
        self._main.add(sample)
        self._memory.sample(sample)
        self._memory.snapshot(self._main.settled)
        if self.conflict is not None:
            before = self.conflict.engine
            self.conflict.take(sample)
            begins = before is not self.conflict.engine
            if begins or sample.time_ns // PERIOD_NS != self._decided_ns:
                self._decided_ns = sample.time_ns // PERIOD_NS
                self._decide()
        elif self._odometer_excluded is None:
            self._apply()

    def insert(self, measurement: Measurement) -> bool:
        """Use a measurement at its stamp; False if it is older than the oldest snapshot."""
        if not insert_if_remembered(self._main, measurement):
            return False
        self._memory.measurement(measurement)
        if self.conflict is not None:
            self.conflict.take(measurement)
        return True

    def outcomes(self) -> list[Outcome]:
        """Use late measurements in both engines, and report the outcomes of the published one since the last call."""
        found, published = self._main.outcomes(), self.engine
        if self.conflict is not None and self.conflict.engine is not None:
            without = self.conflict.engine.outcomes()
            found = without if self.conflict.engine is published else found
        return found

    def follow(self, gnss_since_ns: int | None, *, exclude: bool, odometer_excluded: bool) -> None:
        """Follow the verdict.

        Parameters
        ----------
        gnss_since_ns : int or None
            Suspect time of a conflict of GNSS with the other sensors; None without one.
        exclude : bool
            Whether core.trust has decided that GNSS is wrong.
        odometer_excluded : bool
            Whether the odometer is not used.
        """
        self._wanted = gnss_since_ns, exclude, odometer_excluded
        self._apply()

    def _apply(self) -> None:
        """Apply what differs from the verdict, from the newest sample on."""
        newest = self._main.newest
        if self._wanted is None or newest is None:
            return
        since_ns, _, odometer = self._wanted
        known = self._main.engine.exclusions
        if odometer != (known.odometer if self._odometer_excluded is None else self._odometer_excluded):
            self.insert(OdometerExclusion(newest.time_ns + 1, excluded=odometer))
        self._odometer_excluded = odometer
        if since_ns is None:
            self._end(newest.time_ns)
        elif known.gnss_since_ns is None and not self.unresolved:
            self._begin(since_ns)
        self._decide()

    def _begin(self, since_ns: int) -> None:
        """Begin a conflict, or begin it again where its suspect time is earlier than was known."""
        conflict = self.conflict
        if conflict is not None and conflict.since_ns <= since_ns:
            return
        if conflict is not None and self._memory.oldest_ns > since_ns and conflict.engine is not None:
            # No snapshot is older: what GNSS may have done between the two times is added to the solution without it.
            span_s = (conflict.since_ns - since_ns) * 1e-9
            conflict.engine.insert(GnssExcluded(self._main.engine.time_ns + 1, since_ns, span_s))
            conflict.since_ns = since_ns
            return
        self.conflict = Conflict(since_ns, self._main, self._memory, conflict)

    def _decide(self) -> None:
        """Choose which of the two solutions is published, once a second and with every verdict."""
        conflict = self.conflict
        if conflict is None or conflict.engine is None or self._wanted is None:
            return
        without = conflict.engine.engine
        if without.filter is None:
            self._leave("the solution without GNSS is lost")
            return
        conflict.levels_m = horizontal_m, vertical_m = self._levels(without)
        apart = distance_n(self._main.engine, without)
        if apart is not None:  # the one with GNSS may align again after a reset
            conflict.apart_n = apart
            far_h, far_v = conflict.farthest_m
            conflict.farthest_m = max(far_h, hypot(apart[0], apart[1])), max(far_v, abs(apart[2]))
        limits = self._settings.vehicle.alert_limits_m
        share = max(horizontal_m / limits[0], vertical_m / limits[1])
        if share > LAST_LIMITS:
            self._leave(f"without GNSS the protection level is {horizontal_m:.0f} m: that solution is of no use")
        elif share > MOST_LIMITS:
            conflict.declined = (
                f"without GNSS the protection levels are {horizontal_m:.0f} m horizontal and {vertical_m:.0f} m "
                "vertical, so that this solution decides nothing any more"
            )
        elif conflict.converged_s < CONVERGED_S:
            conflict.declined = (
                f"the filter had run for {conflict.converged_s:.0f} s before the suspect time, {CONVERGED_S:.0f} s are "
                "needed"
            )
        else:
            conflict.declined = ""
        conflict.published = self._wanted[1] and not conflict.declined

    def _leave(self, why: str) -> None:
        """Give the solution without GNSS up: the level holds what the two differed by, and its level."""
        conflict, self.conflict, self.unresolved = self.conflict, None, why
        if conflict is not None and conflict.apart_n is not None:
            main = self._main.engine
            before = main.aids.error_monitor.held
            spread = conflict.levels_m[0] / CLOSURE_SDS, conflict.levels_m[1] / CLOSURE_SDS
            self._hold(before.after(conflict.apart_n, spread, main.time_ns, grew=False, slack=conflict.levels_m))

    def _end(self, now_ns: int) -> None:
        """End the conflict: what the two solutions still differ by is held, unless a return has closed it.

        The solution with GNSS goes on, but for one that has been reset in the conflict or was not published.
        """
        conflict, self.conflict, self.unresolved = self.conflict, None, ""
        main = self._main
        if main.engine.exclusions.gnss_since_ns is not None:  # of a saved state
            self.insert(GnssReadmitted(now_ns + 1))
        if conflict is None or conflict.engine is None:
            return
        apart = distance_n(main.engine, conflict.engine.engine) or conflict.apart_n
        left = None if apart is None else self._left(apart, conflict)
        spread = conflict.levels_m[0] / CLOSURE_SDS, conflict.levels_m[1] / CLOSURE_SDS
        if conflict.published or main.engine.counts.resets > conflict.resets:
            self._go_on_with(conflict.engine)
            self.insert(GnssReadmitted(now_ns + 1))
        if left is not None:
            before = self._main.engine.aids.error_monitor.held
            self._hold(before.after(left, spread, now_ns, grew=False))

    def _left(self, apart_n: Vector, conflict: Conflict) -> Vector | None:
        """Part of a difference that no return has closed: above half of the largest, and above the own level."""
        main = self._main.engine
        levels = (0.0, 0.0) if main.filter is None else self._levels(main)
        closed_h, closed_v = (
            distance <= max(CLOSED_SHARE * far, level)
            for distance, far, level in zip(
                (hypot(apart_n[0], apart_n[1]), abs(apart_n[2])), conflict.farthest_m, levels, strict=True
            )
        )
        if closed_h and closed_v:
            return None
        north, east, down = apart_n
        return (0.0 if closed_h else north, 0.0 if closed_h else east, 0.0 if closed_v else down)

    def _go_on_with(self, without: OutOfSequenceEngine) -> None:
        """Continue with the engine without GNSS in place of the one with it; the smoother's history starts anew."""
        counts, recorder = self._main.engine.counts, self._main.engine.recorder
        self._main = without
        without.carry(counts, recorder)
        if recorder is not None and without.engine.filter is not None:
            recorder.start(without.engine.filter)
        self._memory.restart(without.settled)

    def _hold(self, held: Disagreement) -> None:
        """Let the level of the engine in use hold a disagreement, at once and when late measurements roll it back."""
        main = self._main.engine
        main.aids.error_monitor = replace(main.aids.error_monitor, held=held)
        self.insert(Held(main.time_ns + 1, held))
