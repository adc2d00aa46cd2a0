"""What `obu support` collects, and what it leaves out."""

import json
import zipfile
from pathlib import Path

import pytest

from cli.support import support, without_secrets
from shared.errors import UserError
from shared.recording import Recording
from tests.support.drives.meridian import record

VEHICLE = """[vehicle]
name = "car"
[sensors.corrections]
sources = ["ntrip://anna:hush@caster.example:2101/MOUNT"]
"""


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE)
    for name, value in (("OBU_VEHICLE", vehicle), ("OBU_STATE", tmp_path), ("OBU_BROKER", "mqtt://127.0.0.1:9")):
        monkeypatch.setenv(name, str(value))
    (tmp_path / "recordings").mkdir()
    record(tmp_path / "recordings" / "20231114T221320Z_car.mcap", 120)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "core.fusion.log").write_text("connected to mqtt://anna:hush@127.0.0.1\n")
    return tmp_path


def collected(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_it_holds_what_helps_and_no_secret(state: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = state / "help.zip"
    assert support(out, minutes=0.5) == 0
    found = collected(out)
    assert {"README.txt", "about.json", "doctor.txt", "vehicle.toml", "health.json", "last.mcap"} <= found.keys()
    assert not [name for name, content in found.items() if b"hush" in content]
    assert b"caster.example:2101" in found["vehicle.toml"] and b"connected" in found["logs/core.fusion.log"]
    assert b"[core.fusion]" in found["doctor.txt"] and json.loads(found["about.json"])["obu"]
    assert "nothing was sent" in capsys.readouterr().out

    (state / "last.mcap").write_bytes(found["last.mcap"])
    with Recording(state / "last.mcap") as part, Recording(next((state / "recordings").glob("*.mcap"))) as whole:
        stamps = [envelope.received_ns for envelope in part]
        assert [e.received_ns for e in whole][-len(stamps) :] == stamps, "the end of it, complete"
        assert 25e9 < stamps[-1] - stamps[0] <= 30e9
    assert not list(state.glob(".obu-support*")), "no draft is left"


def test_without_minutes_it_does_not_say_where_the_vehicle_was(state: Path) -> None:
    support(state / "help.zip", minutes=0.0)
    assert "last.mcap" not in collected(state / "help.zip")


def test_a_broken_recording_or_file_costs_itself_alone(state: Path) -> None:
    for path in (state / "recordings").glob("*.mcap"):
        path.write_bytes(b"no recording")
    (state / "vehicle.toml").write_text("[vehicle")
    support(state / "help.zip", minutes=1.0)
    found = collected(state / "help.zip")
    assert b"not valid TOML" in found["vehicle.toml"] and b"NO" in found["doctor.txt"]


def test_a_file_that_exists_is_not_overwritten(state: Path) -> None:
    (state / "help.zip").write_text("mine")
    with pytest.raises(UserError, match="exists already"):
        support(state / "help.zip", minutes=0.0)
    assert (state / "help.zip").read_text() == "mine"


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        ('password = "hush"', False),
        ('api_token = "hush"', False),
        ("wifi_passphrase = 'hush'", False),
        ('device = "tcp://anna:hush@10.0.0.1:80"', False),
        ('name = "hush"', True),
    ],
)
def test_values_that_are_secrets_are_left_out(line: str, kept: bool) -> None:
    assert ("hush" in without_secrets(f"[a]\n{line}\n")) is kept
