"""Judges once a second, publishes alarms after their commit, and tells web hooks beside that."""

import asyncio
import json
import logging
import time

import nats
import psycopg
from nats.aio.client import Client
from nats.aio.msg import Msg

from fleet.bus import closed, connected
from fleet.database.refusals import reason_of
from fleet.servers.nats import NatsAccess
from shared.fleet.topics import ALARM, CHANGED

from .judge import Row, judge
from .late import DAY_S, judge_late
from .web_hook import AddressPolicy, WebHooks

log = logging.getLogger(__name__)

PERIOD_S = 1.0
SLOW_PERIOD_S, LATE_BACK_S = 10.0, 60.0  # a transaction of ingest is seen some time after it has begun
RETRY_S = 5.0  # after the database could not be used
INGEST_TIMEOUT_S = 35.0  # without a word of any ingest, which says something every ten seconds


class Alarms:
    """Works on one connection to the database."""

    def __init__(self, dsn: str) -> None:
        self._dsn = dsn
        self._db: psycopg.Connection | None = None
        self._slow_s = 0.0  # when what reads much is due
        self._back_s = float(DAY_S)
        self.deaf()

    def deaf(self) -> None:
        """Note that nothing is heard of vehicles now."""
        self._hears_since_ms = time.time_ns() // 1_000_000

    def turn(self) -> list[Row]:
        """Judge once; raises errors of psycopg, after which the next turn connects again."""
        now_ms, now_s = time.time_ns() // 1_000_000, time.monotonic()
        try:
            if self._db is None or self._db.closed:
                self._db = psycopg.connect(self._dsn, autocommit=True, connect_timeout=5)
            is_slow = now_s >= self._slow_s
            changed = judge(self._db, now_ms, self._hears_since_ms, finds_missing=is_slow)
            if is_slow:
                changed += judge_late(self._db, now_ms, self._back_s)
                self._slow_s, self._back_s = now_s + SLOW_PERIOD_S, LATE_BACK_S
        except psycopg.Error:
            self.close()
            self._back_s = float(DAY_S)
            self.deaf()
            raise
        return changed

    def close(self) -> None:
        """End the connection."""
        if self._db is not None:
            self._db.close()
        self._db = None


async def serve(server: NatsAccess, dsn: str, reach: AddressPolicy) -> None:
    """Work until cancelled; `reach` says where web hooks may be."""
    client = await connected(server, "alarms")
    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(_judge(client, Alarms(dsn)))
            group.create_task(WebHooks(dsn, reach).run())
    finally:
        await closed(client)


async def _judge(client: Client, alarms: Alarms) -> None:
    heard_s = time.monotonic() - INGEST_TIMEOUT_S

    async def take(_message: Msg) -> None:
        nonlocal heard_s
        heard_s = time.monotonic()

    await client.subscribe(CHANGED, cb=take)
    try:
        while True:
            if time.monotonic() - heard_s >= INGEST_TIMEOUT_S:
                alarms.deaf()
            try:
                for row in await asyncio.to_thread(alarms.turn):
                    await client.publish(ALARM, json.dumps(row).encode())
                await asyncio.sleep(PERIOD_S)
            except psycopg.Error as error:
                log.error("the database cannot be used: %s", reason_of(error))
                await asyncio.sleep(RETRY_S)
            except nats.errors.Error as error:  # open pages are not told: they ask the database every ten seconds
                log.warning("alarms are not told to open pages: %s", error)
    finally:
        alarms.close()
