"""The engine: alignment and filter as a function of IMU samples and measurements in the order of their stamps."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import degrees, hypot, inf, radians, sqrt

import numpy as np

from shared.copies import shallow
from shared.errors import FilterDiverged
from shared.maths.earth import ned_from_geodetic_difference
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import AidingKind, NavigationPhase

from ..aids.aiding import Aids
from ..aids.base import Counts, Measurement, Outcome, Sensor
from ..aids.gnss.comparison import Comparison
from ..aids.gnss.fix import GnssPosition
from ..aids.non_holonomic import aid as non_holonomic
from ..aids.non_holonomic.aid import NonHolonomic
from ..aids.standstill import aid as standstill
from ..aids.standstill.aid import Standstill
from ..aids.updates import model_of
from ..codes import Code, HeadingMethod
from ..inertial.filter import ErrorStateFilter
from ..inertial.imu_faults import Sample, mean
from ..inertial.imu_gaps import (
    MAX_BRIDGED_S,
    SUSPECT_PERIOD_S,
    inflate_for_gap,
    inflate_for_suspect_samples,
)
from ..inertial.propagation import NEVER_NS, Intervals, Samples, Stop, samples_of
from ..inertial.row import diverged, mean_rate
from ..inertial.standstill import is_standstill
from ..integrity.after_loss import NO_LOSS
from ..integrity.disagreement import CLOSURE_SDS, NO_DISAGREEMENT, Disagreement
from ..integrity.over_a_cut import RememberedConflict
from ..settings import Settings
from ..smoothing.history import HistoryRecorder
from ..start import after_gap
from ..start.alignment import Alignment
from ..start.heading import Heading, Prior, better_prior
from ..start.warm_start import SavedState, restored
from .events import Event
from .exclusion import Exclusions
from .segment import Rules, segment

KEPT_HEADING = Heading(0.0, radians(20.0), HeadingMethod.KEPT)
BEFORE_ALL_NS = -(2**62)
PARKED_M_S, PARKED_S = 0.5, 3.0  # a vehicle that moves within this time of its first fix may have left its place


class Engine:
    """Alignment, then the filter with its measurements, gaps and resets.

    All members are replaced and never changed in place, so that a copy is cheap and independent.

    Parameters
    ----------
    settings : Settings
        All settings of the process.
    counts : Counts, optional
        Counts to continue from.
    lost : Explanation, optional
        Why the solution before this engine ended; None if there was none.
    """

    def __init__(self, settings: Settings, counts: Counts | None = None, lost: Explanation | None = None) -> None:
        self._settings = settings
        self.coasting_ns = round(settings.gnss.coasting_after_s * 1e9)
        self._model = model_of(settings)
        self._intervals = Intervals(
            settings.covariance_period_s,
            standstill.PERIOD_S if settings.standstill.enabled else inf,
            non_holonomic.PERIOD_S if settings.non_holonomic.enabled else inf,
        )
        self.phase, self.since_ns = NavigationPhase.WAITING_FOR_IMU, 0
        self.why: tuple[Explanation, ...] = (explain(Code.NO_SAMPLE_YET),)  # it is in its phase
        self.counts = counts or Counts()
        self.last: Sample | None = None  # newest sample, up to which the state is propagated
        self.filter: ErrorStateFilter | None = None
        self.recorder: HistoryRecorder | None = None  # of all filters, for the smoother
        self.accepted_ns: int | None = None  # stamp of the last position that was used
        self.started_ns: int | None = None  # of the filter
        self.first_start: tuple[int | None, bool] = None, False  # stamp of the first filter, and without a standstill
        self.remembered: RememberedConflict | None = None  # of an earlier process, until the first filter
        self._prior: Prior | None = None  # until the first position has been compared with it
        self._odometer_ns: int | None = None  # stamp of the last speed of the odometer that was used
        self._alignment: Alignment | None = Alignment(settings, first=lost is None)
        self._saved: SavedState | None = None  # to be restored with the first sample
        self.aids = Aids(settings)
        self.exclusions = Exclusions()
        self._suspect_s = 0.0  # time of suspect samples since the last inflation
        self._rejections = 0  # number of consecutive rejected positions
        self._lost = lost
        self._begun_ns = 0  # stamp of the first sample

    def copy(self) -> "Engine":
        """Independent copy."""
        made = shallow(self)
        made.filter, made.aids = self.filter and shallow(self.filter), self.aids.copy()
        made._alignment = self._alignment.copy() if self._alignment else None
        return made

    def unrecorded(self) -> "Engine":
        """Independent copy without a history for the smoother."""
        made = self.copy()
        made.recorder, made.filter = None, made.filter and made.filter.unrecorded()
        return made

    def use_prior(self, prior: Prior) -> None:
        """Use a saved position and heading, unless a filter has started before."""
        if self._alignment is not None and self.accepted_ns is None:
            self._alignment.use_prior(prior)
            self._prior = better_prior(self._prior, prior)

    def remember(self, conflict: RememberedConflict) -> None:
        """Hold with the first filter what an earlier process held."""
        if self.filter is None:
            self.remembered = conflict

    def restore(self, saved: SavedState) -> None:
        """Restore a saved state with the first sample, which must be the next."""
        self._saved = saved

    @property
    def time_ns(self) -> int:
        """Instant of the state."""
        return self.last.time_ns if self.last is not None else BEFORE_ALL_NS

    @property
    def odometer_age_s(self) -> float | None:
        """Time since the last speed of the odometer that was used [s]; None without one."""
        return None if self._odometer_ns is None else (self.time_ns - self._odometer_ns) * 1e-9

    @property
    def stationary(self) -> bool:
        """Whether the vehicle is at standstill."""
        if self.filter is not None:
            return is_standstill(self.filter.state.quiet)
        return self._alignment is not None and self._alignment.levelling.is_stationary

    def process(
        self, samples: Samples, measurements: Sequence[Measurement], intervals: Intervals | None = None
    ) -> list[Outcome]:
        """Propagate over samples, and use the measurements up to the last of them at their stamps.

        Parameters
        ----------
        samples : Samples
            Samples newer than all before.
        measurements : sequence of Measurement
            Measurements in the order of their stamps. Those older than the state are left out: they are of a gap that
            ended the solution.
        intervals : Intervals, optional
            Other intervals of the updates than those of the settings.

        Returns
        -------
        list of Outcome
            Outcomes of all observations, in the order in which they were used.
        """
        begin = 0
        if self.last is None and len(samples.times_ns):
            self.last, begin = _sample(samples, 0), 1
            self._begun_ns = self.last.time_ns
            self._enter(NavigationPhase.LEVELLING, self.last.time_ns, explain(Code.MEASURING_AT_REST))
            if self._saved is not None:
                self._start_warm(self._saved, self.last)
        return self._process(samples, begin, measurements, intervals or self._intervals)

    def _process(
        self, samples: Samples, here: int, measurements: Sequence[Measurement], intervals: Intervals
    ) -> list[Outcome]:
        times_ns, end, due = samples.times_ns, len(samples.times_ns), 0
        outcomes: list[Outcome] = []
        while here < end:
            time_ns = times_ns[here]
            if (time_ns - self.time_ns) * 1e-9 > intervals.gap_s:
                until = bisect_right(measurements, time_ns, due, key=lambda m: m.time_ns)
                outcomes += self._bridge(_sample(samples, here), measurements[due:until], intervals)
                here, due = here + 1, until
            elif self.filter is not None:
                taken, due = self._advance(samples, here, measurements, due, intervals, outcomes)
                here += taken
            elif due < len(measurements) and measurements[due].time_ns <= time_ns:
                outcomes += self._align_within(samples, here, measurements[due])
                due += 1
            else:
                self._level(_sample(samples, here))
                here += 1
        return outcomes

    def _align_within(self, samples: Samples, here: int, measurement: Measurement) -> list[Outcome]:
        """Use the part of a sample up to a measurement in the alignment, and the measurement."""
        if measurement.time_ns < self.time_ns:
            return []
        if measurement.time_ns > self.time_ns:
            self._level(_sample(samples, here)._replace(time_ns=measurement.time_ns))
        return self._use(measurement)

    def _advance(
        self, samples: Samples, begin: int, measurements: Sequence[Measurement], due: int, intervals: Intervals,
        outcomes: list[Outcome],
    ) -> tuple[int, int]:  # fmt: skip
        """Propagate the filter over samples with all updates that are due, up to one that has rules of its own.

        Returns
        -------
        tuple of int
            Number of samples that were used in full, and the place of the next measurement.
        """
        assert self.filter is not None
        self.filter.begin_samples(samples.rows[begin])
        if self._goes_step_by_step(samples, begin):
            return self._step(samples, begin, measurements, due, intervals, outcomes)
        navigation, aids, reason = self.filter, self.aids, self.exclusions.reason_of(Sensor.ODOMETER)
        prepared = aids.speeds(measurements, due, excluded=reason is not None)
        end = self._stop(samples, begin, len(samples.times_ns))
        rules, begin_ns = Rules(navigation.noise, self._model, intervals), navigation.time_ns
        found = segment(navigation.numbers, samples, begin, end, prepared.arrays, aids.standing, rules)
        navigation.take_numbers(found.numbers)
        self.last = Sample(navigation.time_ns, navigation.state.force, navigation.state.rate)
        made = aids.took(prepared, found.used, found.standing, begin_ns, found.records, reason)
        for outcome in made:
            if outcome.used and outcome.kind is AidingKind.ODOMETER:
                self._odometer_ns = outcome.time_ns
        outcomes += made
        due = prepared.speeds[found.used - 1].place + 1 if found.used else due
        self._update_phase()
        if found.stop is Stop.DIVERGED:
            self._reset(explain(Code.DIVERGED, cause=diverged(found.fault).cause), kept=None)
        elif found.stop is Stop.MEASUREMENT_DUE:
            due = prepared.next + 1
            outcomes += self._use_in_time(measurements[prepared.next])
        return found.taken, due

    def _use_in_time(self, measurement: Measurement) -> list[Outcome]:
        """Use a measurement, unless it is older than the state: of a gap that ended the solution."""
        return self._use(measurement) if measurement.time_ns >= self.time_ns else []

    def _goes_step_by_step(self, samples: Samples, begin: int) -> bool:
        """Whether each step is looked at: by the smoother, for a suspect sample, a delay, or a reset that is near."""
        assert self.filter is not None
        looked_at = self.filter.recorder is not None or self.filter.late is not None
        return looked_at or begin in samples.faults or self._rejections >= self._settings.gating.reset_after_rejections

    def _step(
        self, samples: Samples, begin: int, measurements: Sequence[Measurement], due: int, intervals: Intervals,
        outcomes: list[Outcome],
    ) -> tuple[int, int]:  # fmt: skip
        """Propagate until an update is due, and make the update: see `_advance`."""
        before_ns, navigation = self.time_ns, self.filter
        assert navigation is not None
        limits = self.aids.standstill_limits(before_ns, navigation)
        due_ns = measurements[due].time_ns if due < len(measurements) else NEVER_NS
        end = self._stop(samples, begin, len(samples.times_ns))
        taken, stop = navigation.propagate(samples, begin, end, limits, intervals, due_ns)
        moved = navigation.time_ns > before_ns
        if moved:
            self.last = Sample(navigation.time_ns, navigation.state.force, navigation.state.rate)
        match stop:
            case Stop.COVARIANCE_DUE:
                self.attempt(ErrorStateFilter.propagate_covariance)
            case Stop.ZERO_VELOCITY_DUE:
                rate, rate_sd = mean_rate(navigation.state)
                navigation.begin_standstill()
                outcomes += self._use(Standstill(self.time_ns, rate, rate_sd))
            case Stop.NON_HOLONOMIC_DUE:
                navigation.begin_non_holonomic()
                if hypot(*navigation.velocity) > non_holonomic.MIN_SPEED_M_S:
                    outcomes += self._use(NonHolonomic(self.time_ns, self._settings))
            case _:
                pass  # handled by `_process`, or below
        if moved and begin in samples.faults:
            self._inflate_for_suspect((self.time_ns - before_ns) * 1e-9)
        self._update_phase()
        if stop is Stop.MEASUREMENT_DUE:
            outcomes += self._use_in_time(measurements[due])
            due += 1
        return taken, due

    def _stop(self, samples: Samples, begin: int, end: int) -> int:
        """End of the samples for one propagation: before a suspect sample, and after the first that is coasting."""
        if end == begin + 1:
            return end
        faults = samples.faults
        if faults:
            end = begin + 1 if begin in faults else min((k for k in faults if begin < k < end), default=end)
        if self.phase is not NavigationPhase.COASTING:
            coasting_ns = (self.accepted_ns or 0) + self.coasting_ns
            end = min(end, bisect_right(samples.times_ns, coasting_ns, begin, end) + 1)
        return end

    def _level(self, sample: Sample) -> None:
        """Use a sample in the alignment."""
        assert self._alignment is not None
        step_s = (sample.time_ns - self.time_ns) * 1e-9
        if step_s > 0.0:
            self._alignment.levelling.advance(sample.force, sample.rate, step_s)
            self.last = sample
            self._update_phase()
            self._start_parked()

    def _start_parked(self) -> None:
        """Start at the saved position where no GNSS position has come for long, and the vehicle has not moved."""
        waited_s = (self.time_ns - self._begun_ns) * 1e-9
        if self._prior is None or self._alignment is None or waited_s < self._settings.alignment.without_gnss_s:
            return
        started = self._alignment.start_parked(self.time_ns)
        if started is not None:
            self._start(started, self.time_ns, Comparison())
            self._enter(NavigationPhase.COASTING, self.time_ns, explain(Code.STARTED_PARKED, waited_s=waited_s))

    def _bridge(self, sample: Sample, measurements: Sequence[Measurement], intervals: Intervals) -> list[Outcome]:
        """Propagate over a gap before a sample with the mean of its two ends, or end the solution."""
        assert self.last is not None
        gap_s = (sample.time_ns - self.time_ns) * 1e-9
        self.counts = self.counts._replace(imu_gaps=self.counts.imu_gaps + 1)
        if gap_s > MAX_BRIDGED_S:
            return self._interrupt(sample, measurements, intervals, gap_s)
        self.attempt(partial(inflate_for_gap, span_s=gap_s))
        row = *mean(self.last.force, sample.force), *mean(self.last.rate, sample.rate)
        bridge = samples_of([sample.time_ns], [row], {0: sample.fault} if sample.fault else {})
        outcomes = self._process(bridge, 0, measurements, intervals._replace(gap_s=inf))
        self.attempt(ErrorStateFilter.propagate_covariance)
        self.last = sample
        return outcomes

    def _interrupt(
        self, sample: Sample, measurements: Sequence[Measurement], intervals: Intervals, gap_s: float
    ) -> list[Outcome]:
        """End the solution at a long gap before a sample, and start again at the newest fix if that is recent.

        Attitude and biases are kept over all but the longest gaps.
        """
        why = explain(Code.GAP, gap_s=gap_s)
        self.attempt(ErrorStateFilter.propagate_covariance)
        lost = self._alignment.carried(self.time_ns) if self._alignment is not None else self.filter
        if lost is None or gap_s > after_gap.MAX_DURATION_S:
            self.last = sample
            self._end_solution(why, None, lost)
            return []
        kept = after_gap.kept_over_gap(self._settings, lost, sample.time_ns, measurements)
        recent = [
            measurement
            for measurement in measurements
            if (sample.time_ns - measurement.time_ns) * 1e-9 <= after_gap.RECENT_WINDOW_S
        ]
        begin_ns = recent[0].time_ns if recent else sample.time_ns
        self.last = sample._replace(time_ns=begin_ns)
        self._end_solution(why, kept.heading, kept.filter, kept.tilt_variance)
        row = samples_of([sample.time_ns], [[*sample.force, *sample.rate]], {0: sample.fault} if sample.fault else {})
        outcomes = self._process(row, 0, recent, intervals._replace(gap_s=inf)) if recent else []
        self.attempt(partial(inflate_for_gap, span_s=(sample.time_ns - begin_ns) * 1e-9))
        self.last = sample
        return outcomes

    def _inflate_for_suspect(self, span_s: float) -> None:
        """Inflate the covariance for a time of suspect samples, ten times a second."""
        self._suspect_s += span_s
        if self.filter is None or self._suspect_s < SUSPECT_PERIOD_S - 1e-3:
            return
        self.aids.gnss.comparison = Comparison()  # its accelerations would be wrong
        self.attempt(partial(inflate_for_suspect_samples, span_s=self._suspect_s))
        self._suspect_s = 0.0

    def attempt(self, act: Callable[[ErrorStateFilter], None]) -> None:
        """Apply a function to the filter, if there is one, and reset the filter if it diverges."""
        try:
            if self.filter is not None:
                act(self.filter)
        except FilterDiverged as error:
            self._reset(explain(Code.DIVERGED, cause=error.cause), kept=None)

    def _use(self, measurement: Measurement) -> list[Outcome]:
        """Use a measurement in the filter, or in the alignment."""
        if isinstance(measurement, Event):
            measurement.apply(self)
            return []
        if (reason := self.exclusions.reason(measurement)) is not None:
            return self._use_excluded(measurement, reason)
        if self.aids.is_duplicate(measurement, self.filter):
            self.counts = self.counts._replace(epochs_repeated=self.counts.epochs_repeated + 1)
            return []
        if self.filter is None or self._is_heading_wrong(measurement, self.filter):
            self._align(measurement)
            return []
        outcomes = []
        try:
            for outcome in self.aids.use(self.filter, measurement):
                outcomes.append(outcome)
                if outcome.used and outcome.kind is AidingKind.ODOMETER:
                    self._odometer_ns = outcome.time_ns
                if measurement.is_fix:
                    self._count_position(outcome, measurement.left_out)
        except FilterDiverged as error:
            self._reset(explain(Code.DIVERGED, cause=error.cause), kept=None)
        if self._is_reset_due(measurement.time_ns):
            self._reset(explain(Code.POSITIONS_REJECTED, count=self._rejections), KEPT_HEADING)
            self._align(measurement)
        return outcomes

    def hold(self, disagreement: Disagreement) -> None:
        """Let the level hold a disagreement."""
        self.aids.error_monitor = replace(self.aids.error_monitor, held=disagreement)

    def end_loss(self) -> None:
        """Hold nothing any more of what the last return of GNSS may be off by."""
        self.aids.error_monitor = replace(self.aids.error_monitor, loss=NO_LOSS)

    def hold_after_interference(self) -> None:
        """Hold what the last return of GNSS may be off by as an offset, which displacement does not end."""
        self.aids.error_monitor = self.aids.error_monitor.after_interference()

    def _use_excluded(self, measurement: Measurement, reason: str) -> list[Outcome]:
        """Compare a measurement of an excluded source with the filter, without using it."""
        outcomes: list[Outcome] = []
        try:
            if self.filter is not None:
                outcomes = list(self.aids.test_only(self.filter, measurement, reason))
        except FilterDiverged as error:
            self._reset(explain(Code.DIVERGED, cause=error.cause), kept=None)
        if measurement.is_fix:
            ratio = outcomes[0].test_ratio if outcomes else None
            self.exclusions = replace(self.exclusions, fixes=self.exclusions.fixes + 1, test_ratio=ratio)
        return outcomes

    def _is_heading_wrong(self, measurement: Measurement, navigation: ErrorStateFilter) -> bool:
        """Compare the heading with GNSS, and reset a filter whose heading it cannot correct."""
        error = self.aids.heading_error(measurement, navigation)
        if error is None:
            return False
        kept = Heading(*error, HeadingMethod.ACCELERATIONS)
        self._reset(explain(Code.HEADING_WRONG, angle_deg=abs(degrees(kept.turn))), kept)
        return True

    def _count_position(self, outcome: Outcome, left_out: tuple[str, ...]) -> None:
        self.counts = self.counts.with_position(outcome.used)
        self.accepted_ns = outcome.time_ns if outcome.used else self.accepted_ns
        if outcome.used and self.exclusions.readmitted_after_s is not None:
            distance_m = hypot(*outcome.innovation[:2])
            why = explain(Code.READMITTED, excluded_s=self.exclusions.readmitted_after_s, distance_m=distance_m)
            self._enter(NavigationPhase.NAVIGATING, outcome.time_ns, why)
            self.exclusions = replace(self.exclusions, readmitted_after_s=None)
        if outcome.used and left_out != self.exclusions.satellites:
            if left_out and not self.exclusions.satellites:
                self._hold_satellite_fault(outcome)
            self.exclusions = replace(self.exclusions, satellites=left_out)
        self._rejections = 0 if outcome.used or outcome.test_ratio <= 1.0 else self._rejections + 1

    def _hold_satellite_fault(self, outcome: Outcome) -> None:
        """Hold what a satellite may have done before it was found: the first fix without it against the solution."""
        z, sd = outcome.innovation, outcome.innovation_sd
        spread = hypot(sd[0], sd[1]), sd[2] if len(sd) == 3 else 0.0
        far = hypot(z[0], z[1]) > spread[0] / sqrt(2.0), len(z) == 3 and abs(z[2]) > spread[1]
        if any(far):
            vector = (*((z[0], z[1]) if far[0] else (0.0, 0.0)), z[2] if far[1] else 0.0)
            self.hold(self.aids.error_monitor.held.after(vector, spread, outcome.time_ns, grew=True))

    def _is_reset_due(self, time_ns: int) -> bool:
        """Whether enough consecutive positions were rejected for long enough."""
        enough = self._rejections >= self._settings.gating.reset_after_rejections
        return enough and time_ns - (self.accepted_ns or 0) >= self._settings.gating.reset_after_s * 1e9

    def _align(self, measurement: Measurement) -> None:
        """Use a measurement in the alignment, and start the filter when it is complete."""
        assert self._alignment is not None
        started = measurement.align(self._alignment)
        if started is None:
            return
        why, lost = explain(Code.STARTED, method=self._alignment.method), self._lost
        self._start(started, measurement.time_ns, self._alignment.comparison)
        self.counts = self.counts.with_position(used=True)
        self.accepted_ns = measurement.time_ns
        self._enter(NavigationPhase.NAVIGATING, measurement.time_ns, why, lost)
        self.exclusions = replace(self.exclusions, readmitted_after_s=None)

    def _aside(self, first: GnssPosition, prior: Prior, started: ErrorStateFilter) -> Disagreement:
        """Compare the first position with the saved one; a vehicle that moves already may have left its place."""
        moving_s = (started.time_ns - first.time_ns) * 1e-9
        if not prior.parked:  # it drove on, or where it stood is not known
            return NO_DISAGREEMENT
        if hypot(*started.velocity[:2]) > PARKED_M_S and moving_s < PARKED_S:
            return NO_DISAGREEMENT
        vehicle, axes = self._settings.vehicle, first.axes
        north, east, down = ned_from_geodetic_difference(first.position, prior.position)
        sd = np.sqrt(first.cov.diagonal()[:axes])
        spread = hypot(sd[0], sd[1], *prior.position_sd[:2]), hypot(sd[2], prior.position_sd[2]) if axes == 3 else inf
        far = hypot(north, east) > max(CLOSURE_SDS * spread[0], vehicle.alert_limit_horizontal_m)
        high = abs(down) > max(CLOSURE_SDS * spread[1], vehicle.alert_limit_vertical_m)
        if not (far or high):
            return NO_DISAGREEMENT
        vector = (north if far else 0.0, east if far else 0.0, down if high else 0.0)
        spread = spread[0], min(spread[1], abs(down))
        return NO_DISAGREEMENT.after(vector, spread, first.time_ns, grew=False, at_start=True)

    def _start(self, started: ErrorStateFilter, time_ns: int, comparison: Comparison) -> None:
        """Continue with a filter that has just started."""
        self.aids.begin(time_ns, started, comparison)
        self.started_ns = time_ns
        if self.first_start[0] is None and self._alignment is not None:
            self.first_start = time_ns, self._alignment.levelling.yaw_at_start is None
        first = self._alignment.first_fix if self._alignment is not None else None
        if self._prior is not None and first is not None:
            aside = self._aside(first, self._prior, started)
            if aside.is_open:
                self.hold(aside)
        if self.remembered is not None:  # beside the saved position, the larger of the two covers both
            remembered, known = self.remembered.at(time_ns), self.aids.error_monitor.held
            if remembered.is_open and max(remembered.bound) >= max(known.bound):
                self.hold(remembered)
        self._prior = self.remembered = None
        self.filter, self._alignment, self._lost, self._rejections = started, None, None, 0
        if self.recorder is not None:
            self.recorder.start(started)

    def _start_warm(self, saved: SavedState, sample: Sample) -> None:
        """Continue from a saved state; the alignment goes on if the restored filter diverges."""
        time_ns, self._saved = sample.time_ns, None
        try:
            started = restored(self._settings, saved, sample)
        except FilterDiverged:
            return
        self._start(started, time_ns, Comparison())
        self.accepted_ns = saved.accepted_ns
        self.exclusions = replace(self.exclusions, gnss_since_ns=saved.gnss_excluded_since_ns)
        self.hold(saved.held)
        self.first_start = 0, False  # it goes on
        coasting = time_ns - (saved.accepted_ns or 0) > self.coasting_ns
        gap_s = (time_ns - saved.inertial.time_ns) * 1e-9
        phase = NavigationPhase.COASTING if coasting else NavigationPhase.NAVIGATING
        self._enter(phase, time_ns, explain(Code.WARM_START, gap_s=gap_s))

    def _update_phase(self) -> None:
        """Enter the phase of the present state, if it is another one."""
        if self.filter is None:
            assert self._alignment is not None
            phase = self._alignment.phase
        elif self.time_ns - (self.accepted_ns or 0) > self.coasting_ns:
            phase = NavigationPhase.COASTING
        else:
            phase = NavigationPhase.NAVIGATING
        if phase is not self.phase:
            self._enter(phase, self.time_ns, self._why(phase))

    def _why(self, phase: NavigationPhase) -> Explanation:
        """Why a phase begins that another one does not explain."""
        if self._alignment is not None and self.filter is None:
            return self._alignment.why
        if phase is NavigationPhase.NAVIGATING:
            return explain(Code.POSITIONS_AGAIN)
        return explain(Code.NO_POSITION_LATELY if self.exclusions.gnss_since_ns is None else Code.GNSS_EXCLUDED)

    def _enter(self, phase: NavigationPhase, time_ns: int, why: Explanation, lost: Explanation | None = None) -> None:
        """Enter a phase; `lost` is why the solution before it ended, if the engine has forgotten it."""
        lost = lost or self._lost
        self.phase, self.since_ns = phase, time_ns
        self.why = (why,) if lost is None else (why, lost)

    def _reset(self, why: Explanation, kept: Heading | None) -> None:
        """End the solution and count a reset; `kept` is the heading correction if the attitude is kept."""
        self.counts = self.counts._replace(resets=self.counts.resets + 1)
        self._end_solution(why, kept, self.filter if kept else None)
        if kept and self._alignment is not None:  # not after a gap, in which the level frame may have turned
            self._alignment.comparison = self.aids.gnss.comparison.interrupted()

    def _end_solution(
        self, why: Explanation, kept: Heading | None, lost: ErrorStateFilter | None, tilt_variance: float = 1.0
    ) -> None:
        """Begin another alignment, with the attitude and the biases of the lost filter where they are kept."""
        self._alignment = Alignment(self._settings, lost, kept, tilt_variance=tilt_variance, first=False)
        self.filter, self._lost, self._rejections = None, why, 0
        self._enter(self._alignment.phase, self.time_ns, self._alignment.why)


def _sample(samples: Samples, k: int) -> Sample:
    fx, fy, fz, wx, wy, wz = map(float, samples.rows[k])
    return Sample(int(samples.times_ns[k]), (fx, fy, fz), (wx, wy, wz), samples.faults.get(k))
