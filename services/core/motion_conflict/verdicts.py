"""The tests of the motion monitor, by name."""

from dataclasses import dataclass, fields

from shared.trust.accused import GNSS, ODOMETER
from shared.trust.result import Test

EITHER_SOURCE = (GNSS, ODOMETER)  # a test that cannot tell which


@dataclass(frozen=True)
class MotionVerdicts:
    """All tests of the motion monitor at one time."""

    trimmed_mean: Test  # the paper's instant verdict
    median: Test  # the same with the median
    event: Test  # the regulation's: five uninterrupted minutes of movement
    distance: Test  # the regulation's: distance between positions against the odometer
    motion_sensor: Test  # the regulation's: the odometer stands still while GNSS moves
    calibrated: Test  # trimmed mean with the learned scale and delay
    scale_step: Test  # change of the odometer's scale within a drive
    scale_range: Test  # scale that no tyre explains
    held_speed: Test  # receiver repeats its last speed
    fast: Test  # difference of speeds over 5 s against its own noise
    carried: Test  # whether a ferry or train may carry the vehicle: it doubts, and never accuses

    def named(self) -> dict[str, Test]:
        """All of them by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def accusing(self) -> tuple[str, ...]:
        """Names of the tests that accuse."""
        return tuple(name for name, test in self.named().items() if test.accuses)
