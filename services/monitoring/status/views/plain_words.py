"""Names of the integrity monitors, and of what they suspect."""

from collections.abc import Sequence

from shared.trust.accused import reference
from shared.words.words import words

LABELS = words().names["monitor"]


def label_of(monitor: str) -> str:
    """Name a monitor."""
    return LABELS.get(monitor) or monitor.replace("_", " ").capitalize()


def who(accused: Sequence[str]) -> str:
    """Name what is suspected or left out: sensors, satellites, neighbours; empty for nothing."""
    return words().references([reference(name) for name in accused]) if accused else ""
