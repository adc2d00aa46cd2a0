"""The estimator as a function of inertial samples and measurements in the order in which they were true."""

from collections.abc import Sequence
from dataclasses import replace
from math import degrees, hypot, radians, sqrt
from typing import NamedTuple

from shared.errors import FilterDiverged
from shared.maths.rotation import Vector
from shared.messages import AidingKind, NavigationPhase

from . import error_model as em
from .aiding import Measurement, Outcome
from .alignment import Alignment
from .baseline import BaselineHeading
from .compass import CompassCheck, MagneticHeading
from .filter import ErrorStateFilter
from .gnss import GnssPosition, GnssVelocity
from .heading import Heading, Prior
from .judging import Judge
from .matching import Comparison
from .samples import Sample
from .settings import Settings
from .standstill import PERIOD_S, Standstill
from .stationary import QUIET_S, SPEED_LIMIT, UNSETTLED, at_rest, length
from .trail import Trail
from .watch import Watch, block
from .wheels import PERIOD_S as WHEELS_PERIOD_S
from .wheels import SLOWEST_M_S, NonHolonomic, WheelSpeed

GAP_S = 0.05  # a longer step is a gap: carried over, and admitted in the covariance
LOST_S = 1.0  # a longer one ends the solution, though not the attitude
FORGOTTEN_S = 5.0  # a still longer one ends that too
GAP_FORCE_SD = 2.0  # [m/s²] what a car may do while nobody looks
GAP_RATE_SD = 0.3  # [rad/s]
DOUBT_PERIOD_S = 0.1
DOUBT_CORRELATION_S = 1.0
KEPT = Heading(0.0, radians(20.0), "heading kept")
TURNED_SD = radians(3.0)
ODOMETER_SILENT_NS = 2_000_000_000  # then another one may take its place
ZERO_SDS = 3.0  # of the velocity, within which a speed of zero is believed
COASTING, NAVIGATING = NavigationPhase.COASTING, NavigationPhase.NAVIGATING  # looked up for every sample


class Counts(NamedTuple):
    """What was used and what was not."""

    fixes_used: int = 0
    fixes_rejected: int = 0
    imu_gaps: int = 0
    resets: int = 0


class Engine:
    """Alignment first, then the filter with its aiding, its gaps and its resets.

    Everything that it knows is replaced and never changed in place, so that a `fork` is cheap and stays as it was.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._coasting_ns = settings.coasting_after_s * 1e9
        self.phase = NavigationPhase.WAITING_FOR_IMU
        self.since_ns = 0
        self.reason = "no inertial sample yet"
        self.counts = Counts()
        self.last: Sample | None = None
        self.filter: ErrorStateFilter | None = None
        self.trail: Trail | None = None  # of whatever filter runs, for a smoother
        self.accepted_ns: int | None = None  # stamp of the last position that was used
        self.stationary = False
        self.watch = Watch()
        self._alignment: Alignment | None = Alignment(settings)
        self._judge = Judge(settings)
        self._rest = UNSETTLED
        self._rest_turn: Vector = (0.0, 0.0, 0.0)  # [rad, body] of the rest since its last update
        self._rest_s = 0.0
        self._doubtful_s = 0.0  # of samples, since the filter was told
        self._rolling_s = 0.0  # since the wheels were last held against the filter
        self._odometer: WheelSpeed | None = None  # newest speed that was not of a spare
        self._compass = CompassCheck()
        self._rejections = 0  # successive positions
        self._why = ""  # the solution was lost

    @property
    def lever_arm_error(self) -> tuple[float, float] | None:
        """Error [m, forward and right] of the lever arm, if it is wrong beyond doubt."""
        return self._judge.arm.wrong()

    def fork(self) -> "Engine":
        """Copy that goes its own way."""
        twin = Engine.__new__(Engine)
        twin.__dict__.update(self.__dict__)
        twin.filter = self.filter.fork() if self.filter else None
        twin._alignment = self._alignment.fork() if self._alignment else None
        twin._judge = self._judge.fork()
        return twin

    def remember(self, prior: Prior) -> None:
        """Take a saved position and heading, of use until the filter runs for the first time."""
        if self._alignment is not None and self.accepted_ns is None:
            self._alignment.remember(prior)

    def begin_after(self, counts: Counts, why: str) -> None:
        """Begin with the counts of an engine that was given up."""
        self.counts = counts._replace(resets=counts.resets + 1)
        self._why = why

    def step(self, sample: Sample, due: Sequence[Measurement]) -> list[Outcome]:
        """Advance to the stamp of a sample, using on the way the measurements that were true before it."""
        last, time_ns = self.last, sample[0]
        if last is None:
            self.last = sample
            self._enter(
                NavigationPhase.LEVELLING,
                time_ns,
                f"levelling, after {self._why}" if self._why else "measuring tilt and gyroscope bias at rest",
            )
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
        self.last = sample
        if sample[3] is not None:
            self._admit(gap_s)
        self._watch_for_standstill(time_ns, gap_s, outcomes)
        self._watch_the_wheels(time_ns, gap_s, outcomes)
        self._settle_phase(time_ns)
        return outcomes

    def _advance(self, sample: Sample, time_ns: int) -> None:
        """Carry alignment or filter to an instant within the step that the sample describes."""
        assert self.last is not None
        if time_ns <= self.last[0]:
            return
        force, rate = sample[1], sample[2]
        try:
            if self.filter is not None:
                self.filter.advance(force, rate, time_ns)
            elif self._alignment is not None:
                self._alignment.levelling.advance(force, rate, (time_ns - self.last[0]) * 1e-9)
        except FilterDiverged as error:
            self._reset(time_ns, str(error), kept=None)

    def _bridge(self, gap_s: float, sample: Sample) -> Sample:
        """Decide what survives a gap, and what is taken to have happened in it: the mean of its two ends."""
        assert self.last is not None
        self.counts = self.counts._replace(imu_gaps=self.counts.imu_gaps + 1)
        if gap_s > LOST_S:
            kept = KEPT if gap_s <= FORGOTTEN_S else None
            self.last = sample
            self._lose(sample.time_ns, f"no inertial sample for {gap_s:.1f} s", kept, self.filter)
            return sample
        if self.filter is not None:
            force_sd, rate_sd = GAP_FORCE_SD * gap_s, GAP_RATE_SD * gap_s
            self.filter.widen(attitude_sd=rate_sd, velocity_sd=force_sd, position_sd=0.5 * force_sd * gap_s)
        return Sample(sample.time_ns, _mean(self.last.force, sample.force), _mean(self.last.rate, sample.rate))

    def _admit(self, span_s: float) -> None:
        """Take a doubtful sample for no better than a guess, ten times a second: errors that last about a second."""
        self._doubtful_s += span_s
        if self.filter is None or self._doubtful_s < DOUBT_PERIOD_S - 1e-3:
            return
        self._judge.comparison = Comparison()  # it would be one with nonsense
        grown = sqrt(self._doubtful_s * DOUBT_CORRELATION_S)
        self.filter.widen(attitude_sd=GAP_RATE_SD * grown, velocity_sd=GAP_FORCE_SD * grown)
        self._doubtful_s = 0.0

    def _aid(self, measurement: Measurement) -> list[Outcome]:
        """Hold a measurement against the filter, or hand it to the alignment."""
        if self.filter is None:
            self._align(measurement)
            return []
        if isinstance(measurement, WheelSpeed) and self._is_spare(measurement, self.filter):
            return []
        if isinstance(measurement, GnssPosition | GnssVelocity) and self._is_turned(measurement, self.filter):
            self._align(measurement)
            return []
        if isinstance(measurement, MagneticHeading):
            self._compass = self._compass.judged(measurement, self.filter)
            measurement = replace(measurement, check=self._compass)
        outcomes = []
        try:
            for observe in measurement.observers():
                before = block(self.filter)
                outcome = self._judge.judge(self.filter, measurement, observe(self.filter))
                outcomes.append(outcome)
                self.watch = self.watch.after(outcome, before, self.filter, self._settings.gate_false_alarm)
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
        found = self._judge.compare(seen, navigation)
        if found is None:
            return False
        turn, sd = found
        why = f"the heading was wrong by {abs(degrees(turn)):.0f} degrees"
        self._reset(seen.time_ns, why, Heading(turn, max(sd, TURNED_SD), "matched accelerations"))
        return True

    def _count_position(self, outcome: Outcome) -> None:
        counts = self.counts
        if outcome.used:
            self.counts, self.accepted_ns = counts._replace(fixes_used=counts.fixes_used + 1), outcome.time_ns
        else:
            self.counts = counts._replace(fixes_rejected=counts.fixes_rejected + 1)
        self._rejections = 0 if outcome.used or outcome.test_ratio <= 1.0 else self._rejections + 1

    def _is_astray(self, time_ns: int) -> bool:
        """Whether the receiver has contradicted the filter for so often and so long that the filter must be wrong."""
        enough = self._rejections >= self._settings.reset_after_rejections
        return enough and time_ns - (self.accepted_ns or 0) >= self._settings.reset_after_s * 1e9

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
        self._judge.acquit(self._alignment.comparison)
        self.filter, self._alignment, self._why = started, None, ""
        self.watch = self.watch.begun(measurement.time_ns, started)
        if self.trail is not None:
            self.trail.follow(started)
        self._rest, self._rest_s = UNSETTLED, 0.0
        self.counts = self.counts._replace(fixes_used=self.counts.fixes_used + 1)
        self.accepted_ns, self._rejections = measurement.time_ns, 0
        self._enter(NavigationPhase.NAVIGATING, measurement.time_ns, how)

    def _watch_for_standstill(self, time_ns: int, step_s: float, outcomes: list[Outcome]) -> None:
        """Tell the filter at 10 Hz that the vehicle stands, for as long as it does."""
        navigation = self.filter
        if navigation is None:
            self.stationary = self._alignment is not None and self._alignment.levelling.at_rest
            return
        rate, speed, limit = navigation.rate, length(navigation.velocity), SPEED_LIMIT
        if speed >= limit and self._odometer is not None:
            limit = self._speed_at_rest(time_ns, navigation)
        rest = self._rest = at_rest(self._rest, rate, navigation.acceleration, speed, step_s, limit)
        self.stationary = rest[2] >= QUIET_S
        if not (self.stationary and self._settings.zero_velocity):
            if self._rest_s:
                self._rest_turn, self._rest_s = (0.0, 0.0, 0.0), 0.0
            return
        x, y, z = self._rest_turn
        self._rest_turn = (x + rate[0] * step_s, y + rate[1] * step_s, z + rate[2] * step_s)
        self._rest_s += step_s
        if self._rest_s < PERIOD_S - 1e-3:
            return
        x, y, z, span_s = *self._rest_turn, self._rest_s
        self._rest_turn, self._rest_s = (0.0, 0.0, 0.0), 0.0
        outcomes += self._aid(Standstill(time_ns, (x / span_s, y / span_s, z / span_s), navigation.rate_noise(span_s)))

    def _speed_at_rest(self, time_ns: int, navigation: ErrorStateFilter) -> float:
        """Find the speed [m/s] up to which the vehicle may be at rest: more, if wheels that stand make it likely."""
        seen = self._odometer
        if seen is None or seen.speed != 0.0 or time_ns - seen.time_ns > ODOMETER_SILENT_NS:
            return SPEED_LIMIT
        return max(SPEED_LIMIT, ZERO_SDS * sqrt(float(navigation.P.diagonal()[em.VELOCITY].sum())))

    def _is_spare(self, seen: WheelSpeed, navigation: ErrorStateFilter) -> bool:
        """Whether another odometer is in use; one that takes its place has a scale of its own."""
        used = self._odometer
        if used is not None and (used.source, used.of_wheels) != (seen.source, seen.of_wheels):
            better = seen.of_wheels and not used.of_wheels
            if not better and seen.time_ns - used.time_ns <= ODOMETER_SILENT_NS:
                return True
            navigation.forget_odometer()
        self._odometer = seen
        return False

    def _watch_the_wheels(self, time_ns: int, step_s: float, outcomes: list[Outcome]) -> None:
        """Tell the filter at 10 Hz that the vehicle goes where its wheels point."""
        self._rolling_s += step_s
        if self._rolling_s < WHEELS_PERIOD_S - 1e-3 or self.filter is None or not self._settings.non_holonomic:
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
        sound = self.filter if kept is not None else None
        self._lose(time_ns, why, kept, sound)

    def _lose(self, time_ns: int, why: str, kept: Heading | None, lost: ErrorStateFilter | None = None) -> None:
        self._alignment = Alignment(self._settings, lost, kept)
        if lost is not None:
            self._alignment.comparison = self._judge.comparison.interrupted()
        self.filter, self._why, self._rejections = None, why, 0
        self._enter(self._alignment.phase, time_ns, f"{self._alignment.reason}, after {why}")


def _mean(first: Vector, second: Vector) -> Vector:
    return 0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]), 0.5 * (first[2] + second[2])
