"""The result of one check."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What was checked, and the remedy if it failed."""

    ok: bool
    what: str
    remedy: str = ""
