"""The list of each paper: no figure or table without a row, no command, test or number that does not exist."""

import ast
import json
from pathlib import Path

import pytest

from cli.catalogue import COMMANDS
from cli.papers.coverage.coverage import (
    Coverage,
    Number,
    Row,
    Status,
    coverage,
    later_commits,
    names,
    outside,
    stored,
    value_at,
)
from cli.papers.coverage.page import cells
from cli.papers.papers import listed
from shared.errors import UserError

TESTS = Path(__file__).parents[2]
PAPERS = ("cooperative", "motion-conflict", "navigation", "spoofing", "toll")


def test_each_paper_has_a_list() -> None:
    assert names() == list(PAPERS)


@pytest.mark.parametrize("paper", PAPERS)
def test_each_figure_and_table_has_a_row_and_each_stored_number_is_within_its_tolerance(paper: str) -> None:
    listing, result = coverage(paper), stored(paper)
    assert listing.missing() == []
    assert result is not None and result["version"] and result["paper"] == paper
    assert result["deviations"] == [], "a result outside the limits of its own command is not kept"
    for row in listing.rows:
        assert outside(row, result) == [], "stored by `make papers KEEP=1`"
        if row.command:
            words = row.command.split()
            assert words[0] == "obu" and any(" ".join(words[1:n]) in COMMANDS for n in (2, 3, 4)), row.command
        if row.test:
            file, _, function = row.test.partition("::")
            tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
            found = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
            assert function in found or (not function and found), row.test


def test_a_missing_or_doubled_row_is_named() -> None:
    row = Row(item="figure 1", shows="x", status=Status.NOT_REPRODUCED, reason="y")
    listing = Coverage(number="9", title="t", figures=2, tables=1, rows=(row, row))
    assert listing.missing() == ["figure 1", "figure 2", "table 1", "figure 1"]


@pytest.mark.parametrize(("value", "is_outside"), [(1.1, False), (0.9, False), (1.2, True), (0.8, True)])
def test_a_number_outside_its_tolerance_is_named(value: float, is_outside: bool) -> None:
    number = Number(at=("rows", "name=a", "value", 0), paper=1.0, tolerance=0.1)
    row = Row(item="table 1", shows="x", status=Status.REPRODUCED, command="obu papers toll", numbers=(number,))
    document = {"rows": [{"name": "b", "value": [9.0]}, {"name": "a", "value": [value]}]}
    assert bool(outside(row, document)) is is_outside
    bound = row.model_copy(update={"numbers": (number.model_copy(update={"at_most": True, "tolerance": 0.0}),)})
    assert bool(outside(bound, document)) is (value > 1.0)


def test_a_fitted_number_is_held_but_not_called_reproduced() -> None:
    fitted = [row for paper in PAPERS for row in coverage(paper).rows if row.status is Status.FITTED]
    assert len(fitted) == 5 and all(row.numbers and row.reason for row in fitted)
    with pytest.raises(ValueError, match="fitted within which tolerance"):
        number = Number(at=("a",), paper=1.0)
        Row(item="x", shows="x", status=Status.FITTED, command="obu papers toll", reason="y", numbers=(number,))


@pytest.mark.parametrize("paper", PAPERS)
def test_a_reproduced_bound_is_not_far_above_ours(paper: str) -> None:
    """A bound that anything smaller meets shows nothing: ours has to be at least half of it."""
    result = stored(paper)
    bounds = [
        number
        for row in coverage(paper).rows
        if row.status is Status.REPRODUCED
        for number in row.numbers
        if number.at_most
    ]
    assert all(value_at(result, number.at) >= 0.5 * number.paper for number in bounds)


def test_a_result_has_later_commits_or_is_unknown() -> None:
    assert later_commits("HEAD") in (0, None), "None without a clone"
    assert later_commits("--all") is None and later_commits("0123456789abcdef") is None


def test_what_is_not_there_or_not_complete_is_an_error() -> None:
    with pytest.raises(KeyError):
        value_at({"a": [1.0]}, ("a", 3))
    with pytest.raises(KeyError):
        value_at({"a": "text"}, ("a",))
    with pytest.raises(ValueError, match="which command"):
        Row(item="figure 1", shows="x", status=Status.REPRODUCED)
    with pytest.raises(ValueError, match="which function of a test"):
        Row(item="x", shows="x", status=Status.REPRODUCED, command="obu papers toll", test="file.py")
    with pytest.raises(ValueError, match="no reason"):
        Row(item="figure 1", shows="x", status=Status.DIFFERS)
    with pytest.raises(UserError, match="choose of"):
        coverage("atlantis")


@pytest.mark.parametrize("paper", PAPERS)
def test_what_is_reproduced_without_a_number_names_its_test_and_ours_is_never_the_papers_own(paper: str) -> None:
    for row in coverage(paper).rows:
        if row.status is Status.REPRODUCED and not row.numbers:
            assert row.test in cells(paper, row)[-1]
        assert not any("published" in map(str, number.at) for number in row.numbers), "that is not computed"


def test_the_lists_are_printed_with_the_texts_numbers_beside_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert listed(None, json=False) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for paper in PAPERS:
        assert coverage(paper).title.split(":")[0] in printed
    assert "70 s: ours 70" in printed
    assert listed("toll", json=True) == 0
    document = json.loads(capsys.readouterr().out)
    assert document.keys() == {"toll"} and document["toll"]["result"]["paper"] == "toll"
