"""The estimator as a function of inertial samples and measurements in the order in which they were true."""

from collections.abc import Callable, Sequence
from functools import partial
from math import degrees, hypot, radians

from shared.errors import FilterDiverged
from shared.messages.navigation import AidingKind, NavigationPhase

from ..alignment.alignment import Alignment
from ..alignment.heading import Heading, Prior
from ..alignment.velocity_matching import Comparison
from ..alignment.warm_start import SavedState, restored
from ..filter.error_model import FloatArray
from ..filter.eskf import ErrorStateFilter
from ..filter.propagation import GAP_S, Departure, Moment
from ..measurements.base import Counts, Measurement, Outcome
from ..measurements.dual_antenna import BaselineHeading
from ..measurements.gnss import GnssPosition, GnssVelocity
from ..measurements.odometer import PERIOD_S as WHEELS_PERIOD_S
from ..measurements.odometer import SLOWEST_M_S, NonHolonomic
from ..measurements.zupt import PERIOD_S, Standstill
from ..plausibility.imu_faults import Sample, mean
from ..settings import Settings
from ..smoothing.history import Trail
from ..timing.delay_compensation import FoundDelay
from .aiding import Aids
from .imu_gaps import DOUBT_PERIOD_S, LostTime, admit_doubt, admit_gap
from .standstill_detector import QUIET_S, STILL, SURE, UNSETTLED, Doubt, at_rest, length

# A step longer than GAP_S is a gap: carried over, and admitted in the covariance.
LOST_S = 1.0  # a longer one ends the solution, though not the attitude
FORGOTTEN_S = 5.0  # a still longer one ends that too
KEPT = Heading(0.0, radians(20.0), "heading kept")
LAST_NS = 2**63 - 1
COASTING, NAVIGATING = NavigationPhase.COASTING, NavigationPhase.NAVIGATING  # looked up for every sample


class Engine:
    """Alignment first, then the filter with its aiding, its gaps and its resets.

    Everything that it knows is replaced and never changed in place, so that a `fork` is cheap and stays as it was.
    """

    def __init__(self, settings: Settings, counts: Counts | None = None, why: str = "") -> None:
        self._settings = settings
        self._coasting_ns = settings.gnss.coasting_after_s * 1e9
        self.phase, self.since_ns = NavigationPhase.WAITING_FOR_IMU, 0
        self.reason = "no inertial sample yet"
        self.counts = counts or Counts()
        self.last: Sample | None = None
        self.filter: ErrorStateFilter | None = None
        self.trail: Trail | None = None  # of whatever filter runs, for a smoother
        self.accepted_ns: int | None = None  # stamp of the last position that was used
        self.stationary = False
        self._alignment: Alignment | None = Alignment(settings, first=not why)
        self._saved: SavedState | None = None  # to go on from with the first sample
        self.aids = Aids(settings)
        self._rest = UNSETTLED
        self._rest_turn, self._rest_s = STILL, 0.0  # [rad, body; s] of the rest since its last update
        self._unattended_s = 0.0  # since the last sample that was attended to
        self._doubtful_s = 0.0  # of samples, since the filter was told
        self._rolling_s = 0.0  # since the wheels were last held against the filter
        self._rejections = 0  # successive positions
        self._why = why  # the solution was lost

    def fork(self) -> "Engine":
        """Copy that goes its own way."""
        twin = Engine.__new__(Engine)
        twin.__dict__.update(self.__dict__)
        twin.filter = self.filter.fork() if self.filter else None
        twin._alignment = self._alignment.fork() if self._alignment else None
        twin.aids = self.aids.fork()
        return twin

    def remember(self, prior: Prior) -> None:
        """Take a saved position and heading, of use until the filter runs for the first time."""
        if self._alignment is not None and self.accepted_ns is None:
            self._alignment.remember(prior)

    def restore(self, saved: SavedState) -> None:
        """Go on from a saved state with the first sample, which must be the next."""
        self._saved = saved

    def step(self, sample: Sample, due: Sequence[Measurement]) -> list[Outcome]:
        """Advance to the stamp of a sample, using on the way the measurements that were true before it."""
        return self.carry(sample, due) + self.attend()

    def carry(self, sample: Sample, due: Sequence[Measurement]) -> list[Outcome]:
        """Do of a step what a solution needs; `attend` does the rest."""
        last, time_ns = self.last, sample[0]
        if last is None:
            self.last = sample
            why = f"levelling, after {self._why}" if self._why else "measuring tilt and gyroscope bias at rest"
            self._enter(NavigationPhase.LEVELLING, time_ns, why)
            if self._saved is not None:
                self._start_warm(self._saved, sample)
            return []
        gap_s = (time_ns - last[0]) * 1e-9
        held = self._bridge(gap_s, sample) if gap_s > GAP_S else sample
        outcomes: list[Outcome] = []
        for measurement in due:
            assert self.last is not None
            if measurement.time_ns < self.last.time_ns:
                continue  # it was true in a gap after which nothing is known of its time
            self._advance(held, measurement.time_ns)
            self.last = held._replace(time_ns=measurement.time_ns)
            outcomes += self._aid(measurement)
        self._advance(held, time_ns)
        self.last, self._unattended_s = sample, gap_s
        return outcomes

    def attend(self) -> list[Outcome]:
        """Bring the covariance up, aid the filter by what a car does not do, and settle the phase."""
        last, gap_s = self.last, self._unattended_s
        if last is None or not gap_s:
            return []
        self._unattended_s = 0.0
        outcomes: list[Outcome] = []
        doubt = self.aids.doubt(last[0], self.filter) if self.filter else SURE  # of before the covariance's step
        self._try(ErrorStateFilter.keep_covariance, last[0])
        if last[3] is not None:
            self._admit(gap_s)
        self._watch_for_standstill(last[0], gap_s, doubt, outcomes)
        self._watch_the_wheels(last[0], gap_s, outcomes)
        self._settle_phase(last[0])
        return outcomes

    def departure(self) -> tuple[Departure, int] | None:
        """What samples can be taken from together that follow the last one, and up to which stamp [ns]."""
        navigation = self.filter
        if navigation is None or self.last is None or navigation.trail is not None or self._unattended_s:
            return None  # there is nothing to carry on, a smoother wants to know of every step, or one is not over
        beside = self._rest, self._rest_turn, self._rest_s, self._rolling_s
        until_ns = LAST_NS if self.phase is COASTING else int((self.accepted_ns or 0) + self._coasting_ns)
        departure = navigation.departure(beside, self.aids.dues)
        return None if departure is None else (departure, until_ns)

    def resume(self, moment: Moment, P: FloatArray, last: Sample) -> None:
        """Go on from where ordinary samples have led to, the last of which is given."""
        assert self.filter is not None
        self._rest, self._rest_turn, self._rest_s, self._rolling_s = self.filter.resume(moment, P, last.time_ns)
        self.last = last
        self.stationary = self._rest[2] >= QUIET_S

    def _advance(self, sample: Sample, time_ns: int) -> None:
        """Carry alignment or filter to an instant within the step that the sample describes."""
        assert self.last is not None
        if time_ns <= self.last[0]:
            return
        force, rate = sample[1], sample[2]
        if self.filter is not None:
            self.filter.advance(force, rate, time_ns)
        elif self._alignment is not None:
            self._alignment.levelling.advance(force, rate, (time_ns - self.last[0]) * 1e-9)

    def _bridge(self, gap_s: float, sample: Sample) -> Sample:
        """Decide what survives a gap, and what is taken to have happened in it: the mean of its two ends."""
        assert self.last is not None
        self.counts = self.counts._replace(imu_gaps=self.counts.imu_gaps + 1)
        if gap_s > LOST_S:
            kept = KEPT if gap_s <= FORGOTTEN_S else None
            self.last = sample
            self._lose(sample.time_ns, f"no inertial sample for {gap_s:.1f} s", kept, self.filter)
            return sample
        self._try(partial(admit_gap, span_s=gap_s), self.last.time_ns)
        return Sample(sample.time_ns, mean(self.last.force, sample.force), mean(self.last.rate, sample.rate))

    def _admit(self, span_s: float) -> None:
        """Take a doubtful sample for no better than a guess; the filter is told ten times a second."""
        self._doubtful_s += span_s
        if self.last is None or self.filter is None or self._doubtful_s < DOUBT_PERIOD_S - 1e-3:
            return
        self.aids.judge.comparison = Comparison()  # it would be one with nonsense
        self._try(partial(admit_doubt, span_s=self._doubtful_s), self.last.time_ns)
        self._doubtful_s = 0.0

    def _try(self, act: Callable[[ErrorStateFilter], None], time_ns: int) -> None:
        """Have the filter, if there is one, do something, and begin again if its numbers have lost their meaning."""
        try:
            if self.filter is not None:
                act(self.filter)
        except FilterDiverged as error:
            self._reset(time_ns, str(error), kept=None)

    def _aid(self, measurement: Measurement) -> list[Outcome]:
        """Hold a measurement against the filter, or hand it to the alignment."""
        if isinstance(measurement, FoundDelay | LostTime):
            self.aids.hear(measurement)
            self._try(measurement.tell, measurement.time_ns)
            return []
        if self.aids.is_told_again(measurement, self.filter):
            self.counts = self.counts._replace(epochs_repeated=self.counts.epochs_repeated + 1)
            return []
        if self.filter is None:
            self._align(measurement)
            return []
        if isinstance(measurement, GnssPosition | GnssVelocity) and self._is_turned(measurement, self.filter):
            self._align(measurement)
            return []
        outcomes = []
        try:
            for outcome in self.aids.hold(self.filter, measurement):
                outcomes.append(outcome)
                if outcome.kind is AidingKind.GNSS_POSITION:
                    self._count_position(outcome)
        except FilterDiverged as error:
            self._reset(measurement.time_ns, str(error), kept=None)
        if self._is_astray(measurement.time_ns):
            self._reset(measurement.time_ns, f"{self._rejections} positions in a row rejected", KEPT)
            self._align(measurement)
        return outcomes

    def _is_turned(self, seen: GnssPosition | GnssVelocity, navigation: ErrorStateFilter) -> bool:
        """Watch the heading, and begin again if it is wrong by more than a filter can mend."""
        kept = self.aids.judge.compare(seen, navigation)
        if kept is None:
            return False
        self._reset(seen.time_ns, f"the heading was wrong by {abs(degrees(kept.turn)):.0f} degrees", kept)
        return True

    def _count_position(self, outcome: Outcome) -> None:
        self.counts = self.counts.with_position(outcome.used)
        self.accepted_ns = outcome.time_ns if outcome.used else self.accepted_ns
        self._rejections = 0 if outcome.used or outcome.test_ratio <= 1.0 else self._rejections + 1

    def _is_astray(self, time_ns: int) -> bool:
        """Whether the receiver has contradicted the filter for so often and so long that the filter must be wrong."""
        enough = self._rejections >= self._settings.gating.reset_after_rejections
        return enough and time_ns - (self.accepted_ns or 0) >= self._settings.gating.reset_after_s * 1e9

    def _align(self, measurement: Measurement) -> None:
        """Give a measurement to the alignment, and start the filter if it can."""
        assert self._alignment is not None
        if isinstance(measurement, GnssVelocity):
            self._alignment.see_velocity(measurement)
        elif isinstance(measurement, BaselineHeading):
            self._alignment.see_heading(measurement)
        started = self._alignment.start_at(measurement) if isinstance(measurement, GnssPosition) else None
        if started is None:
            return
        how = self._alignment.how if not self._why else f"{self._alignment.how}, after {self._why}"
        self._start(started, measurement.time_ns, self._alignment.comparison)
        self.counts = self.counts.with_position(used=True)
        self.accepted_ns = measurement.time_ns
        self._enter(NavigationPhase.NAVIGATING, measurement.time_ns, how)

    def _start(self, started: ErrorStateFilter, time_ns: int, comparison: Comparison) -> None:
        """Go on with a filter that has just started."""
        self.aids.begin(time_ns, started, comparison)
        self.filter, self._alignment, self._why, self._rejections = started, None, "", 0
        if self.trail is not None:
            self.trail.follow(started)
        self._rest, self._rest_turn, self._rest_s = UNSETTLED, STILL, 0.0

    def _start_warm(self, saved: SavedState, sample: Sample) -> None:
        """Go on from a saved state, or align anew if state and sample make no sense together."""
        time_ns, self._saved = sample.time_ns, None
        try:
            started = restored(self._settings, saved, sample)
        except FilterDiverged:
            return
        self._start(started, time_ns, Comparison())
        self.accepted_ns = saved.accepted_ns
        coasts = time_ns - (saved.accepted_ns or 0) > self._coasting_ns
        gap_s = (time_ns - saved.inertial.time_ns) * 1e-9
        self._enter(COASTING if coasts else NAVIGATING, time_ns, f"warm start from a state of {gap_s:.1f} s before")

    def _watch_for_standstill(self, time_ns: int, step_s: float, doubt: Doubt, outcomes: list[Outcome]) -> None:
        """Tell the filter at 10 Hz that the vehicle stands, for as long as it does."""
        navigation = self.filter
        if navigation is None:
            self.stationary = self._alignment is not None and self._alignment.levelling.at_rest
            return
        rate, speed = navigation.rate, length(navigation.velocity)
        rest = self._rest = at_rest(self._rest, rate, navigation.acceleration, speed, step_s, doubt)
        self.stationary = rest[2] >= QUIET_S
        if not (self.stationary and self._settings.standstill.enabled):
            if self._rest_s:
                self._rest_turn, self._rest_s = STILL, 0.0
            return
        x, y, z = self._rest_turn
        self._rest_turn = (x + rate[0] * step_s, y + rate[1] * step_s, z + rate[2] * step_s)
        self._rest_s += step_s
        if self._rest_s < PERIOD_S - 1e-3:
            return
        x, y, z, span_s = *self._rest_turn, self._rest_s
        self._rest_turn, self._rest_s = STILL, 0.0
        outcomes += self._aid(Standstill(time_ns, (x / span_s, y / span_s, z / span_s), navigation.rate_noise(span_s)))

    def _watch_the_wheels(self, time_ns: int, step_s: float, outcomes: list[Outcome]) -> None:
        """Tell the filter at 10 Hz that the vehicle goes where its wheels point."""
        self._rolling_s += step_s
        if self._rolling_s < WHEELS_PERIOD_S - 1e-3 or self.filter is None or not self._settings.non_holonomic.enabled:
            return
        self._rolling_s = 0.0
        if hypot(*self.filter.velocity) > SLOWEST_M_S:
            outcomes += self._aid(NonHolonomic(time_ns, self._settings))

    def _settle_phase(self, time_ns: int) -> None:
        """Say what goes on, where that has changed."""
        if self.filter is None:
            assert self._alignment is not None
            phase, reason = self._alignment.phase, self._alignment.reason
        elif time_ns - (self.accepted_ns or 0) > self._coasting_ns:
            phase, reason = COASTING, "no position used lately"
        else:
            phase, reason = NAVIGATING, "positions are used again"
        if phase is not self.phase:
            self._enter(phase, time_ns, f"{reason}, after {self._why}" if self._why else reason)

    def _enter(self, phase: NavigationPhase, time_ns: int, reason: str) -> None:
        self.phase, self.since_ns, self.reason = phase, time_ns, reason

    def _reset(self, time_ns: int, why: str, kept: Heading | None) -> None:
        """Begin again, because the filter cannot be right."""
        self.counts = self.counts._replace(resets=self.counts.resets + 1)
        self._lose(time_ns, why, kept, self.filter if kept else None)
        if kept and self._alignment is not None:  # in the same frame; in a gap it may have turned
            self._alignment.comparison = self.aids.judge.comparison.interrupted()

    def _lose(self, time_ns: int, why: str, kept: Heading | None, lost: ErrorStateFilter | None = None) -> None:
        self._alignment = Alignment(self._settings, lost, kept, first=False)
        self.filter, self._why, self._rejections = None, why, 0
        self._enter(self._alignment.phase, time_ns, f"{self._alignment.reason}, after {why}")
