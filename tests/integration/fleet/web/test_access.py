"""Who may look at a centre's pages, and at what: real pages, a real database and a real bus."""

import asyncio
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack

import httpx
import psycopg
import pytest

from fleet.web.access import login
from fleet.web.access.attempts import Attempts, FreeAttempts, origins
from fleet.web.access.passwords import agrees, hashed, weakness
from fleet.web.access.rights import GRANTED, ROWS, Right, Role, needed
from fleet.web.database import Database
from shared.page.access.table import WEBSOCKET
from tests.support.fleet.reports import Unit
from tests.support.fleet.web import ACCOUNTS, PASSWORD, RunningWeb, Visitor, tenant
from tests.support.patience import HANGS_S

EXAMPLES = {
    "{zoom}": "3", "{x}": "4", "{y}": "2", "{vehicle}": "car-1", "{alarm}": "1", "{name:path}": "main.js",
    "{rest:path}": "api/viewers",
}  # fmt: skip


def path_of(row_path: str) -> str:
    for name, value in EXAMPLES.items():
        row_path = row_path.replace(name, value)
    return row_path


@pytest.fixture(scope="module")
def visitors(running: RunningWeb) -> Iterator[dict[str, Visitor]]:
    unit = Unit("car-1", 1, time.time_ns() // 1_000_000)
    unit.enter(running.dsn)
    running.report(unit, 0)
    yield {role: running.visitor(name) for name, role in ACCOUNTS.items()}


@pytest.mark.parametrize("role", list(Role))
def test_each_role_may_do_what_the_table_says_and_nothing_else(visitors: dict[str, Visitor], role: Role) -> None:
    for row in ROWS:
        if row.method == WEBSOCKET or row.path in ("/api/logout", "/api/password", "/api/login"):
            continue
        allowed = row.right is Right.PUBLIC or row.right in GRANTED[role]
        visitor = visitors[role]
        path = path_of(row.path)
        answer = visitor.get(path) if row.method == "GET" else visitor.post(path, {"nonsense": 1})
        assert (answer.status_code == 403) is not allowed, f"{row.method} {path} as {role}: {answer.status_code}"
        assert answer.status_code < 500, f"{row.method} {path}: {answer.text}"


def test_without_a_login_only_the_login_is_served(running: RunningWeb, visitors: dict[str, Visitor]) -> None:
    for row in ROWS:
        if row.method == WEBSOCKET or row.right is Right.PUBLIC:
            continue
        answer = httpx.request(row.method, running.address + path_of(row.path))
        assert answer.status_code == 401, row.path
    page = httpx.get(f"{running.address}/", headers={"Accept": "text/html"})
    assert (page.status_code, page.headers["location"]) == (303, "login")
    deep = httpx.get(f"{running.address}/vehicles/car-1/live/", headers={"Accept": "text/html"})
    assert deep.headers["location"] == "../../../login"
    assert httpx.get(f"{running.address}/login").status_code == 200


@pytest.mark.parametrize(
    ("role", "path", "status", "title", "back"),
    [
        (Role.VIEWER, "/nothing", 404, "There is no such page", "./"),
        (Role.VIEWER, "/no<b>/such/page", 404, "There is no such page", "../../"),
        (Role.OPERATOR, "/vehicles/none/live/", 404, "There is no such page", "../../../"),
        (Role.OPERATOR, "/vehicles/car-1/live/nothing", 404, "There is no such page", "../../../"),
        (Role.TOLL, "/vehicles/car-1/live/", 403, "This page is not open to you", "../../../"),
    ],
)  # fmt: skip
def test_a_browser_is_told_by_a_page_with_a_way_back_and_a_program_by_json(
    visitors: dict[str, Visitor], role: Role, path: str, status: int, title: str, back: str
) -> None:
    program = visitors[role].get(path)
    browser = visitors[role].http.get(path, headers={"Accept": "text/html,*/*"})
    assert (program.status_code, browser.status_code) == (status, status)
    assert program.json()["detail"]
    assert browser.headers["content-type"] == "text/html; charset=utf-8"
    assert "style-src" not in browser.headers["content-security-policy"]
    assert f"<h1>{title}</h1>" in browser.text and f'<a href="{back}">' in browser.text
    assert f'href="{back}unit/style.css"' in browser.text and "<b>" not in browser.text


def test_what_is_for_programs_is_json_whoever_asks(running: RunningWeb, visitors: dict[str, Visitor]) -> None:
    assert visitors[Role.VIEWER].http.get("/api/nothing", headers={"Accept": "text/html"}).json()["detail"]
    other = httpx.get(f"{running.address}/", headers={"Accept": "text/html", "Host": "elsewhere.example"})
    assert other.status_code == 421 and "add it to web_names in centre.toml" in other.text
    assert other.headers["content-type"].startswith("text/html")


@pytest.mark.parametrize("end", ["%0A", "%0D%0A", "%00", "%20", ";", "/", "//", "%2F", "?x", "%E2%80%A8", "/../x"])
def test_no_end_of_a_path_gets_round_its_right(visitors: dict[str, Visitor], end: str) -> None:
    for role in Role:
        for row in ROWS:
            if row.method == "GET" and row.right is not Right.PUBLIC and row.right not in GRANTED[role]:
                status = visitors[role].get(path_of(row.path) + end).status_code
                assert status in (307, 400, 403, 404), (role, row.path, end)


def test_what_no_row_describes_needs_the_highest_right() -> None:
    assert needed("DELETE", "/api/vehicles") is Right.ADMIN
    assert needed("PUT", "/") is Right.ADMIN
    assert needed("HEAD", "/api/audit") is Right.ADMIN


def test_a_change_needs_the_header_that_only_our_page_can_send(visitors: dict[str, Visitor]) -> None:
    http = visitors["admin"].http
    refused = http.post("/api/enrolment", json={"vehicle": "car-2"})
    assert refused.status_code == 403
    assert http.post("/api/enrolment", json={}, headers={"X-OBU-CSRF": "guess"}).status_code == 403
    elsewhere = {"X-OBU-CSRF": visitors["admin"].csrf, "Origin": "https://attacker.example"}
    assert http.post("/api/enrolment", json={}, headers=elsewhere).status_code == 403
    assert http.get("/api/vehicles", headers={"Host": "attacker.example"}).status_code == 421


def test_the_cookie_is_not_for_scripts_and_not_for_other_sites(running: RunningWeb) -> None:
    answer = httpx.post(
        f"{running.address}/api/login", json={"name": "anna", "password": PASSWORD}, headers={"X-OBU-CSRF": "login"}
    )
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie and "samesite=strict" in cookie
    stored = running.rows("SELECT encode(token_hash, 'hex') FROM session")
    assert answer.cookies["obu-centre"] not in str(stored), "the database holds hashes alone"


def test_attempts_to_guess_a_password_are_slowed_down(running: RunningWeb) -> None:
    with httpx.Client(base_url=running.address, headers={"X-OBU-CSRF": "login"}) as http:
        statuses = [
            http.post("/api/login", json={"name": "nobody", "password": f"guess {n}"}).status_code for n in range(8)
        ]
        assert statuses[:5] == [401] * 5
        assert statuses[5:] == [429] * 3
        refused = http.post("/api/login", json={"name": "nobody", "password": PASSWORD})
        assert int(refused.headers["retry-after"]) >= 1


def test_who_guesses_locks_out_nobody_at_another_address(running: RunningWeb) -> None:
    tenant(running.dsn, "demo", {"sid": "viewer"})
    with httpx.Client(base_url=running.address, headers={"X-OBU-CSRF": "login"}) as http:
        for number in range(8):
            status = http.post("/api/login", json={"name": "sid", "password": f"guess {number}"}).status_code
    assert status == 429
    elsewhere = httpx.HTTPTransport(local_address="127.0.0.2")
    with httpx.Client(base_url=running.address, headers={"X-OBU-CSRF": "login"}, transport=elsewhere) as http:
        assert http.post("/api/login", json={"name": "sid", "password": PASSWORD}).status_code == 200


def guesses(running: RunningWeb, name: str, number: int, ends: Sequence[str] = ("127.0.0.1",)) -> Counter[int]:
    """Send wrong passwords beside each other; statuses of the answers."""

    async def all_at_once() -> list[httpx.Response]:
        async with AsyncExitStack() as stack:
            clients = [
                await stack.enter_async_context(
                    httpx.AsyncClient(
                        base_url=running.address, headers={"X-OBU-CSRF": "login"}, timeout=HANGS_S,
                        transport=httpx.AsyncHTTPTransport(local_address=end, limits=httpx.Limits()),
                    )
                )
                for end in ends
            ]  # fmt: skip
            body = [{"name": name, "password": f"guess {n}"} for n in range(number)]
            return await asyncio.gather(
                *(clients[n % len(clients)].post("/api/login", json=record) for n, record in enumerate(body))
            )

    return Counter(answer.status_code for answer in asyncio.run(all_at_once()))


@pytest.mark.parametrize("name", ["anna", "nobody-at-all", "\U0001f600"])
def test_guesses_beside_each_other_pass_no_more_than_guesses_in_turn(running: RunningWeb, name: str) -> None:
    forget(running)
    assert guesses(running, name, 50) == {401: FreeAttempts.ONE, 429: 50 - FreeAttempts.ONE}
    assert running.rows("SELECT max(failures) FROM attempt") == [(FreeAttempts.ONE,)]
    forget(running)


def test_guesses_from_many_addresses_beside_each_other_are_counted_for_the_account(
    running: RunningWeb, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(login, "agrees", lambda *_: False)  # which takes a tenth of a second
    forget(running)
    ends = [f"127.0.1.{n}" for n in range(1, 31)]
    assert guesses(running, "anna", 150, ends)[401] == FreeAttempts.ACCOUNT
    forget(running)


def test_guesses_at_the_own_password_beside_each_other_are_counted(running: RunningWeb) -> None:
    tenant(running.dsn, "demo", {"pat": "viewer"})
    session = running.visitor("pat")
    with ThreadPoolExecutor(30) as pool:
        statuses = Counter(pool.map(lambda n: change(session, f"guess {n}"), range(30)))
    assert statuses == {401: FreeAttempts.ONE, 429: 30 - FreeAttempts.ONE}


def forget(running: RunningWeb) -> None:
    with psycopg.connect(running.dsn) as db:
        db.execute("DELETE FROM attempt")


def test_a_botnet_has_a_hundred_guesses_and_a_network_of_ipv6_is_one_address(running: RunningWeb) -> None:
    forget(running)
    database = Database(running.dsn)  # as the owner, who may set a role
    attempts = Attempts(database)

    def begin(account: str, host: str) -> float:
        return running.run(attempts.begin(origins(account, host)))

    def later(seconds: float) -> None:
        with psycopg.connect(running.dsn) as db:
            db.execute("UPDATE attempt SET last = last - make_interval(secs => %s)", (seconds,))

    for number in range(FreeAttempts.ACCOUNT):
        assert begin("anna", f"192.0.2.{number}") == 0
    assert 0 < begin("anna", "198.51.100.1") <= 2.0
    later(2.0)
    right = origins("anna", "198.51.100.1")
    assert running.run(attempts.begin(right)) == 0
    running.run(attempts.succeeded(right))
    later(2.0)
    assert running.run(attempts.begin(right)) == 0, "the right password is not counted"
    for number in range(FreeAttempts.ONE):
        assert begin("otto", f"2001:db8::{number:x}") == 0
    assert begin("otto", "2001:db8::ffff") > 0
    assert begin("otto", "2001:db8:0:1::1") == 0
    assert begin("otto", "no address") == 0
    later(3601.0)
    assert begin("otto", "2001:db8::ffff") == 0, "after an hour all begins again"
    running.run(database.close())
    forget(running)


def change(visitor: Visitor, old: str) -> int:
    return visitor.post("/api/password", {"old": old, "new": "four words and two"}).status_code


def test_guessing_within_a_session_is_slowed_down_and_locks_nobody_out(running: RunningWeb) -> None:
    tenant(running.dsn, "demo", {"sam": "viewer", "sue": "viewer"})
    stolen = running.visitor("sam")
    statuses = [change(stolen, f"guess {n}") for n in range(8)]
    assert statuses == [401] * 5 + [429] * 3
    assert change(stolen, PASSWORD) == 429
    owner = running.visitor("sam")
    assert change(owner, PASSWORD) == 429, "another session of the account has no tries of its own"
    with httpx.Client(base_url=running.address, headers={"X-OBU-CSRF": "login"}) as http:
        session = running.visitor("sue")
        statuses = [http.post("/api/login", json={"name": "sue", "password": f"{n}"}).status_code for n in range(6)]
    assert statuses[-1] == 429
    assert change(session, PASSWORD) == 200, "nor do others who guess at the login"


def test_a_logout_ends_the_session_at_once(running: RunningWeb) -> None:
    visitor = running.visitor("vera")
    assert visitor.get("/api/vehicles").status_code == 200
    assert visitor.post("/api/logout", {}).status_code == 200
    assert visitor.get("/api/vehicles").status_code == 401


def test_passwords_are_hashed_with_a_salt_and_weak_ones_are_refused() -> None:
    first, second = hashed(PASSWORD), hashed(PASSWORD)
    assert first != second and agrees(PASSWORD, first) and agrees(PASSWORD, second)
    assert not agrees("another one", first)
    assert not agrees(PASSWORD, "scrypt$99$8$1$AA==$AA==") and not agrees(PASSWORD, "nonsense")
    assert weakness("short", "anna") and weakness("aaaaaaaaaaaaaaaa", "anna") and not weakness(PASSWORD, "anna")
