import json
import os
import stat
from pathlib import Path
from threading import Thread

import pytest

from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import (
    FILE,
    FOLDER_VARIABLE,
    SESSIONS_MAXIMUM,
    TOKENS_MAXIMUM,
    Tokens,
    hashed,
    is_secret,
    tokens_folder,
)
from shared.errors import UserError


class Clock:
    def __init__(self) -> None:
        self.now_s = 1_795_000_000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def tokens(tmp_path: Path, clock: Clock) -> Tokens:
    return Tokens(tmp_path, clock)


def test_the_file_holds_hashes_and_is_for_its_owner_alone(tmp_path: Path, tokens: Tokens) -> None:
    tokens.make()
    secret = tokens.add("workshop", Right.VIEW)
    cookie, _ = tokens.log_in(secret, 60.0) or ("", None)
    text = (tmp_path / FILE).read_text()
    assert is_secret(secret) and is_secret(cookie)
    assert secret not in text and cookie not in text
    assert hashed(secret) in text and hashed(cookie) in text
    assert stat.S_IMODE((tmp_path / FILE).stat().st_mode) == 0o600
    assert not list(tmp_path.glob("*.draft"))


def test_another_process_sees_a_change(tmp_path: Path, clock: Clock, tokens: Tokens) -> None:
    tokens.make()
    page = Tokens(tmp_path, clock)
    assert page.content().tokens == ()
    secret = tokens.add("workshop", Right.OPERATE)
    found = page.find(secret)
    assert found and (found.name, found.role) == ("workshop", Right.OPERATE)
    tokens.revoke("workshop")
    assert page.find(secret) is None


def test_a_link_logs_in_once(tokens: Tokens) -> None:
    secret = tokens.add_temporary("link", Right.ADMIN, seconds=900.0, single_use=True)
    opened = tokens.log_in(secret, 60.0)
    assert opened and opened[1].role is Right.ADMIN
    assert tokens.session(opened[0]) == opened[1]
    assert tokens.log_in(secret, 60.0) is None


def test_of_two_logins_with_one_link_one_succeeds(tmp_path: Path, tokens: Tokens) -> None:
    secret = tokens.add_temporary("link", Right.ADMIN, seconds=1e9, single_use=True)
    opened: list[object] = []
    threads = [Thread(target=lambda: opened.append(Tokens(tmp_path).log_in(secret, 60.0))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len([value for value in opened if value]) == 1


def test_tokens_and_sessions_expire(clock: Clock, tokens: Tokens) -> None:
    secret = tokens.add("guest", Right.VIEW, seconds=100.0)
    cookie, _ = tokens.log_in(secret, 200.0) or ("", None)
    clock.now_s += 100.0
    assert tokens.find(secret) is None and tokens.log_in(secret, 60.0) is None
    assert tokens.session(cookie)
    clock.now_s += 100.0
    assert tokens.session(cookie) is None
    tokens.add("other", Right.VIEW)
    assert [token.name for token in tokens.content().tokens] == ["other"]
    assert tokens.content().sessions == ()


def test_revoking_a_token_ends_its_logins_also_of_a_used_link(tokens: Tokens) -> None:
    secret = tokens.add("guest", Right.VIEW)
    cookies = [(tokens.log_in(secret, 60.0) or ("", None))[0] for _ in range(2)]
    assert tokens.revoke("guest") == 2
    assert not any(tokens.session(cookie) for cookie in cookies)
    link = tokens.add_temporary("link", Right.VIEW, seconds=60.0, single_use=True)
    cookie, session = tokens.log_in(link, 60.0) or ("", None)
    assert session and tokens.revoke(session.token) == 1
    assert tokens.session(cookie) is None


def test_a_logout_ends_one_session(tokens: Tokens) -> None:
    secret = tokens.add("guest", Right.VIEW)
    (first, session), (second, _) = (tokens.log_in(secret, 60.0) or pytest.fail("no login") for _ in range(2))
    tokens.log_out(session)
    assert tokens.session(first) is None and tokens.session(second)


def test_the_oldest_sessions_give_way(tokens: Tokens) -> None:
    secret = tokens.add("guest", Right.VIEW)
    first, _ = tokens.log_in(secret, 60.0) or ("", None)
    for _ in range(SESSIONS_MAXIMUM):
        assert tokens.log_in(secret, 60.0)
    assert tokens.session(first) is None
    assert len(tokens.content().sessions) == SESSIONS_MAXIMUM


@pytest.mark.parametrize("name", ["", "a/b", "-a", "a b", "x" * 41, "..\n"])
def test_a_name_that_is_none_is_rejected(tokens: Tokens, name: str) -> None:
    with pytest.raises(UserError, match="no name of a token"):
        tokens.add(name, Right.VIEW)


def test_a_name_is_used_once_and_their_number_is_bounded(tokens: Tokens) -> None:
    for number in range(TOKENS_MAXIMUM):
        tokens.add(f"t{number}", Right.VIEW)
    with pytest.raises(UserError, match="revoke one"):
        tokens.add("more", Right.VIEW)
    tokens.revoke("t1")
    with pytest.raises(UserError, match="already"):
        tokens.add("t2", Right.VIEW)
    with pytest.raises(UserError, match="there is no token"):
        tokens.revoke("t1")


@pytest.mark.parametrize("text", ["", "[]", '{"tokens": [{"name": "a"}]}', "\x00" * 10])
def test_a_broken_file_lets_nobody_in_and_is_not_overwritten(tmp_path: Path, tokens: Tokens, text: str) -> None:
    (tmp_path / FILE).write_text(text)
    assert tokens.find("x" * 43) is None
    assert tokens.problem == "not a file of tokens of this version"
    with pytest.raises(UserError, match="move it away"):
        tokens.add("guest", Right.VIEW)
    assert (tmp_path / FILE).read_text() == text


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_of_another_user_is_said(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UserError, match="as the user who runs the unit"):
        Tokens(tmp_path).add("guest", Right.VIEW)


def test_a_folder_that_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot write"):
        Tokens(tmp_path / "missing").make()


def test_two_units_have_cookies_of_different_names(tmp_path: Path) -> None:
    units = set()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        Tokens(tmp_path / name).make()
        units.add(json.loads((tmp_path / name / FILE).read_text())["unit"])
    assert len(units) == 2


def test_a_replay_of_a_page_takes_the_tokens_of_its_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tokens_folder(tmp_path) == tmp_path
    monkeypatch.setenv(FOLDER_VARIABLE, "/var/lib/obu")
    assert tokens_folder(tmp_path) == Path("/var/lib/obu")


def test_roles_are_ordered() -> None:
    assert [Right.OPERATE.includes(right) for right in Right] == [True, True, True, False]
