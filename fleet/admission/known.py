"""Which certificates are valid, and which vehicle a revoked one belongs to, by the database."""

import psycopg

from .callout import JITTER, LIFE_S, PresentedCertificate

IS_VALID = "SELECT 1 FROM certificate WHERE vehicle = %s AND serial = %s AND kind = 'tls' AND revoked IS NULL"
# Older ones have no connection any more (callout.py).
REVOKED = "SELECT key_id, vehicle FROM certificate WHERE kind = 'tls' AND revoked > now() - make_interval(secs => %s)"
OPTIONS = "-c statement_timeout=4000"  # NATS waits for ten seconds
Row = tuple[object, ...]


class VehicleDatabase:
    """One connection to the database that is made again after it was lost."""

    def __init__(self, dsn: str) -> None:
        self._dsn = dsn
        self._db: psycopg.AsyncConnection | None = None

    async def is_valid(self, presented: PresentedCertificate) -> bool:
        """Whether a certificate is one of this centre and not revoked; raises errors of psycopg."""
        return bool(await self._ask(IS_VALID, presented))

    async def revoked(self) -> list[tuple[str, str]]:
        """TLS keys that were revoked while connections of theirs may last, with their vehicles; raises as above."""
        return [(str(key), str(vehicle)) for key, vehicle in await self._ask(REVOKED, (LIFE_S * (1 + JITTER),))]

    async def close(self) -> None:
        """End the connection."""
        if self._db is not None:
            await self._db.close()
        self._db = None

    async def _ask(self, query: str, values: tuple[object, ...]) -> list[Row]:
        try:
            return await self._once(query, values)
        except psycopg.OperationalError:  # the server was started anew since
            await self.close()
            return await self._once(query, values)

    async def _once(self, query: str, values: tuple[object, ...]) -> list[Row]:
        if self._db is None or self._db.closed:
            self._db = await psycopg.AsyncConnection.connect(
                self._dsn, autocommit=True, connect_timeout=4, options=OPTIONS
            )
        return await (await self._db.execute(query.encode(), values)).fetchall()
