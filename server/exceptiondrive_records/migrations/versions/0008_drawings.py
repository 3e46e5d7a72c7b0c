"""Drawings of entries on public splits, and of protocols."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the tables, and the index that lets drawings refer to public splits alone."""
    op.create_index(
        "uq_splits_public", "splits", ["name", "revision", "public_file_digest"], unique=True
    )
    op.create_table(
        "entry_drawings",
        sa.Column("submission_id", sa.String(), nullable=False),
        sa.Column("protocol_digest", sa.String(), nullable=False),
        sa.Column("split_revision", sa.String(), nullable=False),
        sa.Column("split_name", sa.String(), nullable=False),
        sa.Column("public_file_digest", sa.String(), nullable=False),
        sa.Column("drawings", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("submission_id", "protocol_digest", "split_revision"),
        sa.ForeignKeyConstraint(
            ["submission_id", "protocol_digest", "split_revision"],
            [
                "score_sheets.submission_id",
                "score_sheets.protocol_digest",
                "score_sheets.split_revision",
            ],
        ),
        sa.ForeignKeyConstraint(
            ["split_name", "split_revision", "public_file_digest"],
            ["splits.name", "splits.revision", "splits.public_file_digest"],
        ),
    )
    op.create_table(
        "protocol_drawings",
        sa.Column("pictured", sa.String(), primary_key=True),
        sa.Column("drawing", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("protocol_drawings")
    op.drop_table("entry_drawings")
    op.drop_index("uq_splits_public", "splits")
