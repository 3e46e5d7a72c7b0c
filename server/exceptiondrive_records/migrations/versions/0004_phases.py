"""Phases: how many submissions of a team may wait at once. Receipts: the public keys."""

import sqlalchemy as sa
from alembic import op

from exceptiondrive_records.columns import UtcDateTime

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make column and table."""
    op.add_column("phases", sa.Column("quota_concurrent", sa.Integer(), nullable=True))
    op.create_table(
        "receipt_keys",
        sa.Column("key_id", sa.String(), nullable=False),
        sa.Column("public_key", sa.String(), nullable=False),
        sa.Column("first_used_at", UtcDateTime(), nullable=False),
        sa.PrimaryKeyConstraint("key_id"),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("receipt_keys")
    op.drop_column("phases", "quota_concurrent")
