"""Each role at each route: what the table of roles says is what the server does."""

import asyncio
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from fastapi.routing import APIRoute
from pydantic import TypeAdapter
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from services.monitoring.status.web.access.access import Access, Rules
from services.monitoring.status.web.access.guard import Guard
from services.monitoring.status.web.access.manage import TokenList
from services.monitoring.status.web.access.rights import GRANTED, Right
from services.monitoring.status.web.access.table import ROWS, needed
from services.monitoring.status.web.access.tokens import FILE, Tokens
from services.monitoring.status.web.routes import app_without_unit
from shared.page.access.requests import Receive, Scope, Send
from shared.page.access.table import WEBSOCKET, Row
from tests.support.dashboard.status_server import RunningServer, eventually, status_server
from tests.support.patience import HANGS_S

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
ALL = ["download", "keep", "delete", "replay", "solve"]


@dataclass
class GuardedPage:
    """A page that asks everybody to log in."""

    folder: Path
    server: RunningServer
    tokens: Tokens
    secrets: dict[Right, str]

    def ask(self, method: str, path: str, right: Right | None, **headers: str) -> httpx.Response:
        """Ask with the token of a role, and read no more than the head of the answer."""
        head = {"Authorization": f"Bearer {self.secrets[right]}"} if right else {}
        with httpx.stream(method, self.server.address + path, headers={**head, **headers}, timeout=HANGS_S) as answer:
            return answer


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardedPage]:
    folder = tmp_path_factory.mktemp("guarded")
    tokens = Tokens(folder)
    with status_server(folder, login_on_loopback=True, recordings=ALL) as server:
        yield GuardedPage(folder, server, tokens, {right: tokens.add(f"of-{right}", right) for right in GRANTED})


def routes_of(found: list[BaseRoute]) -> set[tuple[str, str]]:
    """Methods and paths of an application; HEAD is that of GET."""
    listed: set[tuple[str, str]] = set()
    for base_route in found:
        if isinstance(base_route, WebSocketRoute):
            listed.add((WEBSOCKET, base_route.path))
        elif isinstance(base_route, Route | APIRoute):
            listed |= {(method, base_route.path) for method in base_route.methods or () if method != "HEAD"}
        else:
            listed |= routes_of(list(getattr(base_route, "routes", ()) or base_route.original_router.routes))  # type: ignore[attr-defined]
    return listed


def sample(path: str) -> str:
    """A path that a route matches."""
    for part, value in (("{zoom}", "1"), ("{x}", "0"), ("{y}", "0"), ("{name:path}", "gnss/fix"), ("{name}", "a.mcap")):
        path = path.replace(part, value)
    return path


def test_every_route_states_its_role() -> None:
    stated, found = {(row.method, row.path) for row in ROWS}, routes_of(app_without_unit().routes)
    assert found <= stated
    assert stated - found == {("GET", "/access/login.js"), ("GET", "/style.css")}, "files of the last route"


def test_no_row_hides_another() -> None:
    for row in ROWS:
        assert needed(row.method, sample(row.path)) is row.right


def test_what_no_row_describes_needs_the_highest_right_to_change() -> None:
    assert needed("DELETE", "/api/solution") is Right.ADMIN
    assert needed("POST", "/api/recordings/") is Right.ADMIN
    assert needed("GET", "/nothing/here") is Right.VIEW
    assert needed("GET", "//login") is Right.VIEW


@pytest.mark.parametrize(("path", "right", "status"), [("/no/page", Right.VIEW, 404), ("/api/tokens", Right.VIEW, 403)])
def test_a_browser_is_told_of_no_page_by_a_page_and_of_the_api_by_json(
    page: GuardedPage, path: str, right: Right, status: int
) -> None:
    head = {"Authorization": f"Bearer {page.secrets[right]}", "Accept": "text/html"}
    answer = httpx.get(page.server.address + path, headers=head)
    assert answer.status_code == status
    if path.startswith("/api/"):
        assert answer.json()["detail"]
    else:
        assert "<h1>There is no such page</h1>" in answer.text and '<a href="../">' in answer.text
        assert 'href="../style.css"' in answer.text


@dataclass
class BareGuard:
    """The guard alone, in front of an application that answers everything."""

    guard: Guard
    secrets: dict[Right, str]

    def status(self, method: str, path: str, **headers: str) -> int:
        """Status of the answer to a request."""
        head = [(name.lower().encode(), value.encode()) for name, value in {"Host": "localhost", **headers}.items()]
        scope = {"type": "http", "method": method, "path": path, "headers": head, "client": ("127.0.0.1", 1)}
        sent: list[Scope] = []

        async def send(message: Scope) -> None:
            sent.append(message)

        async def receive() -> Scope:
            return {"type": "http.disconnect"}

        asyncio.run(self.guard(scope, receive, send))
        return int(sent[0]["status"])


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> BareGuard:
    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        await Response("passed")(scope, receive, send)

    tokens = Tokens(tmp_path_factory.mktemp("guard"))
    secrets = {right: tokens.add(f"of-{right}", right) for right in GRANTED}
    return BareGuard(Guard(answer, Access(Rules(), tokens)), secrets)


@pytest.mark.parametrize("row", [row for row in ROWS if row.method != WEBSOCKET], ids=lambda row: row.path)
def test_each_role_may_what_the_table_says(alone: BareGuard, row: Row[Right]) -> None:
    path = sample(row.path)
    for method in METHODS:
        right = needed(method, path)
        for role in (None, *GRANTED):
            head = {"Authorization": f"Bearer {alone.secrets[role]}"} if role else {}
            status = alone.status(method, path, **{**head, "X-OBU-CSRF": "any"})
            if right is Right.PUBLIC or (role and role.includes(right)):
                assert status == 200, (method, path, role)
            else:
                assert status == (403 if role else 401), (method, path, role)


ENDS = ("%0A", "%0D%0A", "%00", "%20", ";", "/", "//", "%2F", "?x", "%E2%80%A8", "/../x")


@pytest.mark.parametrize("end", ENDS)
def test_no_end_of_a_path_gets_round_its_right(page: GuardedPage, end: str) -> None:
    for row in ROWS:
        if row.method == "GET" and row.right in (Right.OPERATE, Right.ADMIN):
            status = page.ask("GET", sample(row.path) + end, Right.VIEW).status_code
            assert status in (307, 400, 403, 404), (row.path, end)


@pytest.mark.parametrize("row", [row for row in ROWS if row.method != WEBSOCKET], ids=lambda row: row.path)
def test_the_server_answers_nobody_but_who_needs_no_login(page: GuardedPage, row: Row[Right]) -> None:
    status = page.ask(row.method, sample(row.path), None, **{"X-OBU-CSRF": "any"}).status_code
    assert status == 401 if row.right is not Right.PUBLIC else status in (200, 422)


@pytest.mark.parametrize("row", [row for row in ROWS if row.method == "GET"], ids=lambda row: row.path)
def test_head_answers_as_get_without_a_body(page: GuardedPage, row: Row[Right]) -> None:
    path = sample(row.path)
    get, head = (page.ask(method, path, Right.ADMIN) for method in ("GET", "HEAD"))
    assert head.status_code == get.status_code
    assert head.headers["content-type"] == get.headers["content-type"]
    # Files are made in a folder that may outlive neither an answer cut off nor a head alone.
    eventually(lambda: not list(page.folder.glob("jobs/made-*")))


def test_admin_makes_and_revokes_tokens_over_the_page(page: GuardedPage) -> None:
    def change(**body: object) -> httpx.Response:
        head = {"Authorization": f"Bearer {page.secrets[Right.ADMIN]}"}
        return httpx.post(f"{page.server.address}/api/tokens", json=body, headers=head, timeout=HANGS_S)

    made = change(action="add", name="van", role="view", days=1.0).json()["token"]
    found = page.tokens.find(made)
    assert found and (found.name, found.role) == ("van", Right.VIEW)
    head = {"Authorization": f"Bearer {page.secrets[Right.ADMIN]}"}
    listed = httpx.get(f"{page.server.address}/api/tokens", headers=head, timeout=HANGS_S)
    TypeAdapter(TokenList).validate_json(listed.content)
    assert "van" in listed.text and made not in listed.text and found.hash not in listed.text
    assert change(action="add", name="van", role="view").status_code == 409
    assert change(action="revoke", name="van").json() == {"token": None}
    assert page.tokens.find(made) is None
    assert change(action="revoke", name="van").status_code == 409
    assert change(action="add", name="x", role="root").status_code == 422


def test_a_recording_is_deleted_by_admin_alone(page: GuardedPage) -> None:
    def delete(right: Right) -> httpx.Response:
        head = {"Authorization": f"Bearer {page.secrets[right]}"}
        body = {"action": "delete", "name": "a.mcap"}
        return httpx.post(f"{page.server.address}/api/recordings", json=body, headers=head, timeout=HANGS_S)

    for right, allowed in (
        (Right.VIEW, []),
        (Right.OPERATE, ["download", "keep", "replay", "solve"]),
        (Right.ADMIN, sorted(ALL)),
    ):
        head = {"Authorization": f"Bearer {page.secrets[right]}"}
        assert httpx.get(f"{page.server.address}/api/recordings", headers=head).json()["allowed"] == allowed
    assert (delete(Right.VIEW).status_code, delete(Right.OPERATE).status_code) == (403, 403)
    assert delete(Right.ADMIN).status_code == 404  # there is none


@pytest.mark.parametrize("path", ["/ws", "/ws/series?fields=gnss/fix:hdop"])
def test_streams_ask_for_a_login(page: GuardedPage, path: str) -> None:
    address = page.server.address.replace("http", "ws") + path
    with pytest.raises(InvalidStatus) as refused:
        connect(address)
    assert refused.value.response.status_code == 401
    head = {"Authorization": f"Bearer {page.secrets[Right.VIEW]}"}
    with connect(address, additional_headers=head, max_size=None) as socket:
        assert json.loads(socket.recv(timeout=HANGS_S))["kind"] in ("snapshot", "past")


@pytest.mark.parametrize("path", ["/ws", "/ws/series?fields=navigation/solution:roll_rad&seconds=60"])
def test_a_stream_ends_when_its_token_is_revoked(page: GuardedPage, path: str) -> None:
    secret = page.tokens.add("short", Right.VIEW)
    head = {"Authorization": f"Bearer {secret}"}
    with connect(page.server.address.replace("http", "ws") + path, additional_headers=head, max_size=None) as socket:
        socket.recv(timeout=HANGS_S)
        page.tokens.revoke("short")
        with pytest.raises(ConnectionClosed) as ended:
            while True:
                socket.recv(timeout=HANGS_S)
    assert ended.value.rcvd and ended.value.rcvd.code == 4401


def test_an_event_stream_ends_when_its_token_is_revoked(page: GuardedPage) -> None:
    secret = page.tokens.add("short", Right.VIEW)
    head = {"Authorization": f"Bearer {secret}"}
    with httpx.stream("GET", f"{page.server.address}/api/events", headers=head, timeout=HANGS_S) as answer:
        parts = answer.iter_raw()
        next(parts)
        page.tokens.revoke("short")
        assert sum(1 for _ in parts) < 100


def test_tokens_that_change_while_the_page_runs_are_seen(page: GuardedPage) -> None:
    secret = page.tokens.add("guest", Right.VIEW)
    head = {"Authorization": f"Bearer {secret}"}
    assert httpx.get(f"{page.server.address}/api/state", headers=head, timeout=HANGS_S).status_code == 200
    page.tokens.revoke("guest")
    assert httpx.get(f"{page.server.address}/api/state", headers=head, timeout=HANGS_S).status_code == 401


def test_a_file_of_tokens_that_cannot_be_read_lets_nobody_in(tmp_path: Path) -> None:
    secret = Tokens(tmp_path).add("guest", Right.ADMIN)
    with status_server(tmp_path, unit=False, login_on_loopback=True) as server:
        head = {"Authorization": f"Bearer {secret}"}
        assert httpx.get(f"{server.address}/api/state", headers=head, timeout=HANGS_S).status_code == 200
        (tmp_path / FILE).write_text('{"tokens": "all"}')
        assert httpx.get(f"{server.address}/api/state", headers=head, timeout=HANGS_S).status_code == 401
        (tmp_path / FILE).unlink()
        assert httpx.get(f"{server.address}/api/state", headers=head, timeout=HANGS_S).status_code == 401
