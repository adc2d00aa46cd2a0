"""Names and reasons of the integrity monitors in the words of the page."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime

LABELS = {
    "motion": "Motion conflict",
    "motion_fast": "Fast motion test",
    "inertial_short": "Short inertial window",
    "inertial_long": "Long inertial window",
    "satellites": "Satellites",
    "evidence": "Receiver evidence",
    "gyroscope": "Gyroscope test",
    "drift": "Slow drift test",
}
STATED = re.compile(r"(?:monitor )?([a-z_]+): (.+)", re.DOTALL)
SUSPECTS = re.compile(r"\bmonitor ([a-z_]+) (?:suspects|accuses)\b")  # the latter in recordings of earlier releases
EARLIER = {"no monitor accuses": "no monitor suspects", " is accused": " is suspected", "was accused": "was suspected"}
NESTED = re.compile(r"(?<=: )([a-z_]+): ")  # a monitor's reason inside that of a row
UPPER = re.compile(r"\b(gnss|imu)\b")
SINCE = re.compile(r"since (\d{9,10}\.\d) s")  # on the OBU time line, which is UTC


def label_of(monitor: str) -> str:
    """Name a monitor."""
    return LABELS.get(monitor) or monitor.replace("_", " ").capitalize()


def plain(reason: str) -> str:
    """Put a reason of `trust/state` into the words of the page: monitors by label, instants as time of day.

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
    joined = SUSPECTS.sub(lambda found: f"{label_of(found[1])} suspects", joined)
    for old, new in EARLIER.items():
        joined = joined.replace(old, new)
    joined = SINCE.sub(lambda found: f"since {datetime.fromtimestamp(float(found[1]), UTC):%H:%M:%S} UTC", joined)
    return UPPER.sub(lambda found: found[0].upper(), joined.replace("_", " "))


def who(accused: Sequence[str]) -> str:
    """Name what is suspected: sensors, satellites, neighbours."""
    return plain(" or ".join(accused))


def sentence(text: str, detail: str | None = None) -> str:
    """End a sentence, with a detail in parentheses if there is one."""
    return f"{text}{f' ({detail})' if detail else ''}."


def _stated(names: Sequence[str], text: str) -> str:
    if not names:
        return text
    verb = text if len(names) == 1 else text.replace("has ", "have ", 1) if text.startswith("has ") else text
    return f"{_and([LABELS[name] for name in names])}: {verb}"


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
