"""Attempts to log in that failed."""

from alembic import op

revision = "0003"
down_revision = "0002"
UPGRADE = """
-- By the SHA-256 of who is counted: an account, an address, a session. It is of no tenant: who asks is not known yet.
CREATE TABLE attempt (
    origin bytea PRIMARY KEY, failures integer NOT NULL DEFAULT 0, last timestamptz NOT NULL DEFAULT clock_timestamp()
);
CREATE INDEX attempt_last ON attempt (last);
GRANT SELECT, INSERT, UPDATE, DELETE ON attempt TO fleet_web;
"""


def upgrade() -> None:
    """Make the table."""
    op.get_bind().connection.cursor().execute(UPGRADE)
