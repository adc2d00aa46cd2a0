"""Tells the web hooks of tenants which alarms were raised, and which have ended.

A tenant names an address, and this process reaches what its tenant does not: it is asked by HTTPS alone, at addresses
of the public network and those that the operator has named (`web_hook_networks`), no answer is followed, and nothing of
one is read but whether it was taken.
"""

import asyncio
import json
import logging
import socket
import ssl
import time
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address
from itertools import groupby
from typing import Any
from urllib.parse import quote, urlsplit

import psycopg
from psycopg.rows import dict_row

from .signing import signed_headers

log = logging.getLogger(__name__)

PERIOD_S = 1.0
TIMEOUT_S = 5.0  # of one alarm, from the name to the answer
TENANT_TURN_S = 10.0  # of one tenant, so that no other one waits for longer
RETRY_PERIOD_S = 60.0  # after a hook has not answered
RETRY_S = 5.0  # after the database could not be used
MAX_ADDRESS = 500  # characters of an address
MAX_ALARMS = 20  # alarms of a tenant a turn
FOR_HOURS = 24  # after which what could not be told is not tried any more
# An end is told where the beginning was; an alarm that ended before it could be told comes once, with both.
DUE = f"""
SELECT * FROM (
    SELECT alarm_id, tenant_id, vehicle, kind, since_ms, until_ms, late, detail, web_hook, web_hook_secret,
        row_number() OVER (PARTITION BY tenant_id ORDER BY coalesce(ended, raised), alarm_id) AS place
    FROM alarm JOIN tenant USING (tenant_id)
    WHERE web_hook_secret IS NOT NULL AND NOT tenant_id = ANY(%s) AND (
        hooked IS NULL AND raised > now() - interval '{FOR_HOURS} hours' OR
        hooked IS NOT NULL AND hooked_end IS NULL AND ended > now() - interval '{FOR_HOURS} hours')
) AS due WHERE place <= {MAX_ALARMS} ORDER BY tenant_id, place
"""
TOLD = """
UPDATE alarm SET hooked = coalesce(hooked, now()), hooked_end = CASE WHEN %(ended)s THEN now() END
WHERE alarm_id = %(alarm)s
"""
SET = "UPDATE tenant SET web_hook = %s, web_hook_secret = %s WHERE tenant_id = %s"
URL_SIGNS = "/%?:@!$&'()*+,;=~"  # that stay in a path and its query
PRIVATE = (
    "is not of the public network; name a server there, or have the operator of the centre name its network in "
    "web_hook_networks"
)
UNICAST = IPv6Network("2000::/3")  # what of IPv6 is public at all
TUNNELS = IPv6Network("2001::/32"), IPv6Network("2002::/16")  # Teredo and 6to4 lead to any address of IPv4
OF_IPV4 = IPv6Network("::/96"), IPv6Network("::ffff:0:0/96"), IPv6Network("64:ff9b::/96")
Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network
Row = dict[str, Any]


def is_web_hook(address: str) -> bool:
    """Whether an address can be a web hook: https, and without user and password, which would be in the audit."""
    try:
        parts = urlsplit(address)
        port = parts.port or 443
    except ValueError:
        return False
    fits = len(address) <= MAX_ADDRESS and parts.scheme == "https" and bool(parts.hostname)
    return fits and "@" not in parts.netloc and port > 0


class AddressPolicy:
    """Which IP addresses web hooks may have: public ones, and those of networks that the operator names."""

    def __init__(self, networks: Sequence[Network] = ()) -> None:
        self._networks = tuple(networks)

    def allows(self, address: str) -> bool:
        """Whether an IP address may be connected to; of one that stands for an address of IPv4, that counts."""
        ip = inner(ip_address(address.partition("%")[0]))
        return is_public(ip) or any(ip in network for network in self._networks)

    def why_not(self, web_hook: str) -> str | None:
        """Why an address cannot be a web hook; None: it can, as far as is seen without asking for its name."""
        if not is_web_hook(web_hook):
            return "a web hook is an address that begins with https://, without user and password"
        host = (urlsplit(web_hook).hostname or "").rstrip(".")
        try:
            is_allowed = self.allows(host)
        except ValueError:
            is_allowed = host != "localhost" and not host.endswith(".localhost")
        return None if is_allowed else f"{host} {PRIVATE}"


def inner(ip: Address) -> Address:
    """The address of IPv4 that one of IPv6 leads to: mapped, compatible, or by NAT64 (RFC 6052); else itself."""
    if isinstance(ip, IPv6Address) and any(ip in network for network in OF_IPV4):
        return IPv4Address(int(ip) & 0xFFFF_FFFF)
    return ip


def is_public(ip: Address) -> bool:
    """Whether an address is one of the public network, by the registries of IANA."""
    if isinstance(ip, IPv6Address) and (ip not in UNICAST or any(ip in network for network in TUNNELS)):
        return False
    return ip.is_global and not (ip.is_multicast or ip.is_reserved or ip.is_unspecified)


class WebHooks:
    """Asks the database each second what is due; `trust` is for tests."""

    def __init__(self, dsn: str, reach: AddressPolicy, trust: ssl.SSLContext | None = None) -> None:
        self._dsn = dsn
        self._trust, self._reach = trust or ssl.create_default_context(), reach
        self._db: psycopg.AsyncConnection | None = None
        self._waiting: dict[int, float] = {}  # until when [s], by tenant

    async def run(self) -> None:
        """Work until cancelled."""
        try:
            while True:
                try:
                    await self.turn()
                    await asyncio.sleep(PERIOD_S)
                except psycopg.Error as error:
                    log.error("web hooks are not told, the database cannot be used: %s", error)
                    await self.close()
                    await asyncio.sleep(RETRY_S)
        finally:
            await self.close()

    async def turn(self) -> None:
        """Tell what is due, each tenant beside the others; raises errors of psycopg."""
        if self._db is None or self._db.closed:
            self._db = await psycopg.AsyncConnection.connect(self._dsn, autocommit=True, connect_timeout=5)
        now_s = asyncio.get_running_loop().time()
        self._waiting = {tenant: until_s for tenant, until_s in self._waiting.items() if until_s > now_s}
        async with self._db.cursor(row_factory=dict_row) as cursor:
            rows = await (await cursor.execute(DUE, (list(self._waiting),))).fetchall()
        tenants = [(tenant, list(some)) for tenant, some in groupby(rows, lambda row: int(row["tenant_id"]))]
        await asyncio.gather(*(self._tell(self._db, *tenant) for tenant in tenants))

    async def close(self) -> None:
        """End the connection."""
        if self._db is not None:
            await self._db.close()
        self._db = None

    async def _tell(self, db: psycopg.AsyncConnection, tenant: int, rows: list[Row]) -> None:
        """Tell the alarms of a tenant in their order; one that is not taken lets the others wait."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        for row in rows:
            if loop.time() - begun_s > TENANT_TURN_S:
                return
            try:
                async with asyncio.timeout(TIMEOUT_S):
                    await self._post(row["web_hook"], row)
            except (OSError, ValueError, asyncio.LimitOverrunError, EOFError) as error:
                log.warning("a web hook of tenant %d is tried again for %d h: %s", tenant, FOR_HOURS,
                            str(error) or type(error).__name__)  # fmt: skip
                self._waiting[tenant] = loop.time() + RETRY_PERIOD_S
                return
            await db.execute(TOLD, {"alarm": row["alarm_id"], "ended": row["until_ms"] is not None})

    async def _post(self, address: str, row: Mapping[str, Any]) -> None:
        """Send an alarm; raises `OSError`, `ValueError` and what a stream raises if it was not taken."""
        parts = urlsplit(address)
        if not is_web_hook(address) or parts.hostname is None:
            raise ValueError("its address does not begin with https://; change it on the page Alarms")
        names = ("alarm_id", "vehicle", "kind", "since_ms", "until_ms", "late", "detail")
        body = json.dumps({name: row[name] for name in names}).encode()
        path = quote(parts._replace(scheme="", netloc="", fragment="").geturl() or "/", safe=URL_SIGNS)
        message = f"alarm_{row['alarm_id']}_{'raised' if row['until_ms'] is None else 'ended'}"
        headers = {
            "Host": parts.netloc, "Content-Type": "application/json", "Content-Length": len(body),
            "User-Agent": "obu-centre", "Connection": "close",
            **signed_headers(row["web_hook_secret"], message, int(time.time()), body),
        }  # fmt: skip
        lines = [f"POST {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items()), "", ""]
        ip, port = await self._resolved(parts.hostname, parts.port or 443)
        reader, writer = await asyncio.open_connection(ip, port, ssl=self._trust, server_hostname=parts.hostname)
        try:
            writer.write("\r\n".join(lines).encode("ascii") + body)
            await writer.drain()
            words = (await reader.readuntil(b"\n")).split()
            if len(words) < 2 or not words[0].startswith(b"HTTP/1.") or not words[1].startswith(b"2"):
                raise ValueError(f"it answered {b' '.join(words[:2])[:40]!r}, and not 2xx")
        finally:
            writer.transport.abort()  # the rest of an answer is not waited for

    async def _resolved(self, host: str, port: int) -> tuple[str, int]:
        """Find an IP address that may be connected to: it is checked and used, so that no name can change between."""
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        for *_, place in found:
            if self._reach.allows(str(place[0])):
                return str(place[0]), int(place[1])
        raise ValueError(f"its name leads to an address that {PRIVATE}")
