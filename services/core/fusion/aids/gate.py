"""Gating by the normalised innovation squared (NIS), and down-weighting."""

from math import radians

from shared.maths.kalman import Correction
from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import AidingKind

from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..settings import Settings
from .base import Height, Measurement, Observation, Outcome
from .gnss.antenna import antenna_velocity
from .gnss.comparison import Comparison, Corrections
from .gnss.correlated import GNSS_ERROR
from .gnss.faults import FaultStatus
from .gnss.fix import GnssPosition, GnssVelocity
from .gnss.lever_arm import FloatArray, LeverArmMonitor
from .odometer.inflation import INFLATION_M_S_SQRT_S, inflation_after
from .odometer.zero_speeds import NO_TIME_NS

CORRECTED_HEADING_SD = radians(3.0)  # smallest standard deviation of a corrected heading
LEVER_ARM_LIMIT = 9.0  # largest multiple of the gate up to which innovations are used for the lever arm
REJECTED = "beyond the gate"  # reason of an observation that is not used


class Gate:
    """Tests observations and corrects the filter by them; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.corrections = Corrections()
        self.comparison = Comparison()  # of the filter's heading with GNSS
        self.lever_arm = LeverArmMonitor()
        self._height_ns: int | None = None  # since when heights have been rejected
        self.inflation_ns = NO_TIME_NS  # next inflation while wheel speeds are rejected
        self._status: dict[tuple[str, AidingKind], FaultStatus] = {}

    def restart(self, comparison: Comparison) -> None:
        """Start with a new filter: no receiver is excluded."""
        self._status, self.corrections, self.lever_arm = {}, Corrections(), LeverArmMonitor()
        self.comparison = comparison

    def heading_error(
        self, measurement: GnssPosition | GnssVelocity, navigation: ErrorStateFilter
    ) -> tuple[float, float] | None:
        """Turn that corrects the filter's heading where GNSS contradicts it, and its 1 σ [rad]; None if it does not."""
        corrections = self.corrections.at(measurement.time_ns)
        (an, ae, _), (vn, ve, _) = antenna_velocity(navigation, measurement.lever_arm), navigation.velocity
        self.corrections = corrections._replace(yaw=0.0)
        uncorrected = complex(an + vn, ae + ve) + corrections.velocity
        self.comparison = self.comparison.turned(-corrections.yaw).after(measurement, uncorrected)
        if not self.comparison.is_wrong(measurement.time_ns):
            return None
        turn, sd = self.comparison.result()
        return turn, max(sd, CORRECTED_HEADING_SD)

    def use(self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation) -> Outcome:
        """Correct the filter by an observation whose NIS is within the gate, or up to `gating.robust_limit` times it.

        A position beyond the gate that is within it for an unknown time-correlated error resets this error. A position
        of which only the height is beyond the gate is used without its height.
        """
        correction, ratio = self._test(navigation, observation)
        limit = self._settings.gating.robust_limit if measurement.inflation else 1.0
        if ratio > limit and isinstance(measurement, GnssPosition) and observation.H[:, GNSS_ERROR].any():
            other = navigation.unrecorded()
            other.set_parameters(GNSS_ERROR, 1.0)
            with_other_error = measurement.observe(other)
            if self._test(other, with_other_error)[1] <= 1.0:
                navigation.set_parameters(GNSS_ERROR, 1.0)
                observation = with_other_error
                correction, ratio = self._test(navigation, observation)
        if ratio > limit and observation.kind is AidingKind.GNSS_POSITION and len(observation.z) == 3:
            horizontal = Observation(observation.kind, observation.z[:2], observation.H[:2], observation.R[:2, :2])
            tested = self._test(navigation, horizontal)
            if tested[1] <= 1.0:
                remark = f"height beyond the gate by {-float(observation.z[2]):.0f} m: used without it"
                outcome = self._decide(navigation, measurement, horizontal, *tested, remark)
                taken_over = self._reset_height(navigation, observation, measurement.time_ns)
                height = Height(float(observation.z[2]), float(correction.innovation_sd[2]), taken_over)
                return outcome._replace(height=height)
        return self._decide(navigation, measurement, observation, correction, ratio, None)

    def test_only(
        self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation, reason: str
    ) -> Outcome:
        """Test an observation that is not used for a reason; the state does not change."""
        correction, ratio = self._test(navigation, observation)
        return _outcome(measurement, observation, correction, ratio, reason, 0.0)

    def _test(self, navigation: ErrorStateFilter, observation: Observation) -> tuple[Correction, float]:
        correction = navigation.innovate(observation.z, observation.H, observation.R)
        limit = chi_square_limit(len(observation.z), self._settings.gating.false_alarm_probability)
        return correction, float(correction.distance2) / limit

    def _reset_height(self, navigation: ErrorStateFilter, observation: Observation, time_ns: int) -> bool:
        """Inflate the height variance when heights have been rejected for `gating.reset_after_s`; returns whether."""
        self._height_ns = time_ns if self._height_ns is None else self._height_ns
        if time_ns - self._height_ns < self._settings.gating.reset_after_s * 1e9:
            return False
        self._height_ns = None
        navigation.inflate(height_sd=abs(float(observation.z[2])))
        return True

    def _inflate_speed(
        self, navigation: ErrorStateFilter, observation: Observation, time_ns: int, rejected: bool
    ) -> None:
        """Inflate the velocity along the vehicle once a second while wheel speeds are rejected for long."""
        self.inflation_ns, due = inflation_after(time_ns, self.inflation_ns, rejected)
        if due:
            navigation.inflate_along(em.VELOCITY, INFLATION_M_S_SQRT_S * observation.H[0, em.VELOCITY])

    def _decide(
        self,
        navigation: ErrorStateFilter,
        measurement: Measurement,
        observation: Observation,
        correction: Correction,
        ratio: float,
        remark: str | None,
    ) -> Outcome:
        gnss = bool(measurement.inflation)
        if gnss and ratio < LEVER_ARM_LIMIT:
            self._monitor_lever_arm(navigation, measurement, observation, correction.S)
        limit = self._settings.gating.robust_limit if gnss else 1.0
        excluded = gnss and self._is_excluded(measurement, observation.kind, ratio <= limit)
        rejected = REJECTED if ratio > limit else "not admitted again yet" if excluded else None
        reason = observation.unfit or rejected
        weight = 0.0 if reason else _weight(ratio, limit)
        if not reason:
            weighted = (
                correction
                if weight == 1.0
                else navigation.innovate(observation.z, observation.H, observation.R / weight)
            )
            navigation.apply(weighted)
            self.corrections = self.corrections.after(measurement.time_ns, weighted.x[em.LEVEL].tolist())
        if gnss and reason and ratio > 1.0:
            navigation.inflate(**measurement.inflation)
        if observation.kind is AidingKind.ODOMETER:
            self._inflate_speed(
                navigation, observation, measurement.time_ns, reason is not None and observation.unfit is None
            )
        if observation.kind is AidingKind.GNSS_POSITION and len(observation.z) == 3 and not reason:
            self._height_ns = None
        return _outcome(measurement, observation, correction, ratio, reason or remark, weight)

    def _monitor_lever_arm(
        self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation, S: FloatArray
    ) -> None:
        gain = 1.0 - (observation.R.item(0, 0) + observation.R.item(1, 1)) / (S.item(0, 0) + S.item(1, 1))
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


def _outcome(
    measurement: Measurement,
    observation: Observation,
    correction: Correction,
    ratio: float,
    reason: str | None,
    weight: float,
) -> Outcome:
    """Outcome of an observation, which was used if its weight is not zero."""
    z, sd = tuple(observation.z.tolist()), tuple(correction.innovation_sd.tolist())
    return Outcome(
        measurement.time_ns,
        measurement.source,
        observation.kind,
        z,
        sd,
        ratio,
        weight > 0.0,
        reason,
        weight,
        type(measurement),
    )


def _weight(ratio: float, limit: float) -> float:
    """Full weight within the gate, none at the limit, and Tukey's biweight between them."""
    return 1.0 if ratio <= 1.0 else max(1e-3, ((limit - ratio) / (limit - 1.0)) ** 2)
