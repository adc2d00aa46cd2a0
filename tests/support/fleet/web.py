"""The pages of a centre as they are, with a real bus, a real ingest and a real database."""

import asyncio
import json
import subprocess
import threading
import time
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

import httpx
import nats
import psycopg
from nats.aio.client import Client

from cli.demo.local import free_port
from fleet.database.roles import ROLES, dsn_of_process, let_in
from fleet.ingest.process import serve as take_batches
from fleet.servers.nats import NatsAccess, program
from fleet.web.access.passwords import hashed
from fleet.web.process import WebSettings, serve
from shared.errors import UserError
from shared.fleet.topics import BATCH, subject
from tests.support.dashboard.status_server import eventually
from tests.support.fleet.database import missing
from tests.support.fleet.ports import answers
from tests.support.fleet.reports import Unit
from tests.support.patience import HANGS_S

T = TypeVar("T")
PASSWORD = "three words and one"
FINGERPRINT = "ab" * 16
ACCOUNTS = {"anna": "admin", "otto": "operator", "vera": "viewer", "tom": "toll"}
_HASHED = hashed(PASSWORD)


@contextmanager
def bus() -> Iterator[str]:
    """Run a nats-server on loopback; gives its address."""
    try:
        command = program()
    except UserError:
        missing("nats-server")
    port = free_port()
    process = subprocess.Popen(
        [command, "-a", "127.0.0.1", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        eventually(lambda: answers(port))
        yield f"nats://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(HANGS_S)


def tenant(dsn: str, name: str = "demo", accounts: dict[str, str] | None = None) -> int:
    """Enter a tenant with accounts, whose names begin with that of another tenant than demo."""
    with psycopg.connect(dsn) as db:
        row = db.execute(
            "INSERT INTO tenant (name) VALUES (%s) ON CONFLICT (name) DO UPDATE SET name = excluded.name "
            "RETURNING tenant_id", (name,),
        ).fetchone()  # fmt: skip
        assert row is not None
        for account, role in (ACCOUNTS if accounts is None else accounts).items():
            db.execute(
                "INSERT INTO account (tenant_id, name, password, role) VALUES (%s, %s, %s, %s)",
                (row[0], account, _HASHED, role),
            )
    return int(row[0])


@dataclass
class RunningWeb:
    """Pages that run, and the bus behind them."""

    address: str
    dsn: str
    loop: asyncio.AbstractEventLoop
    client: Client
    visitors: "list[Visitor]" = field(default_factory=list)

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Do something in the loop of the pages."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(HANGS_S)

    def publish(self, name: str, content: object) -> None:
        """Publish JSON on the bus, as a process of the centre does."""
        self.run(self.client.publish(name, json.dumps(content).encode()))

    def report(self, unit: Unit, *verdicts: int, placed: bool = True) -> None:
        """Let a vehicle report, again as outboxes do, until the database has it."""
        data = unit.positions(verdicts, placed=placed)

        def is_stored() -> bool:
            self.send(unit.vehicle, data)
            time.sleep(0.1)
            query = "SELECT 1 FROM vehicle_now WHERE vehicle = %s AND sequence = %s"
            return bool(self.rows(query, unit.vehicle, unit.next - 1))

        eventually(is_stored)

    def send(self, vehicle: str, data: bytes) -> None:
        """Publish a batch as the vehicle does."""
        self.run(self.client.publish(subject(vehicle, BATCH), data))

    def wait_for(self, query: str, *values: object) -> None:
        """Wait until a query finds a row."""
        eventually(lambda: self.rows(query, *values))

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Ask the database as its owner."""
        with psycopg.connect(self.dsn, autocommit=True) as db:
            return db.execute(query.encode(), values).fetchall()

    def visitor(self, name: str) -> "Visitor":
        """Log in."""
        self.visitors.append(Visitor(self.address, name))
        return self.visitors[-1]


class Visitor:
    """Somebody who has logged in, as a program."""

    def __init__(self, address: str, name: str) -> None:
        self.http = httpx.Client(base_url=address, timeout=HANGS_S)
        answer = self.log_in(name)
        assert answer.status_code == 200, answer.text
        self.csrf = self.http.get("/api/session").json()["csrf"]

    def log_in(self, name: str, password: str = PASSWORD) -> httpx.Response:
        """Send name and password."""
        body = {"name": name, "password": password}
        return self.http.post("/api/login", json=body, headers={"X-OBU-CSRF": "login"})

    def get(self, path: str) -> httpx.Response:
        """Ask."""
        return self.http.get(path)

    def post(self, path: str, body: object) -> httpx.Response:
        """Change something."""
        return self.http.post(path, json=body, headers={"X-OBU-CSRF": self.csrf})


@contextmanager
def web(dsn: str, nats_url: str, *, ingest: bool = True, **more: Any) -> Iterator[RunningWeb]:
    """Run the pages, and an ingest, in a thread with a loop of its own."""
    port = free_port()
    passwords = dict.fromkeys(ROLES, "a password")
    let_in(dsn, passwords)
    as_process = {name: dsn_of_process(dsn, name, password) for name, password in passwords.items()}
    settings = WebSettings(
        as_process["web"],
        NatsAccess(nats_url),
        enrol_url="https://centre.example:8444",
        fingerprint=FINGERPRINT,
        port=port,
        **more,
    )
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    tasks = [asyncio.run_coroutine_threadsafe(serve(settings), loop)]
    if ingest:
        tasks.append(asyncio.run_coroutine_threadsafe(take_batches(NatsAccess(nats_url), as_process["ingest"]), loop))
    client = asyncio.run_coroutine_threadsafe(nats.connect(nats_url), loop).result(HANGS_S)
    running = RunningWeb(f"http://127.0.0.1:{port}", dsn, loop, client)
    try:
        eventually(lambda: answers(port) or tasks[0].done())
        if tasks[0].done():
            tasks[0].result()
        yield running
    finally:
        for visitor in running.visitors:
            visitor.http.close()
        asyncio.run_coroutine_threadsafe(client.close(), loop).result(HANGS_S)
        for task in tasks:
            task.cancel()
        deadline = time.monotonic() + 10.0
        while asyncio.run_coroutine_threadsafe(_others(), loop).result(HANGS_S) and time.monotonic() < deadline:
            time.sleep(0.02)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(HANGS_S)


async def _others() -> int:
    return len(asyncio.all_tasks()) - 1
