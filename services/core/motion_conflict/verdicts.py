"""The verdicts of the motion monitor: one per test, each with its statistic and threshold."""

from dataclasses import dataclass, fields
from enum import StrEnum


class State(StrEnum):
    """Outcome of a test."""

    PASS = "pass"
    ACCUSES = "accuses"
    NOT_EVALUATED = "not_evaluated"


class Accused(StrEnum):
    """Sensor that a test holds responsible; two of them when the test cannot tell which."""

    GNSS = "gnss"
    ODOMETER = "odometer"


EITHER = (Accused.GNSS, Accused.ODOMETER)


@dataclass(frozen=True)
class Verdict:
    """Outcome of one test at one time.

    `statistic` and `threshold` share `unit`; the test accuses when the statistic is strictly greater.
    `false_alarm_rate` is per evaluation, None where a rule fixes the threshold. `suspect_since_ns` is the earliest
    time from which the evidence may be wrong, `since_ns` the time at which `state` was reached.
    """

    state: State
    reason: str
    unit: str
    window_s: float
    statistic: float | None = None
    threshold: float | None = None
    false_alarm_rate: float | None = None
    accused: tuple[Accused, ...] = ()
    suspect_since_ns: int | None = None
    since_ns: int | None = None


@dataclass(frozen=True)
class MotionVerdicts:
    """All verdicts of the motion monitor at one time."""

    trimmed_mean: Verdict  # the paper's instant verdict
    median: Verdict  # the same with the median
    event: Verdict  # the regulation's: five uninterrupted minutes of movement
    distance: Verdict  # the regulation's: distance between positions against the odometer
    motion_sensor: Verdict  # the regulation's: the odometer stands still while GNSS moves
    calibrated: Verdict  # trimmed mean with the learned scale and delay
    scale_step: Verdict  # change of the odometer's scale within a drive
    scale_range: Verdict  # scale that no tyre explains
    held_speed: Verdict  # receiver repeats its last speed
    fast: Verdict  # difference of speeds over 5 s against its own noise

    def accusing(self) -> tuple[str, ...]:
        """Names of the tests that accuse."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name).state is State.ACCUSES)
