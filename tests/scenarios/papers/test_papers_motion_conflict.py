"""`obu papers motion-conflict` with one drive of each kind instead of twenty."""

import json
from pathlib import Path

import pytest

from cli.papers.motion_conflict.drives import FAULTS
from cli.papers.motion_conflict.paper import is_worse, reproduce
from cli.papers.report import Paper, publish

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Paper:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OBU_DATA", str(tmp_path_factory.mktemp("none")))
        return reproduce(1, progress=False)


def test_the_published_break_points_are_reproduced_and_nothing_is_detected_without_a_fault(paper: Paper) -> None:
    assert paper.deviations == []
    drives = paper.document["drives"]
    assert isinstance(drives, dict) and set(drives) == {"highway", "urban"}
    for kind in drives.values():
        assert set(kind["detections"]) == set(FAULTS)
        assert kind["detections"]["none"]["trimmed_mean_above"] == 0
    assert drives["highway"]["detections"]["scale -30 %"]["trimmed_mean_above"] > 0
    assert drives["urban"]["detections"]["delay 10 s"]["median_above"] > 0


def test_both_speeds_falsified_alike_pass_the_tachographs_test_and_are_found_in_bends(paper: Paper) -> None:
    alike = paper.document["falsified_alike"]
    assert isinstance(alike, dict) and set(alike) == {"highway", "urban"}
    for runs in alike.values():
        by_factor = {run["factor"]: run for run in runs}
        assert by_factor[1.0]["bends"] is None
        assert all(run["trimmed_mean_above"] == 0 for run in runs), "the difference of both speeds stays as it was"
    town = {item["factor"]: item for item in alike["urban"]}
    assert town[1.1]["bends"] <= 5 and town[1.1]["suspect_time_before_it"]
    assert town[1.03]["bends"] is not None


def test_break_points_of_drives_that_were_not_fitted_are_listed_beside_the_published_ones(paper: Paper) -> None:
    assert paper.fitted
    texts = [text for text in paper.not_reproduced if "were not fitted" in text]
    assert any(text.startswith("highway") and "delay, median" in text and "published 6" in text for text in texts)


def test_an_absent_recording_is_skipped_with_a_remedy(paper: Paper) -> None:
    assert len(paper.skipped) == 3
    assert all("set OBU_DATA" in text for text in paper.skipped)


def test_figures_and_json_are_written(paper: Paper, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert publish(paper, json=True, out=tmp_path) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["break_points"]["highway"]["bias"] == 70.0 and document["deviations"] == []
    assert {path.name for path in tmp_path.iterdir()} == {
        "sweeps.svg", "nominal-differences.svg", "tunnels.svg", "correlation-of-both-speeds.svg",
        "histograms-of-the-statistics.svg", "result.json",
    }  # fmt: skip


def test_a_number_outside_its_tolerance_fails_the_command(paper: Paper, capsys: pytest.CaptureFixture[str]) -> None:
    off = Paper(paper.name, paper.tables, paper.document, deviations=["delay [s] at 9 s"])
    assert publish(off, json=False, out=None) == 1
    printed = capsys.readouterr().out
    assert "delay [s] at 9 s" in printed and "all limits met" not in printed


@pytest.mark.parametrize(
    ("name", "ratio", "worse"),
    [("delay, MT", 1.26, True), ("delay, MT", 0.1, False), ("bias", 1.25, False), ("scale, median", 1.3, True),
     ("gap, median", 0.74, True), ("gap, median", 3.0, False)],
)  # fmt: skip
def test_break_points_may_only_be_better(name: str, ratio: float, worse: bool) -> None:
    assert is_worse(name, ratio) is worse


@pytest.mark.recording
def test_on_the_recordings_no_window_is_above_10_km_h_and_both_systems_have_positions() -> None:
    from cli.papers.motion_conflict.constellations import PHONE, STATION, compare_phone, station_speeds
    from cli.papers.motion_conflict.drives import RECORDING, recorded
    from cli.papers.motion_conflict.sweeps import with_scale
    from tests.support.data import recording

    nominal = with_scale(recorded(recording(RECORDING)), 0.0)
    assert nominal.mean < 0.85 and nominal.mean_above == nominal.median_above == 0
    phone = compare_phone(recording(PHONE))
    assert min(phone.epochs.values()) > 0.95 * phone.total
    assert phone.largest_mean_km_h < 10.0, "positions 5 s apart, 5.9 km/h were measured"
    assert max(station_speeds(recording(STATION))) < 0.2, "km/h over 30 s"
