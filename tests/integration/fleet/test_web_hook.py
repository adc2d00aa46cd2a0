"""What a web hook is told, by real servers on loopback, and what a hostile one can do."""

import asyncio
import base64
import contextlib
import hashlib
import hmac
import json
import socket
import ssl
import time
from collections.abc import Awaitable, Callable
from ipaddress import ip_network
from pathlib import Path

import psycopg
import pytest

from fleet.alarms import web_hook
from fleet.alarms.signing import new_secret, signed_headers
from fleet.alarms.web_hook import AddressPolicy, WebHooks
from fleet.database.roles import ROLES, dsn_of_process, let_in
from tests.support.fleet.certificates import Authority
from tests.support.patience import HANGS_S

Serve = Callable[[bytes, asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"


class Hooks:
    """Servers by tenant, and the process that tells them."""

    def __init__(self, dsn: str, folder: Path) -> None:
        self.dsn, self.tenants, self._servers = dsn, list[int](), list[asyncio.Server]()
        authority = Authority()
        pem, certificate, key = authority.write(folder, "127.0.0.1")
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(certificate, key)
        self.trust = ssl.create_default_context(cafile=str(pem))
        let_in(dsn, dict.fromkeys(ROLES, "a password"))
        self.process = self.made()

    def made(self, **more: object) -> WebHooks:
        settings = {"trust": self.trust, "reach": AddressPolicy([ip_network("127.0.0.0/8")]), **more}
        return WebHooks(dsn_of_process(self.dsn, "alarms", "a password"), **settings)  # type: ignore[arg-type]

    async def serve(self, serve: Serve, scheme: str = "https") -> list[bytes]:
        """Serve a tenant of its own; gives the list of what it is sent."""
        seen = list[bytes]()

        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            head = await reader.readuntil(b"\r\n\r\n")
            size = int(head.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
            seen.append(head + await reader.readexactly(size))
            with contextlib.suppress(OSError):  # the process does not wait for the rest
                await serve(head, reader, writer)
            writer.transport.abort()

        context = self._context if scheme == "https" else None
        server = await asyncio.start_server(take, "127.0.0.1", 0, ssl=context)
        self._servers.append(server)
        port = server.sockets[0].getsockname()[1]
        with psycopg.connect(self.dsn) as db:
            row = db.execute(
                "INSERT INTO tenant (name, web_hook, web_hook_secret) VALUES (%s, %s, %s) RETURNING tenant_id",
                (f"tenant {port}", f"{scheme}://127.0.0.1:{port}/hook?from=centre", SECRET),
            ).fetchone()
        assert row is not None
        self.tenants.append(row[0])
        return seen

    async def close(self) -> None:
        for server in self._servers:
            server.close()
        await self.process.close()
        await asyncio.sleep(0.1)  # of the loop: sockets are closed

    def raise_alarm(self, tenant: int, vehicle: str = "car-1", since_ms: int = 1) -> None:
        with psycopg.connect(self.dsn) as db:
            db.execute(
                "INSERT INTO alarm (tenant_id, vehicle, kind, since_ms) VALUES (%s, %s, 'unsafe', %s)",
                (tenant, vehicle, since_ms),
            )

    def told(self) -> list[tuple[object, ...]]:
        with psycopg.connect(self.dsn) as db:
            return db.execute("SELECT vehicle FROM alarm WHERE hooked IS NOT NULL ORDER BY alarm_id").fetchall()


def answering(data: bytes) -> Serve:
    async def serve(_head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(data)
        await writer.drain()
        writer.write_eof() if writer.can_write_eof() else writer.close()
        await reader.read()

    return serve


answer_ok = answering(OK)


@pytest.fixture
def hooks(dsn: str, tmp_path: Path) -> Hooks:
    return Hooks(dsn, tmp_path)


def run(work: Awaitable[None]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(30.0):
            await work

    asyncio.run(bounded())


def test_an_alarm_is_told_once_with_what_the_contract_says(hooks: Hooks) -> None:
    async def work() -> None:
        seen = await hooks.serve(answer_ok)
        hooks.raise_alarm(hooks.tenants[0], "car-7", 12)
        await hooks.process.turn()
        await hooks.process.turn()
        assert len(seen) == 1 and seen[0].startswith(b"POST /hook?from=centre HTTP/1.1\r\nHost: 127.0.0.1:")
        content = json.loads(seen[0].split(b"\r\n\r\n", 1)[1])
        assert content == {"alarm_id": 1, "vehicle": "car-7", "kind": "unsafe", "since_ms": 12, "until_ms": None,
                           "late": False, "detail": {}}  # fmt: skip
        await hooks.close()

    run(work())
    assert hooks.told() == [("car-7",)]


def test_the_end_of_an_alarm_is_told_as_well_and_each_message_is_signed(hooks: Hooks) -> None:
    async def work() -> None:
        seen = await hooks.serve(answer_ok)
        hooks.raise_alarm(hooks.tenants[0], "car-7", 12)
        await hooks.process.turn()
        with psycopg.connect(hooks.dsn) as db:
            db.execute("UPDATE alarm SET until_ms = 20, ended = now()")
            over = "INSERT INTO alarm (tenant_id, vehicle, kind, since_ms, until_ms) VALUES (%s, 'car-8', 'gap', 1, 2)"
            db.execute(over, hooks.tenants)
        await hooks.process.turn()
        await hooks.process.turn()
        messages = [parsed(payload) for payload in seen]
        assert [(name, content["until_ms"]) for name, content in messages] == [
            ("alarm_1_raised", None), ("alarm_1_ended", 20), ("alarm_2_ended", 2),
        ]  # fmt: skip
        await hooks.close()

    run(work())


def parsed(message: bytes) -> tuple[str, dict[str, object]]:
    """Name and content of a message, whose signature and stamp are those of the secret and of now."""
    head, body = message.split(b"\r\n\r\n", 1)
    headers = dict(line.split(": ", 1) for line in head.decode().split("\r\n")[1:])
    name, stamp = headers["webhook-id"], headers["webhook-timestamp"]
    mac = hmac.new(base64.b64decode(SECRET[6:]), f"{name}.{stamp}.".encode() + body, hashlib.sha256).digest()
    assert headers["webhook-signature"] == "v1," + base64.b64encode(mac).decode()
    assert abs(time.time() - int(stamp)) < 60
    return name, json.loads(body)


def test_the_signature_is_that_of_the_specification() -> None:
    headers = signed_headers(SECRET, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert headers["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
    assert len(base64.b64decode(new_secret()[6:])) == 24 and new_secret() != new_secret()


def test_what_was_not_taken_is_told_again_after_a_pause_and_in_order(
    hooks: Hooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_hook, "RETRY_PERIOD_S", 0.3)
    answers = [b"HTTP/1.1 503 Busy\r\n\r\n", OK, OK]

    async def serve(head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await answering(answers.pop(0))(head, reader, writer)

    async def work() -> None:
        seen = await hooks.serve(serve)
        hooks.raise_alarm(hooks.tenants[0], "car-1")
        hooks.raise_alarm(hooks.tenants[0], "car-2")
        await hooks.process.turn()
        await hooks.process.turn()
        assert len(seen) == 1 and hooks.told() == [], "it waits"
        await asyncio.sleep(0.4)
        await hooks.process.turn()
        assert len(seen) == 3
        await hooks.close()

    run(work())
    assert hooks.told() == [("car-1",), ("car-2",)]


@pytest.mark.parametrize(
    "data",
    [
        b"HTTP/1.1 302 Found\r\nLocation: https://127.0.0.1:1/\r\n\r\n", b"", b"\r\n", b"SSH-2.0-x 200\r\n",
        b"x" * 200_000, b"HTTP/1.1 404 no\r\n\r\n", b"HTTP/1.1 \xff\r\n\r\n",
    ],
)  # fmt: skip
def test_what_is_no_answer_of_a_hook_is_not_taken_for_one(hooks: Hooks, data: bytes) -> None:
    async def work() -> None:
        seen = await hooks.serve(answering(data))
        hooks.raise_alarm(hooks.tenants[0])
        await hooks.process.turn()
        assert len(seen) == 1
        await hooks.close()

    run(work())
    assert hooks.told() == []


def test_an_answer_without_end_is_not_read_and_a_slow_hook_keeps_nobody_else_waiting(
    hooks: Hooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_hook, "TIMEOUT_S", 1.0)
    sent = 0

    async def endless(_head: bytes, _reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal sent
        writer.write(b"HTTP/1.1 200 OK\r\n\r\n")
        while not writer.is_closing():
            writer.write(b"x" * 65_536)
            sent += 65_536
            await writer.drain()

    async def dripping(_head: bytes, _reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while not writer.is_closing():  # who waited for its end would hang
            writer.write(b"H")
            await asyncio.sleep(0.1)

    async def work() -> None:
        for serve in (endless, dripping, answer_ok):
            await hooks.serve(serve)
        for number, tenant in enumerate(hooks.tenants):
            hooks.raise_alarm(tenant, f"car-{number}")
        await asyncio.wait_for(hooks.process.turn(), HANGS_S)
        await hooks.close()

    run(work())
    assert hooks.told() == [("car-0",), ("car-2",)]
    assert sent < 50_000_000


def test_a_hook_without_encryption_of_an_unknown_authority_or_on_this_machine_is_not_asked(hooks: Hooks) -> None:
    async def work() -> None:
        seen = [await hooks.serve(answer_ok), await hooks.serve(answer_ok, "http")]
        for process in (hooks.made(reach=AddressPolicy()), hooks.made(trust=ssl.create_default_context())):
            for tenant in hooks.tenants:
                hooks.raise_alarm(tenant, f"car-{tenant}-{len(hooks.told())}-{id(process)}")
            await process.turn()
            await process.close()
        assert seen == [[], []]
        await hooks.close()

    run(work())
    assert hooks.told() == []


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1", "127.9.9.9", "0.0.0.0", "0.1.2.3", "10.1.2.3", "172.16.0.1", "192.168.1.1", "100.64.0.1",
        "169.254.169.254", "192.0.2.7", "198.18.0.1", "224.0.0.1", "224.0.1.1", "240.0.0.1", "255.255.255.255", "::",
        "::1", "fe80::1%eth0", "fec0::1", "fd00::1", "ff02::1", "ff0e::1", "2001:db8::7", "::ffff:127.0.0.1",
        "::ffff:10.0.0.1", "::ffff:a00:1", "::10.0.0.1", "64:ff9b::10.0.0.1", "64:ff9b::7f00:1", "64:ff9b:1::1",
        "2002:a00:1::1", "2002:7f00:1::", "2001:0:a00:1::", "100::1",
    ],
)  # fmt: skip
def test_a_hook_is_in_the_public_network_or_in_one_that_the_operator_names(address: str) -> None:
    host = f"[{address}]" if ":" in address else address
    assert not AddressPolicy().allows(address)
    assert "web_hook_networks" in (AddressPolicy().why_not(f"https://{host.replace('%', '%25')}/hook") or "")


@pytest.mark.parametrize("address", ["93.184.216.34", "2606:2800:220:1::1", "::ffff:93.184.216.34", "64:ff9b::808:808"])
def test_a_hook_in_the_public_network_may_be_told(address: str) -> None:
    assert AddressPolicy().allows(address)


def test_networks_that_the_operator_names_are_reached_and_no_others() -> None:
    reach = AddressPolicy([ip_network("10.1.2.0/24"), ip_network("fd00:1::/32")])
    assert reach.allows("10.1.2.3") and reach.allows("::ffff:10.1.2.3") and reach.allows("fd00:1::9")
    assert not reach.allows("10.1.3.3") and not reach.allows("fd00:2::9") and not reach.allows("127.0.0.1")
    assert reach.why_not("https://10.1.2.3/hook") is None


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST.", "a.localhost", "127.0.0.1", "[::1]", "[::ffff:10.0.0.1]"])
def test_a_hook_that_is_seen_to_be_private_is_refused_when_it_is_set(host: str) -> None:
    assert AddressPolicy().why_not(f"https://{host}:8443/hook")


@pytest.mark.parametrize("answers", [["10.0.0.1"], ["::ffff:127.0.0.1", "fd00::1"], ["169.254.169.254"]])
def test_the_address_that_was_checked_is_the_one_that_is_used(hooks: Hooks, answers: list[str]) -> None:
    """A name that leads to a public address first, and to a private one when it is asked for again."""
    asked, connected = list[str](), list[str]()

    async def work() -> None:
        process = hooks.made(reach=AddressPolicy())
        loop = asyncio.get_running_loop()

        async def getaddrinfo(host: str, port: int, **_: object) -> list[tuple[object, ...]]:
            asked.append(host)
            found = ["93.184.216.34"] if len(asked) == 1 else answers
            return [(socket.AF_INET6 if ":" in name else socket.AF_INET, 1, 6, "", (name, port)) for name in found]

        async def open_connection(host: str, port: int, **_: object) -> None:
            connected.append(host)
            raise ConnectionRefusedError

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(loop, "getaddrinfo", getaddrinfo)
            patch.setattr(asyncio, "open_connection", open_connection)
            row = dict.fromkeys(("vehicle", "kind", "since_ms", "until_ms", "late", "detail"))
            row |= {"alarm_id": 1, "web_hook_secret": SECRET}
            with pytest.raises(ConnectionRefusedError):
                await process._post("https://hook.example/x", row)
            assert (asked, connected) == (["hook.example"], ["93.184.216.34"]), "the name is asked for once"
            with pytest.raises(ValueError, match="web_hook_networks"):
                await process._post("https://hook.example/x", row)
            assert connected == ["93.184.216.34"]

    run(work())


def test_a_redirect_is_not_followed(hooks: Hooks) -> None:
    async def work() -> None:
        other = await hooks.serve(answer_ok)
        with psycopg.connect(hooks.dsn) as db:
            (address,) = db.execute("SELECT web_hook FROM tenant").fetchone() or ("",)
        moved = f"HTTP/1.1 307 Moved\r\nLocation: {address}\r\nContent-Length: 0\r\n\r\n".encode()
        first = await hooks.serve(answering(moved))
        hooks.raise_alarm(hooks.tenants[1])
        await hooks.process.turn()
        assert (len(first), other) == (1, [])
        await hooks.close()

    run(work())
    assert hooks.told() == []
