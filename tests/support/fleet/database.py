"""A real PostgreSQL with the schema of a centre, for tests."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest
from psycopg import sql

from fleet.database.migrate import migrate
from fleet.servers.postgres import DEBIAN, Postgres
from shared.errors import UserError

TABLES = (
    "SELECT tablename FROM pg_tables WHERE schemaname = 'public' "
    "AND tablename NOT IN ('spatial_ref_sys', 'alembic_version') AND NOT tablename LIKE 'segment\\_%'"
)


@contextmanager
def database() -> Iterator[Postgres]:
    """Run a server with the newest schema; where none is installed the test is skipped, and fails in CI."""
    if not list(DEBIAN.glob("*/bin/postgres")) and shutil.which("postgres") is None:
        missing("PostgreSQL")
    if not list(Path("/usr/share/postgresql").glob("*/extension/postgis.control")):
        missing("PostGIS")
    folder = Path(tempfile.mkdtemp(prefix="obu-pg-"))  # below a folder that the server's user may enter
    server = Postgres(folder / "postgres", 5432, durable=False)
    try:
        folder.chmod(0o755)
        server.start()
        migrate(server.dsn)
        yield server
    finally:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def emptied(server: Postgres) -> str:
    """Empty every table; return the DSN."""
    with psycopg.connect(server.dsn, autocommit=True) as db:
        names = [row[0] for row in db.execute(TABLES)]
        tables = sql.SQL(", ").join(map(sql.Identifier, names))
        db.execute(sql.SQL("TRUNCATE {} RESTART IDENTITY CASCADE").format(tables))
    return server.dsn


def missing(what: str) -> None:
    """Skip a test that needs a program; in CI that is a failure."""
    text = f"{what} is not installed; `make test` installs it on Debian"
    if os.environ.get("OBU_CI") == "1":
        raise UserError(text)
    pytest.skip(text)
