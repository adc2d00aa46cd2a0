"""Gating by the normalised innovation squared (NIS), and down-weighting."""

from typing import NamedTuple

from shared.maths.kalman import Correction
from shared.maths.quantiles import chi_square_limit
from shared.messages.navigation import AidingKind

from ..inertial import error_model as em
from ..inertial.filter import ErrorStateFilter
from ..settings import Settings
from .base import Measurement, Observation, Outcome
from .gnss.comparison import Corrections
from .odometer.inflation import INFLATION_M_S_SQRT_S, inflation_after
from .odometer.zero_speeds import NO_TIME_NS

REJECTED = "beyond the gate"  # reason of an observation that is not used


class Tested(NamedTuple):
    """Correction that an observation would make, and its NIS over the limit of the gate."""

    correction: Correction
    ratio: float


class Gate:
    """Tests observations and corrects the filter by them; its state is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.corrections = Corrections()
        self.inflation_ns = NO_TIME_NS  # next inflation while wheel speeds are rejected

    def use(self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation) -> Outcome:
        """Correct the filter by an observation whose NIS is within the gate."""
        tested = self.test(navigation, observation)
        rejected = REJECTED if tested.ratio > 1.0 else None
        outcome = self.decide(navigation, measurement, observation, tested, rejected)
        if observation.kind is AidingKind.ODOMETER:
            unfit = observation.unfit is not None
            self._inflate_speed(navigation, observation, measurement.time_ns, rejected is not None and not unfit)
        return outcome

    def test_only(
        self, navigation: ErrorStateFilter, measurement: Measurement, observation: Observation, reason: str
    ) -> Outcome:
        """Test an observation that is not used for a reason; the state does not change."""
        return _outcome(measurement, observation, self.test(navigation, observation), reason, 0.0)

    def test(self, navigation: ErrorStateFilter, observation: Observation) -> Tested:
        """Test an observation; the state does not change."""
        correction = navigation.innovate(observation.z, observation.H, observation.R)
        limit = chi_square_limit(len(observation.z), self._settings.gating.false_alarm_probability)
        return Tested(correction, float(correction.distance2) / limit)

    def decide(
        self,
        navigation: ErrorStateFilter,
        measurement: Measurement,
        observation: Observation,
        tested: Tested,
        rejected: str | None,
        *,
        limit: float = 1.0,
        remark: str | None = None,
    ) -> Outcome:
        """Correct the filter, unless the observation is rejected for a reason, or unfit.

        Beyond the gate, up to `limit` times it, the observation has less weight. `remark` is said of a used one.
        """
        reason = observation.unfit or rejected
        weight = 0.0 if reason else _weight(tested.ratio, limit)
        if not reason:
            weighted = (
                tested.correction
                if weight == 1.0
                else navigation.innovate(observation.z, observation.H, observation.R / weight)
            )
            navigation.apply(weighted)
            self.corrections = self.corrections.after(measurement.time_ns, weighted.x[em.LEVEL].tolist())
        return _outcome(measurement, observation, tested, reason or remark, weight)

    def _inflate_speed(
        self, navigation: ErrorStateFilter, observation: Observation, time_ns: int, rejected: bool
    ) -> None:
        """Inflate the velocity along the vehicle once a second while wheel speeds are rejected for long."""
        self.inflation_ns, due = inflation_after(time_ns, self.inflation_ns, rejected)
        if due:
            navigation.inflate_along(em.VELOCITY, INFLATION_M_S_SQRT_S * observation.H[0, em.VELOCITY])


def _outcome(
    measurement: Measurement, observation: Observation, tested: Tested, reason: str | None, weight: float
) -> Outcome:
    """Outcome of an observation, which was used if its weight is not zero."""
    z, sd = tuple(observation.z.tolist()), tuple(tested.correction.innovation_sd.tolist())
    return Outcome(
        measurement.time_ns,
        measurement.source,
        observation.kind,
        z,
        sd,
        tested.ratio,
        weight > 0.0,
        reason,
        weight,
        type(measurement),
    )


def _weight(ratio: float, limit: float) -> float:
    """Full weight within the gate, none at the limit, and Tukey's biweight between them."""
    return 1.0 if ratio <= 1.0 else max(1e-3, ((limit - ratio) / (limit - 1.0)) ** 2)
