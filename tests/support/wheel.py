"""A wheel for the tests."""

import subprocess
from pathlib import Path

import pytest

from deploy import wheel


def built(folder: Path) -> Path:
    """Build the wheel into a folder; the test is skipped where the dashboard or a builder is not installed."""
    try:
        return wheel.build(folder)
    except wheel.WheelIncomplete as error:
        pytest.skip(str(error))
    except subprocess.CalledProcessError:
        if wheel.builds_offline():
            raise
        pytest.skip("no setuptools to build with, and none can be fetched; run `make test` once with internet")
