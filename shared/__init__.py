"""The only thing that processes have in common: topics, messages, the bus and the runtimes."""

from datetime import date
from pathlib import Path

VERSION = "0.1.0"  # of the project
RELEASED = date(2026, 11, 25)  # of this version: set with it
ROOT = Path(__file__).resolve().parents[1]  # of the repository, or where a wheel was installed: both hold deploy/


def is_newer(version: str) -> bool:
    """Whether a version such as 0.2.0 is later than this one; what is no version is not."""
    parts = version.split(".")
    numbers = [int(part) for part in parts if part.isdecimal() and len(part) < 10]
    return len(numbers) == len(parts) and numbers > [int(part) for part in VERSION.split(".")]


def shipped(path: Path) -> Path:
    """Find a file that may come with the code: a relative path that is not in the working folder is below `ROOT`."""
    return path if path.exists() or not (ROOT / path).exists() else ROOT / path
