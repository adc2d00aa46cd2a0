"""The first schema."""

from pathlib import Path

from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make tables, policies, roles and functions."""
    text = Path(__file__).with_name("0001_first.sql").read_text(encoding="utf-8")
    op.get_bind().connection.cursor().execute(text)  # by the driver itself: the text holds several statements, and %
