"""Aiding of the filter: selection among sensors of one kind, plausibility and integrity state of each."""

from collections.abc import Iterator
from dataclasses import replace

from shared.copies import shallow

from ..inertial.filter import ErrorStateFilter
from ..inertial.standstill import Limits, limits_of
from ..integrity.error_monitor import NO_BLOCK, ErrorMonitor, block
from ..integrity.undetected_shift import UndetectedShift
from ..settings import Settings
from .base import Measurement, Outcome
from .gate import Gate
from .gnss.comparison import Comparison
from .gnss.duplicate_epochs import Epochs
from .gnss.fix import GnssPosition, GnssVelocity
from .gnss.lever_arm import LeverArmMonitor
from .magnetometer import CompassCheck, MagneticHeading
from .odometer import WheelSpeed
from .zero_speeds import ZeroSpeeds

ODOMETER_SILENT_NS = 2_000_000_000  # silence of the odometer in use after which another one is used


class Aids:
    """Passes measurements to the filter; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.gate = Gate(settings)
        self.error_monitor = ErrorMonitor()
        self.undetected_shift = UndetectedShift()
        self._odometer: WheelSpeed | None = None  # newest speed of the odometer in use
        self._zeros = ZeroSpeeds()  # of the odometer in use
        self._compass = CompassCheck()
        self._epochs = Epochs()
        self._delays: tuple[float, float] | None = None  # [s] of GNSS, found: for later filters

    def copy(self) -> "Aids":
        """Independent copy."""
        made = shallow(self)
        made.gate = shallow(self.gate)
        return made

    def begin(self, time_ns: int, started: ErrorStateFilter, comparison: Comparison) -> None:
        """Start with a new filter and the comparison that gave its heading."""
        if self._delays is not None:
            started.correct_delay(*self._delays, moved=False)  # it starts at a place that a corrected fix has given
        self.gate.restart(comparison)
        self.error_monitor = self.error_monitor.restarted(time_ns, started)

    def use_delay(self, corrected: tuple[float, float], left_s: float) -> None:
        """Keep the delays of GNSS [s] by which stamps are corrected from now on, and what is left of a position's."""
        self._delays = corrected
        self.error_monitor = replace(self.error_monitor, delay_s=left_s)
        self.gate.lever_arm = LeverArmMonitor()  # what late fixes have shown is of the delay

    def heading_error(self, measurement: Measurement, navigation: ErrorStateFilter) -> tuple[float, float] | None:
        """Turn that corrects the filter's heading where GNSS contradicts it, and its 1 σ [rad]; None if it does not."""
        if isinstance(measurement, GnssPosition | GnssVelocity):
            return self.gate.heading_error(measurement, navigation)
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
        gating = self._settings.gating
        for observe in measurement.observers():
            before = block(navigation) if isinstance(measurement, GnssPosition) else NO_BLOCK
            observation = observe(navigation)
            navigation.propagate_covariance()
            P = navigation.P
            outcome = self.gate.use(navigation, measurement, observation)
            if outcome.used and isinstance(measurement, GnssPosition | GnssVelocity):
                limits = gating.false_alarm_probability, gating.robust_limit
                self.undetected_shift = self.undetected_shift.after(outcome, P, navigation.P, limits)
            estimated = (
                isinstance(measurement, GnssPosition)
                and measurement.time_correlated
                and not navigation.gnss_errors.follows
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

    def test_only(self, navigation: ErrorStateFilter, measurement: Measurement, reason: str) -> Iterator[Outcome]:
        """Compare a measurement of an excluded source with the filter; the state does not change."""
        for observe in measurement.observers():
            yield self.gate.test_only(navigation, measurement, observe(navigation), reason)

    def standstill_limits(self, time_ns: int, navigation: ErrorStateFilter) -> Limits:
        """Limits of the standstill detector; with wheels at zero speed, an uncertain filter needs no longer time."""
        limits, odometer = limits_of(navigation.P), self._zeros
        zero = odometer.speed == 0.0 and odometer.doubt is None and time_ns - odometer.time_ns <= ODOMETER_SILENT_NS
        return limits._replace(pace=1.0, tilted_pace=1.0) if zero else limits

    def _is_redundant(self, seen: WheelSpeed, navigation: ErrorStateFilter) -> bool:
        """Whether another odometer is in use. When the odometer changes, its scale is reset."""
        used = self._odometer
        if used is not None and (used.source, used.of_wheels) != (seen.source, seen.of_wheels):
            better = seen.of_wheels and not used.of_wheels
            if not better and seen.time_ns - used.time_ns <= ODOMETER_SILENT_NS:
                return True
            navigation.reset_odometer_scale()
            self._zeros = ZeroSpeeds()
        self._odometer = seen
        return False
