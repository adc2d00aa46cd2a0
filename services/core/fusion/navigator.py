"""The navigator: solutions from inertial samples and measurements, without bus and messages.

vehicle = Vehicle(gnss=GnssAntenna(lever_arm_body_m=(0.3, 0.0, -1.2)))
navigator = Navigator(Settings(vehicle=vehicle))
navigator.fix(t_ns, position=Geodetic(...), velocity=(...))
navigator.imu(t_ns, force, rate)
solution = navigator.solution()
"""

from collections import Counter
from collections.abc import Collection, Sequence
from math import isfinite

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector
from shared.messages.explanation import Explanation, explain
from shared.messages.navigation import NavigationPhase
from shared.messages.trust import Hypothesis

from .aids.base import Counts, Measurement, Outcome
from .aids.devices import Devices
from .aids.gnss.fix import Reading, Stamp, gnss_measurements
from .aids.odometer.aid import WheelSpeed
from .codes import Code
from .hypotheses.bank import Bank
from .hypotheses.motion_model import State
from .inertial.imu_clock import FUTURE_LIMIT_NS, Clock
from .inertial.imu_faults import Repeats, Sample, credible
from .integrity.over_a_cut import RememberedConflict
from .integrity.set_up_spread import SetUpSpread
from .settings import Settings
from .smoothing.history import HistoryRecorder
from .solution import Solution, UncertaintyCache, solution_of, upper
from .start.heading import Prior
from .start.warm_start import SavedState, fault, saved_state
from .timeline.conflict import MAX_LIMITS, Verdicts
from .timeline.engine import Engine
from .timeline.events import GnssDelay, LostTime, ReturnAfterInterference
from .timeline.timeline import Timeline

FloatArray = npt.NDArray[np.float64]

NEW_DELAY_S = 0.05  # change of a suspected delay that matters


class Navigator:
    """Loosely coupled INS/GNSS whose result depends on stamps alone, and not on the order of arrival.

    The filter runs behind the newest sample, at the horizon of the `timeline`, where all measurements have arrived; the
    solution is that filter, carried to the newest sample by the inertial sensors.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.rejects: Counter[str] = Counter()
        self.samples_used = 0
        self.samples_rejected = 0
        self._timeline = Timeline(self.settings, self.rejects)
        self.bank = Bank(self.settings, self._timeline)
        self._uncertainty = UncertaintyCache(self.settings)
        self._clock: Clock | None = None  # while samples are rejected for their stamps
        self._repeats: Repeats | None = None
        self._surviving: frozenset[Hypothesis] = frozenset()  # the level reaches to their solutions
        self._imu_excluded = False  # as core.trust has decided
        self._found = 0.0, 0.0  # [s] delays of GNSS positions and velocities
        self._devices = Devices(self.rejects, self._now_ns)

    def imu(
        self,
        time_ns: int,
        force: Sequence[float],
        rate: Sequence[float],
        received_ns: int | None = None,
    ) -> list[Outcome]:
        """Use one inertial sample, and the measurements that are due: `advance` and `release` in one.

        Parameters
        ----------
        time_ns : int
            End of the sampling interval.
        force : sequence of three floats
            [m/s², body] Mean specific force over the interval, as measured.
        rate : sequence of three floats
            [rad/s, body] Mean angular rate over the interval, as measured.
        received_ns : int, optional
            When it arrived at the driver; `time_ns` if not given.

        Returns
        -------
        list of Outcome
            Outcomes of the measurements since the last call.
        """
        self.advance(time_ns, force, rate, received_ns)
        return self.release(time_ns if received_ns is None else received_ns)

    def advance(
        self,
        time_ns: int,
        force: Sequence[float],
        rate: Sequence[float],
        received_ns: int | None = None,
        *,
        saturated: bool = False,
    ) -> None:
        """Use one inertial sample, `saturated` if the sensor says so; call `release` before the next one."""
        fx, fy, fz = force
        wx, wy, wz = rate
        sample = Sample(time_ns, (fx, fy, fz), (wx, wy, wz))
        if reason := self._unusable(sample, received_ns):
            self.samples_rejected += 1
            self.rejects[reason] += 1
            return
        if self._clock:
            self._end_clock_fault(time_ns, self._clock.lost_s)
        readings = fx, fy, fz, wx, wy, wz
        self._repeats = self._repeats or Repeats(time_ns, readings)
        repeat_fault = self._repeats.fault(time_ns, readings)
        if fault := "gyroscope saturated" if saturated else repeat_fault:
            self.rejects[fault] += 1
            sample = sample._replace(fault=fault)
        self.samples_used += 1
        self._timeline.add(sample)

    def measure(self, measurement: Measurement) -> None:
        """Add a measurement of any kind, which is used at its stamp."""
        if measurement.time_ns > measurement.received_ns + FUTURE_LIMIT_NS:
            self.rejects["measurement from the future"] += 1
            return
        if violation := measurement.implausible():
            self.rejects[violation] += 1
        elif self._is_due(measurement):
            self._timeline.measure(measurement)

    def _is_due(self, measurement: Measurement) -> bool:
        """Whether a measurement is of an accepted device, and the first of its period."""
        source, time_ns, period_ns = measurement.source, measurement.time_ns, measurement.period_ns
        if not period_ns:
            return self._devices.is_known(source)
        return self._devices.is_due(source, measurement.quantity, time_ns, period_ns)

    def fix(
        self,
        time_ns: int,
        *,
        position: Geodetic,
        velocity: Vector | None = None,
        position_sd: Vector | None = None,
        velocity_sd: Vector | None = None,
        received_ns: int | None = None,
        source: str = "gnss",
    ) -> None:
        """Add position [rad, rad, m] and velocity [m/s, NED] of the antenna, with standard deviations [m, m/s]."""
        stamp = Stamp(time_ns, time_ns if received_ns is None else received_ns, source)
        reading = Reading((0.0, 0.0, 0.0), _diagonal(position_sd))
        moving = None if velocity is None else Reading(velocity, _diagonal(velocity_sd))
        for measurement in gnss_measurements(self.settings, stamp, position, reading, moving):
            self.measure(measurement)

    def speed(
        self,
        time_ns: int,
        speed: float,
        *,
        resolution: float = 0.0,
        of_wheels: bool = True,
        exact: bool = True,
        received_ns: int | None = None,
        source: str = "wheels",
    ) -> None:
        """Add a speed [m/s] of the vehicle with its resolution [m/s]; at most ten per second and device are used.

        It is `exact` if it is the mean of both rear wheels.
        """
        if self.settings.odometer.enabled:
            arrival_ns = time_ns if received_ns is None else received_ns
            self.measure(WheelSpeed(time_ns, arrival_ns, source, speed, resolution, of_wheels, exact, self.settings))

    def record_history(self, recorder: HistoryRecorder) -> None:
        """Record a history for the smoother, from the first sample on."""
        self._timeline.record_history(recorder)

    def use_prior(self, prior: Prior) -> None:
        """Use a position and heading saved before the unit was switched off."""
        self._timeline.use_prior(prior)

    def remember(self, conflict: RememberedConflict) -> None:
        """Hold with the first filter what an earlier process held."""
        self._timeline.remember(conflict)

    def restore(self, saved: SavedState, time_ns: int) -> None:
        """Restore the state of an earlier process, if it is valid at the stamp of the first sample."""
        if reason := fault(saved, self.settings, time_ns):
            self.rejects[reason] += 1
        else:
            self._timeline.restore(saved)

    def saved_state(self) -> SavedState | None:
        """State for a later process; None while no filter runs."""
        engine = self._timeline.now
        if engine.filter is None or engine.last is None:
            return None
        return saved_state(engine.filter, engine.last, engine.accepted_ns, engine.exclusions.gnss_since_ns,
                           self.verdicts.held)  # fmt: skip

    def apply_exclusions(
        self, gnss_suspect_since_ns: int | None, *, odometer_excluded: bool, exclude: bool = True
    ) -> None:
        """Follow core.trust: a conflict of GNSS since a suspect time (None: none), and who is excluded for it.

        With `exclude` the solution without GNSS is published, as far as it is good; otherwise it only adds its distance
        to the level.
        """
        self.verdicts.follow(gnss_suspect_since_ns, exclude=exclude, odometer_excluded=odometer_excluded)

    def believe(
        self, surviving: Collection[Hypothesis], suspect_since_ns: int | None, *, imu_excluded: bool = False,
        of_gnss: float = 1.0,
    ) -> None:  # fmt: skip
        """Follow core.trust: hypotheses that survive, since when a source is suspect, and whether the IMU is not used.

        The level reaches to the solutions of hypotheses that survive. While the IMU is excluded the solution of the
        model of motion is published, as far as it is good. `of_gnss` is the probability that GNSS is wrong: the weight
        of an offset that the level holds.
        """
        self.verdicts.weight = of_gnss
        self._surviving, self._imu_excluded = frozenset(surviving), imu_excluded
        self.bank.suspect(suspect_since_ns)

    def disturbed_since(self, since_ns: int | None) -> None:
        """Follow core.trust: GNSS was lost with interference after this time, and its return is not confirmed yet."""
        loss = self.verdicts.main.engine.aids.error_monitor.loss
        if since_ns is not None and loss.returned_ns is not None and loss.returned_ns > since_ns:
            self._timeline.happen(ReturnAfterInterference(self._timeline.next_ns))

    @property
    def what_ends_the_held(self) -> tuple[Explanation, ...]:
        """What would end the offset that the level holds; empty without one."""
        engine, place = self.engine, self.verdicts.place
        if place is None or engine.filter is None:
            return engine.aids.error_monitor.held.ends(None)
        return engine.aids.error_monitor.held.ends(place.distance_m(engine.filter.published_position))

    def confirm_position(self) -> bool:
        """Hold no offset any more, because the operator has confirmed the position; returns whether it could be."""
        return self.verdicts.confirm()

    @property
    def verdicts(self) -> Verdicts:
        """The published solution, and the other one while there is a conflict."""
        return self._timeline.verdicts

    def correct_delay(self, position_s: float, velocity_s: float) -> None:
        """Correct delays [s] of GNSS positions and velocities that no setting corrects, from now on; 0 ends it."""
        old_s, old_velocity_s = self._found
        if max(abs(position_s - old_s), abs(velocity_s - old_velocity_s)) < NEW_DELAY_S:
            return
        self._found = position_s, velocity_s
        grown_s = max(0.0, abs(velocity_s) - abs(old_velocity_s))
        self._timeline.correct_delay(GnssDelay(self._timeline.next_ns, position_s, velocity_s, grown_s))

    def leave_out_heights(self, *, wrong: bool) -> None:
        """Use positions of GNSS without their heights from now on, because these have the wrong sign, or with them."""
        self._timeline.leave_out_heights(wrong=wrong)

    @property
    def merge_lag_s(self) -> float:
        """Time by which the filter waits for late measurements [s]."""
        return self._timeline.horizon.lag_ns * 1e-9

    @property
    def found_delays(self) -> tuple[float, float]:
        """Delays of positions and of velocities [s] that have been found beyond the settings; 0 where there is none."""
        return self._found

    @property
    def corrected_delay_s(self) -> float | None:
        """Delay of positions [s] that has been found and is corrected; None if there is none."""
        position_s, velocity_s = self._found
        return position_s if velocity_s else None

    def use_spread(self, spread: SetUpSpread) -> None:
        """Hold what lever arm and delay may be off by in the protection levels, by what the checks have found."""
        self._uncertainty.spread = spread

    @property
    def engine(self) -> Engine:
        """Alignment or filter at the horizon."""
        return self._timeline.engine

    @property
    def now(self) -> Engine:
        """Alignment or filter at the newest sample, which is that of the horizon, carried on; not to be changed."""
        return self._timeline.now

    @property
    def phase(self) -> NavigationPhase:
        """Phase of the solution."""
        return self._timeline.now.phase

    @property
    def since_ns(self) -> int:
        """When the phase began."""
        return self._timeline.now.since_ns

    @property
    def why(self) -> tuple[Explanation, ...]:
        """Why the phase began, and why the solution before it ended."""
        return self._timeline.now.why

    @property
    def counts(self) -> Counts:
        """Counts of used and rejected positions, gaps and resets."""
        return self.engine.counts

    @property
    def measurements_late(self) -> int:
        """Number of measurements that came behind the horizon."""
        return self._timeline.measurements_late

    @property
    def lever_arm_error(self) -> tuple[float, float] | None:
        """True minus assumed lever arm, forward and right [m], if the difference is significant."""
        return self.engine.aids.gnss.lever_arm.significant_error()

    def solution(self) -> Solution | None:
        """State at the newest inertial sample, or None while there is no valid one."""
        solution = solution_of(self._timeline.now, self._uncertainty)
        if solution is None:
            return None
        if self._imu_excluded and (found := self._without_imu(solution)) is not None:
            return found
        # While GNSS is excluded its own solution is none of those that may be true, unless other hypotheses survive.
        alone = self.verdicts.conflict is not None and self.verdicts.conflict.published
        alone = alone and self._surviving == {Hypothesis.GNSS}
        difference = None if alone else self.verdicts.difference()
        solution = solution if difference is None else solution.reaching(*difference)
        reached = self._surviving if self.verdicts.conflict is None else self._surviving - {Hypothesis.GNSS}
        for hypothesis in reached - {Hypothesis.SATELLITES}:  # a fix without the satellite takes its place
            other = self.bank.alternative(hypothesis)
            solution = solution if other is None else solution.reaching(other.apart_n, other.levels)
        return solution

    @property
    def imu_excluded(self) -> bool:
        """Whether the published solution is that of the model of motion."""
        return self._imu_excluded and self._motion() is not None

    def _motion(self) -> State | None:
        """State of the model of motion at the newest sample, if its levels are of use."""
        state = self.bank.motion.state(self._timeline.newest_ns)
        limits_m = self.settings.vehicle.alert_limits_m
        if state is None or self.bank.levels(state.position_cov)[0] > MAX_LIMITS * limits_m[0]:
            return None
        return state

    def _without_imu(self, solution: Solution) -> Solution | None:
        """Solution of the model of motion, with roll and pitch of the inertial sensors; None without one."""
        state = self._motion()
        if state is None:
            return None
        horizontal, vertical = self.bank.levels(state.position_cov)
        attitude_cov = solution.attitude_cov.copy()
        attitude_cov[2, :2] = attitude_cov[:2, 2] = 0.0
        attitude_cov[2, 2] = state.heading_variance
        covariances = state.position_cov, state.velocity_cov, attitude_cov
        position, velocity, attitude = (upper(covariance.tolist()) for covariance in covariances)
        return solution._replace(
            position=state.position,
            velocity=state.velocity,
            yaw=state.heading,
            position_cov=state.position_cov,
            velocity_cov=state.velocity_cov,
            attitude_cov=attitude_cov,
            protection_level_horizontal=horizontal,
            protection_level_vertical=vertical,
            triangles=(position, velocity, attitude),
        )

    def release(self, received_ns: int) -> list[Outcome]:
        """Move the horizon, all being known that was received by a time; returns the outcomes since the last call."""
        outcomes = self._timeline.advance(received_ns)
        self.bank.advance()
        return outcomes

    def finish(self) -> list[Outcome]:
        """Use everything that has arrived up to the newest sample, at the end of a log; returns the outcomes."""
        return self._timeline.finish()

    def _now_ns(self) -> int:
        return self._timeline.newest_ns

    def _unusable(self, sample: Sample, received_ns: int | None) -> str | None:
        """Reason for which a sample cannot be used; None if it can."""
        time_ns, force, rate, _ = sample
        if not credible(force, rate):
            return "implausible sample" if isfinite(sum(force) + sum(rate)) else "sample not finite"
        last = self._timeline.log.newest
        if last is not None and not 0 < time_ns - last.time_ns <= FUTURE_LIMIT_NS:
            return self._stamp_fault(sample, last.time_ns, received_ns)
        return None

    def _stamp_fault(self, sample: Sample, newest_ns: int, received_ns: int | None) -> str | None:
        """Reason for which a stamp is invalid, or None; restarts the filter if the clock went back."""
        clock = self._clock or Clock()
        if sample.time_ns > newest_ns:
            if not clock.is_ahead(sample.time_ns, newest_ns, received_ns):
                return None
            self._clock = clock
            return "sample from the future"
        self._clock = clock
        if clock.goes_back(sample.time_ns, known=self._timeline.is_known(sample)):
            self._timeline.restart(explain(Code.CLOCK_BACK))
            self._clock, self._repeats, self._found = None, None, (0.0, 0.0)
        return "sample doubled or out of order"

    def _end_clock_fault(self, time_ns: int, lost_s: float) -> None:
        """Continue after samples that were rejected for their stamps, and inflate the covariance for their time."""
        self._clock = None
        if lost_s:
            self.rejects["time lost as the inertial clock went back"] += 1
            self._timeline.happen(LostTime(time_ns, lost_s))


def _diagonal(sd: Vector | None) -> FloatArray | None:
    return None if sd is None else np.diag(np.square(sd))
