"""What a command tells the program that has started it, beside its exit code: a small file of JSON.

The starter names the file in an environment variable, which the command takes out of its own environment, so that its
children do not write there. What is printed is for people, and read by nothing.
"""

import json
import logging
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from ..bounded import read_bytes

log = logging.getLogger(__name__)

VARIABLE = "OBU_REPORT"
MAXIMUM_BYTES = 100_000
LENGTH = 1000  # of a text


@dataclass(frozen=True)
class Report:
    """What is known of a command that runs or has ended."""

    error: str = ""  # why it failed, in a sentence
    finding: str = ""  # what it found, in a sentence
    port: int | None = None  # where it serves a page


class _Place:
    path: Path | None = None


def begin() -> None:
    """Take the name of the file out of the environment; to be called once, before children are started."""
    name = os.environ.pop(VARIABLE, "")
    _Place.path = Path(name) if name else None


def tell(*, error: str = "", finding: str = "", port: int | None = None) -> None:
    """Write the report, if somebody wants one; where that fails, as on a full disk, the exit code alone tells."""
    if _Place.path is None:
        return
    report = Report(error=error[:LENGTH], finding=finding[:LENGTH], port=port)
    fresh = _Place.path.with_name(f"{_Place.path.name}.new")
    try:
        fresh.write_text(json.dumps(asdict(report)), encoding="utf-8")
        fresh.replace(_Place.path)
    except OSError as failed:
        log.warning("what was found cannot be told to the program that waits for it: %s", failed)


def read_report(path: Path) -> Report:
    """Read a report; an empty one of a command that wrote none."""
    from pydantic import TypeAdapter  # every command imports this module, and the shortest must not wait for it

    try:
        return TypeAdapter(Report).validate_json(read_bytes(path, MAXIMUM_BYTES), strict=True)
    except (OSError, ValueError):
        return Report()
