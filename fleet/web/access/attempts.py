"""Limits how often a password may be tried: for an account from an address, from an address, and for an account.

An account has so many free that nobody locks another person out from one address. Within a session it counts apart.
"""

from collections.abc import Sequence
from enum import IntEnum
from hashlib import sha256
from typing import NamedTuple

from fleet.database.retention import RETENTION_S
from shared.page.access.peer import place_of

from ..database import Database

FIRST_WAIT_S, MOST_WAIT_S = 2.0, 900.0
ENTER = "INSERT INTO attempt (origin) SELECT unnest(%s::bytea[]) ON CONFLICT DO NOTHING"
LOCK = f"""
SELECT origin, age_s, CASE WHEN age_s < {RETENTION_S} THEN failures ELSE 0 END AS failures
FROM (SELECT origin, failures, last FROM attempt WHERE origin = ANY(%s) ORDER BY origin FOR UPDATE) AS locked
CROSS JOIN LATERAL (SELECT extract(epoch FROM clock_timestamp() - last)::double precision AS age_s) AS since
"""
COUNT = f"""
UPDATE attempt SET last = clock_timestamp(),
    failures = CASE WHEN last > clock_timestamp() - interval '{RETENTION_S} s' THEN failures ELSE 0 END + 1
WHERE origin = ANY(%s)
"""
TAKE_BACK = "UPDATE attempt SET failures = greatest(failures - 1, 0) WHERE origin = ANY(%s)"
FORGET = "DELETE FROM attempt WHERE origin = ANY(%s)"


class FreeAttempts(IntEnum):
    """Failures that cost nothing."""

    ONE = 5  # of one person: an account from an address, or a session
    ADDRESS = 30  # which many may share
    ACCOUNT = 100  # from all addresses


class Origin(NamedTuple):
    """Whose failures are counted together."""

    name: str
    free: FreeAttempts


def origins(account: str, host: str) -> tuple[Origin, Origin, Origin]:
    """What a login is counted by: the person, the place, the account."""
    place = place_of(host)
    return (
        Origin(f"login of {account} from {place}", FreeAttempts.ONE),
        Origin(f"address {place}", FreeAttempts.ADDRESS),
        Origin(f"account {account}", FreeAttempts.ACCOUNT),
    )


class Attempts:
    """Failures by origin, in the database: processes share them, and a start forgets none.

    After the free ones each doubles the time until the next attempt is taken.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    async def begin(self, origins: Sequence[Origin]) -> float:
        """Count an attempt as a failure before it is made; returns the time [s] until it may be, 0: now.

        The rows are locked, so that of attempts beside each other no more pass than of attempts in turn. One that may
        not be made is not counted.
        """
        by_digest = {_digest(origin): origin for origin in origins}
        digests = sorted(by_digest)
        async with self._database.nobody() as cursor:
            await cursor.execute(ENTER, (digests,))
            await cursor.execute(LOCK, (digests,))
            rows = await cursor.fetchall()
            wait_s = max(_wait_s(row["failures"], row["age_s"], by_digest[row["origin"]].free) for row in rows)
            if wait_s <= 0.0:
                await cursor.execute(COUNT, (digests,))
        return max(wait_s, 0.0)

    async def succeeded(self, origins: Sequence[Origin]) -> None:
        """Forget the failures of a person, and take back the one that was counted at once of what others share."""
        given = sorted((_digest(origin), origin.free is FreeAttempts.ONE) for origin in origins)
        async with self._database.nobody() as cursor:
            await cursor.execute(LOCK, ([digest for digest, _ in given],))
            await cursor.execute(TAKE_BACK, ([digest for digest, is_one in given if not is_one],))
            await cursor.execute(FORGET, ([digest for digest, is_one in given if is_one],))


def _digest(origin: Origin) -> bytes:
    return sha256(origin.name.encode("utf-8", "surrogatepass")).digest()


def _wait_s(count: int, age_s: float, free: int) -> float:
    if count < free:
        return 0.0
    return min(FIRST_WAIT_S * 2.0 ** min(count - free, 20), MOST_WAIT_S) - age_s
