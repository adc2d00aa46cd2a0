"""Processes of a centre log in to the database as themselves, none of them as its owner."""

from collections.abc import Mapping

import psycopg
from psycopg import conninfo, sql

from .migrate import LOCK

ROLES = {name: f"fleet_{name}" for name in ("ingest", "admission", "alarms", "web")}
IDLE = "60s"  # after which a transaction that does nothing is ended: it would hold up the removal of old days


def let_in(dsn: str, passwords: Mapping[str, str]) -> None:
    """Let the processes log in with these passwords; needs the owner's DSN."""
    with psycopg.connect(dsn) as db:
        db.execute("SELECT pg_advisory_xact_lock(%s)", (LOCK,))
        for name, role in ROLES.items():
            # Hashed here, so that neither the server nor its log sees the password.
            hashed = db.pgconn.encrypt_password(passwords[name].encode(), role.encode(), b"scram-sha-256").decode()
            statement = sql.SQL("ALTER ROLE {} LOGIN PASSWORD {}")
            db.execute(statement.format(sql.Identifier(role), sql.Literal(hashed)))
            limit = sql.SQL("ALTER ROLE {} SET idle_in_transaction_session_timeout = {}")
            db.execute(limit.format(sql.Identifier(role), sql.Literal(IDLE)))


def dsn_of_process(dsn: str, name: str, password: str) -> str:
    """Give the DSN of a process, from that of the owner."""
    place = {word: value for word, value in conninfo.conninfo_to_dict(dsn).items() if word != "passfile"}
    return conninfo.make_conninfo("", **{**place, "user": ROLES[name], "password": password})
