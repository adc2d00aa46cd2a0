"""Connections to the database; each transaction sees one tenant alone, by row-level security."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import psycopg
from fastapi import HTTPException
from psycopg.rows import TupleRow, dict_row

from fleet.database.refusals import reason_of

log = logging.getLogger(__name__)

CONNECTIONS = 6
WAIT_TIMEOUT_S = 5.0  # for a free connection
STATEMENT_MS = 8000
OPTIONS = f"-c role=fleet_web -c statement_timeout={STATEMENT_MS} -c lock_timeout=2000 -c jit=off"
AWAY = "the database cannot be used now; what vehicles report is stored when it is back. Try again"
# What is shown of an event: a vehicle may sign one of 262 kB, and pages list hundreds.
MAX_CONTENT = 8192  # bytes
CONTENT = f"""CASE WHEN octet_length(content::text) <= {MAX_CONTENT} THEN content
    ELSE jsonb_build_object('left_out', octet_length(content::text) || ' bytes') END AS content"""
Row = dict[str, Any]
Cursor = psycopg.AsyncCursor[Row]
_Connection = psycopg.AsyncConnection[TupleRow]


class Database:
    """A few connections that are made when they are needed, and again after they were lost."""

    def __init__(self, dsn: str, connections: int = CONNECTIONS) -> None:
        self._dsn = dsn
        self._free: asyncio.LifoQueue[_Connection | None] = asyncio.LifoQueue()
        for _ in range(connections):
            self._free.put_nowait(None)

    @asynccontextmanager
    async def tenant(self, tenant_id: int) -> AsyncIterator[Cursor]:
        """Give a cursor in a transaction that sees this tenant; raises `HTTPException` 503 without a database."""
        async with self._transaction(str(tenant_id)) as cursor:
            yield cursor

    @asynccontextmanager
    async def nobody(self) -> AsyncIterator[Cursor]:
        """Give a cursor in a transaction of no tenant, for the functions of the login."""
        async with self._transaction("") as cursor:
            yield cursor

    async def close(self) -> None:
        """End what is open."""
        while not self._free.empty():
            connection = self._free.get_nowait()
            if connection is not None:
                await connection.close()

    @asynccontextmanager
    async def _transaction(self, tenant: str) -> AsyncIterator[Cursor]:
        try:
            connection = await asyncio.wait_for(self._free.get(), WAIT_TIMEOUT_S)
        except TimeoutError as error:
            raise HTTPException(503, "the centre is busy; try again", {"Retry-After": "5"}) from error
        try:
            if connection is None or connection.closed:
                connection = await psycopg.AsyncConnection.connect(
                    self._dsn, options=OPTIONS, connect_timeout=5, autocommit=True
                )
            async with connection.transaction(), connection.cursor(row_factory=dict_row) as cursor:
                await cursor.execute("SELECT set_config('fleet.tenant', %s, true)", (tenant,))
                yield cursor
        except psycopg.OperationalError as error:
            if isinstance(error, psycopg.errors.QueryCanceled):
                raise HTTPException(503, "the database took too long; narrow the question, or try again") from error
            log.warning("the database cannot be used: %s", reason_of(error))
            raise HTTPException(503, AWAY, {"Retry-After": "5"}) from error
        except psycopg.DataError as error:
            raise HTTPException(422, "a value of the request cannot be looked for; change it") from error
        finally:
            if connection is not None and connection.broken:
                await connection.close()
                connection = None
            self._free.put_nowait(connection)
