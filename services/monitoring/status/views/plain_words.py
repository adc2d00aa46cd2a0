"""What a message says, in the words of the page."""

from collections.abc import Sequence

from shared.messages.explanation import Explanation
from shared.trust.accused import reference
from shared.words.words import words

LABELS = words().names["monitor"]


def label_of(monitor: str) -> str:
    """Name a monitor."""
    return LABELS.get(monitor) or monitor.replace("_", " ").capitalize()


def said(reason: str, code: Explanation | None) -> str:
    """Put a reason into words: by its code, else as the message has it."""
    return reason if code is None else words().detail(code) or reason


def who(accused: Sequence[str]) -> str:
    """Name what is suspected or left out: sensors, satellites, neighbours; empty for nothing."""
    return words().references([reference(name) for name in accused]) if accused else ""
