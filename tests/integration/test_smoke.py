"""Every make target that measures can run: one job of a few seconds, with real programs."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
MEASURES = re.compile(r"-m benchmarks(?!\.tables)|-m cli (?:attack-lab|papers)")
# A target and its commands.
RULES = dict(re.findall(r"^([a-z0-9-]+):[^\n]*\n((?:\t[^\n]*\n)+)", MAKEFILE, re.M))
TARGETS = sorted(name for name, commands in RULES.items() if MEASURES.search(commands))

ALONE = {"bench", "bench-replay", "fleet", "security", "v2x"}  # which start programs of their own

pytestmark = pytest.mark.broker


def test_the_targets_that_measure_are_found() -> None:
    assert {"bench", "drives", "fleet", "fuzz", "papers", "attack-lab"} <= set(TARGETS)


def _run_in_turn(target: str) -> object:
    return pytest.param(target, marks=pytest.mark.whole_unit) if target in ALONE else target


@pytest.mark.slow
@pytest.mark.parametrize("target", [_run_in_turn(target) for target in TARGETS])
def test_a_target_that_measures_runs_in_its_smoke_form_and_stores_nothing(target: str) -> None:
    before = _stored()
    done = subprocess.run(
        ["make", "--no-print-directory", target, "SMOKE=1"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert _stored() == before


def _stored() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (ROOT / "benchmarks" / "results").iterdir()}
