"""The timeline: one log, its horizon, the cursors on it, and the prediction from the horizon to the newest sample.

The filter runs at the horizon, in the order of the stamps, each sample once. A measurement waits for a fixed time after
its arrival and then enters the log at its stamp; behind the horizon it takes the cursors back to a snapshot, and makes
the lag of the horizon larger. So the result depends on stamps and arrival stamps alone.
"""

from bisect import insort
from collections import Counter
from math import hypot

from shared.messages.explanation import Explanation

from ..aids.base import Measurement, Outcome
from ..inertial.imu_clock import FUTURE_LIMIT_NS
from ..inertial.imu_faults import Sample
from ..integrity.known_place import KnownPlace, known_well
from ..integrity.over_a_cut import RememberedConflict
from ..settings import Settings
from ..smoothing.history import HistoryRecorder
from ..start.heading import Prior
from ..start.warm_start import SavedState
from . import predictor
from .conflict import Verdicts
from .cursor import Cursor
from .engine import BEFORE_ALL_NS, Engine
from .events import Event, GnssDelay, WrongHeights
from .horizon import Horizon
from .log import Log

MEMORY_NS = 120_000_000_000  # for which snapshots are kept: a monitor accuses GNSS 6 to 120 s after the error began
MAX_STEP_NS = 100_000_000  # of the horizon
LEAD_STEPS = 5  # the horizon moves by this part of a step before a solution is due, which then has little left to carry
FAULT_FREE_NS = 3_000_000_000  # time after a fault-free fix in which another one is expected
FAULT_FREE_WAIT_NS = 1_000_000_000  # for which the receiver's own fix waits for it, and the horizon with it
# Samples that wait for the horizon, and samples in the log, two minutes at 2.5 kHz. With more, of a device whose stamps
# hardly advance, the horizon moves on and the oldest are dropped.
MAX_PENDING, MAX_SAMPLES = 20_000, 300_000
INFINITE_NS = 2**62
HELD_LIMIT = 1000  # largest number of measurements that wait


class Timeline:
    """Samples in order and measurements in any order of arrival; the solution at the newest sample."""

    def __init__(self, settings: Settings, rejects: Counter[str]) -> None:
        self._settings, self._rejects = settings, rejects
        self._allowance_ns = round(settings.merge_delay_s * 1e9)
        self._history_ns = round(settings.history_s * 1e9)
        self._step_ns = min(round(settings.solution_period_s * 1e9), MAX_STEP_NS)
        self._waiting: list[tuple[int, int, str, Measurement]] = []  # (enters by, stamp, source, measurement)
        self._fault_free_ns = -FAULT_FREE_NS  # stamp of the newest fix without an excluded satellite
        self._heights_wrong = False  # of GNSS: they are left out
        self.measurements_late = 0  # that came behind the horizon
        self.followers: tuple[Cursor, ...] = ()  # other cursors on the log, which their owner advances
        self._begin(Engine(settings))

    def _begin(self, engine: Engine) -> None:
        self.log, self.horizon = Log(), Horizon(self._allowance_ns, self._history_ns)
        self.verdicts = Verdicts(self._settings, self.log, Cursor(engine))
        self._delays = 0.0, 0.0  # [s] of positions and velocities, found and corrected
        self._pending = 0  # samples that the horizon has not passed
        self._step = BEFORE_ALL_NS  # of the horizon, by the newest sample
        self._now: Engine | None = None  # carried from the horizon to the newest sample

    @property
    def engine(self) -> Engine:
        """Alignment or filter at the horizon, of the published solution."""
        return self.verdicts.engine

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample; 0 before the first."""
        return self.log.newest.time_ns if self.log.newest is not None else 0

    @property
    def now(self) -> Engine:
        """Filter at the newest sample: that of the horizon, carried on by the inertial sensors alone.

        An alignment is that of the horizon.
        """
        if self._now is not None:
            return self._now
        if self.engine.filter is None and self.engine.last is not None:
            return self.engine
        now = predictor.predicted(self.verdicts.published, self.log, self.horizon.lag_ns)
        self._now = now if self.log.newest is not None else None  # an engine without a log is not this timeline's
        return now

    def is_known(self, sample: Sample) -> bool:
        """Whether a sample of the past was used before, or falls into a bridged gap."""
        return self.log.is_known(sample, self._oldest_ns)

    def restart(self, why: Explanation) -> None:
        """Begin again from nothing, because the clock went back.

        Counts, history, what the level holds, what core.trust wants and what the checks of the set-up say of heights
        stay; the measurements that wait are used as far as their stamps are of the new time.
        """
        engine = self.engine
        counts = engine.counts
        fresh = Engine(self._settings, counts._replace(resets=counts.resets + 1), why)
        fresh.recorder = engine.recorder
        fresh.hold(engine.aids.error_monitor.held)  # a clock that goes back decides nothing
        wanted, place = self.verdicts.wanted, self.verdicts.place
        if (remembered := engine.remembered) is not None:
            fresh.remember(remembered)
        self._begin(fresh)
        self.verdicts.wanted, self.verdicts.place = wanted, place

    def use_prior(self, prior: Prior) -> None:
        """Take a saved position and heading; where the vehicle was parked is a known place."""
        if prior.parked and known_well(prior.level_m) and self.verdicts.place is None:
            north, east, down = prior.position_sd
            self.verdicts.place = KnownPlace(prior.position, (hypot(north, east), down))
        for cursor in self.verdicts.cursors:
            cursor.use_prior(prior)
        self._now = None

    def remember(self, conflict: RememberedConflict) -> None:
        """Hold with the first filter what an earlier process held."""
        self.verdicts.main.engine.remember(conflict)

    def restore(self, saved: SavedState) -> None:
        """Go on from a saved state with the first sample, which must be the next."""
        self.engine.restore(saved)

    def record_history(self, recorder: HistoryRecorder) -> None:
        """Record a history for the smoother, from the first sample on."""
        self.engine.recorder = recorder

    def add(self, sample: Sample) -> None:
        """Append a sample, newer than all before."""
        self.log.add(sample)
        self._pending += 1
        self._now = None

    def measure(self, measurement: Measurement) -> None:
        """Let a measurement wait until it enters the log.

        The receiver's own fix waits longer where a fault-free fix of its epoch is expected, which replaces it.
        """
        enters_ns = measurement.received_ns + self._allowance_ns
        if measurement.left_out:
            self._fault_free_ns = measurement.time_ns
        elif measurement.epoch and 0 < measurement.time_ns - self._fault_free_ns <= FAULT_FREE_NS:
            enters_ns += FAULT_FREE_WAIT_NS
        insort(self._waiting, (enters_ns, measurement.time_ns, measurement.source, measurement), key=lambda w: w[:3])
        if len(self._waiting) > HELD_LIMIT:
            self._waiting.pop(0)
            self._rejects["held without inertial samples"] += 1

    def happen(self, event: Event) -> None:
        """Let an event happen at the horizon."""
        self.log.insert(event)

    @property
    def next_ns(self) -> int:
        """Time behind the horizon, at which an event is the next one."""
        return self.verdicts.next_ns

    def correct_delay(self, found: GnssDelay) -> None:
        """Correct stamps behind the horizon by other delays; fixes that were true before it are left out."""
        self._delays = found.of_stamps
        self.log.change(self.verdicts.main.engine.time_ns, self._as_found)
        self.happen(found)

    def leave_out_heights(self, *, wrong: bool) -> None:
        """Use positions behind the horizon without their heights, because these have the wrong sign, or with them."""
        begins, self._heights_wrong = wrong and not self._heights_wrong, wrong
        if begins:
            self.log.change(self.verdicts.main.engine.time_ns, self._as_found)
            self.happen(WrongHeights(self.next_ns))

    def _as_found(self, measurement: Measurement) -> Measurement:
        """Measurement as the checks of the set-up have found it: at its true time, without a wrong height."""
        measurement = measurement.corrected(*self._delays)
        return measurement.without_height() if self._heights_wrong else measurement

    def advance(self, received_ns: int) -> list[Outcome]:
        """Move the horizon with the first sample of each step; returns the outcomes of what it has passed."""
        step = (self.newest_ns + self._step_ns // LEAD_STEPS) // self._step_ns
        crowded = self._pending > MAX_PENDING
        if self.log.newest is None or (step == self._step and not crowded):
            return []
        self._step = step
        self._enter(received_ns)
        return self._advance(self.newest_ns if crowded else self._until(received_ns))

    def finish(self) -> list[Outcome]:
        """Move the horizon to the newest sample, because nothing more will arrive; returns the last outcomes."""
        self._enter(INFINITE_NS)
        return self._advance(self.newest_ns)

    def _advance(self, until_ns: int) -> list[Outcome]:
        samples = self.verdicts.main.advance(self.log, until_ns)
        self._pending -= samples
        self.verdicts.advance(until_ns, samples)
        self._forget()
        self._now = None
        return self.verdicts.outcomes()

    @property
    def _oldest_ns(self) -> int:
        """Stamp up to which measurements are rejected."""
        oldest_ns = self.newest_ns - self._history_ns - self._allowance_ns if self.log.newest else BEFORE_ALL_NS
        return max(oldest_ns, self.verdicts.main.oldest_ns or BEFORE_ALL_NS)

    def _until(self, received_ns: int) -> int:
        """Horizon, before a fix that waits for the fault-free one of its epoch."""
        until_ns = self.horizon.behind(self.newest_ns)
        for enters_ns, time_ns, _, waiting in self._waiting:
            if waiting.epoch and enters_ns - waiting.received_ns > self._allowance_ns and enters_ns > received_ns:
                until_ns = min(until_ns, waiting.corrected(*self._delays).time_ns - 1, time_ns - 1)
        return until_ns

    def _enter(self, received_ns: int) -> None:
        """Let the measurements enter the log whose time has come."""
        while self._waiting and self._waiting[0][0] <= received_ns:
            measurement = self._waiting.pop(0)[3]
            if measurement.time_ns > self.newest_ns + FUTURE_LIMIT_NS:
                self._rejects["measurement from the future"] += 1  # on the clock of the inertial samples
                continue
            measurement = self._as_found(measurement)
            # What is ahead of the horizon needs no memory: after a gap of the samples that may be long ago.
            if measurement.time_ns <= min(self._oldest_ns, self.verdicts.main.engine.time_ns):
                self._rejects["measurement older than the memory"] += 1
                continue
            self.horizon.see(measurement.time_ns, measurement.received_ns)
            if self.log.supersedes(measurement):
                continue
            self.measurements_late += measurement.time_ns <= self.verdicts.main.engine.time_ns
            is_new = self.log.insert(measurement)
            for cursor in (*self.verdicts.cursors, *self.followers):
                cursor.insert(measurement, is_new=is_new)

    def _forget(self) -> None:
        """Drop what is older than two minutes, and was passed by all cursors."""
        for cursor in self.verdicts.cursors:
            cursor.forget(self.newest_ns - MEMORY_NS)
            if self.log.size > MAX_SAMPLES:
                cursor.forget_all()
        oldest_ns = [cursor.oldest_ns for cursor in self.verdicts.cursors if cursor.oldest_ns is not None]
        if oldest_ns:
            self.log.drop(min(*oldest_ns, *(cursor.engine.time_ns for cursor in self.followers), self.newest_ns))
