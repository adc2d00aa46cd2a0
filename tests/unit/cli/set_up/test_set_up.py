"""`obu set-up` on a drive of tables: what it prints and writes, and its certificate."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import import_drive
from cli.set_up.certificate import verify_set_up
from cli.set_up.set_up import set_up
from services.sensors.simulator.drive import simulate
from shared.errors import UserError
from shared.evidence.ring import KeyRing
from shared.runtime.config import load_vehicle
from tests.support.drives.csv_drive import LATE_S, write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five minutes in a car park; samples are stamped 0.03 s late, and the lever arm is said to be zero."""
    folder = tmp_path_factory.mktemp("drive")
    mapping = write_drive(folder, simulate("parking_lot", 5, 300.0))
    (folder / "made.toml").write_text('[vehicle]\nname = "made" # a comment\n')
    mapping.write_text(mapping.read_text().replace(f"stamps_late_s = {LATE_S}\n", ""))
    import_drive(mapping, folder, folder / "drive.mcap")
    return folder / "drive.mcap"


@pytest.fixture
def keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "state").mkdir()
    monkeypatch.setenv("OBU_STATE", str(tmp_path / "state"))
    monkeypatch.delenv("OBU_KEYS", raising=False)
    yield tmp_path / "state" / "keys"


def test_a_drive_proposes_settings_writes_them_and_agrees_with_them_afterwards(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "better.toml"
    assert set_up(drive, out=out, as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    rows = {row["quantity"]: row for row in found["findings"]}
    assert rows["mounting"]["verdict"] == "agrees" and not rows["mounting"]["changes"]
    assert rows["lever_arm"]["verdict"] == "contradicts"
    assert "# a comment" in out.read_text()
    vehicle = load_vehicle(out)
    assert vehicle.facts.gnss.lever_arm_body_m[:2] == pytest.approx((0.3, 0.0), abs=0.1)
    assert vehicle.tables["core.fusion"]["gnss"]["delay_s"] == pytest.approx(-LATE_S, abs=0.01)  # type: ignore[index]
    assert set_up(drive, vehicle=out, as_json=True) == 0
    again = {row["quantity"]: row for row in json.loads(capsys.readouterr().out)["findings"]}
    assert {again[name]["verdict"] for name in ("mounting", "lever_arm", "delay")} == {"agrees"}


@pytest.mark.slow
def test_proposals_are_compared_with_the_present_settings_on_the_drive(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set_up(drive, compare=True, as_json=True) == 0
    innovations = json.loads(capsys.readouterr().out)["innovations"]
    assert innovations["after"]["gnss_velocity"] < innovations["before"]["gnss_velocity"]


def test_what_is_found_is_printed_as_a_table_with_the_settings_to_write(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set_up(drive) == 0
    said = capsys.readouterr().out
    assert "lever arm of the" in said and "vehicle.gnss.lever_arm_body_m = [" in said


def test_a_certificate_is_genuine_until_one_letter_of_it_is_changed(
    drive: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    certificate = tmp_path / "made.json"
    assert set_up(drive, certificate=certificate) == 0
    assert verify_set_up(certificate) == 0
    fields = json.loads(certificate.read_text())
    assert fields["vehicle"] == "made" and "contradicts" in fields["finding lever_arm"]
    other = KeyRing(())
    other.write(tmp_path / "ring.json")
    assert verify_set_up(certificate, key=[tmp_path / "ring.json"]) == 1
    certificate.write_text(json.dumps({**fields, "vehicle": "mode"}))
    assert verify_set_up(certificate) == 1
    assert "does not fit" in capsys.readouterr().out


def test_a_certificate_is_printed_as_a_page(drive: Path, keys: Path, tmp_path: Path) -> None:
    assert set_up(drive, certificate=tmp_path / "made.pdf") == 0
    assert (tmp_path / "made.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("text", ["", "[]", '{"vehicle": 1}', '{"vehicle": "car"}', "\x00"])
def test_what_is_no_certificate_is_an_error_or_not_genuine(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    try:
        assert verify_set_up(path) == 1
    except UserError as error:
        assert "certificate" in str(error)


def test_files_that_are_there_are_not_overwritten(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "there").write_text("mine")
    for option in ("out", "certificate"):
        with pytest.raises(UserError, match="already exists"):
            set_up(drive, **{option: tmp_path / "there"})  # type: ignore[arg-type]
    assert np.array_equal((tmp_path / "there").read_text(), "mine")
