"""The containers of a control centre: what each may do, and which secrets it can read."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import pytest
import yaml

from fleet.centre import Centre
from fleet.containers import GROUP, USERS, owners, prepare
from fleet.database.roles import ROLES
from fleet.processes import NAMES
from shared.errors import UserError
from tests.support.data import REPOSITORY
from tests.support.fleet.database import missing

COMPOSE = REPOSITORY / "deploy" / "compose.centre.yml"
SETTINGS = REPOSITORY / "deploy" / "centre.toml"
Service = dict[str, object]
PUBLISHED = {"nats": 8883, "admission": 8444, "web": 8090}
OUTSIDE = {*PUBLISHED, "alarms"}  # alarms calls web hooks


@pytest.fixture(scope="module")
def services() -> dict[str, Service]:
    return cast("dict[str, Service]", yaml.safe_load(COMPOSE.read_text())["services"])


def test_every_process_of_a_centre_has_a_container(services: dict[str, Service]) -> None:
    assert set(services) == {"prepare", "postgres", "nats", *NAMES}
    for name in NAMES:
        assert services[name]["command"] == ["centre", "run", name]


def test_no_container_may_more_than_it_must(services: dict[str, Service]) -> None:
    for name, service in services.items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert {"mem_limit", "pids_limit", "user", "logging"} <= set(service), name
        if name != "prepare":
            assert str(service["user"]).split(":")[0] == str(USERS[name]), name
            assert "cap_add" not in service
        reaches_out = "outside" in cast("list[str]", service.get("networks", []))
        assert reaches_out == (name in OUTSIDE), name


def test_ports_are_those_of_the_settings_and_of_this_machine_unless_told(
    services: dict[str, Service], tmp_path: Path
) -> None:
    published = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert set(published) == set(PUBLISHED)
    for name, port in PUBLISHED.items():
        (entry,) = cast("list[str]", published[name])
        assert entry.startswith("${OBU_CENTRE_") and entry.endswith(f":-127.0.0.1}}:{port}:{port}")
    (tmp_path / "centre.toml").write_text(SETTINGS.read_text())
    settings = Centre(tmp_path).settings
    assert (settings.mqtt_port, settings.enrol_port, settings.web_port) == (8883, 8444, 8090)
    assert (settings.listen, settings.nats_host, settings.database) == ("0.0.0.0", "nats", "host=postgres dbname=fleet")


def test_no_password_is_in_the_compose_file() -> None:
    text = COMPOSE.read_text()
    assert "POSTGRES_PASSWORD:" not in text
    assert "trust" not in text.lower()


def test_each_secret_is_read_by_its_process_and_by_maintenance_at_most() -> None:
    for path, user, group, mode in owners():
        secret = path.startswith("secrets/") or path.endswith((".key", "nats.conf"))
        assert mode & 0o007 == 0, path
        if secret and not path.endswith("server.key"):
            assert mode in (0o400, 0o440) and (mode == 0o400 or group == USERS["maintenance"]), path
        assert user in USERS
    names = {path for path, *_ in owners()}
    assert {f"secrets/database-{name}" for name in ROLES} <= names


@pytest.fixture
def reachable() -> Iterator[Path]:
    """A folder that other users pass through, which those of pytest are not."""
    with TemporaryDirectory() as made:
        Path(made).chmod(0o711)
        yield Path(made)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to other users")
def test_processes_read_their_own_secrets_and_not_those_of_others(reachable: Path) -> None:
    folder = reachable / "centre"
    folder.mkdir(mode=0o711)
    (folder / "centre.toml").write_text(SETTINGS.read_text())
    centre = Centre(folder)
    prepare(centre)
    before = centre.passwords, centre.database_passwords, centre.authority_pem
    prepare(centre)
    assert (centre.passwords, centre.database_passwords, centre.authority_pem) == before
    everything = [path for path, *_ in owners() if (folder / path).is_file()]
    open_to_all = [path for path in folder.rglob("*") if path.is_file() and path.stat().st_mode & 0o004]
    assert [path.name for path in open_to_all] == ["centre.toml"]
    for name in NAMES:
        readable = _readable_by(name, folder, everything)
        secrets = {path for path in readable if path.startswith("secrets/")}
        if name == "maintenance":
            assert "secrets/database-owner.pgpass" in secrets
            assert not readable & {"authority/ca.key", "secrets/issuer", "nats/nats.conf"}
        elif name == "admission":
            own = {"nats-admission", "nats-callout", "nats-system", "database-admission", "issuer"}
            assert secrets == {f"secrets/{item}" for item in own}
            assert "authority/ca.key" in readable
        else:
            assert secrets == {f"secrets/nats-{name}", f"secrets/database-{name}"}
            assert "authority/ca.key" not in readable


def _readable_by(name: str, folder: Path, paths: list[str]) -> set[str]:
    group, groups = (USERS[name], str(GROUP)) if name == "maintenance" else (GROUP, "")
    command = ["setpriv", "--reuid", str(USERS[name]), "--regid", str(group)]
    command += ["--groups", groups] if groups else ["--clear-groups"]
    # Not Python: the interpreter may lie where other users cannot reach it.
    script = 'cd "$1" && shift && for one; do if [ -r "$one" ]; then echo "$one"; fi; done'
    command += ["sh", "-c", script, "sh", str(folder), *paths]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd="/")
    return set(done.stdout.split())


def test_only_root_prepares(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(UserError, match="as root"):
        prepare(Centre(tmp_path))


def test_nats_takes_the_configuration_for_containers(tmp_path: Path) -> None:
    from fleet.servers.nats import program
    from fleet.up import nats_configuration

    try:
        command = program()
    except UserError as error:
        missing(str(error))
    (tmp_path / "centre.toml").write_text(SETTINGS.read_text())
    path = tmp_path / "nats.conf"
    path.write_text(nats_configuration(Centre(tmp_path), tmp_path / "nats"))
    done = subprocess.run([command, "-t", "-c", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert 'listen: "0.0.0.0:4222"' in path.read_text()
