"""`obu papers toll`: few runs reproduce the reference within its tolerances, and every figure is drawn."""

import json
from dataclasses import replace

import pytest

from cli.papers.report import publish
from cli.papers.toll import lane_decisions
from cli.papers.toll.filters import NOISES, compare
from cli.papers.toll.lane_decisions import REFERENCE, ROWS, Decisions
from cli.papers.toll.paper import filter_deviations, lane_deviations, reproduce

RUNS = 2


@pytest.fixture(scope="module")
def decisions() -> list[Decisions]:
    rows = [lane_decisions.simulate(errors, 60, 1) for errors in ROWS[:1]]
    return [*rows, lane_decisions.simulate(ROWS[0], 60, 1, corrected=True)]


def test_two_runs_of_the_filters_are_within_their_limits() -> None:
    white = compare(NOISES[0], RUNS, 1)
    assert filter_deviations([white], RUNS) == []
    better = replace(white, mse={name: 0.5 * value for name, value in white.mse.items()})
    assert filter_deviations([better], RUNS) == [], "an improvement is no deviation"
    worse = replace(white, mse={name: 4.0 * value for name, value in white.mse.items()})
    assert len(filter_deviations([worse], RUNS)) == len(NOISES[0].reference)


def test_sixty_vehicles_are_in_their_lanes_and_more_right_lanes_are_no_deviation(decisions: list[Decisions]) -> None:
    assert lane_deviations(decisions) == []
    first, corrected = decisions
    assert lane_deviations([replace(first, filtered_delta=1.0, filtered=0.9), corrected]) == []
    (text,) = lane_deviations([replace(first, filtered_delta=0.89), corrected])
    assert "reference 95 - 5 %" in text
    assert len(lane_deviations([replace(first, filtered=first.raw - 0.06), corrected])) == 1


def test_raw_positions_are_in_their_lane_as_the_normal_distribution_has_it() -> None:
    """End lanes with one bound would be right more often than the reference says, by 4 of its standard deviations."""
    for errors, row in zip(ROWS, REFERENCE, strict=True):
        share = lane_decisions.simulate(errors, 300, 7).raw if errors is ROWS[0] else None
        closed, opened = lane_decisions.expected_raw(errors), lane_decisions.expected_raw(errors, ends_are_open=True)
        assert closed < row[0] / 100.0 < opened
        if share is not None:
            assert share == pytest.approx(closed, abs=3.0 * (closed * (1.0 - closed) / 300) ** 0.5)
    p = lane_decisions.expected_raw(ROWS[3], ends_are_open=True)
    assert (p - REFERENCE[3][0] / 100.0) / (p * (1.0 - p) / 150) ** 0.5 > 4.0


@pytest.mark.slow
def test_few_runs_reproduce_the_toll_paper(capsys, tmp_path) -> None:  # type: ignore[no-untyped-def]
    paper = reproduce(4, progress=False)
    assert publish(paper, json=True, out=tmp_path) == 0, paper.deviations
    document = json.loads(capsys.readouterr().out)
    assert document["deviations"] == []
    assert document["mercator_mse_m2"]["mercator"] > 10.0
    assert len(document["filters"]) == len(document["lanes"]) == 4
    assert sorted(path.stem for path in tmp_path.iterdir()) == [
        "lane-decisions", "mean-square-errors", "raw-lanes", "roundabout", "speed-profile",
    ]  # fmt: skip
