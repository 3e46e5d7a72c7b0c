"""Which submissions are alike, for organizers."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "similarities",
        sa.Column("submission_id", sa.String(), sa.ForeignKey("submissions.id"), primary_key=True),
        sa.Column("alike", sa.Text(), nullable=False),
        sa.Column("compared_at", sa.DateTime(timezone=True), nullable=False),
    )


def downgrade() -> None:
    """Drop it."""
    op.drop_table("similarities")
