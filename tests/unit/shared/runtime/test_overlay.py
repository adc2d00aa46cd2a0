"""The text that holds in the place of a vehicle's file, and who notices that it does."""

from pathlib import Path

import pytest

from shared.messages.settings import SettingsState
from shared.runtime.config import load_vehicle
from shared.runtime.overlay import FILE, over, settings_folder
from shared.settings.held import HeldSettings

SHIPPED = '[vehicle]\nname = "car"\n'
CHANGED = '[vehicle]\nname = "car"\nalert_limit_horizontal_m = 3.0\n'


@pytest.fixture
def vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "vehicle.toml"
    path.write_text(SHIPPED)
    monkeypatch.setenv("OBU_VEHICLE", str(path))
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    folder = settings_folder(tmp_path)
    folder.mkdir()
    (folder / FILE).write_text(over(CHANGED, SHIPPED))
    return path


def test_the_changed_text_holds_as_long_as_the_file_is_the_one_that_it_was_made_from(vehicle: Path) -> None:
    assert load_vehicle().text == CHANGED and load_vehicle().path == str(vehicle)
    vehicle.write_text(SHIPPED + "# edited by hand\n")
    assert load_vehicle().facts.alert_limit_horizontal_m == 10.0


def test_a_file_that_is_named_is_read_as_it_is(vehicle: Path) -> None:
    assert load_vehicle(vehicle).text == SHIPPED


@pytest.mark.parametrize("content", [b"", b"\xff", b"[vehicle", over("", "another").encode(), b"#" * 300_000])
def test_a_changed_text_that_cannot_be_read_or_is_of_another_file_does_not_hold(vehicle: Path, content: bytes) -> None:
    (settings_folder(vehicle.parent) / FILE).write_bytes(content)
    assert load_vehicle().text == SHIPPED


def announced(digest: str) -> SettingsState:
    return SettingsState(sampled_ns=1, digests={"core.fusion": digest})


def test_a_process_ends_only_if_its_next_life_has_other_settings() -> None:
    now = "a" * 16
    held = HeldSettings("a" * 16, lambda: now)
    assert not held.note("core.fusion", announced("a" * 16))
    assert not held.note("core.fusion", announced("b" * 16)), "the file says what it has"
    assert not held.note("core.trust", announced("b" * 16)), "of another process"
    now = "b" * 16
    assert held.note("core.fusion", announced("b" * 16)) and held.have_changed
    assert not HeldSettings().note("core.fusion", announced("b" * 16)), "a program that has no settings"
