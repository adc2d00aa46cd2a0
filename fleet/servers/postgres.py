"""A PostgreSQL of our own: its data in a folder, on a socket there, as a user that is not root."""

import os
import pwd
import shutil
import signal
import subprocess
import time
from pathlib import Path

import psycopg

from shared.errors import UserError

from .children import Child, bound_to_parent
from .logs import cause_in

USER, DATABASE = "fleet_owner", "fleet"
START_S = 60.0
DEBIAN = Path("/usr/lib/postgresql")
INSTALL = "install PostgreSQL and PostGIS: sudo apt install postgresql-15-postgis-3"
OTHER_USER = "nobody"  # of the server, where root starts it: PostgreSQL refuses root
# Who started the server owns the database; everybody else has a password, the processes of the centre as well.
ACCESS = f"local all {USER} peer map=owner\nlocal all all scram-sha-256\n"
# Without synchronisation to the disk, for tests alone: a power cut would cost data there.
FOR_TESTS = ("fsync=off", "synchronous_commit=off", "full_page_writes=off")


def programs() -> Path:
    """Folder of PostgreSQL's programs; raises `UserError` where there are none."""
    versions = sorted(
        DEBIAN.glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]) if path.parts[-3].isdigit() else 0
    )
    found = versions[-1] if versions else shutil.which("initdb")
    if found is None:
        raise UserError(f"PostgreSQL is not installed; {INSTALL}")
    return Path(found).resolve().parent


class Postgres(Child):
    """A server that runs until `stop`; its data stay in the folder."""

    def __init__(self, folder: Path, port: int, *, durable: bool = True) -> None:
        # SIGTERM would wait for those who are connected.
        super().__init__(folder.resolve() / "postgres.log", signal.SIGINT, OTHER_USER if os.geteuid() == 0 else None)
        self.folder, self.port = folder.resolve(), port
        self._durable = durable
        self._programs = programs()

    @property
    def dsn(self) -> str:
        """Where the owner of the database connects: the user of this machine who has started it."""
        return f"{self.place} user={USER}"

    @property
    def place(self) -> str:
        """Where others connect, each with name and password."""
        return f"host={self.folder} port={self.port} dbname={DATABASE}"

    def check_owner(self) -> None:
        """Raise `UserError` if the database is of another user than the one who would run the server."""
        try:
            owner = self.folder.stat().st_uid
        except FileNotFoundError:
            return
        if owner in {os.geteuid() if self._user is None else pwd.getpwnam(self._user).pw_uid, self._unused_by()}:
            return
        name = "root" if owner == pwd.getpwnam(OTHER_USER).pw_uid else name_of(owner)
        raise UserError(f"the database in {self.folder} is of the user {name}: give this command as {name}")

    def _unused_by(self) -> int | None:
        """Root, where it has made the folder and no database yet."""
        return 0 if self._user is not None and not (self.folder / "data").exists() else None

    def start(self) -> None:
        """Make the database if there is none, and start the server; raises `UserError`."""
        self.check_owner()
        data = self.folder / "data"
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if self._user is not None:
            shutil.chown(self.folder, self._user)
        if not (data / "PG_VERSION").exists():
            shutil.rmtree(data, ignore_errors=True)  # of an initdb that did not end
            self._finish(
                "initdb", "--pgdata", str(data), "--username", USER, "--auth", "reject", "--encoding", "UTF8",
                "--no-locale",
            )  # fmt: skip
        self._write_access(data)
        settings = [
            f"port={self.port}", "listen_addresses=", f"unix_socket_directories={self.folder}",
            "unix_socket_permissions=0700", *(() if self._durable else FOR_TESTS),
        ]  # fmt: skip
        options = [word for setting in settings for word in ("-c", setting)]
        self._run([str(self._programs / "postgres"), "-D", str(data), *options])
        self._wait()

    def _write_access(self, data: Path) -> None:
        """State who may connect; the server's user only may read it."""
        names = f"owner {pwd.getpwuid(os.geteuid()).pw_name} {USER}\n"
        for name, text in (("pg_hba.conf", ACCESS), ("pg_ident.conf", names)):
            draft = data / f".{name}"
            draft.write_text(text, encoding="utf-8")
            draft.chmod(0o600)
            if self._user is not None:
                shutil.chown(draft, self._user)
            draft.replace(data / name)

    def _wait(self) -> None:
        deadline = time.monotonic() + START_S
        while True:
            ended = not self.is_running
            try:
                if ended or not self._is_ours():
                    raise psycopg.OperationalError("no server of this start")
                with psycopg.connect(self.dsn.replace(f"dbname={DATABASE}", "dbname=postgres"), autocommit=True) as db:
                    known = db.execute("SELECT 1 FROM pg_database WHERE datname = %s", (DATABASE,)).fetchone()
                    if known is None:
                        db.execute(f"CREATE DATABASE {DATABASE}")
                return
            except psycopg.OperationalError as error:
                if ended or time.monotonic() > deadline:
                    self.stop()
                    raise UserError(
                        f"PostgreSQL did not start: {self.log.cause() if ended else error}; its log is {self.log.path}"
                    ) from error
                time.sleep(0.1)

    def _is_ours(self) -> bool:
        """Whether the server that holds the data is the process that was started."""
        try:
            first = (self.folder / "data" / "postmaster.pid").read_text(encoding="utf-8").partition("\n")[0]
        except FileNotFoundError:
            return False
        return first == str(self.pid)

    def _finish(self, program: str, *arguments: str) -> None:
        command = bound_to_parent([str(self._programs / program), *arguments], "INT", self._user)
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/")
        if done.returncode:
            cause = cause_in(done.stderr)
            raise UserError(f"{program} failed: {cause}; {self._advice(cause)}")

    def _advice(self, cause: str) -> str:
        if "No space left" in cause or "Disk quota" in cause:
            return f"make room on the disk of {self.folder}"
        if "Permission denied" in cause:
            return (
                f"the user {self._user or name_of(os.geteuid())} must be able to enter the folders above {self.folder}"
            )
        return f"look at {self.folder}"


def name_of(user: int) -> str:
    """Name of a user of this machine; containers have users without one."""
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"number {user}"
