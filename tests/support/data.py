"""Where real recordings are found; they are not part of the repository."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def data_folder() -> Path:
    """Folder of the real recordings, which may be missing."""
    return Path(os.environ.get("OBU_DATA", REPOSITORY.parent / "shared" / "data"))


def recording(name: str) -> Path:
    """Find a recording by the name of its folder, or skip the test with a message that states a remedy."""
    root = data_folder()
    path = root / name
    if not path.exists():
        pytest.skip(f"recording {name!r} is not at {root}: set OBU_DATA to the folder that holds it")
    return path
