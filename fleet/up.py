"""A whole centre on one machine: PostgreSQL, nats-server, and the processes of the centre, until it is stopped."""

import fcntl
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol

import psycopg
from sqlalchemy.exc import SQLAlchemyError

from shared.errors import UserError
from shared.runtime.warm.client import WarmStart

from .admission.authority import AUTHORITY, SERVER, Authority
from .admission.nkeys import Issuer
from .centre import SECRETS, Centre, is_loopback
from .database.maintenance import prepare
from .database.refusals import reason_of
from .processes import MODULES, NAMES
from .servers.children import Child
from .servers.nats import EVERYWHERE, LOOPBACK, Certificates, Nats, configuration
from .servers.postgres import name_of

log = logging.getLogger(__name__)

AGAIN_S, LONGEST_AGAIN_S = 1.0, 60.0  # of a part that has ended at once; twice as long each time that it does so again
STABLE_AFTER_S = 10.0  # a part that has run for less has ended at once
AWAY_S = 5.0  # in which NATS on another machine accepts a connection
WAIT_S = 0.05  # between two looks at a parent that imports its modules
WARM_S = 5.0  # for which a process waits for it: then it starts by itself
LOGS = "logs"  # of the processes; the servers have theirs in their folders


def start_servers(centre: Centre, stack: ExitStack) -> list["PeriodicCheck"]:
    """Start PostgreSQL with the newest schema, and NATS; both end with the stack. Raises `UserError`."""
    settings, servers = centre.settings, list[PeriodicCheck]()
    if centre.has_own_database:
        postgres = centre.postgres
        servers.append(ManagedProcess("PostgreSQL", postgres, postgres.start, stack))
    try:
        prepare(centre.owner_dsn, centre.database_passwords)
    except (psycopg.Error, SQLAlchemyError) as error:
        raise UserError(f"the database cannot be used: {reason_of(error)}; {_remedy(centre)}") from error
    if is_loopback(settings.nats_host):
        nats = Nats(centre.folder / "nats", settings.nats_port, settings.mqtt_port)
        text = nats_configuration(centre, nats.folder)
        servers.append(ManagedProcess("nats-server", nats, lambda: nats.start(text), stack))
        servers.append(NatsReload(nats, centre.authority / SERVER))
    else:
        warn_if_away(settings.nats_host, settings.nats_port)
    return servers


def _remedy(centre: Centre) -> str:
    if centre.has_own_database:
        return f"its log is in {centre.folder / 'postgres'}"
    return "check `database` in centre.toml, or OBU_CENTRE_DSN, and the log of that server"


def warn_if_away(host: str, port: int) -> None:
    """Say that NATS elsewhere does not answer now: the processes wait for it, and say so in their logs alone."""
    try:
        socket.create_connection((host, port), AWAY_S).close()
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        log.warning("NATS at %s:%d does not answer: %s; check nats_host and nats_port", host, port, reason)


class PeriodicCheck(Protocol):
    """What is looked at several times a second."""

    def look(self) -> None:
        """Do what is due."""


class NatsReload:
    """NATS, which reads its certificate again when admission has made another one."""

    def __init__(self, nats: Nats, certificate: Path) -> None:
        self._nats, self._certificate = nats, certificate
        self._made_ns = self._changed_ns()

    def look(self) -> None:
        """Tell NATS if there is another certificate."""
        if (made_ns := self._changed_ns()) not in (self._made_ns, 0):
            self._made_ns = made_ns
            self._nats.reload()
            log.info("nats-server has the new certificate")

    def _changed_ns(self) -> int:
        try:
            return self._certificate.stat().st_mtime_ns
        except OSError:
            return 0  # it is being replaced


class Pauses:
    """How long a part that ends again and again is left alone; its reason is said when it is another one."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._reason = ""
        self._pause_s = 0.0
        self._begun_s = self._due_s = 0.0

    @property
    def is_over(self) -> bool:
        """Whether it may start."""
        return time.monotonic() >= self._due_s

    def begin(self) -> None:
        """It starts."""
        self._begun_s = time.monotonic()

    def end(self, reason: str) -> None:
        """It has ended, or did not start."""
        now_s = time.monotonic()
        if now_s - self._begun_s > STABLE_AFTER_S:
            self._pause_s, self._reason = 0.0, ""
        if reason != self._reason:
            log.warning("%s has ended: %s; it is started again", self._name, reason)
        self._reason, self._due_s = reason, now_s + self._pause_s
        self._pause_s = min(max(2.0 * self._pause_s, AGAIN_S), LONGEST_AGAIN_S)


class ManagedProcess:
    """A server or process that is started again when it ends."""

    def __init__(self, name: str, child: Child, start: Callable[[], None], stack: ExitStack) -> None:
        """Start it; it ends with the stack. Raises `UserError`."""
        self._child, self._start = child, start
        self._pauses = Pauses(name)
        self._runs = True
        stack.callback(child.stop)
        self._pauses.begin()
        start()

    def look(self) -> None:
        """Start it if it does not run."""
        if self._child.is_running:
            return
        if self._runs:
            self._runs = False
            self._pauses.end(self._child.cause())
        if not self._pauses.is_over:
            return
        self._pauses.begin()
        try:
            self._start()
            self._runs = True
        except UserError as error:  # such as processes of a killed PostgreSQL that have not ended yet
            self._pauses.begin()  # however long that took
            self._pauses.end(str(error))


def nats_configuration(centre: Centre, store: Path) -> str:
    """Make what NATS needs of this centre, and write its configuration; raises `UserError`."""
    authority = Authority(centre.authority)
    certificate, key = authority.server(centre.names)
    files = Certificates(certificate, key, authority.folder / AUTHORITY)
    issuer = Issuer(centre.secret("issuer", 32)).public
    settings = centre.settings
    clients = LOOPBACK if is_loopback(settings.nats_host) else EVERYWHERE[0], settings.nats_port
    mqtt = settings.listen, settings.mqtt_port
    return configuration(store, clients, mqtt, files, issuer, centre.passwords)


class Process(Child):
    """A process of the centre, forked from the parent of all where there is one."""

    def __init__(self, name: str, folder: Path, warm: WarmStart) -> None:
        super().__init__(folder / LOGS / f"{name}.log")
        self._arguments = ("centre", "run", name, "--folder", str(folder))
        self._warm = warm

    def start(self) -> None:
        """Start it."""
        self._process = None
        latest_s = time.monotonic() + WARM_S
        while not (self._warm.is_ready() or self._warm.is_given_up) and time.monotonic() < latest_s:
            time.sleep(WAIT_S)
        if self._warm.is_ready():
            with self.log.output() as output:
                self._process = self._warm.start(self._arguments, os.environ, output)
        if self._process is None:
            self._run([sys.executable, "-m", "cli", *self._arguments])


def run(centre: Centre, ended: threading.Event, begun: Callable[[], None]) -> None:
    """Run a centre until `ended` is set; `begun` is called when its servers run. Raises `UserError`."""
    check_rights(centre.folder)
    if centre.has_own_database:
        centre.postgres.check_owner()
    if os.geteuid() == 0:
        log.warning("a centre that root starts runs as root, but for PostgreSQL: start it as an ordinary user")
    with ExitStack() as stack:
        stack.enter_context(alone(centre.folder))
        centre.check()
        warm = WarmStart(MODULES, "cli.__main__:main")
        stack.callback(warm.stop)
        warm.is_ready()  # it imports while the servers start
        try:
            (centre.folder / LOGS).mkdir(mode=0o700, exist_ok=True)
            parts = start_servers(centre, stack)
        except OSError as error:  # such as a full disk
            raise UserError(
                f"cannot use {error.filename or centre.folder}: {error.strerror or error}; mend that, and start again"
            ) from error
        begun()
        for name in NAMES:
            process = Process(name, centre.folder, warm)
            parts.append(ManagedProcess(name, process, process.start, stack))
        while not ended.wait(0.2):
            warm.is_ready()  # a parent that has ended is replaced before it is needed
            for part in parts:
                part.look()


def check_rights(folder: Path) -> None:
    """Raise `UserError` if a folder of the centre is closed to this user, as after a start by another one."""
    for path in (folder, *(folder / name for name in (LOGS, "authority", "nats", SECRETS))):
        if path.is_dir() and not os.access(path, os.R_OK | os.W_OK | os.X_OK, effective_ids=True):
            raise UserError(
                f"cannot write to {path}: it is of the user {name_of(path.stat().st_uid)}; give this command as that "
                "user, or name another folder with --folder"
            )


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the folder of a centre; the kernel lets go of it when this process ends. Raises `UserError`."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(f"a centre runs in {folder} already; end it first, or name another folder") from error
        yield
    finally:
        os.close(descriptor)


def until_stopped() -> threading.Event:
    """An event that SIGINT and SIGTERM set."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    return ended
