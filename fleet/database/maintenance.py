"""Brings the database up to date, makes partitions ahead and removes what is older than tenants keep, every day."""

import asyncio
import logging
from collections.abc import Mapping

import psycopg
from sqlalchemy.exc import SQLAlchemyError

from .migrate import migrate
from .refusals import reason_of
from .retention import make_days, retain
from .roles import let_in

log = logging.getLogger(__name__)

FIRST_TENANT = "demo"
PERIOD_S = 6 * 3600.0
RETRY_PERIOD_S = 60.0  # after a failure


def prepare(dsn: str, passwords: Mapping[str, str]) -> None:
    """Give the database its newest schema, the users of the processes and a first tenant; raises errors of psycopg."""
    migrate(dsn)
    let_in(dsn, passwords)
    with psycopg.connect(dsn) as db:
        if not db.execute("SELECT FROM tenant LIMIT 1").fetchone():
            db.execute("INSERT INTO tenant (name) VALUES (%s) ON CONFLICT DO NOTHING", (FIRST_TENANT,))
    make_days(dsn)


async def serve(dsn: str, passwords: Mapping[str, str]) -> None:
    """Work until cancelled; the database may come later, or be away for a time."""
    while True:
        try:
            await asyncio.to_thread(prepare, dsn, passwords)
            removed = await asyncio.to_thread(retain, dsn)
        except (psycopg.Error, SQLAlchemyError) as error:
            log.error("the database is tried again in a minute: %s", reason_of(error))
            await asyncio.sleep(RETRY_PERIOD_S)
            continue
        if removed.days or removed.rows:
            log.info("removed %d days and %d further rows, which no tenant keeps", *removed)
        await asyncio.sleep(PERIOD_S)
