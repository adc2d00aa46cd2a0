"""`obu token`: what it prints, and what the unit then accepts."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli import token
from cli.main import command_line
from cli.token import login_link, network_address, page_address
from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import FOLDER_VARIABLE, Tokens
from shared.errors import UserError
from shared.runtime.config import ADDRESS_FILE

APP = command_line(["token"])


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OBU_STATE", str(tmp_path))
    monkeypatch.delenv(FOLDER_VARIABLE, raising=False)
    return tmp_path


def run(*arguments: str) -> str:
    done = CliRunner().invoke(APP, ["token", *arguments])
    if isinstance(done.exception, UserError):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.stdout


def test_a_token_is_printed_once_and_listed_without_its_text(state: Path) -> None:
    secret = run("add", "workshop", "--role", "operate", "--days", "30").strip()
    found = Tokens(state).find(secret)
    assert found and (found.name, found.role) == ("workshop", Right.OPERATE)
    assert found.expires_s and found.expires_s - found.created_s == 30 * 86_400.0
    listed = run("list")
    assert secret not in listed
    assert "| workshop | operate | " in listed and found.hash[:8] in listed and found.hash not in listed


def test_without_a_token_the_list_says_how_to_make_one(state: Path) -> None:
    assert "obu token show-link" in run("list")


def test_a_link_leads_to_the_unit_that_runs(state: Path) -> None:
    (state / ADDRESS_FILE).write_text("http://127.0.0.1:8123/")
    link = run("show-link").strip()
    address, _, secret = link.partition("/login#token=")
    assert address == "http://127.0.0.1:8123"
    opened = Tokens(state).log_in(secret, 60.0)
    assert opened and opened[1].role is Right.ADMIN
    assert "| used | 1 |" in run("list")
    assert run("revoke", opened[1].token) == f"revoked {opened[1].token}, and ended 1 login\n"
    assert Tokens(state).session(opened[0]) is None


def test_a_link_may_be_for_another_address_and_a_lesser_role(state: Path) -> None:
    link = run("show-link", "--role", "view", "--minutes", "60", "--address", "https://car.example/").strip()
    assert link.startswith("https://car.example/login#token=")
    found = Tokens(state).find(link.partition("=")[2])
    assert found and found.role is Right.VIEW and found.single_use
    assert found.expires_s and found.expires_s - found.created_s == 3600.0


def test_mistakes_end_in_what_to_do(state: Path) -> None:
    with pytest.raises(UserError, match="obu token list"):
        run("revoke", "nobody")
    run("add", "a")
    with pytest.raises(UserError, match="obu token revoke a"):
        run("add", "a")
    Tokens(state).path.write_text("{")
    with pytest.raises(UserError, match="not a file of tokens"):
        run("list")


def test_addresses_of_links(state: Path) -> None:
    assert page_address(state) == "http://127.0.0.1:8080"
    assert login_link("http://[::1]:8080/", "x") == "http://[::1]:8080/login#token=x"
    reached = network_address(8080)
    assert reached is None or reached.endswith(":8080")


@pytest.mark.parametrize(("host", "network", "shown"), [
    ("0.0.0.0", "http://10.1.2.3:8123", "http://10.1.2.3:8123/login#"),
    ("0.0.0.0", None, "http://127.0.0.1:8123/login#"),
    ("127.0.0.1", "http://10.1.2.3:8123", "http://127.0.0.1:8123/login#"),
])  # fmt: skip
def test_a_code_for_a_phone_leads_to_what_a_phone_reaches(
    state: Path, monkeypatch: pytest.MonkeyPatch, host: str, network: str | None, shown: str
) -> None:
    (state / ADDRESS_FILE).write_text("http://127.0.0.1:8123/")
    (state / "obu.env").write_text(f"# OBU_HTTP_HOST=1.1.1.1\nOBU_HTTP_HOST={host}\n")
    monkeypatch.setattr(token, "STATE", state)
    monkeypatch.setattr(token, "SERVICES_ENVIRONMENT", state / "obu.env")
    monkeypatch.setattr(token, "network_address", lambda _port: network)
    done = CliRunner().invoke(APP, ["token", "show-link", "--qr"])
    assert shown in done.stdout
    assert ("--address" in done.output) is shown.startswith("http://127.")
    assert "http://127.0.0.1:8123/login#" in run("show-link"), "on the machine itself"
