"""`make papers` reproduces every paper, also behind one that is outside its limits."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("failing", [(), ("cooperative", "toll")])
def test_all_papers_run_and_the_end_says_which_failed(tmp_path: Path, failing: tuple[str, ...]) -> None:
    program = tmp_path / "python"
    fails = "".join(f"*{paper}*) exit 1;; " for paper in failing)
    program.write_text(f'#!/bin/sh\necho "ran $*"\ncase "$*" in {fails}*) ;; esac\n')
    program.chmod(0o755)
    done = subprocess.run(
        ["make", "-o", "setup", "papers", f"PYTHON={program}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    for paper in ("motion-conflict", "cooperative", "spoofing", "toll", "navigation"):
        assert f"ran -m cli papers {paper}" in done.stdout
    assert (done.returncode != 0) == bool(failing)
    if failing:
        assert f"outside their limits: {' '.join(failing)}" in done.stdout
