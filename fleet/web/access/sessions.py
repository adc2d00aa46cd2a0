"""Logins: a cookie of 32 random bytes, of which the database holds the SHA-256."""

import secrets
import time
from collections import OrderedDict
from dataclasses import dataclass
from hashlib import sha256

from ..database import Database
from .rights import Role, Visitor

COOKIE = "obu-centre"
STILL_VALID_S = 1.0  # between two looks at one session: a page asks for a dozen tiles at once
MAX_SESSIONS = 2000
SESSIONS_OF_ACCOUNT = 20
# Accounts and sessions are of all tenants until somebody has logged in: functions that give one row, and no table.
FIND_ACCOUNT = "SELECT * FROM login_account(%s)"
FIND_SESSION = "SELECT * FROM login_session(%s)"
ADD_SESSION = """
INSERT INTO session (token_hash, account_id, csrf, expires) VALUES (%s, %s, %s, now() + make_interval(secs => %s))
"""
TIDY = """
DELETE FROM session WHERE expires < now() OR token_hash IN (
    SELECT token_hash FROM session WHERE account_id = %s ORDER BY expires DESC OFFSET %s)
"""


@dataclass(frozen=True)
class Account:
    """An account that may log in."""

    account_id: int
    tenant_id: int
    name: str
    password: str
    role: Role


class Sessions:
    """Opens, finds and ends sessions."""

    def __init__(self, database: Database, session_s: float) -> None:
        self._database, self.session_s = database, session_s
        self._known: OrderedDict[bytes, tuple[float, Visitor | None]] = OrderedDict()

    async def account(self, name: str) -> Account | None:
        """The account of that name, if it may log in."""
        async with self._database.nobody() as cursor:
            row = await (await cursor.execute(FIND_ACCOUNT, (name,))).fetchone()
        if row is None:
            return None
        return Account(row["account_id"], row["tenant_id"], row["name"], row["password"], Role(row["role"]))

    async def open(self, account: Account) -> str:
        """Open a session; returns the value of its cookie."""
        secret = secrets.token_urlsafe(32)
        values = _hash(secret), account.account_id, secrets.token_urlsafe(32), self.session_s
        async with self._database.tenant(account.tenant_id) as cursor:
            await cursor.execute(ADD_SESSION, values)
            await cursor.execute(TIDY, (account.account_id, SESSIONS_OF_ACCOUNT))
        return secret

    async def find(self, cookie: str) -> Visitor | None:
        """The visitor of a cookie; the answer is at most a second old."""
        token_hash, now_s = _hash(cookie), time.monotonic()
        looked_s, visitor = self._known.get(token_hash, (-1e9, None))
        if now_s - looked_s < STILL_VALID_S:
            return visitor
        async with self._database.nobody() as cursor:
            row = await (await cursor.execute(FIND_SESSION, (token_hash,))).fetchone()
        visitor = None
        if row is not None:
            visitor = Visitor(
                row["account_id"], row["tenant_id"], row["tenant"], row["name"], Role(row["role"]), row["csrf"],
                token_hash,
            )  # fmt: skip
        self._known[token_hash] = now_s, visitor
        while len(self._known) > MAX_SESSIONS:
            self._known.popitem(last=False)
        return visitor

    async def end(self, visitor: Visitor) -> None:
        """End a session."""
        async with self._database.tenant(visitor.tenant_id) as cursor:
            await cursor.execute("DELETE FROM session WHERE token_hash = %s", (visitor.token_hash,))
        self.forget()

    def forget(self) -> None:
        """Look again at every session: an account was changed."""
        self._known.clear()


def _hash(cookie: str) -> bytes:
    return sha256(cookie.encode()).digest()
