"""`obu config` on a file: what it prints, writes, refuses and takes back."""

import json
from pathlib import Path

import pytest

from cli.config import config
from shared.errors import ConfigError, UserError
from shared.settings.history import KEPT, History
from tests.support.drives.golden import VEHICLE

DELAY = "core.fusion.gnss.delay_s"


@pytest.fixture
def car(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "car.toml"
    path.write_text(VEHICLE.read_text())
    monkeypatch.setenv("OBU_VEHICLE", str(path))
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    return path


def test_a_change_is_shown_written_and_taken_back(car: Path, capsys: pytest.CaptureFixture[str]) -> None:
    former = car.read_text()
    assert config.set_values([f"{DELAY}=0.08", "vehicle.gnss.lever_arm_sd_m = 0.03"]) == 0
    said = capsys.readouterr().out
    assert f"{DELAY}: 0.0 -> 0.08" in said and "lever_arm_sd_m: 0.02 -> 0.03" in said
    assert "start again, for it to hold: " in said and "core.fusion" in said
    assert "# the simulated antenna is there" in car.read_text()
    assert config.history() == 0 and config.diff() == 1
    assert "settings differ" in capsys.readouterr().out
    assert config.undo() == 0 and car.read_text() == former
    assert config.undo() == 0 and "delay_s = 0.08" in car.read_text(), "what was undone can return"
    assert config.unset([DELAY]) == 0 and f"{DELAY}: 0.08 -> 0.0" in capsys.readouterr().out


def test_a_dry_run_and_a_value_that_stands_already_write_nothing(car: Path, capsys: pytest.CaptureFixture[str]) -> None:
    former, stamp = car.read_text(), car.stat().st_mtime_ns
    assert config.set_values([f"{DELAY}=0.08"], dry_run=True) == 0
    assert config.set_values(["vehicle.gnss.lever_arm_sd_m=0.02"]) == 0
    assert (car.read_text(), car.stat().st_mtime_ns) == (former, stamp)
    assert "nothing is written" in capsys.readouterr().out
    assert config.history() == 0 and "nothing was changed" in capsys.readouterr().out


@pytest.mark.parametrize("change", [f"{DELAY}=9", f"{DELAY}=abc", "core.fusion.nothing=1", DELAY, "vehicle.role=boat"])
def test_a_wrong_change_is_an_error_and_the_file_stays(car: Path, change: str) -> None:
    former = car.read_text()
    with pytest.raises((UserError, ConfigError)):
        config.set_values([change])
    assert car.read_text() == former


def test_a_file_that_is_not_there_or_cannot_be_written_is_an_error_with_what_to_try(
    car: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match="--vehicle"):
        config.get(DELAY, vehicle=tmp_path / "other.toml")
    monkeypatch.setenv("OBU_STATE", str(car / "state"))  # below a file
    with pytest.raises(UserError, match=r"OBU_STATE|cannot write"):
        config.set_values([f"{DELAY}=0.08"])
    monkeypatch.delenv("OBU_VEHICLE")
    with pytest.raises(UserError, match="OBU_VEHICLE"):
        config.get(DELAY)


def test_ten_earlier_texts_are_kept_in_private_files(tmp_path: Path) -> None:
    history = History(tmp_path / "settings")
    for number in range(KEPT + 3):
        history.keep(f"# {number}\n")
    texts = [version.text() for version in history.versions()]
    assert texts == [f"# {number}\n" for number in range(KEPT + 2, 2, -1)]
    assert all(version.path.stat().st_mode & 0o777 == 0o600 for version in history.versions())
    gone = history.versions()[0]
    gone.path.unlink()
    with pytest.raises(UserError, match="history"):
        gone.text()


def test_an_earlier_text_that_does_not_exist_is_an_error(car: Path) -> None:
    assert config.set_values([f"{DELAY}=0.08"], vehicle=car) == 0
    with pytest.raises(UserError, match="lists 1"):
        config.undo(2)


def test_the_list_finds_by_name_and_meaning_and_hides_passwords(car: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert config.list_settings("lever arm", json=True) == 0
    names = [row["name"] for row in json.loads(capsys.readouterr().out)]
    assert "vehicle.gnss.lever_arm_body_m" in names and DELAY not in names
    assert config.list_settings(changed=True, json=True) == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(row["value"] != row["default"] for row in rows) and len(rows) > 5
    assert config.list_settings("no such thing") == 1
    car.write_text('[sensors.corrections]\ncasters = [{ url = "ntrip://me:secret@caster.example:2101/MOUNT" }]\n')
    shown = config._shown("ntrip://me:secret@caster.example:2101/MOUNT")
    assert "secret" not in shown and "caster.example" in shown


def test_the_value_of_a_setting_is_printed_with_its_bounds(car: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert config.get(DELAY) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{DELAY} = 0.0\n") and "at least -2.0" in said
    assert config.get("vehicle.role", json=True) == 0
    assert json.loads(capsys.readouterr().out)["choices"] == ["obu", "rsu"]
