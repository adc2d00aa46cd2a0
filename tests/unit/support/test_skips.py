"""Where CI runs, a test that lacks a program fails, and one that lacks a recording or rights does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.data import REPOSITORY

SKIPS = """import os
import pytest

def test_program():
    pytest.skip("no mosquitto on this machine: `apt install mosquitto` brings it")

@pytest.mark.skipif(True, reason="gpsd is not installed: apt install gpsd")
def test_marked():
    pass

def test_recording():
    pytest.skip("recording 'x' is not at /data: set OBU_DATA to the folder that holds it")

@pytest.mark.skipif(True, reason="only root can give a folder to another user")
def test_rights():
    pass

@pytest.mark.xfail(strict=True)
def test_known():
    raise ValueError
"""


@pytest.mark.parametrize(
    ("ci", "expected"), [("1", "1 failed, 2 skipped, 1 xfailed, 1 error"), ("", "4 skipped, 1 xfailed")]
)
def test_a_skip_for_want_of_a_program_fails_where_ci_runs(tmp_path: Path, ci: str, expected: str) -> None:
    (tmp_path / "test_skips.py").write_text(SKIPS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.conftest", "-c", str(tmp_path / "pytest.ini")]
    done = subprocess.run(
        [*command, str(tmp_path)], cwd=REPOSITORY, env=os.environ | {"OBU_CI": ci}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert expected in done.stdout, done.stdout + done.stderr
