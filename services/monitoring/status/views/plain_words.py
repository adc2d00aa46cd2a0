"""Names of the integrity monitors, of hypotheses and of what is suspected, in the words of the page."""

from collections.abc import Sequence
from dataclasses import dataclass

from shared.messages.trust import Hypothesis
from shared.words.words import words

LABELS, SOURCES = words().names["monitor"], words().names["source"]


@dataclass(frozen=True)
class HypothesisWords:
    """One hypothesis in words."""

    label: str  # of a row or a metric
    condition: str  # of the solution that follows from it


HYPOTHESES = {
    Hypothesis.NOTHING: HypothesisWords("Nothing is wrong", "if nothing is wrong"),
    Hypothesis.GNSS: HypothesisWords("GNSS is wrong", "if GNSS is wrong"),
    Hypothesis.IMU: HypothesisWords("The inertial sensors are wrong", "if the inertial sensors are wrong"),
    Hypothesis.ODOMETER: HypothesisWords("The odometer is wrong", "if the odometer is wrong"),
    Hypothesis.GNSS_AND_ODOMETER: HypothesisWords(
        "GNSS and odometer are falsified alike", "if GNSS and odometer are falsified alike"
    ),
    Hypothesis.RECEIVER_TIME: HypothesisWords("The receiver's time is wrong", "if the receiver's time is wrong"),
    Hypothesis.SATELLITES: HypothesisWords("Satellites are wrong", "if these satellites are wrong"),
}


def label_of(monitor: str) -> str:
    """Name a monitor."""
    return LABELS.get(monitor) or monitor.replace("_", " ").capitalize()


def who(accused: Sequence[str]) -> str:
    """Name what is suspected: sensors, satellites, neighbours."""
    return " or ".join(SOURCES.get(name, name) for name in accused)
