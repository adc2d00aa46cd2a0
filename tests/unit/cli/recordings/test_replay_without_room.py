"""`obu replay` of a recording without solutions on a full disk."""

import resource
import subprocess
import sys
from pathlib import Path

from tests.support.data import REPOSITORY
from tests.support.drives.golden import record_golden_drive
from tests.support.patience import HANGS_S

ROOM = 500  # bytes of the largest file that may be written


def test_a_full_disk_is_reported_with_a_remedy(tmp_path: Path) -> None:
    drive = record_golden_drive(tmp_path / "drive.mcap")
    environment = {"OBU_STATE": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}  # half a file would stay behind
    done = subprocess.run(
        [sys.executable, "-m", "cli", "replay", str(drive), "--port", "0"],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=HANGS_S, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM)),  # as a disk that is full
    )  # fmt: skip
    assert done.returncode == 2
    sentence = done.stderr.splitlines()[-1]
    assert sentence.startswith("obu: cannot write "), done.stderr
    assert sentence.endswith("File too large; make room, or set OBU_STATE to another disk")
