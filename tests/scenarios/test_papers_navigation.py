"""The five degraded drives of the OBU paper and a white one, with two seeds each instead of ten: 12 runs of 240 s."""

import json

import pytest

from services.commands import papers_navigation as papers
from shared.errors import UserError

pytestmark = pytest.mark.xdist_group("papers_navigation")  # one worker, for the runs are shared


@pytest.fixture(scope="module")
def results() -> list[papers.Result]:
    return papers.measure_all(papers.CASES, runs=2, workers=2, progress=False)


def test_the_simulated_gnss_is_exactly_as_bad_as_that_of_the_paper(results: list[papers.Result]) -> None:
    for result in results:
        rmse = [square**0.5 for square in result.gnss]
        assert rmse == pytest.approx(result.case.error.rmse_ned_m, abs=0.005), result.case.name


def test_the_fusion_is_as_good_as_a_correct_filter_is(results: list[papers.Result]) -> None:
    """3-D RMSE at most 0.40 of GNSS's, better on every axis, and 0.45 m with white errors."""
    assert papers.shortcomings(results) == []


def test_the_fusion_gains_about_what_it_gains_in_the_paper(results: list[papers.Result]) -> None:
    """Ratios of 0.28 to 0.47 in the paper; two drives of 225 s scatter around 0.37 by about as much."""
    for result in results:
        if result.case.paper_fused:
            assert 0.2 < result.ratio < 0.55, result.case.name


def test_the_table_says_what_falls_short(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    poor = [papers.Result(case, (9.0, 4.0, 2.0), (10.0, 1.0, 1.0)) for case in papers.CASES]
    monkeypatch.setattr(papers, "measure_all", lambda *_args, **_kwargs: poor)
    assert papers.run(3, json=False) == 1
    printed = capsys.readouterr().out
    assert "not reached" in printed and "drive 5" in printed
    assert papers.run(3, json=True) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["runs"] == 3
    assert len(document["shortcomings"]) == 1 + 6 + 1  # the ratio, six times an axis, and the white errors


def test_no_runs_are_an_error_that_says_what_to_try() -> None:
    with pytest.raises(UserError, match="try"):
        papers.run(0, json=False)
