"""`obu keys`, as a person uses it."""

from pathlib import Path

import pytest

from cli import keys
from shared.errors import UserError


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.delenv("OBU_CREDENTIALS", raising=False)
    monkeypatch.delenv("OBU_VEHICLE", raising=False)
    return tmp_path


def test_keys_are_made_listed_added_removed_and_replaced(state: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert keys.make(None, None, None) == 0
    before = (state / "credentials" / "core.fusion").read_text()
    capsys.readouterr()
    keys.show()
    listed = capsys.readouterr().out
    assert "core.fusion" in listed and "observer.8" in listed and before.strip() not in listed
    keys.add("gateway")
    added = capsys.readouterr().out
    secret = (state / "credentials" / "readers" / "gateway").read_text().strip()
    assert f"mqtt://gateway:{secret}@" in added and "reload" in added
    assert "gateway:" in (state / "rules" / "passwords").read_text()
    keys.rotate(None)
    assert (state / "credentials" / "core.fusion").read_text() != before
    assert (state / "credentials" / "readers" / "gateway").read_text().strip() != secret
    keys.remove("gateway")
    assert "gateway:" not in (state / "rules" / "passwords").read_text()


@pytest.mark.parametrize(
    "name", ["core.fusion", "observer.1", "../x", "", "A", "a" * 49, "x y", "$7$", "replay", "observer", "address"]
)
def test_a_name_that_is_none_or_of_the_unit_is_refused(name: str) -> None:
    keys.make(None, None, None)
    with pytest.raises(UserError, match="is no name of a reader"):
        keys.add(name)


def test_what_is_missing_is_said_with_what_to_do() -> None:
    with pytest.raises(UserError, match="obu keys make"):
        keys.show()
    keys.make(None, None, None)
    with pytest.raises(UserError, match="obu keys list"):
        keys.remove("nobody")
    with pytest.raises(UserError, match="obu keys list"):
        keys.rotate("nobody")
    with pytest.raises(UserError, match="install"):
        keys.make(None, None, None, "no-such-group")


def test_what_is_not_given_again_stays(state: Path) -> None:
    vehicle = state / "car.toml"
    vehicle.write_text('[vehicle]\nname = "car"\n')
    keys.make(vehicle, state / "files", None)
    keys.make(None, None, None)
    assert "obu/car/" in (state / "files" / "acl.conf").read_text() and not (state / "rules").exists()
    keys.add("gateway")
    assert "gateway:" in (state / "files" / "passwords").read_text()


@pytest.mark.parametrize("name", ["../core.trust", "..", ".", "", "core.trust", "made.json"])
def test_only_a_reader_is_removed(state: Path, name: str) -> None:
    keys.make(None, None, None)
    before = sorted(path.name for path in (state / "credentials").iterdir())
    with pytest.raises(UserError, match="obu keys list"):
        keys.remove(name)
    assert sorted(path.name for path in (state / "credentials").iterdir()) == before


def test_a_file_in_place_of_a_folder_is_said(state: Path) -> None:
    (state / "file").touch()
    with pytest.raises(UserError):
        keys.make(None, state / "file", None)


@pytest.mark.parametrize("role", ["operator", "detector"])
def test_a_program_of_a_plaza_gets_the_rights_of_its_role(
    state: Path, capsys: pytest.CaptureFixture[str], role: str
) -> None:
    keys.make(None, None, None)
    keys.add("office", role)
    assert "mqtt://office:" in capsys.readouterr().out
    rules = (state / "rules" / "acl.conf").read_text().split("user office\n")[1].split("user ")[0]
    assert "topic write" in rules and "#" not in rules
    keys.show()
    assert f"office                   {role} (obu keys add)" in capsys.readouterr().out
    with pytest.raises(UserError, match="has the role"):
        keys.add("office")
    with pytest.raises(UserError, match="the roles are"):
        keys.add("other", "owner")
    keys.rotate("office")
    keys.remove("office")
    assert "user office" not in (state / "rules" / "acl.conf").read_text()
