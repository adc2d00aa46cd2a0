"""`obu papers cooperative` with 60 runs instead of 500; with 500 it is marked slow."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cli.papers.cooperative import (
    ALERT_LIMIT_M,
    ASSUMPTIONS,
    Sensitivity,
    deviations,
    mean_rates,
    reproduce,
    sensitivity,
    splits,
)
from cli.papers.report import Paper, publish
from services.core.cooperative.paper.monte_carlo import RATIOS, Rates, row

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def paper() -> Paper:
    return reproduce(6, progress=False)


def test_the_command_prints_every_ratio_and_writes_figures(
    paper: Paper, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(paper, json=True, out=tmp_path)
    document = json.loads(capsys.readouterr().out)
    assert [item["ratio"] for item in document["ratios"]] == list(RATIOS)
    assert document["mean"]["published"] == pytest.approx([2.83, 0.457, 47.27], abs=0.005)
    assert set(document["sensitivities"]) == {assumption.name for assumption in ASSUMPTIONS}
    assert len(list(tmp_path.glob("*.svg"))) == 4


def test_white_errors_of_the_reference_do_not_change_the_missed_ramp() -> None:
    chosen = [assumption for assumption in ASSUMPTIONS if assumption.reference_error_m is not None]
    assert len(chosen) == 4
    for assumption in chosen:
        assert sensitivity(assumption, 500).rates.missed_ramp == pytest.approx(assumption.missed_ramp, abs=1.5), (
            assumption.name
        )


def test_the_four_highest_satellites_as_real_ones_make_the_test_blind_for_the_step() -> None:
    found = splits()
    assert found["as fitted"].local_m == pytest.approx([28.02, 20.31, 20.22, 27.43], abs=0.02)
    assert found["as fitted"].baarda_m == pytest.approx([21.72, 16.97, 17.38, 21.32], abs=0.02)
    assert found["as fitted"].hpl_m == pytest.approx(20.657, abs=0.01)
    assert all(67.0 < value < 116.0 for value in found["four highest real"].local_m)


def test_virtual_satellites_that_are_chosen_anew_have_a_level_within_the_limit_and_sharper_tests() -> None:
    found = splits()
    assert found["as fitted"].hpl_m > ALERT_LIMIT_M and found["four highest real"].hpl_m > ALERT_LIMIT_M
    assert found["chosen anew"].hpl_m <= ALERT_LIMIT_M
    assert max(found["chosen anew"].local_m) < 20.0


def test_what_was_fitted_and_what_is_not_reproduced_is_in_the_json(
    paper: Paper, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(paper, json=True, out=None)
    document = json.loads(capsys.readouterr().out)
    remarks = " ".join(document["not_reproduced"])
    assert document["fitted"] and "0.36 % on average in the text, 0.457 %" in remarks
    assert "Missed step at a ratio of 1.0" in remarks and "published 1.08 %" in remarks


def test_numbers_outside_the_tolerance_are_deviations() -> None:
    one = row(5, runs=60)
    poor = replace(one, open_loop=Rates(4.0, 0.4, 43.9), leave_one_out=Rates(0.5, 0.1, 61.0))
    better = replace(one, open_loop=Rates(0.0, 0.0, 0.0), leave_one_out=Rates(0.0, 0.0, 0.0))
    assert deviations([better], [Sensitivity(ASSUMPTIONS[0], Rates(0.0, 0.0, 0.0))]) == [], "better is no deviation"
    changed = Sensitivity(ASSUMPTIONS[0], Rates(0.0, 0.0, ASSUMPTIONS[0].missed_ramp + 1.6))
    texts = deviations([poor], [changed])
    assert len(texts) == 4, "false alarms of the open loop, the ramp of the bank twice, one assumption"
    assert mean_rates([one, poor], "leave_one_out").missed_step == pytest.approx(
        0.5 * (one.leave_one_out.missed_step + 0.1)
    )


def test_the_published_table_of_500_runs_is_within_its_tolerances() -> None:
    assert reproduce(500, progress=False).deviations == []
