"""What a start of a centre refuses, in seconds and in one sentence, and what is bounded while it runs."""

import asyncio
import contextlib
import os
import pwd
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import httpx
import nats
import psycopg
import pytest
from pydantic import ValidationError

from cli.centre.common import centre_of, hand_over
from cli.demo.local import free_port
from fleet.admission.authority import Authority
from fleet.bus import connected
from fleet.centre import Centre
from fleet.database.refusals import unusable
from fleet.servers.children import Child
from fleet.servers.logs import BoundedLog
from fleet.servers.nats import Nats, NatsAccess
from fleet.servers.ports import is_of
from fleet.servers.postgres import Postgres, name_of
from fleet.up import LONGEST_AGAIN_S, Pauses, alone, check_rights, warn_if_away
from fleet.web.access.accounts import NewAccount
from fleet.web.access.rights import Role
from shared.errors import UserError
from shared.fleet.topics import VEHICLE, vehicle_of
from shared.runtime.config import Vehicle
from tests.support.dashboard.status_server import eventually
from tests.support.data import REPOSITORY
from tests.support.fleet.ports import answers
from tests.support.fleet.running_centre import PORTS
from tests.support.fleet.vehicle_link import obu, rows
from tests.support.patience import HANGS_S

WITHIN_S = 30.0


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user may enter."""
    with tempfile.TemporaryDirectory(prefix="obu-start-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def ordinary_user() -> Iterator[None]:
    """Be a user whom rights of files bind, also where root runs the tests."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(pwd.getpwnam("nobody").pw_uid)
    yield
    os.seteuid(user)


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    """Somebody who listens, and counts who connects."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


def up(folder: Path, *lines: str) -> subprocess.CompletedProcess[str]:
    """Try to start a centre that does not start."""
    if lines:
        (folder / "centre.toml").write_text("\n".join(lines))
    command = [sys.executable, "-m", "cli", "centre", "up", "--folder", str(folder)]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=WITHIN_S)


@pytest.mark.parametrize("setting", PORTS)
def test_a_port_in_use_is_named_with_its_setting(tmp_path: Path, setting: str, stranger: socket.socket) -> None:
    port = stranger.getsockname()[1]
    ports = {name: free_port() for name in PORTS} | {setting: port}
    done = up(tmp_path, *(f"{name} = {number}" for name, number in ports.items()))
    assert done.returncode == 2
    assert "centre in" not in done.stdout
    assert f"port {port} of 127.0.0.1 is in use" in done.stderr
    assert setting in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "postgres").exists()


def test_two_settings_with_one_port_are_named(tmp_path: Path) -> None:
    ports = {name: free_port() for name in PORTS}
    ports["enrol_port"] = ports["mqtt_port"]
    done = up(tmp_path, 'listen = "0.0.0.0"', *(f"{name} = {number}" for name, number in ports.items()))
    assert done.returncode == 2
    assert f"mqtt_port and enrol_port are both {ports['mqtt_port']}; give each a port of its own" in done.stderr
    assert not (tmp_path / "postgres").exists()


def test_a_second_centre_in_a_folder_says_that_one_runs_and_ends_no_part_of_it(folder: Path) -> None:
    done = up(folder)
    assert done.returncode == 2
    assert f"a centre runs in {folder} already" in done.stderr
    assert "Traceback" not in done.stderr
    assert rows(folder, "SELECT 1") == [(1,)]


def test_a_folder_is_free_again_when_its_centre_has_ended(tmp_path: Path) -> None:
    with alone(tmp_path), pytest.raises(UserError, match="already"), alone(tmp_path):
        pass
    with alone(tmp_path):
        pass


@pytest.mark.parametrize("taken", ["nats", "mqtt"])
def test_nats_has_not_started_where_another_program_listens(
    tmp_path: Path, stranger: socket.socket, taken: str
) -> None:
    port, other = stranger.getsockname()[1], free_port()
    clients, mqtt = (port, other) if taken == "nats" else (other, port)
    server = Nats(tmp_path, clients, mqtt)
    text = f'server_name: "x"\nlisten: "127.0.0.1:{clients}"\njetstream {{ store_dir: "{tmp_path}/jetstream" }}\n'
    with pytest.raises(UserError, match=r"nats-server did not start: .*address already in use"):
        server.start(text + f'mqtt {{ listen: "127.0.0.1:{mqtt}" }}\n')
    assert not server.is_running
    assert is_of(os.getpid(), port)
    assert not is_of(os.getpid(), other)


def test_postgresql_has_not_started_where_another_one_holds_the_data(postgres: Postgres) -> None:
    second = Postgres(postgres.folder, postgres.port)
    with pytest.raises(UserError, match=r"PostgreSQL did not start: FATAL: .*lock file"):
        second.start()
    assert not second.is_running
    with psycopg.connect(postgres.dsn) as db:
        assert db.execute("SELECT 1").fetchone() == (1,)


def test_root_leaves_the_database_of_another_user_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owned = tmp_path / "postgres"
    (owned / "data").mkdir(parents=True)
    if os.geteuid() == 0:
        os.chown(owned, 1, 1)
    before = owned.stat()
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    server = Postgres(owned, 5433)
    with pytest.raises(UserError, match=r"is of the user .*: give this command as"):
        server.start()
    after = owned.stat()
    assert (before.st_uid, before.st_mode, before.st_mtime_ns) == (after.st_uid, after.st_mode, after.st_mtime_ns)


@pytest.mark.parametrize(
    ("cause", "advice"),
    [
        ("FATAL:  could not write to file: No space left on device", "make room on the disk"),
        ('initdb: error: could not access directory "x": Permission denied', "must be able to enter the folders above"),
    ],
)
def test_an_initdb_that_fails_says_its_cause_and_what_to_do(
    open_folder: Path, monkeypatch: pytest.MonkeyPatch, cause: str, advice: str
) -> None:
    program = open_folder / "initdb"
    program.write_text(f"#!/bin/sh\ncat >&2 <<'end'\n{cause}\ninitdb: removing data directory\nend\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr("fleet.servers.postgres.programs", lambda: open_folder)
    with pytest.raises(UserError) as refused:
        Postgres(open_folder / "postgres", 5433).start()
    assert cause.removeprefix("initdb: ") in str(refused.value)
    assert advice in str(refused.value)
    assert "removing" not in str(refused.value)


def test_commands_pass_on_what_the_database_says(tmp_path: Path) -> None:
    assert "refuses: no space left" in unusable(psycopg.errors.DiskFull("no space left"))
    starting = psycopg.OperationalError("connection to server failed: FATAL:  the database system is starting up\n")
    assert "(FATAL:  the database system is starting up)" in unusable(starting)
    (tmp_path / "centre.toml").touch()
    assert "No such file or directory" in obu("centre", "vehicles", folder=tmp_path).stderr


@pytest.mark.parametrize(
    "command",
    [
        ("centre", "account", "add", "anna"), ("centre", "retain"), ("centre", "revoke", "car-1"), ("centre", "token"),
        ("fleet", "simulate", "--vehicles", "1"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_stopped_centre_is_named_in_one_line_with_what_to_try(tmp_path: Path, command: tuple[str, ...]) -> None:
    Authority(tmp_path / "authority").server(("127.0.0.1",))
    (tmp_path / "centre.toml").touch()
    done = obu(*command, folder=tmp_path)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "does not answer (No such file or directory); start it with `obu centre up`" in line


@pytest.mark.parametrize("closed", [".", "logs", "authority", "nats", "secrets"])
def test_a_folder_without_rights_is_named_with_its_user_before_anything_starts(
    open_folder: Path, ordinary_user: None, closed: str
) -> None:
    user = os.geteuid()
    os.seteuid(os.getuid())
    path = open_folder / "centre" / closed
    path.mkdir(parents=True)
    path.parent.chmod(0o777)
    path.chmod(0)
    os.seteuid(user)
    with pytest.raises(UserError, match=rf"cannot write to {path}: it is of the user {name_of(os.getuid())}; give"):
        check_rights(open_folder / "centre")


def test_a_folder_that_cannot_be_looked_into_is_named(open_folder: Path, ordinary_user: None) -> None:
    user = os.geteuid()
    os.seteuid(os.getuid())
    (open_folder / "closed").mkdir(mode=0)
    os.seteuid(user)
    with pytest.raises(UserError, match=r"cannot look into .*closed/centre: Permission denied; give this command as"):
        centre_of(open_folder / "closed" / "centre")


def test_what_cannot_be_written_at_the_start_is_named(open_folder: Path) -> None:
    ports = [f"{name} = {free_port()}" for name in PORTS]
    (open_folder / "logs").touch()
    done = up(open_folder, *ports)
    assert done.returncode == 2
    assert f"obu: cannot use {open_folder / 'logs'}: File exists; mend that" in done.stderr


def test_who_does_not_own_the_database_is_told_so() -> None:
    error = psycopg.OperationalError('connection failed: FATAL:  Peer authentication failed for user "fleet_owner"')
    assert unusable(error).endswith("give this command as the user who has started the centre")


def test_a_database_elsewhere_that_refuses_is_named_in_one_line_with_its_setting(tmp_path: Path) -> None:
    ports = [f"{name} = {free_port()}" for name in PORTS]
    done = up(tmp_path, *ports, f'database = "host=127.0.0.1 port={free_port()} dbname=fleet"')
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("obu: ")]
    assert "the database cannot be used: Connection refused; check `database` in centre.toml" in line
    assert "TCP/IP" not in done.stderr


def test_a_wrong_certificate_of_the_pages_is_named_before_anything_starts(tmp_path: Path) -> None:
    ports = [f"{name} = {free_port()}" for name in PORTS]
    done = up(tmp_path, *ports, 'web_certificate = "/no/such.pem"', 'web_key = "/no/such.key"')
    assert done.returncode == 2
    assert "centre in" not in done.stdout
    assert "web_certificate and web_key (/no/such.pem, /no/such.key): No such file or directory" in done.stderr
    assert "Traceback" not in done.stderr


def test_who_does_not_reach_nats_says_where_and_why(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def unreachable(_url: str, **options: object) -> None:
        tell = options["error_cb"]
        assert callable(tell)
        await tell(TimeoutError())

    monkeypatch.setattr(nats, "connect", unreachable)
    asyncio.run(connected(NatsAccess("tls://alarms:secret@centre.example:4222"), "alarms"))
    assert caplog.messages == ["NATS at centre.example:4222: it does not answer in time"]


def test_a_server_that_stays_away_is_told_once_a_minute_and_another_reason_at_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)

    async def away(_url: str, **options: Callable[[Exception], Awaitable[None]]) -> None:
        nonlocal now_s
        for _ in range(121):
            await options["error_cb"](OSError("refused"))
            now_s += 0.5
        await options["error_cb"](TimeoutError())

    monkeypatch.setattr(nats, "connect", away)
    asyncio.run(connected(NatsAccess("tls://alarms:secret@centre.example:4222"), "alarms"))
    place = "NATS at centre.example:4222"
    assert caplog.messages == [f"{place}: refused", f"{place}: refused", f"{place}: it does not answer in time"]


def test_a_start_says_that_nats_elsewhere_does_not_answer(
    stranger: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    warn_if_away("127.0.0.1", stranger.getsockname()[1])
    assert caplog.messages == []
    port = free_port()
    warn_if_away("127.0.0.1", port)
    assert caplog.messages == [
        f"NATS at 127.0.0.1:{port} does not answer: Connection refused; check nats_host and nats_port"
    ]


@pytest.mark.parametrize("host", ["localhost", "::1"])
def test_processes_connect_to_the_address_that_nats_of_this_machine_listens_at(tmp_path: Path, host: str) -> None:
    (tmp_path / "centre.toml").write_text(f'nats_host = "{host}"\n')
    Authority(tmp_path / "authority")
    assert Centre(tmp_path).nats("web").url.endswith("@127.0.0.1:4222")


def test_another_host_in_the_settings_keeps_no_process_from_nats_before_a_restart(tmp_path: Path) -> None:
    certificate, key = Authority(Centre(tmp_path).authority).server(Centre(tmp_path).names)
    (tmp_path / "centre.toml").write_text('host = "centre.example"\n')
    access = Centre(tmp_path).nats("ingest")
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(certificate, key)
    theirs, ours = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = (
        access.tls["tls"].wrap_bio(theirs, ours, server_hostname=access.tls["tls_hostname"]),
        server.wrap_bio(ours, theirs, server_side=True),
    )
    for end in ends * 3:
        with contextlib.suppress(ssl.SSLWantReadError):
            end.do_handshake()
    assert ends[0].version() is not None


@pytest.mark.parametrize("proof", ["none", "another authority"])
def test_who_took_the_port_of_nats_is_told_no_password(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, proof: str
) -> None:
    Authority(tmp_path / "authority")
    heard = b""

    async def impostor(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal heard
        writer.write(b'INFO {"server_id":"NX","version":"2.10.4","max_payload":1048576,"proto":1}\r\n')
        while data := await reader.read(4096):
            heard += data
        writer.close()

    async def meet() -> None:
        context = None
        if proof != "none":
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(*Authority(tmp_path / "other").server(["localhost"]))
        stranger = await asyncio.start_server(impostor, "127.0.0.1", 0, ssl=context)
        port = stranger.sockets[0].getsockname()[1]
        (tmp_path / "centre.toml").write_text(f"nats_port = {port}\n")
        joining = asyncio.create_task(connected(Centre(tmp_path).nats("alarms"), "alarms"))
        while not caplog.messages:
            await asyncio.sleep(0.01)
        joining.cancel()
        stranger.close()

    asyncio.run(meet())
    assert b"CONNECT" not in heard and Centre(tmp_path).passwords["alarms"].encode() not in heard
    assert not heard or heard[:2] == b"\x16\x03", "the first bytes are those of a TLS handshake"
    # What came before the server's part of a handshake may be lost: it is not known then what it was.
    whys = ("does not speak TLS", "does not answer") if proof == "none" else ("its certificate is not accepted",)
    assert any(why in caplog.messages[0] for why in whys)


@pytest.mark.parametrize(
    ("end", "cause"), [("kill -9 $$", "it was killed"), ("exit 3", "the database is full (exit code 3)")]
)
def test_a_part_that_was_killed_is_not_said_to_have_ended_by_its_last_line(
    tmp_path: Path, end: str, cause: str
) -> None:
    class Part(Child):
        def start(self) -> None:
            self._run(["sh", "-c", f"echo the database is full; {end}"])

    part = Part(tmp_path / "log")
    part.start()
    eventually(lambda: not part.is_running)
    assert part.cause() == cause


def test_a_part_that_ends_at_once_waits_longer_each_time_and_says_its_reason_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    pauses, waited = Pauses("web"), list[float]()

    def ends(reason: str, after_s: float = 1.0) -> float:
        nonlocal now_s
        begun_s = now_s
        pauses.begin()
        now_s += after_s
        pauses.end(reason)
        begun_s = now_s
        while not pauses.is_over:
            now_s += 0.5
        return now_s - begun_s

    waited = [ends("port in use") for _ in range(9)]
    assert waited == [0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, LONGEST_AGAIN_S, LONGEST_AGAIN_S]
    assert caplog.messages == ["web has ended: port in use; it is started again"]
    assert ends("another") == LONGEST_AGAIN_S
    assert ends("another", after_s=3600.0) == 0.0
    assert len(caplog.messages) == 3


def test_a_log_keeps_its_end_and_does_not_grow_beyond_its_bound(tmp_path: Path) -> None:
    log = BoundedLog(tmp_path / "noisy.log", most_bytes=200_000)
    script = "for n in range(100_000): print('line', n)\nprint('2026-11-26 [7] FATAL:  the end')\nprint('after')"
    with log.output() as output:
        process = subprocess.Popen([sys.executable, "-c", script], stdout=output)
    assert process.wait(WITHIN_S) == 0
    assert log.cause() == "FATAL:  the end"
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["noisy.log", "noisy.log.1"]
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 400_000
    assert log.path.read_text().endswith("after\n")


def test_a_program_goes_on_where_its_log_cannot_be_written(tmp_path: Path) -> None:
    log = BoundedLog(tmp_path / "missing" / "noisy.log")
    with log.output() as output:
        process = subprocess.Popen([sys.executable, "-c", "print('x' * 1_000_000)"], stdout=output)
    assert process.wait(WITHIN_S) == 0


def test_the_first_password_is_in_a_file_and_in_no_log(folder: Path) -> None:
    path = folder / "secrets" / "password-of-admin"
    assert path.stat().st_mode & 0o777 == 0o600
    password = path.read_text().strip()
    logs = [folder.parent / "log", *(folder / "logs").iterdir(), folder / "nats" / "nats.log"]
    assert str(path) in logs[0].read_text()
    for log in logs:
        assert password not in log.read_text()
    eventually(lambda: answers(Centre(folder).settings.web_port))
    with httpx.Client(base_url=Centre(folder).web_url, headers={"X-OBU-CSRF": "login"}, timeout=HANGS_S) as http:
        assert http.post("/api/login", json={"name": "admin", "password": password}).status_code == 200


@pytest.mark.parametrize(
    ("terminal", "journal", "logged", "printed"),
    [
        (True, False, True, True), (True, True, True, True), (False, False, True, False), (False, True, False, False),
        (False, False, False, True),
    ],
)  # fmt: skip
def test_a_password_is_printed_where_no_log_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], terminal: bool,
    journal: bool, logged: bool, printed: bool,
) -> None:  # fmt: skip
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    monkeypatch.setenv("JOURNAL_STREAM", "8:1") if journal else monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    for password in ("a first password", "another one"):
        hand_over(Centre(tmp_path), "nora@north", password, logged=logged)
        assert (password in capsys.readouterr().out) is printed
        path = tmp_path / "secrets" / "password-of-nora@north"
        assert path.exists() is not printed
        assert printed or path.read_text() == f"{password}\n"


@pytest.mark.parametrize("name", ["--help", "-x", "-", "--folder=/tmp", "", "a b", "a/b", "../a", "a\n", "\u2014help"])
def test_a_name_that_a_command_takes_for_an_option_is_none(folder: Path, name: str) -> None:
    assert vehicle_of(f"obu.{name}.uplink.batch") is None
    assert not VEHICLE.fullmatch(name)
    with pytest.raises(ValidationError):
        Vehicle(name=name)
    with pytest.raises(ValidationError):
        NewAccount(action="add", name=name, role=Role.VIEWER, password="three words and one")


@pytest.mark.parametrize("name", ["--help", "a/b"])
def test_commands_refuse_such_a_name(folder: Path, name: str) -> None:
    refused = (
        obu("centre", "token", f"--vehicle={name}", folder=folder),
        obu("centre", "tenant", "add", "--", name, folder=folder),
        obu("centre", "account", "add", "--", name, folder=folder),
    )
    for done in refused:
        assert done.returncode != 0 and "Traceback" not in done.stderr
        assert "is no name of" in done.stderr, done.stderr
