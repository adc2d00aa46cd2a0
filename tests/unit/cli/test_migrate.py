"""`obu migrate` as a command."""

from pathlib import Path

import pytest

from cli.migrate import migrate
from shared.errors import UserError
from shared.runtime.config import load_vehicle
from shared.runtime.overlay import over, settings_folder, text_over

OLD = """[vehicle]
name = "car" # mine

[core.fusion.imu]
body_from_imu = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "car.toml"
    path.write_text(OLD)
    return path


def test_a_file_is_rewritten_and_its_former_text_kept(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.chmod(0o640)
    assert migrate(file) == 0
    assert load_vehicle(file).facts.imu.body_from_sensor == ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    assert file.with_name("car.toml.old").read_text() == OLD and "# mine" in file.read_text()
    assert file.stat().st_mode & 0o777 == 0o640
    assert "[core.fusion.imu] body_from_imu -> [vehicle.imu] body_from_sensor" in capsys.readouterr().out
    assert migrate(file) == 0 and "nothing is written" in capsys.readouterr().out
    assert file.with_name("car.toml.old").read_text() == OLD, "a second run does not replace what it keeps"


def test_check_writes_nothing_and_says_by_its_exit_code_whether_something_is_old(file: Path) -> None:
    assert migrate(file, check=True) == 1 and file.read_text() == OLD
    migrate(file)
    assert migrate(file, check=True) == 0


def test_another_file_is_written_on_request(file: Path, tmp_path: Path) -> None:
    assert migrate(file, output=tmp_path / "new.toml") == 0
    assert file.read_text() == OLD and load_vehicle(tmp_path / "new.toml").name == "car"


@pytest.mark.parametrize("text", [b"\xff\xfe", b"[vehicle", OLD.encode() + b"[core.spoofing]\ngrade = 'best'\n"])
def test_a_file_with_another_fault_is_named_and_left(file: Path, text: bytes) -> None:
    file.write_bytes(text)
    with pytest.raises(UserError, match=r"car\.toml"):
        migrate(file)
    assert file.read_bytes() == text and len(list(file.parent.iterdir())) == 1


@pytest.mark.parametrize("broken_off", [False, True])
def test_what_the_page_has_changed_holds_over_the_new_file(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken_off: bool
) -> None:
    monkeypatch.setenv("OBU_VEHICLE", str(file))
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    changed = settings_folder(tmp_path / "state") / "vehicle.toml"
    changed.parent.mkdir(parents=True)
    changed.write_text(over(OLD.replace('"car"', '"truck"'), OLD))
    changed.chmod(0o660)
    migrate(file)
    if broken_off:  # between the two files
        file.write_text(OLD)
        migrate(file)
    assert text_over(file.read_text(), tmp_path / "state") is not None
    assert load_vehicle().name == "truck" and "body_from_sensor" in changed.read_text()
    assert changed.stat().st_mode & 0o777 == 0o660


def test_changes_over_another_file_are_left(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OBU_VEHICLE", str(file))
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    changed = settings_folder(tmp_path / "state") / "vehicle.toml"
    changed.parent.mkdir(parents=True)
    changed.write_text(over(OLD, "# a file that was edited since"))
    before = changed.read_text()
    migrate(file)
    assert changed.read_text() == before and load_vehicle().name == "car"
