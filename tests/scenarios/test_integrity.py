"""A small campaign of protection levels with each kind of simulated drive; `make integrity` is the large one."""

import json
from pathlib import Path

import pytest

from benchmarks.integrity import report
from benchmarks.integrity.simulated import CASES, ErrorsAndLevels, jobs_of
from cli import campaign
from cli.campaign import Outcome, in_processes
from cli.reference.wrap import wrap


@pytest.fixture(scope="module")
def judged() -> list[ErrorsAndLevels]:
    found = {}
    for number, item in in_processes(dict(enumerate(jobs_of(len(CASES), first_seed=5000))), 2):
        assert isinstance(item, ErrorsAndLevels), item
        found[number] = item
    return [found[number] for number in sorted(found)]


def test_at_most_1e_3_of_the_errors_are_above_their_protection_levels(judged: list[ErrorsAndLevels]) -> None:
    whole = report.row_of("all", judged)
    assert whole.runs == len(CASES) and whole.epochs > 2000
    assert max(whole.above) <= 1e-3


def test_the_median_ratio_of_levels_to_errors_is_below_10(judged: list[ErrorsAndLevels]) -> None:
    """Median ratio, horizontal and vertical: the goal of the large campaign is 6."""
    assert max(report.row_of("all", judged).ratio) < 10.0


def test_levels_grow_by_half_in_outages(judged: list[ErrorsAndLevels]) -> None:
    for item in judged:
        assert item.level_m[:, 0].max() > 1.5 * item.level_m[:, 0].min(), item.case


def test_the_table_has_every_case_and_exceeded_levels_fail_the_command(
    judged: list[ErrorsAndLevels], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    exceeded = [ErrorsAndLevels(item.case, item.seed, 3.0 * item.level_m, item.level_m) for item in judged]
    found = Outcome(list(enumerate(exceeded)), len(exceeded))
    monkeypatch.setattr(campaign, "run", lambda *_, **__: found)
    assert report.main(["--short"]) == 1 and not list(tmp_path.iterdir()), "the short form stores nothing"
    capsys.readouterr()
    assert report.main(["--runs", str(len(CASES))]) == 1
    printed = capsys.readouterr().out
    assert all(case.name in printed for case in CASES) and "100 / 100" in printed
    assert f"{len(CASES)} runs; the full campaign" in printed
    assert (tmp_path / "integrity.md").read_text() == wrap(printed)
    stored = json.loads((tmp_path / "integrity.json").read_text())
    assert stored["simulated"][-1]["above"] == [1.0, 1.0]
