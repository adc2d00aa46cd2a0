"""`obu papers toll`: few runs reproduce the reference within its tolerances, and every figure is drawn."""

import json

import pytest

from cli.papers.report import publish
from cli.papers.toll.paper import reproduce


@pytest.mark.slow
def test_few_runs_reproduce_the_toll_paper(capsys, tmp_path) -> None:  # type: ignore[no-untyped-def]
    paper = reproduce(4, progress=False)
    assert publish(paper, json=True, out=tmp_path) == 0, paper.deviations
    document = json.loads(capsys.readouterr().out)
    assert document["deviations"] == []
    assert document["mercator_mse_m2"]["mercator"] > 10.0
    assert len(document["filters"]) == len(document["lanes"]) == 4
    assert sorted(path.stem for path in tmp_path.iterdir()) == [
        "lane-decisions", "mean-square-errors", "roundabout", "speed-profile",
    ]  # fmt: skip
