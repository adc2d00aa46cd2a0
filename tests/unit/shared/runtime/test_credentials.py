"""Which secret a process or a program finds, and what it is told where there is none for it."""

import os
from pathlib import Path

import pytest

from shared.errors import UserError
from shared.runtime import credentials, private
from shared.runtime.credentials import OBSERVERS, identity_of, observer_of, replay_of

HERE, THERE = "127.0.0.1:1883", "127.0.0.1:40000"


@pytest.fixture(autouse=True)
def nothing_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("CREDENTIALS_DIRECTORY", "OBU_CREDENTIALS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(credentials, "INSTALLED", tmp_path / "not-installed")


def test_secrets_of_an_installed_unit_are_in_a_folder_of_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(private, "STATE", tmp_path / "obu")
    monkeypatch.setattr(private, "PRIVATE", tmp_path / "obu-private")
    assert credentials.folder_of(tmp_path / "obu") == tmp_path / "obu" / "credentials"
    (tmp_path / "obu-private").mkdir()
    assert credentials.folder_of(tmp_path / "obu") == tmp_path / "obu-private" / "credentials"
    assert private.page_folder(tmp_path / "obu") == tmp_path / "obu-private" / "page"
    assert private.page_folder(tmp_path / "demo") == tmp_path / "demo"


def secrets(folder: Path, *names: str, address: str | None = None, mark: str = "") -> None:
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_text(f"{mark}secret of {name}\n")
    if address:
        (folder / "address").write_text(f"{address}\n")


def test_a_process_reads_its_own_and_systemd_is_asked_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert identity_of("core.fusion", tmp_path).secret is None
    secrets(tmp_path / "credentials", "core.fusion")
    assert identity_of("core.fusion", tmp_path).secret == "secret of core.fusion"
    secrets(tmp_path / "elsewhere", "core.fusion", mark="other ")
    monkeypatch.setenv("OBU_CREDENTIALS", str(tmp_path / "elsewhere"))
    assert identity_of("core.fusion", tmp_path).secret == "other secret of core.fusion"
    secrets(tmp_path / "systemd", "secret")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "systemd"))
    assert identity_of("core.fusion", tmp_path).secret == "secret of secret"


def test_programs_take_the_first_free_observer_of_the_broker_they_ask(tmp_path: Path) -> None:
    assert observer_of(tmp_path, HERE).secret is None, "a broker that checks nothing needs none"
    secrets(tmp_path / "credentials", *OBSERVERS, address=HERE)
    secrets(tmp_path / "demo" / "credentials", *OBSERVERS, address=THERE, mark="demo ")
    first, second = observer_of(tmp_path, HERE), observer_of(tmp_path, HERE)
    assert (first.user, second.user) == OBSERVERS[:2]
    there = observer_of(tmp_path, THERE)
    assert there.secret == "demo secret of observer.1"
    there.release()
    first.release()
    again = observer_of(tmp_path, HERE)
    assert again.user == OBSERVERS[0]
    again.release()
    second.release()


def test_a_broker_that_the_secrets_are_not_of_gets_none(tmp_path: Path) -> None:
    secrets(tmp_path / "credentials", *OBSERVERS, "replay", address=HERE)
    assert observer_of(tmp_path, THERE).secret is None
    assert replay_of(tmp_path, THERE).secret is None
    assert replay_of(tmp_path, HERE).secret == "secret of replay"


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_a_secret_that_may_not_be_read_says_what_to_do(tmp_path: Path) -> None:
    secrets(tmp_path / "credentials", "core.fusion")
    (tmp_path / "credentials" / "core.fusion").chmod(0)
    with pytest.raises(UserError, match="sudo"):
        identity_of("core.fusion", tmp_path)


def test_a_secret_that_is_no_text_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "credentials").mkdir()
    (tmp_path / "credentials" / "core.fusion").write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match="not ASCII"):
        identity_of("core.fusion", tmp_path)


def test_no_secret_is_in_what_is_printed(tmp_path: Path) -> None:
    secrets(tmp_path / "credentials", "core.fusion")
    assert "secret of" not in repr(identity_of("core.fusion", tmp_path))
