"""Brings the schema of a database up to this version."""

from pathlib import Path

import psycopg
from alembic import command
from alembic.config import Config
from sqlalchemy import create_engine
from sqlalchemy.pool import NullPool

MIGRATIONS = Path(__file__).with_name("migrations")
LOCK = 2400  # of the migrations, so that two processes that start together do not make the tables twice


def migrate(dsn: str) -> None:
    """Apply the migrations that are missing; raises errors of psycopg and SQLAlchemy."""
    engine = create_engine("postgresql+psycopg://", creator=lambda: psycopg.connect(dsn), poolclass=NullPool)
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    with psycopg.connect(dsn, autocommit=True) as guard:
        if (encoding := guard.info.parameter_status("server_encoding")) != "UTF8":
            raise psycopg.NotSupportedError(
                f"the database has the encoding {encoding}; make another with `createdb -E UTF8 -T template0`"
            )
        guard.execute("SELECT pg_advisory_lock(%s)", (LOCK,))
        with engine.connect() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
            connection.commit()
