"""What `centre.toml` states of the pages, as the process of the pages uses it."""

import asyncio
import contextlib
import ssl
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from cli.demo.local import free_port
from fleet.admission.authority import Authority as OwnAuthority
from fleet.centre import EXAMPLE, Centre, Settings
from fleet.database.roles import let_in
from fleet.processes import work_of
from fleet.servers.nats import Nats
from fleet.up import nats_configuration
from shared.errors import UserError
from tests.support.dashboard.tile_files import write_pmtiles
from tests.support.data import REPOSITORY
from tests.support.fleet.certificates import Authority
from tests.support.fleet.database import missing
from tests.support.fleet.web import PASSWORD, tenant
from tests.support.patience import HANGS_S

HOW_TO = REPOSITORY / "docs/how-to/run-a-control-centre.md"


def centre_with(folder: Path, dsn: str = "", **settings: object) -> Centre:
    folder.mkdir(exist_ok=True)
    given = {"database": dsn, "nats_port": free_port(), "mqtt_port": free_port(), **settings}
    lines = [f"{name} = {value!r}\n" for name, value in given.items()]
    (folder / "centre.toml").write_text("".join(lines))
    centre = Centre(folder)
    OwnAuthority(centre.authority)
    return centre


@contextlib.contextmanager
def nats_of(centre: Centre) -> Iterator[None]:
    """Run the NATS of a centre."""
    try:
        nats = Nats(centre.folder / "nats", centre.settings.nats_port, centre.settings.mqtt_port)
    except UserError:
        missing("nats-server")
    nats.start(nats_configuration(centre, nats.folder))
    try:
        yield
    finally:
        nats.stop()


def test_the_file_that_is_made_and_the_how_to_name_every_setting_with_its_default() -> None:
    lines = [line.removeprefix("# ") for line in EXAMPLE.splitlines() if line.startswith("# ") and " = " in line]
    assert Settings.model_validate(tomllib.loads("\n".join(lines))) == Settings()
    assert {line.split(" = ")[0] for line in lines} == set(Settings.model_fields)
    text = HOW_TO.read_text()
    assert [name for name in Settings.model_fields if f"`{name}`" not in text] == []


def test_the_pages_answer_by_https_to_the_names_of_the_settings_and_show_the_map(dsn: str, tmp_path: Path) -> None:
    pem, certificate, key = Authority().write(tmp_path / "files", "127.0.0.1")
    write_pmtiles(tmp_path / "region.pmtiles", 48.1, 11.5)
    tenant(dsn)
    port = free_port()
    centre = centre_with(
        tmp_path / "centre", dsn, web_port=port, web_names=["fleet.example"], web_certificate=str(certificate),
        web_key=str(key), map_file=str(tmp_path / "region.pmtiles"),
    )  # fmt: skip
    with nats_of(centre):
        assert centre.web_url == f"https://127.0.0.1:{port}"
        let_in(dsn, centre.database_passwords)

        async def look(http: httpx.AsyncClient) -> None:
            by_name = await http.get("/login", headers={"Host": "fleet.example"})
            assert by_name.status_code == 200
            other = await http.get("/login", headers={"Host": "other.example"})
            assert other.status_code == 421 and "web_names in centre.toml" in other.text
            body = {"name": "vera", "password": PASSWORD}
            answer = await http.post("/api/login", json=body, headers={"X-OBU-CSRF": "login"})
            assert answer.status_code == 200 and "secure" in answer.headers["set-cookie"].lower()
            described = (await http.get("/api/map")).json()
            assert described["map"]["attribution"] == "© test mappers" and described["problem"] is None

        asyncio.run(_while_it_runs(centre, ssl.create_default_context(cafile=str(pem)), look))


async def _while_it_runs(centre: Centre, trust: ssl.SSLContext, look: Callable[[httpx.AsyncClient], Any]) -> None:
    task = asyncio.ensure_future(work_of("web", centre))
    try:
        async with asyncio.timeout(30.0), httpx.AsyncClient(base_url=centre.web_url, verify=trust) as http:
            while True:
                assert not task.done(), task.exception()
                with contextlib.suppress(httpx.ConnectError):
                    await http.get("/login")
                    break
                await asyncio.sleep(0.1)
            await look(http)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def test_elsewhere_than_on_loopback_the_pages_have_the_certificate_of_the_own_authority(tmp_path: Path) -> None:
    centre = centre_with(tmp_path / "centre", web_listen="0.0.0.0", host="centre.example", web_names=["fleet.example"])
    assert centre.web_certificate is not None and centre.web_url == "https://centre.example:8090"
    assert {"centre.example", "fleet.example"} <= set(centre.names)


@pytest.mark.parametrize(
    ("certificate", "key"), [("no.pem", "no.key"), ("server.pem", "other.key"), ("empty", "empty")]
)
def test_a_certificate_that_cannot_be_used_names_its_settings(tmp_path: Path, certificate: str, key: str) -> None:
    Authority().write(tmp_path, "127.0.0.1")
    (tmp_path / "other.key").write_text(Authority().certified("127.0.0.1")[0])
    (tmp_path / "empty").write_text("")
    centre = centre_with(
        tmp_path / "centre", "host=127.0.0.1 port=1", web_port=free_port(),
        web_certificate=str(tmp_path / certificate), web_key=str(tmp_path / key),
    )  # fmt: skip
    with nats_of(centre), pytest.raises(UserError, match="web_certificate and web_key"):
        asyncio.run(asyncio.wait_for(_run(centre), HANGS_S))


async def _run(centre: Centre) -> None:
    await work_of("web", centre)


def test_one_half_of_a_certificate_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="belong together"):
        _ = centre_with(tmp_path / "centre", web_key="key.pem").web_certificate
