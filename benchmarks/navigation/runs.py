"""Imports the drives, solves every case in processes of their own, and puts the outages of one case together."""

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .cases import DRIVES, Case

REPOSITORY = Path(__file__).resolve().parents[2]
MAPPINGS = REPOSITORY / "benchmarks" / "recordings" / "mappings"
Metrics = dict[str, float | None]
Advance = Callable[[str], None]
TIMEOUT_S = 1800.0


def data_folder() -> Path:
    """Find the recordings, which are not part of the repository: where OBU_DATA says, or beside it."""
    return Path(os.environ.get("OBU_DATA", REPOSITORY.parent / "shared" / "data"))


@dataclass(frozen=True)
class Job:
    """One run of `obu solve`."""

    case: str
    number: int
    drive: str
    options: tuple[str, ...]

    @property
    def folder(self) -> str:
        """Name of the folder for its results."""
        return f"{self.case.replace(' ', '-')}-{self.number}"


def present(drives: Iterable[str]) -> list[str]:
    """Name the drives whose folder is there."""
    return [name for name in dict.fromkeys(drives) if (data_folder() / DRIVES[name].folder).is_dir()]


def import_drives(names: Sequence[str], folder: Path, advance: Advance) -> None:
    """Turn drives into recordings."""
    commands = {
        name: ["import", str(MAPPINGS / f"{DRIVES[name].mapping}.toml"), str(data_folder() / DRIVES[name].folder),
               "-o", str(recording(folder, name))]
        for name in names
    }  # fmt: skip
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = {pool.submit(_obu, command): name for name, command in commands.items()}
        for done in as_completed(waiting):
            done.result()
            advance(f"imported {waiting[done]}")


def recording(folder: Path, name: str) -> Path:
    """Where the recording of a drive lies."""
    return folder / f"{name}.mcap"


def jobs_of(key: str, case: Case) -> list[Job]:
    """List the runs of a case: one, or one an outage pattern."""
    common = ("--score-from", str(case.score_from), *(("--aiding", case.aiding) if case.aiding else ()))
    patterns: list[tuple[str, ...]] = [("--outage", outage) for outage in case.outages] or [()]
    return [Job(key, number, case.drive, (*common, *pattern)) for number, pattern in enumerate(patterns)]


def solve_cases(cases: dict[str, Case], folder: Path, advance: Advance) -> dict[str, Metrics]:
    """Run every job, as many at once as there are cores; the metrics of each case."""
    jobs = [job for key, case in cases.items() for job in jobs_of(key, case) if not _done(job, folder)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = {pool.submit(solve_job, job, folder): job for job in jobs}
        for done in as_completed(waiting):
            done.result()
            advance(f"solved {waiting[done].case}")
    return {key: _metrics(key, case, folder) for key, case in cases.items()}


def _done(job: Job, folder: Path) -> bool:
    """Whether a folder that was kept holds the results already."""
    return (folder / job.folder / "report.html").is_file()


def solve_job(job: Job, folder: Path) -> None:
    """Run `obu solve` for a job; the results are in its folder."""
    _obu(["solve", str(recording(folder, job.drive)), "--out", str(folder / job.folder), *job.options])


def _obu(arguments: Sequence[str]) -> None:
    # One thread of linear algebra each: with more they stand in each other's way.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "cli", *arguments], cwd=REPOSITORY, env=environment, check=False,
        capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"obu {' '.join(arguments)}: {done.stderr.strip() or done.stdout.strip()}")


def _metrics(key: str, case: Case, folder: Path) -> Metrics:
    results = [folder / job.folder for job in jobs_of(key, case)]
    metrics: Metrics = json.loads((results[0] / "metrics.json").read_text(encoding="utf-8"))
    return pooled([_outages(result, case.most) for result in results]) if case.outages else metrics


Outage = dict[str, float]


def _outages(folder: Path, most: int | None) -> list[Outage]:
    with (folder / "outages.csv").open(newline="", encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)][:most]


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
