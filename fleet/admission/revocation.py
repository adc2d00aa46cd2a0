"""Ends connections of vehicles whose key is revoked: at once when that is told, and by a look at the database.

The message is lost where NATS or this process is away at that moment; the row of the database is not.
"""

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Any

from nats.aio.client import Client
from nats.aio.msg import Msg

from shared.fleet.topics import REVOKED

log = logging.getLogger(__name__)

CONNECTIONS = "$SYS.REQ.SERVER.PING.CONNZ"
ANSWERS_S = 2.0  # in which every server of a cluster answers
MAX_ANSWERS = 64
POLL_PERIOD_S = 20.0  # between two looks at the database
RETRY_PERIOD_S = (
    1.5 * POLL_PERIOD_S
)  # a connection that was asked about before the revocation may be admitted after the first look
Revoked = Callable[[], Awaitable[list[tuple[str, str]]]]  # TLS keys of the last connections' life, with their vehicles


class Revocation:
    """Asks the servers, in the system's account, for connections of a vehicle, and has them ended."""

    def __init__(self, client: Client, system: Client, revoked: Revoked) -> None:
        self._client, self._system, self._revoked = client, system, revoked
        self._told = asyncio.Event()
        self._ended_s: dict[str, float] = {}  # keys, and when their connections were ended first

    async def run(self) -> None:
        """Work until cancelled."""
        await self._client.subscribe(REVOKED, cb=self._take)
        while True:
            self._told.clear()
            await self.look()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._told.wait(), POLL_PERIOD_S)

    async def look(self) -> None:
        """End the connections of keys that were revoked; what fails is tried again at the next look."""
        try:
            keys: dict[str, set[str]] = {}
            for key, vehicle in await self._revoked():
                keys.setdefault(vehicle, set()).add(key)
            known = set().union(*keys.values())
            self._ended_s = {key: at_s for key, at_s in self._ended_s.items() if key in known}
            for vehicle, of_vehicle in keys.items():
                now_s = time.monotonic()
                if any(now_s - self._ended_s.get(key, now_s) <= RETRY_PERIOD_S for key in of_vehicle):
                    await self.end(vehicle)
                    self._ended_s = dict.fromkeys(of_vehicle, now_s) | self._ended_s
        except Exception as error:  # noqa: BLE001  # of the database or of NATS: the next look is the remedy
            log.error("connections of a revoked vehicle are not ended, tried again in %d s: %s", POLL_PERIOD_S, error)

    async def _take(self, _message: Msg) -> None:
        self._told.set()

    async def end(self, vehicle: str) -> None:
        """End the connections of a vehicle; raises `TimeoutError` and errors of NATS."""
        for server, connection in await self._connections(vehicle):
            body = json.dumps({"cid": connection}).encode()
            await self._system.request(f"$SYS.REQ.SERVER.{server}.KICK", body, timeout=ANSWERS_S)
            log.info("ended a connection of %s, which is revoked", vehicle)

    async def _connections(self, vehicle: str) -> list[tuple[str, int]]:
        """Find server and number of each connection that was admitted by this name; raises `TimeoutError`."""
        inbox = self._system.new_inbox()
        answers = await self._system.subscribe(inbox, max_msgs=MAX_ANSWERS)
        question = json.dumps({"auth": True, "user": vehicle, "limit": 1024}).encode()
        await self._system.publish(CONNECTIONS, question, inbox)
        found, servers = list[tuple[str, int]](), 0
        with contextlib.suppress(TimeoutError):  # all that have answered by now
            async with asyncio.timeout(ANSWERS_S):
                async for message in answers.messages:
                    found += _connections_in(json.loads(message.data), vehicle)
                    servers += 1
        await answers.unsubscribe()
        if not servers:
            raise TimeoutError("no server of NATS has answered")
        return found


def _connections_in(answer: dict[str, Any], vehicle: str) -> list[tuple[str, int]]:
    server = str(answer["server"]["id"])
    connections = answer.get("data", {}).get("connections") or ()
    return [
        (server, int(connection["cid"])) for connection in connections if connection.get("authorized_user") == vehicle
    ]
