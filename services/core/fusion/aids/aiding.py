"""Aiding of the filter: selection among sensors of one kind, plausibility and integrity state of each."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from shared.copies import shallow
from shared.messages.navigation import AidingKind

from ..inertial.filter import ErrorStateFilter
from ..inertial.standstill import Limits, limits_of
from ..integrity.error_monitor import NO_BLOCK, ErrorMonitor, block
from ..integrity.undetected_shift import UndetectedShift
from ..settings import Settings
from .base import Measurement, Outcome
from .carrier.aid import AntennaDisplacement, CarrierPath
from .gate import REJECTED, Gate
from .gnss.comparison import Comparison, Corrections
from .gnss.correlated import position_errors_of
from .gnss.duplicate_epochs import Epochs
from .gnss.fix import GnssPosition, GnssVelocity
from .gnss.gate import GnssGate
from .gnss.lever_arm import LeverArmMonitor
from .magnetometer.aid import CompassCheck, MagneticHeading
from .non_holonomic.aid import NonHolonomic
from .odometer.aid import WheelSpeed
from .odometer.selection import PreparedSpeeds, is_in_use, is_other, prepared
from .odometer.zero_speeds import ZeroSpeeds
from .standstill.aid import Standstill
from .updates import (
    AFTER,
    AXES,
    BEYOND_GATE,
    ERRORS,
    EXCLUDED,
    INNOVATION,
    KIND,
    RATIO,
    SDS,
    UNFIT,
    USED,
    VERDICT,
    Standing,
)

# Kind and class of the measurement of each update that a segment makes.
KINDS: tuple[tuple[AidingKind, type], ...] = (
    (AidingKind.ZERO_VELOCITY, Standstill), (AidingKind.ZERO_ANGULAR_RATE, Standstill),
    (AidingKind.NON_HOLONOMIC, NonHolonomic), (AidingKind.ODOMETER, WheelSpeed),
)  # fmt: skip

CARRIED = "carried by carrier phases"  # reason of a velocity that is not used


class Aids:
    """Passes measurements to the filter; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.gate, self.gnss = Gate(settings), GnssGate(settings)
        self.error_monitor = ErrorMonitor()
        self.undetected_shift = UndetectedShift()
        self._odometer: WheelSpeed | None = None  # newest speed of the odometer in use
        self._zeros = ZeroSpeeds()  # of the odometer in use
        self._compass = CompassCheck()
        self._epochs = Epochs()
        self._carrier = CarrierPath()
        self._delays: tuple[float, float] | None = None  # [s] of GNSS, found: for later filters

    def copy(self) -> "Aids":
        """Independent copy."""
        made = shallow(self)
        made.gate, made.gnss = shallow(self.gate), shallow(self.gnss)
        return made

    def begin(self, time_ns: int, started: ErrorStateFilter, comparison: Comparison) -> None:
        """Start with a new filter and the comparison that gave its heading."""
        if self._delays is not None:
            started.correct_delay(*self._delays, moved=False)  # it starts at a place that a corrected fix has given
        self._carrier = CarrierPath()
        self.gate.corrections = Corrections()
        self.gnss.restart(comparison)
        self.error_monitor = self.error_monitor.restarted(time_ns, started)

    def use_delay(self, corrected: tuple[float, float], left_s: float) -> None:
        """Keep the delays of GNSS [s] by which stamps are corrected from now on, and what is left of a position's."""
        self._delays = corrected
        self.error_monitor = replace(self.error_monitor, delay_s=left_s)
        self.gnss.lever_arm = LeverArmMonitor()  # what late fixes have shown is of the delay

    def heading_error(self, measurement: Measurement, navigation: ErrorStateFilter) -> tuple[float, float] | None:
        """Turn that corrects the filter's heading where GNSS contradicts it, and its 1 σ [rad]; None if it does not."""
        if isinstance(measurement, GnssPosition | GnssVelocity):
            return self.gnss.heading_error(self.gate, measurement, navigation)
        return None

    def is_duplicate(self, measurement: Measurement, navigation: ErrorStateFilter | None) -> bool:
        """Whether a measurement repeats an earlier one of its receiver."""
        if not isinstance(measurement, GnssPosition | GnssVelocity):
            return False
        self._epochs, is_duplicate = self._epochs.after(measurement, navigation)
        return is_duplicate

    def use(self, navigation: ErrorStateFilter, measurement: Measurement) -> Iterator[Outcome]:
        """Use a measurement, unless a better sensor measures the same quantity; yields one outcome per observation."""
        if isinstance(measurement, WheelSpeed):
            if self._is_redundant(measurement, navigation):
                return
            self._zeros = self._zeros.after(measurement.time_ns, measurement.speed)
            measurement = replace(measurement, doubt=self._zeros.doubt)
        if isinstance(measurement, MagneticHeading):
            self._compass = self._compass.judged(measurement, navigation)
            measurement = replace(measurement, check=self._compass)
        if isinstance(measurement, GnssVelocity) and self._carrier.carries(measurement):
            yield from self._test_velocity(navigation, measurement)
            return
        if isinstance(measurement, AntennaDisplacement):
            yield from self._use_displacement(navigation, measurement.after(self._carrier))
            return
        yield from self._use(navigation, measurement)

    def _use(self, navigation: ErrorStateFilter, measurement: Measurement) -> Iterator[Outcome]:
        """Use each observation of a measurement, and learn from its outcome."""
        gating = self._settings.gating
        for observe in measurement.observers():
            before = block(navigation) if isinstance(measurement, GnssPosition) else NO_BLOCK
            observation = observe(navigation)
            navigation.propagate_covariance()
            P = navigation.P
            if measurement.inflation:
                outcome = self.gnss.use(self.gate, navigation, measurement, observation)
            else:
                outcome = self.gate.use(navigation, measurement, observation)
            if outcome.used and isinstance(measurement, GnssPosition | GnssVelocity):
                limits = gating.false_alarm_probability, gating.robust_limit
                self.undetected_shift = self.undetected_shift.after(outcome, P, navigation.P, limits)
            estimated = (
                isinstance(measurement, GnssPosition)
                and measurement.time_correlated
                and not position_errors_of(navigation).follows
            )
            self.error_monitor = self.error_monitor.after(
                outcome, before, navigation, gating.false_alarm_probability, estimated=estimated,
                limits_m=self._settings.vehicle.alert_limits_m,
            )  # fmt: skip
            if isinstance(measurement, GnssPosition) and outcome.used:
                self.error_monitor = replace(
                    self.error_monitor, unestimated=measurement.unestimated_variances(navigation)
                )
            yield outcome
            if isinstance(measurement, GnssPosition | GnssVelocity) and outcome.used:
                measurement.update_statistics(navigation, outcome.innovation)

    def _use_displacement(self, navigation: ErrorStateFilter, measurement: AntennaDisplacement) -> Iterator[Outcome]:
        """Use a displacement along its path; levels know what it shows, and what it may have done."""
        used, false_alarm = False, self._settings.gating.false_alarm_probability
        for observe in measurement.observers():
            observation = observe(navigation)
            navigation.propagate_covariance()
            P = navigation.P
            outcome = self.gate.use(navigation, measurement, observation)
            used = outcome.used
            if used:
                self.undetected_shift = self.undetected_shift.after(outcome, P, navigation.P, (false_alarm, 1.0))
            self._monitor(outcome, navigation)
            yield outcome
        self._carrier = measurement.path_after(navigation, used=used)

    def _test_velocity(self, navigation: ErrorStateFilter, measurement: GnssVelocity) -> Iterator[Outcome]:
        """Compare a velocity with the filter that displacements carry: monitors see it, and it changes no state."""
        for outcome in self.test_only(navigation, measurement, CARRIED):
            self._monitor(outcome, navigation)
            yield outcome

    def _monitor(self, outcome: Outcome, navigation: ErrorStateFilter) -> None:
        """Add an outcome that is not of a position to the statistics of innovations."""
        self.error_monitor = self.error_monitor.after(
            outcome, NO_BLOCK, navigation, self._settings.gating.false_alarm_probability, estimated=False,
            limits_m=self._settings.vehicle.alert_limits_m,
        )  # fmt: skip

    def test_only(self, navigation: ErrorStateFilter, measurement: Measurement, reason: str) -> Iterator[Outcome]:
        """Compare a measurement of an excluded source with the filter; the state does not change."""
        for observe in measurement.observers():
            yield self.gate.test_only(navigation, measurement, observe(navigation), reason)

    def standstill_limits(self, time_ns: int, navigation: ErrorStateFilter) -> Limits:
        """Limits of the standstill detector; with wheels at zero speed, an uncertain filter needs no longer time."""
        return limits_of(navigation.P, wheels_stand=time_ns <= self._zeros.stand_until_ns)

    @property
    def standing(self) -> Standing:
        """What speeds have left behind."""
        return Standing(self._zeros.stand_until_ns, self.gate.inflation_ns)

    def speeds(self, measurements: Sequence[Measurement], begin: int, *, excluded: bool) -> "PreparedSpeeds":
        """Prepare the speeds from a place in the list on, up to the next measurement that the engine decides about."""
        return prepared(measurements, begin, self._odometer, self._zeros, excluded=excluded)

    def took(
        self, prepared: "PreparedSpeeds", used: int, standing: Standing, begin_ns: int,
        records: list[list[float]], reason: str | None,
    ) -> list[Outcome]:  # fmt: skip
        """Take over what a segment has done with its updates, of which so many speeds; returns the outcomes.

        `reason` is why speeds were only tested.
        """
        if used:
            self._odometer, self._zeros = prepared.speeds[used - 1][2:4]
        if prepared.speeds and not prepared.speeds[0].excluded:
            self.gate.inflation_ns = standing.inflation_ns
        outcomes, corrections, speeds = (
            [],
            self.gate.corrections,
            (speed for speed in prepared.speeds if not speed.ignored),
        )
        for of in records:
            time_ns = begin_ns + int(of[AFTER])
            kind, measurement = KINDS[int(of[KIND])]
            axes, verdict, source, why = int(of[AXES]), int(of[VERDICT]), "core.fusion", None
            if verdict == USED:
                corrections = corrections.after(time_ns, of[ERRORS:])
            if measurement is WheelSpeed:
                speed = next(speeds)
                source = speed.measurement.source
                why = speed.zeros.doubt if verdict == UNFIT else reason if verdict == EXCLUDED else None
            if verdict == BEYOND_GATE:
                why = REJECTED
            z, sd = tuple(of[INNOVATION : INNOVATION + axes]), tuple(of[SDS : SDS + axes])
            weight = 1.0 if verdict == USED else 0.0
            outcomes.append(Outcome(time_ns, source, kind, z, sd, of[RATIO], verdict == USED, why, weight, measurement))
        self.gate.corrections = corrections
        return outcomes

    def _is_redundant(self, seen: WheelSpeed, navigation: ErrorStateFilter) -> bool:
        """Whether another odometer is in use. When the odometer changes, its scale is reset."""
        used = self._odometer
        if used is not None and is_other(used, seen):
            if is_in_use(used, seen):
                return True
            navigation.reset_block("odometer_scale")
            self._zeros = ZeroSpeeds()
        self._odometer = seen
        return False
