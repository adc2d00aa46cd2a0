"""What the gate does with observations of GNSS beside its test: weights, exclusion, heights, lever arm, heading."""

from math import radians

from shared.messages.navigation import AidingKind

from ...inertial.filter import ErrorStateFilter
from ...settings import Settings
from ..base import Height, Measurement, Observation, Outcome
from ..gate import REJECTED, Gate, Tested
from .antenna import antenna_velocity
from .comparison import Comparison
from .correlated import GNSS_ERROR
from .faults import FaultStatus
from .fix import GnssPosition, GnssVelocity
from .lever_arm import LeverArmMonitor

CORRECTED_HEADING_SD = radians(3.0)  # smallest standard deviation of a corrected heading
LEVER_ARM_LIMIT = 9.0  # largest multiple of the gate up to which innovations are used for the lever arm


class GnssGate:
    """Uses observations of GNSS by the gate of all aids; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.comparison = Comparison()  # of the filter's heading with GNSS
        self.lever_arm = LeverArmMonitor()
        self._height_ns: int | None = None  # since when heights have been rejected
        self._status: dict[tuple[str, AidingKind], FaultStatus] = {}

    def restart(self, comparison: Comparison) -> None:
        """Start with a new filter: no receiver is excluded."""
        self._status, self.lever_arm, self.comparison = {}, LeverArmMonitor(), comparison

    def heading_error(
        self, gate: Gate, measurement: GnssPosition | GnssVelocity, navigation: ErrorStateFilter
    ) -> tuple[float, float] | None:
        """Turn that corrects the filter's heading where GNSS contradicts it, and its 1 σ [rad]; None if it does not."""
        corrections = gate.corrections.at(measurement.time_ns)
        (an, ae, _), (vn, ve, _) = antenna_velocity(navigation, measurement.lever_arm), navigation.velocity
        gate.corrections = corrections._replace(yaw=0.0)
        uncorrected = complex(an + vn, ae + ve) + corrections.velocity
        self.comparison = self.comparison.turned(-corrections.yaw).after(measurement, uncorrected)
        if not self.comparison.is_wrong(measurement.time_ns):
            return None
        turn, sd = self.comparison.result()
        return turn, max(sd, CORRECTED_HEADING_SD)

    def use(
        self, gate: Gate, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation
    ) -> Outcome:
        """Correct the filter by an observation whose NIS is within `gating.robust_limit` times the gate.

        A position beyond it that is within the gate for an unknown time-correlated error resets this error. A position
        of which only the height is beyond it is used without its height.
        """
        tested, limit = gate.test(navigation, observation), self._settings.gating.robust_limit
        if tested.ratio > limit and isinstance(measurement, GnssPosition) and observation.H[:, GNSS_ERROR].any():
            other = navigation.unrecorded()
            other.set_parameters(GNSS_ERROR, 1.0)
            with_other_error = measurement.observe(other)
            if gate.test(other, with_other_error).ratio <= 1.0:
                navigation.set_parameters(GNSS_ERROR, 1.0)
                observation = with_other_error
                tested = gate.test(navigation, observation)
        if tested.ratio > limit and observation.kind is AidingKind.GNSS_POSITION and len(observation.z) == 3:
            horizontal = Observation(observation.kind, observation.z[:2], observation.H[:2], observation.R[:2, :2])
            without_height = gate.test(navigation, horizontal)
            if without_height.ratio <= 1.0:
                remark = f"height beyond the gate by {-float(observation.z[2]):.0f} m: used without it"
                outcome = self._decide(gate, navigation, measurement, horizontal, without_height, remark)
                taken_over = self._reset_height(navigation, observation, measurement.time_ns)
                sd = float(tested.correction.innovation_sd[2])
                return outcome._replace(height=Height(float(observation.z[2]), sd, taken_over))
        outcome = self._decide(gate, navigation, measurement, observation, tested)
        if observation.kind is AidingKind.GNSS_POSITION and len(observation.z) == 3 and outcome.used:
            self._height_ns = None
        return outcome

    def _decide(
        self, gate: Gate, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation,
        tested: Tested, remark: str | None = None,
    ) -> Outcome:  # fmt: skip
        """Use an observation, unless its receiver is excluded; a rejected one inflates the covariance."""
        limit = self._settings.gating.robust_limit
        if tested.ratio < LEVER_ARM_LIMIT:
            self._monitor_lever_arm(navigation, measurement, observation, tested)
        excluded = self._is_excluded(measurement, observation.kind, tested.ratio <= limit)
        rejected = REJECTED if tested.ratio > limit else "not admitted again yet" if excluded else None
        outcome = gate.decide(navigation, measurement, observation, tested, rejected, limit=limit, remark=remark)
        if not outcome.used and tested.ratio > 1.0:
            navigation.inflate(**measurement.inflation)
        return outcome

    def _reset_height(self, navigation: ErrorStateFilter, observation: Observation, time_ns: int) -> bool:
        """Inflate the height variance when heights have been rejected for `gating.reset_after_s`; returns whether."""
        self._height_ns = time_ns if self._height_ns is None else self._height_ns
        if time_ns - self._height_ns < self._settings.gating.reset_after_s * 1e9:
            return False
        self._height_ns = None
        navigation.inflate(height_sd=abs(float(observation.z[2])))
        return True

    def _monitor_lever_arm(
        self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation, tested: Tested
    ) -> None:
        R, S = observation.R, tested.correction.S
        gain = 1.0 - (R.item(0, 0) + R.item(1, 1)) / (S.item(0, 0) + S.item(1, 1))
        position = observation.kind is AidingKind.GNSS_POSITION
        self.lever_arm = self.lever_arm.after(
            measurement.time_ns, navigation, observation.z, S, gain=gain, position=position
        )

    def _is_excluded(self, measurement: Measurement, kind: AidingKind, agrees: bool) -> bool:
        """Update the fault status of GNSS; returns whether it is excluded now."""
        key = measurement.source, kind
        before = self._status.get(key, FaultStatus())
        after = before.after(measurement.time_ns, agrees, self._settings)
        if after is not before:
            self._status = {**self._status, key: after}
        return after.excluded
