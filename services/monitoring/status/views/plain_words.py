"""Names and reasons of the integrity monitors in the words of the page."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from shared.messages.explanation import Explanation
from shared.messages.trust import Hypothesis
from shared.words.words import words

LABELS = words().names["monitor"]


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
STATED = re.compile(r"(?:monitor )?([a-z_]+): (.+)", re.DOTALL)
NESTED = re.compile(r"(?<=: )([a-z_]+): ")  # a monitor's reason inside that of a row
UPPER = re.compile(r"\b(gnss|imu)\b")
SINCE = re.compile(r"since (\d{9,10}\.\d) s")  # on the OBU time line, which is UTC


def label_of(monitor: str) -> str:
    """Name a monitor."""
    return LABELS.get(monitor) or monitor.replace("_", " ").capitalize()


def plain(reason: str) -> str:
    """Put a reason of a monitor into the words of the page: monitors by label, instants as time of day.

    Successive statements of the form "monitor: text" with the same text are joined: "Satellites and Motion conflict:
    have not published yet".
    """
    said: list[tuple[list[str], str]] = []
    for part in reason.split("; "):
        match = STATED.fullmatch(part)
        names, text = ([match[1]], match[2]) if match and match[1] in LABELS else ([], part)
        if said and names and said[-1][0] and said[-1][1] == text:
            said[-1][0].extend(names)
        else:
            said.append((names, text))
    joined = "; ".join(_stated(names, text) for names, text in said)
    joined = NESTED.sub(lambda found: f"{LABELS[found[1]]}: " if found[1] in LABELS else found[0], joined)
    joined = SINCE.sub(lambda found: f"since {datetime.fromtimestamp(float(found[1]), UTC):%H:%M:%S} UTC", joined)
    return UPPER.sub(lambda found: found[0].upper(), joined.replace("_", " "))


def said(reason: str, code: Explanation | None) -> str:
    """Put a reason into words: by its code, else the text itself; one without a code in the words of the page."""
    return plain(reason) if code is None else words().detail(code) or reason


def who(accused: Sequence[str]) -> str:
    """Name what is suspected: sensors, satellites, neighbours."""
    return plain(" or ".join(accused))


def _stated(names: Sequence[str], text: str) -> str:
    if not names:
        return text
    verb = text if len(names) == 1 else text.replace("has ", "have ", 1) if text.startswith("has ") else text
    return f"{all_of([LABELS[name] for name in names])}: {verb}"


def all_of(names: Sequence[str], word: str = "and") -> str:
    """Join names: "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"
