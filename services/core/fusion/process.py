"""core.fusion: position, velocity and attitude of the vehicle with covariance and protection levels."""

from collections.abc import Iterator

from shared.chosen import ChosenSource, gnss_choice, imu_choice, receiver_choice, receiver_of, speed_choice
from shared.messages.base import Message, Tick
from shared.messages.explanation import Explanation
from shared.messages.gnss import CarrierDisplacement, FaultFreeFix, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import (
    AidingUpdate,
    ConflictRecord,
    FilterState,
    LastPosition,
    NavigationPhase,
    NavigationSolution,
    NavigationState,
    SetUpState,
)
from shared.messages.operation import ModeCommand, ModeState, OperatorCommand, ProcessLoad, Work
from shared.messages.trust import TrustHypotheses, TrustState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds

from . import messages
from .aids.base import Measurement
from .aids.kinds import measurements_of
from .conflict_record import ConflictRecorder, remembered
from .navigator import Navigator
from .set_up.height_sign import HeightSign
from .set_up.monitor import SetUpMonitor
from .settings import Settings
from .without_imu import SILENCE_TIMEOUT_NS, WithoutImu

STATE_PERIOD_NS = 1_000_000_000
PAUSED_PERIOD_NS = 250_000_000  # shortest period of solutions while Work.SOLUTIONS is paused
In = (
    ModeState
    | ImuSamples
    | GnssFix
    | LastPosition
    | FilterState
    | ConflictRecord
    | VehicleSpeed
    | WheelSpeeds
    | TrustState
    | FaultFreeFix
    | CarrierDisplacement
    | ProcessLoad
    | ModeCommand
    | Tick
)
Exclusion = tuple[int | None, bool, tuple[str, ...]]  # GNSS excluded since, odometer excluded, satellites left out
NO_EXCLUSION: Exclusion = (None, False, ())
Out = NavigationSolution | NavigationState | FilterState | ConflictRecord | AidingUpdate | SetUpState | TrustHypotheses


class Config(Settings):
    """Settings of core.fusion."""


class Process:
    """Passes messages to the navigator, and publishes its solutions, states and outcomes."""

    def __init__(self, config: Config) -> None:
        self._navigator = Navigator(config)
        self._set_up, self._height_sign = SetUpMonitor(config), HeightSign()
        self.rejects, self.record_history = self._navigator.rejects, self._navigator.record_history
        self._solution_period_ns = round(config.solution_period_s * 1e9)
        self._last_solution, self._sampled_ns = -1, 0  # period of the last solution; stamp of the newest sample
        self._published_ns = 0  # stamp of the newest solution
        self._last_state: tuple[NavigationPhase, tuple[Explanation, ...], Exclusion, int] | None = None
        self._saved: FilterState | None = None  # of an earlier process, until the first sample
        self._recorder = ConflictRecorder()
        self._speed = ChosenSource(speed_choice)
        self._receiver, self._fixes = ChosenSource(receiver_choice), ChosenSource(gnss_choice)
        self._imus = ChosenSource(imu_choice, SILENCE_TIMEOUT_NS)
        self._imu: str | None = None  # source in use
        self._without_imu = WithoutImu(config)
        self._begun_ns: int | None = None  # arrival of the first measurement
        self._gnss_excluded = False  # as core.trust has decided
        self._innovations_paused = False
        self._late_s: float | None = None  # of the newest fix

    def handle(self, message: In) -> Iterator[Out]:
        """Handle one message; the clock is that of the inertial samples."""
        match message:
            case ImuSamples():
                yield from self._inertial(message)
            case ModeState():
                for chosen in (self._speed, self._receiver, self._fixes, self._imus):
                    chosen.follow(message)
            case VehicleSpeed() if not self._speed.takes(message.source, message.received_ns):
                self.rejects["speed of a second source"] += 1
            case GnssFix() | FaultFreeFix():
                yield from self._fix(message)
            case LastPosition() | TrustState() | ProcessLoad() | ModeCommand():
                self._follow(message)
            case FilterState() | ConflictRecord():
                self._resume(message)
            case _:
                self._aid(message)

    def _follow(self, message: LastPosition | TrustState | ProcessLoad | ModeCommand) -> None:
        """Follow what other processes know or want."""
        match message:
            case LastPosition():
                self._use_last_position(message)
            case TrustState():
                self._gnss_excluded = message.gnss_excluded
                messages.use_trust_state(self._navigator, message)
            case ProcessLoad():
                self._follow_load(message)
            case ModeCommand(command=OperatorCommand.CONFIRM_POSITION):
                if not self._navigator.confirm_position():
                    self.rejects["confirmation of a position in a conflict"] += 1

    def _resume(self, message: FilterState | ConflictRecord) -> None:
        """Use what an earlier process has saved; after the first sample it is of this process."""
        if self._imu is not None:
            return
        if isinstance(message, FilterState):
            self._saved = message
        else:
            self._recorder.resume(message)
            self._navigator.remember(remembered(message))

    def _conflict_record(self) -> Iterator[ConflictRecord]:
        """Publish what the level holds, for a start after a power cut."""
        if self._navigator.engine.filter is not None:
            yield from self._recorder.update(self._navigator, self._navigator.engine.time_ns)

    def _use_last_position(self, message: LastPosition) -> None:
        """Use the last position of an earlier drive; one that is newer than the first measurement is of this drive."""
        if self._begun_ns is None or message.sampled_ns < self._begun_ns:
            self._navigator.use_prior(messages.prior_from_last_position(message))

    def _follow_load(self, load: ProcessLoad) -> None:
        """Pause work, or resume it, as the lag of this process demands."""
        self._navigator.bank.pause(paused=Work.HYPOTHESES in load.paused)
        paused_ns = PAUSED_PERIOD_NS if Work.SOLUTIONS in load.paused else 0
        self._innovations_paused = Work.INNOVATIONS in load.paused
        period_ns = max(round(self._navigator.settings.solution_period_s * 1e9), paused_ns)
        if period_ns != self._solution_period_ns:
            self._solution_period_ns, self._last_solution = period_ns, -1

    def _inertial(self, batch: ImuSamples) -> Iterator[Out]:
        if not self._imus.takes(batch.source, batch.received_ns):
            self.rejects["samples of a second imu"] += 1
            return
        self._begun_ns = self._begun_ns or batch.received_ns
        if self._saved is not None:
            messages.restore(self._navigator, self._saved, batch)
            self._saved = None
        self._without_imu.interrupted(batch.received_ns, self._navigator.engine.filter)
        self._imu, self._without_imu.heard_ns = batch.source, batch.received_ns
        for sampled_ns, force, rate in messages.samples_of(batch):
            due = self._is_due(sampled_ns)
            self._navigator.advance(sampled_ns, force, rate, batch.received_ns, saturated=batch.saturated)
            if due:  # before late measurements are used, which take longer
                yield from self._solution(sampled_ns)
            outcomes = self._navigator.release(batch.received_ns)
            if not self._innovations_paused:
                yield from map(messages.aiding_message, outcomes)
            if due or sampled_ns // STATE_PERIOD_NS != self._sampled_ns // STATE_PERIOD_NS:
                yield from self._state(sampled_ns)
            if sampled_ns // STATE_PERIOD_NS != self._sampled_ns // STATE_PERIOD_NS:
                yield from self._filter_state(batch.source)
                yield from self._hypotheses()
                yield from self._conflict_record()
            self._sampled_ns = sampled_ns
        self._set_up.samples(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s)
        if self._set_up.is_due(self._sampled_ns):
            self._set_up.evaluate(self._sampled_ns, messages.arm_error(self._navigator))
            self._navigator.correct_delay(*self._set_up.delays)
            self._navigator.leave_out_heights(wrong=self._set_up.heights_wrong)
            self._navigator.use_spread(self._set_up.spread(self._navigator.corrected_delay_s))
            yield messages.set_up_message(self._set_up, self._sampled_ns)
        self._aid(batch)

    def _fix(self, fix: GnssFix | FaultFreeFix) -> Iterator[Out]:
        """Use a fix in the filter, or publish it where inertial samples are missing."""
        without, received_ns = self._without_imu, fix.received_ns
        if not self._is_chosen(fix):
            self.rejects["fix of a second receiver"] += 1
            return
        if without.is_far_ahead(received_ns):
            self.rejects["fix from the future"] += 1
            return
        self._begun_ns = self._begun_ns or received_ns
        if isinstance(fix, GnssFix):
            self._height_sign.see(fix)
            self._late_s = fix.late_s
        measurements = self._aid(fix, keep=not without.is_abandoned(received_ns))
        if not measurements:
            self.rejects["fix without position"] += 1
        found = without.solve(measurements, received_ns, self._navigator.engine.filter)
        if found is not None and not self._gnss_excluded and found.time_ns > self._published_ns:
            self._published_ns = found.time_ns
            yield messages.solution_message(found)
        yield from self._silence(received_ns)

    def _is_chosen(self, fix: GnssFix | FaultFreeFix) -> bool:
        """Whether a fix is of the source in use; one without a position does not take another one's place."""
        if isinstance(fix, FaultFreeFix):
            return self._receiver.takes(receiver_of(fix.source), fix.received_ns)
        return fix.latitude_deg is None or self._fixes.takes(fix.source, fix.received_ns)

    def _aid(self, message: Message, *, keep: bool = True) -> list[Measurement]:
        """Use what a message measures, in the checks of the set-up and, to `keep` it, in the navigator."""
        measurements = measurements_of(message, self._navigator.settings)
        for measurement in measurements:
            self._set_up.see(measurement)
            if keep:
                self._navigator.measure(measurement)
        return measurements

    def finish(self) -> Iterator[AidingUpdate]:
        """Use everything up to the newest sample, at the end of a recording; yields the last outcomes."""
        yield from map(messages.aiding_message, self._navigator.finish())

    def _is_due(self, sampled_ns: int) -> bool:
        """Whether a sample is the first of a solution period."""
        return sampled_ns // self._solution_period_ns != self._last_solution

    def _silence(self, received_ns: int) -> Iterator[NavigationState]:
        """Publish that inertial samples are missing, when a fix arrives long after the last sample."""
        without = self._without_imu
        if not without.is_silent(received_ns) and without.missing is None:
            return
        phase = NavigationPhase.WAITING_FOR_IMU if without.missing is None else NavigationPhase.GNSS_ONLY
        current = (phase, (), NO_EXCLUSION, received_ns // STATE_PERIOD_NS)
        if current != self._last_state:
            self._last_state = current
            yield self._state_message(received_ns, silent=True)

    def _state(self, sampled_ns: int) -> Iterator[NavigationState]:
        """Publish the state when it changes, and every second."""
        if self._without_imu.missing is not None:  # said with each fix, until the filter has a solution
            return
        navigator, exclusions = self._navigator, self._navigator.engine.exclusions
        exclusion = exclusions.gnss_since_ns, exclusions.odometer, exclusions.satellites
        current = (navigator.phase, navigator.why, exclusion, sampled_ns // STATE_PERIOD_NS)
        if current != self._last_state:
            self._last_state = current
            yield self._state_message(sampled_ns)

    def _state_message(self, time_ns: int, *, silent: bool = False) -> NavigationState:
        state = messages.state_message(
            self._navigator, time_ns, delay_known=self._set_up.delay_known, fixes_late_s=self._late_s
        )
        without = self._without_imu
        if without.missing is not None:
            return messages.without_imu(state, without.missing, excluded=self._gnss_excluded)
        if silent:
            return messages.waiting_for_imu(state, without.heard_ns or time_ns)
        return state

    def _filter_state(self, imu: str) -> Iterator[FilterState]:
        """Publish the state for a later process, while a filter runs."""
        if (saved := self._navigator.saved_state()) is not None:
            yield messages.filter_state_message(saved, self._navigator.settings, imu)

    def _hypotheses(self) -> Iterator[TrustHypotheses]:
        """Publish where the vehicle is under each hypothesis, while a filter runs."""
        if self._navigator.engine.filter is not None:
            yield messages.hypotheses_message(self._navigator)

    def _solution(self, sampled_ns: int) -> Iterator[NavigationSolution]:
        """Publish the solution."""
        solution = self._navigator.solution()
        if solution is not None and solution.time_ns == sampled_ns:  # otherwise the sample was rejected
            self._last_solution = sampled_ns // self._solution_period_ns
            self._without_imu.end()
            self._published_ns = sampled_ns
            solution = self._height_sign.widened(solution, known=self._set_up.height_known)
            yield messages.solution_message(solution, self._set_up.turn)
