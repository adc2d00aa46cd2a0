"""Behind nginx with the configuration of the how-to page."""

import json
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cli.demo.local import free_port
from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.access.tokens import Tokens
from tests.support.dashboard.status_server import RunningServer, status_server
from tests.support.nginx import nginx
from tests.support.patience import HANGS_S

PER_CLIENT = 6


@dataclass
class ProxiedUnit:
    """A simulated unit behind nginx."""

    address: str
    unit: RunningServer
    tokens: Tokens

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.address, verify=False, timeout=HANGS_S, headers={"X-OBU-CSRF": "login"})

    def log_in(self, client: httpx.Client) -> httpx.Response:
        secret = self.tokens.add_temporary("link", Right.ADMIN, seconds=60.0, single_use=True)
        return client.post("/api/login", json={"token": secret}, headers={"Origin": self.address})


@pytest.fixture(scope="module")
def proxied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ProxiedUnit]:
    folder = tmp_path_factory.mktemp("proxied")
    with (
        status_server(folder, trusted_proxies=["127.0.0.1"], connections_per_client=PER_CLIENT) as unit,
        nginx(folder / "nginx", free_port(), unit.address) as address,
    ):
        yield ProxiedUnit(address, unit, Tokens(folder))


def test_a_simulated_unit_asks_for_a_login_through_a_proxy_only(proxied: ProxiedUnit) -> None:
    with proxied.client() as client:
        assert client.get("/api/state").status_code == 401
        assert client.get("/api/alive").status_code == 200
    assert httpx.get(f"{proxied.unit.address}/api/state", timeout=HANGS_S).status_code == 200


def test_the_login_is_a_cookie_of_https_and_ends_with_the_logout(proxied: ProxiedUnit) -> None:
    with proxied.client() as client:
        cookie = proxied.log_in(client).headers["set-cookie"]
        assert {"HttpOnly", "SameSite=strict", "Secure", "Path=/"} <= set(cookie.split("; "))
        assert client.get("/api/state").status_code == 200
        csrf = client.get("/api/session").json()["csrf"]
        stop = {"command": "stop"}
        for header, status in (("wrong", 403), (csrf, 202)):
            answer = client.post("/api/simulation/attack", json=stop, headers={"X-OBU-CSRF": header})
            assert answer.status_code == status
        kept = dict(client.cookies)
        assert client.post("/api/logout").status_code == 403, "the header of another page"
        assert client.post("/api/logout", headers={"X-OBU-CSRF": csrf}).status_code == 200
        client.cookies.update(kept)
        assert client.get("/api/state").status_code == 401, "a copy of the cookie is of no use"


def test_streams_pass_through_the_proxy(proxied: ProxiedUnit) -> None:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    stream = proxied.address.replace("https", "wss") + "/ws"
    with pytest.raises(InvalidStatus) as refused:
        connect(stream, ssl=context)
    assert refused.value.response.status_code == 401
    with proxied.client() as client:
        proxied.log_in(client)
        head = {"Cookie": "; ".join(f"{name}={value}" for name, value in client.cookies.items())}
        with connect(stream, ssl=context, additional_headers=head, max_size=None) as socket:
            assert json.loads(socket.recv(timeout=HANGS_S))["kind"] == "snapshot"
        with client.stream("GET", "/api/events") as events:
            assert next(events.iter_text()).startswith("retry:")


def test_requests_are_counted_by_the_address_that_the_proxy_states(proxied: ProxiedUnit) -> None:
    with proxied.client() as client, ExitStack() as stack:
        proxied.log_in(client)
        for _ in range(PER_CLIENT):
            stream = stack.enter_context(client.stream("GET", "/api/events"))
            assert stream.status_code == 200
        assert client.get("/api/alive").status_code == 503
        assert httpx.get(f"{proxied.unit.address}/api/alive", timeout=HANGS_S).status_code == 200


def test_what_a_client_states_of_itself_is_overwritten(proxied: ProxiedUnit) -> None:
    with proxied.client() as client:
        for name in ("X-Forwarded-For", "X-Real-IP", "Forwarded"):
            assert client.get("/api/state", headers={name: "127.0.0.1"}).status_code == 401


def test_a_foreign_name_or_page_is_refused(proxied: ProxiedUnit) -> None:
    with proxied.client() as client:
        assert client.get("/api/alive", headers={"Host": "evil.example"}).status_code == 421
        assert client.get("/api/alive", headers={"Origin": "https://evil.example"}).status_code == 403


def test_a_proxy_that_is_not_named_is_not_believed(tmp_path: Path) -> None:
    with status_server(tmp_path, unit=False) as unit, nginx(tmp_path / "nginx", free_port(), unit.address) as address:
        page = ProxiedUnit(address, unit, Tokens(tmp_path))
        with page.client() as client:
            assert client.get("/api/state").status_code == 401
            assert "Secure" not in page.log_in(client).headers["set-cookie"]
