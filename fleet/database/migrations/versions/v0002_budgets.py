"""Budgets of tenants and their vehicles, and the alarm of who exceeds them."""

from alembic import op

revision = "0002"
down_revision = "0001"
UPGRADE = """
ALTER TABLE tenant ADD COLUMN vehicle_mb_day integer NOT NULL DEFAULT 50 CHECK (vehicle_mb_day BETWEEN 1 AND 1000000),
    ADD COLUMN mb_day integer NOT NULL DEFAULT 50000 CHECK (mb_day BETWEEN 1 AND 100000000);
GRANT SELECT (tenant_id, vehicle_mb_day, mb_day) ON tenant TO fleet_ingest;
ALTER TABLE alarm DROP CONSTRAINT alarm_kind_check,
    ADD CONSTRAINT alarm_kind_check CHECK (kind IN ('unsafe', 'gap', 'silent', 'signature', 'flood'));
"""


def upgrade() -> None:
    """Add them."""
    op.get_bind().connection.cursor().execute(UPGRADE)
