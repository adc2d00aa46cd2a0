"""Where recordings are found, which are not part of the repository."""

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def find(name: str) -> Path | None:
    """Find the folder of a recording below OBU_DATA, or beside the repository; None where it is not."""
    path = Path(os.environ.get("OBU_DATA", REPOSITORY.parent / "shared" / "data")) / name
    return path if path.exists() else None


def missing(name: str, purpose: str) -> str:
    """Print what is skipped because a recording is missing, and what to do."""
    return f"{purpose}: recording {name!r} was not found; set OBU_DATA to the folder that holds it"
