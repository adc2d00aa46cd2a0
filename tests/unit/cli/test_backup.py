"""A backup makes another machine the same unit, and is read as bytes of a stranger."""

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cli import backup as module
from cli.backup import backup, read_backup, reset, restore
from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from shared import shipped
from shared.errors import UserError
from shared.evidence import KeyFile
from shared.runtime.overlay import over, settings_folder

VEHICLE = """[vehicle]
name = "car"
[core.fusion.gnss]
delay_s = 0.05 # measured
"""


def unit(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str = VEHICLE) -> Path:
    """A unit's folders, which the environment names."""
    folder.mkdir()
    (folder / "vehicle.toml").write_text(text)
    monkeypatch.setenv("OBU_VEHICLE", str(folder / "vehicle.toml"))
    monkeypatch.setenv("OBU_STATE", str(folder))
    return folder


@pytest.fixture
def first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = unit(tmp_path / "first", monkeypatch)
    (folder / "saved-trust-record.json").write_text('{"learned": 1}')
    KeyFile(folder / "keys").signer()
    Tokens(folder).add("workshop", Right.VIEW)
    (folder / "recordings").mkdir()
    (folder / "recordings" / "drive.mcap").write_bytes(b"drive")
    return folder


def key_of(folder: Path) -> str:
    return KeyFile(folder / "keys").signer().key_id


def test_another_machine_becomes_the_unit(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backup(tmp_path / "b.zip")
    assert (tmp_path / "b.zip").stat().st_mode & 0o777 == 0o600, "it holds the key"
    key = key_of(first)
    second = unit(tmp_path / "second", monkeypatch, "# of the card\n")
    restore(tmp_path / "b.zip")
    assert key_of(second) == key and (second / "saved-trust-record.json").read_text() == '{"learned": 1}'
    assert (second / "vehicle.toml").read_text() == VEHICLE, "with its comments"
    assert (second / "vehicle.toml.old").read_text() == "# of the card\n"
    assert [token.name for token in Tokens(second).content().tokens] == ["workshop"]
    assert (second / "keys" / "evidence.key").stat().st_mode & 0o077 == 0


def test_what_the_page_has_changed_is_what_is_kept(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = VEHICLE.replace("0.05", "0.07")
    settings_folder(first).mkdir()
    (settings_folder(first) / "vehicle.toml").write_text(over(changed, VEHICLE))
    backup(tmp_path / "b.zip")
    second = unit(tmp_path / "second", monkeypatch)
    settings_folder(second).mkdir()
    (settings_folder(second) / "vehicle.toml").write_text(over("# of another unit", VEHICLE))
    restore(tmp_path / "b.zip")
    assert "delay_s = 0.07" in (second / "vehicle.toml").read_text()
    assert not (settings_folder(second) / "vehicle.toml").exists(), "the restored file holds"


def test_without_keys_it_speaks_for_nobody(first: Path, tmp_path: Path) -> None:
    backup(tmp_path / "b.zip", without_keys=True)
    _, _, files = read_backup(tmp_path / "b.zip")
    assert [name for name, _, _ in files] == ["state/saved-trust-record.json"]


def test_check_changes_nothing(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backup(tmp_path / "b.zip")
    second = unit(tmp_path / "second", monkeypatch)
    restore(tmp_path / "b.zip", check=True)
    assert [path.name for path in second.iterdir()] == ["vehicle.toml"]


def rewritten(source: Path, target: Path, change: Callable[[dict[str, bytes]], object]) -> Path:
    with zipfile.ZipFile(source) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return target


def about_with(**row: object) -> Callable[[dict[str, bytes]], None]:
    """A change of the list of files: of its first row."""

    def change(files: dict[str, bytes]) -> None:
        about = json.loads(files["about.json"])
        content = files.get(about["files"][0]["name"], b"")
        about["files"][0].update(row)
        files[str(row.get("name", "x"))] = content
        files["about.json"] = json.dumps(about).encode()

    return change


CHANGES: dict[str, Callable[[dict[str, bytes]], object]] = {
    "a path out of its folder": about_with(name="keys/../x.json"),
    "an absolute path": about_with(name="/etc/passwd"),
    "a place that is none": about_with(name="boot/config.txt"),
    "a name that no unit has": about_with(name="state/authorized_keys"),
    "a changed key": lambda files: files.update({"keys/evidence.key": b"another"}),
    "changed settings": lambda files: files.update({"vehicle.toml": b"[vehicle]"}),
    "a missing file": lambda files: files.pop("keys/evidence.key"),
    "no list": lambda files: files.update({"about.json": b"[]"}),
    "a bomb": lambda files: files.update({"vehicle.toml": bytes(50_000_000)}),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_backup_that_was_changed_restores_nothing(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    backup(tmp_path / "b.zip")
    bad = rewritten(tmp_path / "b.zip", tmp_path / "bad.zip", CHANGES[name])
    second = unit(tmp_path / "second", monkeypatch)
    with pytest.raises(UserError, match="is no whole backup"):
        restore(bad)
    assert [path.name for path in second.iterdir()] == ["vehicle.toml"]


def test_no_zip_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(os.urandom(100))
    with pytest.raises(UserError, match="is no whole backup"):
        read_backup(tmp_path / "b.zip")
    with pytest.raises(UserError, match="obu backup"):
        read_backup(tmp_path / "none.zip")


def test_a_reset_keeps_drives_and_the_key(first: Path) -> None:
    key = key_of(first)
    assert reset(yes=True) == 0
    assert key_of(first) == key and (first / "recordings" / "drive.mcap").exists()
    assert not (first / "saved-trust-record.json").exists() and not Tokens(first).content().tokens
    assert "obu-gnss" in (first / "vehicle.toml").read_text(), "the file that is shipped"
    assert (first / "vehicle.toml.old").read_text() == VEHICLE


def test_before_it_is_passed_on_everything_goes(first: Path) -> None:
    key = key_of(first)
    reset(everything=True, yes=True)
    assert not list((first / "recordings").iterdir()) and key_of(first) != key


def test_a_running_unit_is_left_alone(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backup(tmp_path / "b.zip")
    monkeypatch.setattr(module, "_insist_on_rest", running)
    with pytest.raises(UserError, match="stop it"):
        restore(tmp_path / "b.zip")
    with pytest.raises(UserError, match="stop it"):
        reset(yes=True)
    assert (first / "vehicle.toml").read_text() == VEHICLE


def running(_state: Path) -> None:
    raise UserError("the unit runs; stop it first")


def test_before_it_is_passed_on_nothing_that_was_replaced_or_reported_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = tmp_path / "stick"
    folder = unit(tmp_path / "first", monkeypatch, f'{VEHICLE}[monitoring.recorder]\nfolder = "{drives}"\n')
    monkeypatch.setattr(module, "STATE", folder)
    monkeypatch.setattr(module, "BACKUPS", tmp_path / "backups")
    names = ["keys/evidence.key", "keys/evidence.key.old", "tokens.json.old", "uplink/outbox.sqlite", "logs/core.log",
             "uplink/tls.pem.old", "recordings/a.mcap", "toll/ledger.sqlite-wal", "saved-x.json.old",
             "vehicle.toml.old"]  # fmt: skip
    gone = [folder / name for name in names] + [drives / "b.mcap", tmp_path / "backups" / "before-upgrade-1.zip"]
    for path in gone:
        path.parent.mkdir(exist_ok=True)
        path.write_text("a secret")
    (drives / "photo.jpg").write_text("of another")
    assert reset(everything=True, yes=True) == 0
    assert not [path for path in gone if path.exists()]
    assert (drives / "photo.jpg").exists(), "no file of the recorder"


def test_settings_that_are_broken_can_be_reset(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, (text, kind) in enumerate({
        "[vehicle\nname=": "pi", '[vehicle]\nrole = "rsu"\n[[[': "rsu", "[sensors.simulator]\nx = [": "simulated",
        '[vehicle]\nrole = "tank"\n': "pi",
    }.items()):  # fmt: skip
        folder = unit(tmp_path / str(number), monkeypatch, text)
        assert reset(yes=True) == 0
        assert (folder / "vehicle.toml").read_bytes() == shipped(Path(f"deploy/vehicles/{kind}.toml")).read_bytes()
        assert (folder / "vehicle.toml.old").read_text() == text


def test_a_planted_link_leads_nowhere(first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backup(tmp_path / "b.zip")
    second = unit(tmp_path / "second", monkeypatch)
    target, elsewhere = tmp_path / "passwd", tmp_path / "elsewhere"
    target.write_text("root")
    elsewhere.mkdir()
    (elsewhere / "x.mcap").write_text("of another")
    (second / "saved-trust-record.json").write_text("planted")
    for name in ("saved-trust-record.json.old", "saved-trust-record.json.part", "saved-y.json", "tokens.json"):
        (second / name).symlink_to(target)
    (second / "recordings").symlink_to(elsewhere)
    restore(tmp_path / "b.zip")
    assert target.read_text() == "root" and (second / "saved-trust-record.json.old").read_text() == "planted"
    assert not (second / "tokens.json").is_symlink()
    backup(tmp_path / "c.zip")
    assert "state/saved-y.json" not in [name for name, _, _ in read_backup(tmp_path / "c.zip")[2]]
    reset(everything=True, yes=True)
    assert target.read_text() == "root" and (elsewhere / "x.mcap").exists()
    assert not (second / "recordings").is_symlink()


def test_a_restore_twice_keeps_what_was_there_first_and_its_rights(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    backup(tmp_path / "b.zip")
    second = unit(tmp_path / "second", monkeypatch, "# with a password\n")
    (second / "vehicle.toml").chmod(0o600)
    restore(tmp_path / "b.zip")
    restore(tmp_path / "b.zip")
    assert (second / "vehicle.toml.old").read_text() == "# with a password\n"
    assert (second / "vehicle.toml").stat().st_mode & 0o777 == 0o600


def test_a_ledger_of_another_name_goes_wherever_drives_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = '[vehicle]\nname = "plaza"\nrole = "rsu"\n[monitoring.ledger]\nfile = "books/own.sqlite"\n'
    folder = unit(tmp_path / "plaza", monkeypatch, text)
    (folder / "books").mkdir()
    (folder / "books" / "own.sqlite").write_bytes(b"ledger")
    reset(everything=True, yes=True)
    assert not (folder / "books" / "own.sqlite").exists()
