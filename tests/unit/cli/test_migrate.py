"""`obu migrate` as a command."""

from pathlib import Path

import pytest

from cli.migrate import migrate
from shared.errors import UserError
from shared.runtime.config import load_vehicle

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
