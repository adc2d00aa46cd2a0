"""`obu kpi` over recordings with and without a solution."""

import json
from functools import partial
from pathlib import Path

import pytest

from cli.import_drive.import_drive import import_drive
from cli.kpi.kpi import kpi
from cli.solve.solve import solve
from services.sensors.simulator.drive import simulate
from shared.errors import UserError
from tests.support.drives import meridian
from tests.support.drives.csv_drive import write_drive


def test_a_recorded_solution_is_evaluated_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = meridian.record(tmp_path / "drive.mcap", 60)
    assert kpi(path, out=tmp_path / "kpi.html", as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["solution"] == "as the unit gave it while it drove"
    assert found["solution_available_share"] > 0.9
    assert "usable_share" in (tmp_path / "kpi.html").read_text()


def test_a_drive_without_a_solution_is_solved_and_compared_with_its_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = write_drive(tmp_path, simulate("parking_lot", seed=3, duration_s=40.0))
    import_drive(mapping, tmp_path, tmp_path / "drive.mcap")
    capsys.readouterr()
    assert kpi(tmp_path / "drive.mcap", out=tmp_path / "kpi.html", as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["solution"].startswith("solved anew") and found["truth_count"] > 100
    assert found["fused_horizontal_p95_m"] < 3.0
    assert found["gnss_north_rmse_m"] is not None
    assert found["horizontal_within_level_share"] == 1.0 and found["horizontal_misleading_s"] == 0.0


def test_a_page_is_written_only_where_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = meridian.record(tmp_path / "drive.mcap", 20)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert kpi(path) == 0 and "--out kpi.html" in capsys.readouterr().out
    assert not list((tmp_path / "here").iterdir()) and len(list(tmp_path.iterdir())) == 2


def test_arguments_are_checked_before_a_recording_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = meridian.record(tmp_path / "drive.mcap", 20)  # its fixes are none of RTK

    def never(*_: object) -> None:
        raise AssertionError("it was solved")

    monkeypatch.setattr("cli.kpi.kpi._solved", never)
    monkeypatch.setattr("cli.solve.solve._run", never)
    for command in (partial(kpi, path, anew=True), partial(solve, path, out=tmp_path / "out")):
        with pytest.raises(UserError, match="no fix of the recording has RTK quality"):
            command(truth="fixes")
        with pytest.raises(UserError, match=r"cannot read the truth nowhere\.csv"):
            command(truth="nowhere.csv")
    with pytest.raises(UserError, match=r"there is no folder .*none; choose another path with --out"):
        kpi(path, anew=True, out=tmp_path / "none" / "kpi.html")
    assert not (tmp_path / "out").exists()


def test_what_is_no_recording_says_what_to_give(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("")
    with pytest.raises(UserError, match="give a file written by"):
        kpi(tmp_path / "x.mcap")
