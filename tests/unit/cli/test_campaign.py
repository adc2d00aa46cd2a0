"""Campaigns: results are kept by what they depend on, and a job that fails or is stopped leaves the others alone."""

import argparse
import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from pathlib import Path

import numpy as np
import pytest

from cli import campaign
from cli.campaign import Failure, Job, Kept, Size, in_processes, options_of, sources_of, worth_storing
from shared.errors import UserError

ROOT = Path(__file__).resolve().parents[3]


class Verdict(StrEnum):
    GOOD = "good"


@dataclass(frozen=True)
class Result:
    """All kinds of values that campaigns keep."""

    error_m: Kept
    verdicts: list[Verdict]
    intervals: dict[str, list[tuple[float, float]]]
    slowest_s: float
    bound: float | None


def work(seed: int, log: Path) -> Result:
    with log.open("a") as file:
        file.write(f"{seed}\n")
    return Result(np.array([[seed, 0.1], [np.nan, 2.0]]), [Verdict.GOOD], {"motion": [(0.1, 0.3)]}, inf, None)


def some_fail(seed: int, log: Path) -> int:
    if seed == 1:
        raise ValueError("seed 1 is bad")
    if seed == 2:
        raise UserError("no such drive")
    if seed == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    with log.open("a") as file:
        file.write(f"{seed}\n")
    return seed


def first_at_once(seed: int) -> int:
    if seed > 1:
        time.sleep(60.0)
    return seed


def makes_file(path: Path) -> None:
    path.write_text(path.read_text() + "made\n" if path.exists() else "made\n")


def threads() -> tuple[str | None, int]:
    return os.environ.get("OPENBLAS_NUM_THREADS"), os.getpgrp()


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    return tmp_path / "state"


def done(log: Path) -> list[int]:
    return sorted(map(int, log.read_text().split())) if log.exists() else []


def test_a_stopped_campaign_goes_on_and_fresh_begins_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    jobs = [Job(f"seed {seed}", work, (seed, log)) for seed in range(3)]
    first = campaign.run("some", jobs[:2], workers=2)
    assert first.complete and done(log) == [0, 1]
    again = campaign.run("some", jobs, workers=2)
    assert again.complete and done(log) == [0, 1, 2], "only what was not done yet"
    assert [result.error_m[0, 0] for result in again.results] == [0.0, 1.0, 2.0], "in the order of the jobs"
    campaign.run("some", jobs[:1], workers=1, fresh=True)
    assert done(log) == [0, 0, 1, 2]


def test_what_is_kept_is_what_was_found_to_the_last_bit(tmp_path: Path) -> None:
    (job,) = jobs = [Job("one", work, (7, tmp_path / "log"))]
    (first,), (kept,) = (campaign.run("kept", jobs).results for _ in range(2))
    assert done(tmp_path / "log") == [7]
    np.testing.assert_array_equal(kept.error_m, first.error_m)
    assert isinstance(kept.error_m, np.ndarray) and kept.error_m.dtype == np.float64
    assert (kept.verdicts, kept.intervals, kept.slowest_s, kept.bound) == ([Verdict.GOOD], first.intervals, inf, None)
    assert isinstance(kept.verdicts[0], Verdict) and job.key == jobs[0].key


def test_jobs_that_fail_and_processes_that_die_leave_the_others_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = [Job(f"seed {seed}", some_fail, (seed, tmp_path / "log")) for seed in range(8)]
    outcome = campaign.run("failing", jobs, workers=2)
    assert outcome.results == [0, 4, 5, 6, 7] and outcome.planned == 8 and not outcome.complete
    told = capsys.readouterr().err
    assert "seed 1 failed: Traceback" in told and "ValueError: seed 1 is bad" in told
    assert "seed 2 failed: no such drive" in told and "seed 3 failed: its process died" in told
    options = argparse.Namespace(short=False)
    assert not worth_storing(options, outcome) and "3 jobs are not done" in capsys.readouterr().err


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Python's handler of SIGINT, which a shell's background jobs do not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_keeps_what_is_finished(state: Path) -> None:
    jobs = [Job(f"seed {seed}", first_at_once, (seed,)) for seed in (0, 1, 2, 3)]
    folder = state / "campaigns" / "stopped"

    def interrupt() -> None:
        while len(list(folder.glob("*.json"))) < 2:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    outcome = campaign.run("stopped", jobs, workers=2)
    assert outcome.results == [0, 1] and not outcome.complete
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_job_whose_file_is_gone_is_done_again(tmp_path: Path) -> None:
    path = tmp_path / "made"
    jobs = [Job("file", makes_file, (path,), makes=path)]
    for _ in range(2):
        campaign.run("files", jobs)
    assert path.read_text() == "made\n"
    path.unlink()
    assert campaign.run("files", jobs).complete and path.exists()


def test_a_process_has_one_thread_of_linear_algebra_and_a_group_of_its_own() -> None:
    ((_, found),) = in_processes({0: Job("threads", threads, ())})
    assert not isinstance(found, Failure) and found[0] == "1" and found[1] != os.getpgrp()


def test_a_key_depends_on_arguments_files_read_and_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = tmp_path / "drive.mcap"
    missing = Job("one", work, (1, tmp_path), reads=(read,)).key
    read.write_text("a")
    job = Job("one", work, (1, tmp_path), reads=(read,))
    known = job.key
    assert known != missing and Job("another name", work, (1, tmp_path), reads=(read,)).key == known
    assert Job("one", work, (2, tmp_path), reads=(read,)).key != known
    read.write_text("ab")
    assert job.key != known
    read.unlink()
    monkeypatch.setattr(campaign, "code_of", lambda _: "changed")
    assert job.key != missing


def test_the_code_of_a_job_is_all_that_its_module_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {path.relative_to(ROOT).as_posix() for path in sources_of("benchmarks.integrity.faults")}
    assert {
        "cli/attack_lab/run.py",
        "cli/solve/inputs.py",
        "cli/campaign.py",
        "services/core/trust/process.py",
    } <= found
    assert {"deploy/vehicles/simulated.toml", "benchmarks/integrity/__init__.py"} <= found
    assert not {path for path in found if path.startswith(("benchmarks/starts", "cli/demo", "tests/"))}
    (tmp_path / "pkg").mkdir()
    (tmp_path / "pkg" / "jobs.py").write_text("from .helper import run")
    (tmp_path / "pkg" / "helper.py").write_text("def run(): import pkg.late")
    (tmp_path / "pkg" / "late.py").write_text("1")
    monkeypatch.setattr(campaign, "ROOT", tmp_path)
    assert {path.name for path in sources_of("pkg.jobs")} == {"jobs.py", "helper.py", "late.py"}
    campaign.code_of.cache_clear()
    before = campaign.code_of("pkg.jobs")
    (tmp_path / "pkg" / "late.py").write_text("2")
    campaign.code_of.cache_clear()
    assert campaign.code_of("pkg.jobs") != before
    campaign.code_of.cache_clear()


@pytest.mark.parametrize(
    ("arguments", "runs", "short"),
    [([], 50, False), (["--short"], 3, True), (["--full"], 400, False), (["--runs", "7"], 7, False)],
)
def test_a_campaign_has_a_short_a_usual_and_a_full_size(arguments: list[str], runs: int, short: bool) -> None:
    options = options_of(argparse.ArgumentParser(), arguments, Size(3, 50, 400, "drives"))
    assert (options.runs, options.short, options.fresh, options.workers) == (runs, short, False, 0)


@pytest.mark.parametrize("arguments", [["--runs", "0"], ["--short", "--full"]])
def test_no_runs_and_two_sizes_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        options_of(argparse.ArgumentParser(), arguments, Size(3, 50, 400))
    assert "less than 1" in (told := capsys.readouterr().err) or "not allowed with" in told


def test_the_short_form_stores_nothing_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    complete = campaign.Outcome([(0, 1)], 1)
    assert not worth_storing(argparse.Namespace(short=True), complete)
    assert "short form: no result is stored" in capsys.readouterr().err
    assert worth_storing(argparse.Namespace(short=False), complete)


def test_a_page_says_how_many_runs_it_has_of_how_many() -> None:
    assert Size(3, 50, 400).note(50) == "50 runs; the full campaign (`FULL=1`) has 400, and bounds rare events better."
    assert Size(3, 50, 400, "drives").note(400) == "400 drives, the full campaign."
