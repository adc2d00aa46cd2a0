"""Which observations the filter is given, with what weight, and how a device that was wrong earns its way back."""

from shared.messages import AidingKind

from .aiding import Measurement, Observation, Outcome
from .filter import ErrorStateFilter
from .kalman import chi_square_limit
from .matching import Corrections
from .settings import Settings

# A refused GNSS measurement admits that the filter may be too sure of itself [m, m/s].
WIDENING = {
    AidingKind.GNSS_POSITION: {"position_sd": 0.1, "velocity_sd": 0.1},
    AidingKind.GNSS_VELOCITY: {"position_sd": 0.0, "velocity_sd": 0.1},
}


class Judge:
    """Holds observations against the filter; what it knows is replaced and never changed in place."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.corrections = Corrections()

    def fork(self) -> "Judge":
        """Copy that goes its own way."""
        twin = Judge.__new__(Judge)
        twin.__dict__.update(self.__dict__)
        return twin

    def judge(self, navigation: ErrorStateFilter, measurement: Measurement, seen: Observation) -> Outcome:
        """Use an observation if its d² is within the limit of d²."""
        correction = navigation.weigh(seen.z, seen.H, seen.R)
        ratio = correction.distance2 / chi_square_limit(len(seen.z), self._settings.gate_false_alarm)
        used = ratio <= 1.0
        if used:
            navigation.accept(correction)
            self.corrections = self.corrections.after(measurement.time_ns, correction.x[:5].tolist())
        elif seen.kind in WIDENING:
            navigation.widen(**WIDENING[seen.kind])
        return Outcome(
            measurement.time_ns,
            measurement.source,
            seen.kind,
            tuple(seen.z.tolist()),
            tuple(correction.innovation_sd.tolist()),
            ratio,
            used,
            None if used else "beyond the gate",
        )
