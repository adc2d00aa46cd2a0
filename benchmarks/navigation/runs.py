"""Imports the drives, solves every case by `obu solve`, and puts the outages of one case together."""

import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cli import campaign
from cli.campaign import Job
from shared.runtime.config import state_dir

from .cases import DRIVES, Case

REPOSITORY = Path(__file__).resolve().parents[2]
MAPPINGS = REPOSITORY / "benchmarks" / "recordings" / "mappings"
Metrics = dict[str, float | None]
Outage = dict[str, float]
TIMEOUT_S = 1800.0


@dataclass(frozen=True)
class SolveRun:
    """What one run of `obu solve` found."""

    metrics: dict[str, Any]  # metrics.json
    outages: list[Outage]  # outages.csv; none of a run without outages


def data_folder() -> Path:
    """Find the recordings, which are not part of the repository: where OBU_DATA says, or beside it."""
    return Path(os.environ.get("OBU_DATA", REPOSITORY.parent / "shared" / "data"))


def present(drives: Iterable[str]) -> list[str]:
    """Name the drives whose folder is there."""
    return [name for name in dict.fromkeys(drives) if (data_folder() / DRIVES[name].folder).is_dir()]


def recording(name: str) -> Path:
    """Where the recording of a drive lies."""
    return state_dir().resolve() / "campaigns" / "recordings" / f"{name}.mcap"


def import_drives(names: Sequence[str], *, workers: int = 0, fresh: bool = False) -> campaign.Outcome[None]:
    """Turn drives into recordings, where they are not yet."""
    jobs = [
        Job(
            f"importing {name}", import_drive, (name,), also=("cli.import_drive.import_drive",), makes=recording(name),
            reads=(_mapping(name), *sorted(path for path in _source(name).rglob("*") if path.is_file())),
        )
        for name in names
    ]  # fmt: skip
    return campaign.run("recordings", jobs, workers=workers, fresh=fresh)


def import_drive(name: str) -> None:
    """Run `obu import` for a drive."""
    recording(name).parent.mkdir(parents=True, exist_ok=True)
    recording(name).unlink(missing_ok=True)  # of another version of the code
    _obu(["import", str(_mapping(name)), str(_source(name)), "-o", str(recording(name))])


def _mapping(name: str) -> Path:
    return MAPPINGS / f"{DRIVES[name].mapping}.toml"


def _source(name: str) -> Path:
    return data_folder() / DRIVES[name].folder


def solve_job(name: str, drive: str, options: tuple[str, ...] = ()) -> Job[SolveRun]:
    """One run of `obu solve`."""
    return Job(name, solve, (drive, options), reads=(recording(drive),), also=("cli.solve.solve",))


def solve(drive: str, options: tuple[str, ...]) -> SolveRun:
    """Run `obu solve`."""
    with tempfile.TemporaryDirectory(prefix="obu-drives-") as name:
        _obu(["solve", str(recording(drive)), "--out", name, *options])
        metrics = json.loads((Path(name) / "metrics.json").read_text(encoding="utf-8"))
        table = Path(name) / "outages.csv"
        lines = table.read_text(encoding="utf-8").splitlines() if table.exists() else []
    return SolveRun(metrics, [{key: float(value) for key, value in row.items()} for row in csv.DictReader(lines)])


def jobs_of(key: str, case: Case) -> list[Job[SolveRun]]:
    """List the runs of a case: one, or one an outage pattern."""
    common = ("--score-from", str(case.score_from), *(("--aiding", case.aiding) if case.aiding else ()))
    patterns: list[tuple[str, ...]] = [("--outage", outage) for outage in case.outages] or [()]
    return [solve_job(key, case.drive, (*common, *pattern)) for pattern in patterns]


def metrics_of(
    cases: Mapping[str, Case], jobs: Sequence[Job[SolveRun]], found: Mapping[int, SolveRun]
) -> dict[str, Metrics]:
    """Judge the runs of every case together; a case of which a run is missing is left out."""
    runs: dict[str, list[SolveRun | None]] = {key: [] for key in cases}
    for number, job in enumerate(jobs):
        runs[job.name].append(found.get(number))
    return {key: judged(cases[key], [solved for solved in each if solved]) for key, each in runs.items() if all(each)}


def judged(case: Case, runs: Sequence[SolveRun]) -> Metrics:
    """Judge the runs of a case."""
    return pooled([run.outages[: case.most] for run in runs]) if case.outages else runs[0].metrics


def _obu(arguments: Sequence[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cli", *arguments], cwd=REPOSITORY, check=False, capture_output=True, text=True,
        timeout=TIMEOUT_S,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"obu {' '.join(arguments)}: {done.stderr.strip() or done.stdout.strip()}")


def pooled(runs: Sequence[Sequence[Outage]]) -> Metrics:
    """Judge the outages of several runs as one set, under the names that `obu solve` has for one run."""
    outages = [outage for run in runs for outage in run]
    if not outages:
        return {"outage_count": 0}
    ends = np.array([outage["end_error_m"] for outage in outages])
    largest = np.array([outage["largest_error_m"] for outage in outages])
    ways = np.array([outage["distance_m"] for outage in outages])
    went = ways >= 10.0
    return {
        "outage_count": len(outages),
        "outage_end_error_median_m": float(np.median(ends)),
        "outage_end_error_max_m": float(ends.max()),
        "outage_end_error_share_median": float(np.median(ends[went] / ways[went])) if went.any() else None,
        "outage_largest_error_rms_m": float(np.sqrt(np.mean(largest**2))),
        "outage_largest_error_max_m": float(largest.max()),
    }
